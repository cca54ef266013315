"""Latency from a press on the page to the first EGM datagram that moves the robot, on one
computer."""

from __future__ import annotations

import contextlib
import random
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from bench.network.clients import server
from cardan.demos.examples import free_ports
from studies.cartesian.controller import session
from studies.cartesian.sessions import (
    MODEL,
    PERIOD_S,
    Robot,
    as_a_controller,
    free_endpoint,
    network_table,
    quantile,
)
from tests.console.browser import Tab, chromium, find_chromium
from tests.console.page_input import FINGER, RELOADED, STATE, enable, jog

AIMS_S = (0.015, 0.040)
"""Limits for the median and the p99."""

PRESSES = 200
LONGEST_S = 1.0
"""Timeout of a press: without motion by then it was refused, e.g. because the browser had
stalled."""
REST_S = 0.3
"""Minimum rest of the arm before the next press."""

STILL_RAD = 1e-9

BROWSERS = {
    "no 3D picture": ["--disable-3d-apis"],
    "3D picture drawn by the processor": [],
}
"""Chromium flags of each case. Without a graphics card, drawing the picture takes processor time
from everything else, which computers with one do not show."""

PRESSED = """
window.pressed = [];
addEventListener("pointerdown", (e) => e.isTrusted && window.pressed.push(e.timeStamp), true);
"""


class Delays(NamedTuple):
    """Delays of one browser."""

    delays_s: list[float]
    lost: int
    """Presses that moved nothing."""
    uncertain_s: float
    """Uncertainty of the page's clock."""


class Controller(threading.Thread):
    """A robot that obeys, and records the times of commands to move."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(daemon=True)
        self._robot, self._over = robot, threading.Event()
        self._lock = threading.Lock()
        self._moves: list[float] = []
        """Times of datagrams whose commanded position differs from the previous one, monotonic
        s."""

    def run(self) -> None:
        with as_a_controller():
            slot_s = time.monotonic()
            while not self._over.is_set():
                before = self._robot.place.joints
                self._robot.ask()
                now_s = time.monotonic()
                after = self._robot.place.joints
                if before and after and _apart(before, after) > STILL_RAD:
                    with self._lock:
                        self._moves.append(now_s)
                slot_s = max(slot_s + PERIOD_S, now_s)
                time.sleep(max(0.0, slot_s - time.monotonic()))

    def end(self) -> None:
        """Stop the robot's thread."""
        self._over.set()
        self.join()

    def first_move(self, since_s: float) -> float | None:
        """Return the time of the first command that moves the robot at or after `since_s`; None: no
        such command."""
        with self._lock:
            return next((each for each in self._moves if each >= since_s), None)

    def rests(self) -> bool:
        """Return True if no command to move came within the last REST_S."""
        with self._lock:
            return not self._moves or time.monotonic() - self._moves[-1] > REST_S


def _apart(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    return max(abs(a - b) for a, b in zip(one, other, strict=True))


@contextlib.contextmanager
def _served() -> Iterator[tuple[Controller, str]]:
    """Run a robot and its session; yield them with the page's address."""
    port, endpoint = free_ports(), free_endpoint()
    with contextlib.ExitStack() as stack:
        stack.enter_context(session(port, MODEL + network_table(endpoint)))
        robot = Robot(port)
        stack.callback(robot.close)
        controller = Controller(robot)
        controller.start()
        stack.callback(controller.end)
        server_port, _ = stack.enter_context(server("console", endpoint))
        yield controller, f"http://127.0.0.1:{server_port}/"


def measure(presses: int = PRESSES) -> dict[str, Delays]:
    """Press repeatedly in each browser."""
    program = find_chromium()
    if program is None:
        raise SystemExit("chromium is not installed: apt-get install chromium")
    found = {}
    for name, flags in BROWSERS.items():
        with (
            tempfile.TemporaryDirectory(prefix="cardan-finger-") as folder,
            chromium(program, Path(folder), flags) as browser,
            _served() as (controller, address),
            browser.open(address, scripts=[PRESSED]) as page,
        ):
            page.until(RELOADED)
            found[name] = _pressed(page, controller, presses)
    return found


def _pressed(page: Tab, controller: Controller, presses: int) -> Delays:
    delays_s: list[float] = []
    lost = 0
    offset_s, uncertain_s = clock(page)
    for number in range(presses):
        enable(page)
        # Frames are periodic: presses must not synchronize with them.
        time.sleep(random.uniform(0.0, 0.05))
        page.value("window.pressed.length = 0")
        before_s = time.monotonic()
        at = FINGER.press(page, jog("X", 1 if number % 2 else -1))
        give_up_s = before_s + LONGEST_S
        while (moved_s := controller.first_move(before_s)) is None:
            if time.monotonic() > give_up_s:
                break
            time.sleep(0.001)
        stamps = page.value("window.pressed")
        if moved_s is None or not stamps:
            lost += 1
        else:
            delays_s.append(moved_s - (stamps[0] * 1e-3 + offset_s))
        FINGER.let_go(page, at)
        page.until(f"{STATE} !== 'held'")
        while not controller.rests():
            time.sleep(0.01)
    return Delays(delays_s, lost, uncertain_s)


def clock(page: Tab) -> tuple[float, float]:
    """Offset between our clock and the page's, from the fastest exchange, and its uncertainty,
    s."""
    found = []
    for _ in range(50):
        asked_s = time.monotonic()
        page_s = 1e-3 * page.value("performance.now()")
        now_s = time.monotonic()
        found.append((now_s - asked_s, 0.5 * (asked_s + now_s) - page_s))
    took_s, offset_s = min(found)
    return offset_s, 0.5 * took_s


def table(found: dict[str, Delays]) -> str:
    """Return the table of docs/measurements.md."""
    lines = [
        "| page | presses | median | p99 | slowest | without motion |",
        "|---|---|---|---|---|---|",
    ]
    for name, delays in found.items():
        cells = " | ".join(f"{1e3 * quantile(delays.delays_s, q):.1f} ms" for q in (0.5, 0.99, 1.0))
        lines.append(f"| {name} | {len(delays.delays_s)} | {cells} | {delays.lost} |")
    first = next(iter(found.values()))
    shares = zip((0.5, 0.99), AIMS_S, strict=True)
    met = all(quantile(first.delays_s, share) <= aim_s for share, aim_s in shares)
    aims = " and p99 ".join(f"{1e3 * each:.0f} ms" for each in AIMS_S)
    lines += [
        "",
        f"Aim, without the picture: median {aims}: {'met' if met else 'missed'}. The page's clock "
        f"is known to {1e3 * max(each.uncertain_s for each in found.values()):.1f} ms.",
    ]
    return "\n".join(lines)
