"""Simulated user of the console page, in a real browser: holds a jog button, previews a goal, moves
the arm there, and takes pictures of the page."""

from __future__ import annotations

import json
import math
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

from cardan.demos.demo import choose_demo, find_problems, simulated_hardware
from cardan.demos.pauses import Pauses
from cardan.errors import CardanError, DriverError
from cardan.gateway.session.session import EXIT_OK
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor import supervise
from cardan.gateway.session.with_server import with_server
from tests.console.browser import Tab, chromium

WIDE, NARROW = (1120, 720), (360, 740)
"""Screen sizes in CSS pixels: a notebook and a small phone."""

JOGGED_MM = 40.0
"""Least distance of a jog while its button is held."""

RAISED_MM = 60.0
"""Upward distance from the arm's pose to the goal; this space is free of obstacles."""

MISSED_MM = 2.0
"""Allowed distance between the arm at rest and its goal: the page releases the arm once it is
within 0.5 mm."""

REST_S = 30.0
"""Longest time from the end of a hold until the page shows that the arm rests."""

LOOK_S = 0.05
"""Period of looking at the page during a hold."""

SETTLED_S = 0.5
"""An arm whose position has not changed for this time is at rest."""

STILL_S = 2.0
"""Wait before a picture is taken: without a graphics card the page draws the arm finely only after
some time at rest."""

_Say = Callable[[str], None]


class OverError(Exception):
    """The session has ended, or its time is over."""


def use_console(
    browser: str, folder: Path, seconds: float, say: _Say = print, still_s: float = STILL_S
) -> tuple[Snapshot, list[str]]:
    """Run the console example and a user of its page in the program `browser`, for at most
    `seconds`. `say` receives progress messages. Pictures of the page are written to `folder`, each
    `still_s` after the page shows its subject. Returns the session's last snapshot and a list of
    problems."""
    with simulated_hardware(choose_demo("console"), seconds) as (config, _):
        assert config.network is not None
        with with_server("console", config.network, "127.0.0.1", 0) as server, Pauses() as pauses:
            over = threading.Event()
            person = Person(server.endpoint, folder, say, over, still_s)
            thread = threading.Thread(target=person.work, args=(browser,), daemon=True)
            thread.start()
            try:
                outcome = supervise(config, seconds, poll=thread.is_alive)
            finally:
                over.set()
                thread.join()
    if outcome.exit_code != EXIT_OK:
        return outcome.last, [f"the session failed: {outcome.last.error}"]
    found = find_problems(outcome.last, paused_s=pauses.longest_s)
    return outcome.last, person.problems() + found


class Person:
    """Simulated user of the page, until `over` is set."""

    def __init__(
        self, address: str, folder: Path, say: _Say, over: threading.Event, still_s: float = STILL_S
    ) -> None:
        self.done: list[str] = []
        """Completed steps."""
        self._address, self._folder, self._say, self._over = address, folder, say, over
        self._still_s = still_s
        self._failed = ""
        self._shown = ""
        """Reason for no motion that the page showed when the time was over."""

    def problems(self) -> list[str]:
        """List the steps that failed."""
        missing = [each for each in ("jogged", "at rest", "at the goal") if each not in self.done]
        if self._failed:
            return [f"at the page: {self._failed}"]
        return [f"at the page the arm was never {each}; it says: {self._shown}" for each in missing]

    def work(self, browser: str) -> None:
        """Open the page and carry out all steps."""
        try:
            with (
                tempfile.TemporaryDirectory(
                    prefix="cardan-chromium-", ignore_cleanup_errors=True
                ) as profile,
                chromium(browser, Path(profile)) as running,
                running.open(self._address, *WIDE) as tab,
            ):
                try:
                    self._use(tab)
                except OverError:
                    self._shown = str(tab.value("document.querySelector('.why').textContent"))
        except (CardanError, RuntimeError, OSError) as error:
            if not self._over.is_set():
                self._failed = str(error)

    def _use(self, tab: Tab) -> None:
        self._wait(tab, "document.querySelectorAll('.joint-jog').length > 0")
        self._wait(tab, "document.querySelector('.readout').textContent.startsWith('X ')")
        self._say("the page shows the arm")
        self._jog(tab)
        self._go(tab)
        self._look_around(tab)

    def _jog(self, tab: Tab) -> None:
        """Hold X+ until the arm has moved far enough. A busy computer sometimes ends a hold,
        correctly; the hold is then repeated."""
        tab.click("#tab-move")
        tab.value("document.activeElement.blur()")
        began = self._position(tab)
        self._hold(
            tab,
            'button[aria-label="X+"]',
            lambda: math.dist(began, self._position(tab)) >= JOGGED_MM,
            "move",
        )
        far = math.dist(began, self._position(tab))
        self.done.append("jogged")
        self._say(f"X+ was held: the TCP went {far:.1f} mm")
        self._rest(tab)

    def _go(self, tab: Tab) -> None:
        """Preview a goal, and hold its button until the arm has arrived."""
        tab.click("#tab-goal")
        x, y, z = self._position(tab)
        goal = (x, y, z + RAISED_MM)
        if tab.value("document.body.dataset.state") != "watching":
            tab.click(".enable")
        tab.value(
            "(slider => { slider.value = " + json.dumps(goal[2]) + ";"
            "slider.dispatchEvent(new Event('input', {bubbles: true})); })"
            "(document.querySelector('#panel-goal input[type=range][aria-label=\"Z\"]'))"
        )
        self._wait(tab, "document.querySelector('.verdict').dataset.kind === 'ok'")
        verdict = tab.value("document.querySelector('.verdict').textContent")
        self._say(f"a goal {RAISED_MM:.0f} mm above: {verdict}")
        self._photograph(tab, "goal")
        self._enable(tab)
        self._wait(tab, "!document.querySelector('.send').disabled")
        while "at the goal" not in self.done:
            self._hold(tab, ".send", lambda: math.dist(goal, self._position(tab)) <= MISSED_MM)
            self._rest(tab)
            missed = math.dist(goal, self._position(tab))
            self._say(f"it was held until the arm was there, and rests {missed:.1f} mm from it")
            # A page that gets reports late releases late; hold the button again in that case.
            if missed <= MISSED_MM:
                self.done.append("at the goal")

    def _look_around(self, tab: Tab) -> None:
        """Take pictures of the other panels, and of the page on a phone."""
        tab.click(".enable")
        for word in ("plots", "device", "setup"):
            tab.click(f"#tab-{word}")
            self._photograph(tab, word)
        tab.click("#tab-move")
        tab.resize(*NARROW)
        self._photograph(tab, "phone")

    def _hold(self, tab: Tab, selector: str, enough: Callable[[], bool], picture: str = "") -> None:
        """Hold a control until `enough()`; take `picture`, if it has a name, during the motion."""
        while not enough():
            self._check_time()
            self._enable(tab)
            at = tab.center(selector)
            tab.mouse("mousePressed", at)
            try:
                while tab.value("document.body.dataset.state") == "held" and not enough():
                    self._check_time()
                    if (
                        picture
                        and tab.value("document.querySelector('.why').dataset.level") == "ok"
                    ):
                        tab.photograph(self._folder / f"console-{picture}.png")
                        picture = ""
                    time.sleep(LOOK_S)
            finally:
                tab.mouse("mouseReleased", at)

    def _enable(self, tab: Tab) -> None:
        """Re-arm."""
        self._wait(tab, "!document.querySelector('.enable').disabled")
        if tab.value("document.body.dataset.state") == "watching":
            tab.click(".enable")
        self._wait(tab, "document.body.dataset.state !== 'watching'")

    def _rest(self, tab: Tab) -> None:
        """Check that the arm soon comes to rest and stays there."""
        end_s = time.monotonic() + REST_S
        before = self._position(tab)
        while time.monotonic() < end_s:
            self._check_time()
            time.sleep(SETTLED_S)
            now = self._position(tab)
            if now == before:
                self.done.append("at rest")
                return
            before = now
        raise DriverError(f"the arm moved on for {REST_S:g} s after it was let go of")

    def _position(self, tab: Tab) -> tuple[float, float, float]:
        """TCP position that the page shows, mm."""
        words = str(tab.value("document.querySelector('.readout').textContent")).split()
        try:
            x, y, z = (float(words[words.index(axis) + 1]) for axis in ("X", "Y", "Z"))
        except (ValueError, IndexError):
            raise DriverError(f"the page shows no position: {' '.join(words)!r}") from None
        return x, y, z

    def _photograph(self, tab: Tab, name: str) -> None:
        self._check_time()
        time.sleep(self._still_s)
        tab.photograph(self._folder / f"console-{name}.png")

    def _wait(self, tab: Tab, expression: str) -> None:
        while not tab.value(expression):
            self._check_time()
            time.sleep(LOOK_S)

    def _check_time(self) -> None:
        if self._over.is_set():
            raise OverError
