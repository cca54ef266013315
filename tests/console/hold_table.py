"""Generate the table of docs/console.md: every way in which a hold on the page ends, and the arm's
reaction.

To write it again: ``make hold-table``, or ``python -m tests.console.hold_table``.
"""

from __future__ import annotations

import contextlib
import os
import re
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from cardan.gateway.servers.console.hold_to_run import FRESH_S
from tests.console.browser import Browser, Tab, chromium, find_chromium
from tests.console.page_input import (
    FINGER,
    KEY,
    MOUSE,
    RELOADED,
    PageInput,
    Place,
    hold,
    jog,
    keeps,
)
from tests.console.proxy import Proxy, network_to
from tests.console.robot_and_server import (
    RobotAndSession,
    ServerProcess,
    Stop,
    console_server,
    robot_and_session,
)
from tests.docs_tables import replaced
from tests.waiting import until

PAGE = Path(__file__).parents[2] / "docs" / "console.md"
BEGIN = "<!-- made by tests/console/hold_table.py -->\n"

SPEED_M_S = 0.1
SPEED_PERCENT = 40
"""Fastest jog of the page: 250 mm/s."""
RAMP_S = 0.1
"""Time for braking from that speed with 1 m/s², the acceleration of an arm's streams."""
TRAIL_S = 0.1
"""Lag of the simulated drives, plus the page's next frame and the transport to the session."""
BOUND_S = FRESH_S + RAMP_S + TRAIL_S
"""Longest stopping time of an arm whose page has fallen silent."""
UNSEEN_S = 0.85
"""Longest stopping time if the page stops receiving the arm's state: it sends pings every 250 ms,
and releases after twice the round trip that it considers slow, 300 ms."""

WATCHED_S = 2.0
"""Time of watching after the end of the fault; in most rows the pointer, finger or key is still
pressed."""
TIMES = 3

HELD_S = 0.3
"""Time for which the arm has moved at full speed."""

STALL_S = 1.0


class Bench(NamedTuple):
    """Processes and addresses for measuring the rows."""

    browser: Browser
    robot: RobotAndSession
    server: ServerProcess
    network: Proxy
    address: str
    """Address of the page behind the proxy."""


class Held(NamedTuple):
    """A page on which a button is held."""

    page: Tab
    at: Place
    bench: Bench


class End(NamedTuple):
    """A way in which a hold ends."""

    act: Callable[[Held], None]
    page_input: PageInput = MOUSE
    lives: bool = True
    """True if the page still exists afterwards."""
    tested: bool = True
    """False: this end is like another one, and is measured only for the table, to keep the tests
    short."""
    bound_s: float = BOUND_S
    logged: str = ""
    """Pattern of events that the page itself must have received, in the notation of EVENTS."""
    unheard: str = ""
    """Pattern of events that it must not have received."""


EVENTS = """
window.logged_events = [];
for (const name of [
  "pointerdown", "pointerup", "pointercancel", "mousedown", "mouseup", "keydown", "keyup", "blur",
  "contextmenu", "resize", "pagehide", "lostpointercapture",
]) window.addEventListener(name, (event) => {
  const on = event.target?.closest?.("button")?.className ?? "";
  const what = event.code ?? event.pointerId ?? "";
  const key = JSON.stringify(event.key ?? "");
  logged_events.push(`${name} ${what} ${key} ${event.buttons ?? 0} [${on}]`);
}, true);
visualViewport.addEventListener("resize", () => logged_events.push("seen"));
"""
"""Each event as "type key-or-pointer key buttons [classes of its element]"."""


def _let_go(held: Held) -> None:
    MOUSE.let_go(held.page, held.at)


def _lift(held: Held) -> None:
    FINGER.let_go(held.page, held.at)


def _release_key(held: Held) -> None:
    KEY.let_go(held.page, held.at)


def _cancel(held: Held) -> None:
    held.page.touch("touchCancel")


def _take_the_capture(held: Held) -> None:
    held.page.value("document.body.setPointerCapture(1)")


def _slide(held: Held) -> None:
    held.page.mouse("mouseMoved", (held.at[0] - 300, held.at[1]))


def _slide_finger(held: Held) -> None:
    held.page.touch("touchMove", (held.at[0] - 200, held.at[1] + 20))


def _focus_elsewhere(held: Held) -> None:
    held.page.value("document.querySelector('.enable').focus()")
    _release_key(held)


def _blur(held: Held) -> None:
    held.page.value("window.dispatchEvent(new Event('blur'))")


def _hide(held: Held) -> None:
    with held.bench.browser.in_front():
        time.sleep(STALL_S)


def _minimize(held: Held) -> None:
    window = held.page.ask("Browser.getWindowForTarget")["windowId"]
    for state in ("minimized", "normal"):
        held.page.ask("Browser.setWindowBounds", windowId=window, bounds={"windowState": state})
        time.sleep(0.5 * STALL_S)


def _freeze(held: Held) -> None:
    held.page.ask("Page.setWebLifecycleState", state="frozen")
    time.sleep(STALL_S)
    held.page.ask("Page.setWebLifecycleState", state="active")


def _open_a_dialog(held: Held) -> None:
    held.page.tell("Runtime.evaluate", expression="alert('?')")
    time.sleep(STALL_S)
    held.page.ask("Page.handleJavaScriptDialog", accept=True)


def _block(held: Held) -> None:
    """Block the page's main thread for a while."""
    held.page.value(
        f"{{ const end = performance.now() + {1e3 * STALL_S}; while (performance.now() < end); }}"
    )


def _stall(*, up: bool, down: bool, seconds: float = STALL_S) -> Callable[[Held], None]:
    def act(held: Held) -> None:
        with held.bench.network.stalled(up=up, down=down):
            time.sleep(seconds)

    return act


def _second_finger(selector: str) -> Callable[[Held], None]:
    """Tap another button with a second finger while the first one holds."""

    def act(held: Held) -> None:
        other = held.page.value(
            "(b => [b.x + b.width / 2, b.y + b.height / 2])"
            f"(document.querySelector('{selector}').getBoundingClientRect())"
        )
        held.page.fingers("touchStart", {0: held.at, 1: tuple(other)})
        held.page.fingers("touchMove", {0: held.at})

    return act


def _chord(button: str, number: int) -> Callable[[Held], None]:
    """Press another mouse button, then release the left one while the other stays pressed."""

    def act(held: Held) -> None:
        held.page.mouse("mousePressed", held.at, button, 1 + number)
        held.page.mouse("mouseReleased", held.at, "left", number)

    return act


def _second_button(held: Held) -> None:
    held.page.mouse("mousePressed", held.at, "right", 3)


def _key_up_as(key: str, code: str) -> Callable[[Held], None]:
    return lambda held: held.page.key("keyUp", key, code)


def _resize(held: Held) -> None:
    held.page.resize(1000, 900)


def _push_away(held: Held) -> None:
    """Insert space above the button, which moves it down."""
    held.page.value("document.querySelector('header').style.marginBottom = '160px'")


def _lie_over(held: Held) -> None:
    """Cover the button with an element of the page."""
    held.page.value(
        "document.body.append(Object.assign(document.createElement('div'), "
        "{style: 'position: fixed; inset: 0; z-index: 99'}))"
    )


def _shrink_what_is_seen(held: Held) -> None:
    """Shrink the visual viewport at a constant window size, as a phone's keyboard does."""
    held.page.ask("Emulation.setPageScaleFactor", pageScaleFactor=1.5)


def _context_menu(held: Held) -> None:
    held.page.value(
        f"document.elementFromPoint({held.at[0]}, {held.at[1]}).dispatchEvent("
        "new MouseEvent('contextmenu', {bubbles: true, cancelable: true}))"
    )


HOLDING_UP = r"^pointer(up|cancel) .*\[jog"
"""Release of the holding finger, which a second finger must not be mistaken for."""

ENDS: dict[str, End] = {
    "mouse button let go": End(_let_go, logged=r"^pointerup 1 \"\" 0"),
    "finger lifted": End(_lift, FINGER, tested=False, logged=r"^pointerup .*held"),
    "key let go": End(_release_key, KEY, tested=False, logged="^keyup Space"),
    "key let go while something else has the focus": End(_focus_elsewhere, KEY),
    "touch canceled: a gesture of the system, a call, a palm": End(
        _cancel, FINGER, logged="^pointercancel", unheard="^pointerup"
    ),
    "pointer captured by something else": End(_take_the_capture),
    "mouse slides off the button": End(_slide, tested=False),
    "finger slides off the button": End(_slide_finger, FINGER),
    "*Stop* tapped with another finger": End(
        _second_finger(".stop"), FINGER, logged=r"^pointerdown .*\[stop", unheard=HOLDING_UP
    ),
    "*Disable* tapped with another finger": End(
        _second_finger(".enable"), FINGER, logged=r"^pointerdown .*\[enable", unheard=HOLDING_UP
    ),
    "right button goes down, too": End(
        _second_button, logged="^mousedown .* 3 ", unheard="^(mouse|pointer)up"
    ),
    "left button let go while the right one is down": End(
        _chord("right", 2), logged="^mouseup .* 2 ", unheard="^pointerup"
    ),
    "left button let go while the middle one is down": End(_chord("middle", 4), tested=False),
    "Space let go while AltGr is down": End(
        _key_up_as("\xa0", "Space"), KEY, logged='^keyup Space "\xa0"', unheard='^keyup Space " "'
    ),
    "key let go that the keyboard does not name": End(
        _key_up_as("Unidentified", ""), KEY, tested=False
    ),
    "window of another size, or turned": End(
        _resize, lives=False, logged="^resize", unheard="^pointerup"
    ),
    "the button moves away from the pointer": End(
        _push_away, lives=False, unheard="^(pointer|mouse)|^blur"
    ),
    "something lies over the button": End(
        _lie_over, lives=False, unheard="^(pointer|mouse)|^blur|^resize"
    ),
    "less of the page is seen, as under a phone's keyboard": End(
        _shrink_what_is_seen, FINGER, lives=False, logged="^seen", unheard="^pointerup|^resize"
    ),
    "context menu, as by a long press": End(
        _context_menu, FINGER, logged="^contextmenu", unheard="^pointer(up|cancel)"
    ),
    "Escape": End(lambda held: held.page.key("keyDown", "Escape")),
    "window loses the focus": End(_blur),
    "another tab in front for 1 s": End(_hide),
    "window minimized for half a second": End(_minimize, tested=False),
    "page frozen for 1 s": End(_freeze, lives=False),
    "a dialog of the browser for 1 s": End(_open_a_dialog, tested=False),
    "page's thread blocked for 1 s": End(_block),
    "browser's main process alone stopped for 2.5 s": End(
        lambda held: held.bench.browser.hang(2.5)
    ),
    "browser stopped for 1 s, as by a computer that sleeps": End(
        lambda held: held.bench.browser.stand_still(STALL_S), tested=False
    ),
    "network stands still for 1 s, then all arrives": End(_stall(up=True, down=True)),
    "the same, of what the page sends": End(_stall(up=True, down=False), tested=False),
    "the same, of what the page hears, for 2 s": End(
        _stall(up=False, down=True, seconds=2 * STALL_S), bound_s=BOUND_S + UNSEEN_S
    ),
    "connection cut": End(lambda held: held.bench.network.cut()),
    "server stopped for 1 s": End(
        lambda held: held.bench.server.stand_still(STALL_S), tested=False
    ),
    "page left": End(
        lambda held: held.page.ask("Page.navigate", url="about:blank"), lives=False, tested=False
    ),
    "page reloaded": End(lambda held: held.page.ask("Page.reload"), lives=False, tested=False),
    "page closed": End(lambda held: held.page.ask("Page.close"), lives=False),
    "page crashes": End(
        lambda held: held.page.tell("Page.crash") and None, lives=False, tested=False
    ),
}


@contextlib.contextmanager
def bench(browser: Browser, folder: Path) -> Iterator[Bench]:
    """A robot, its session, the server, and a proxy between page and server."""
    with (
        robot_and_session(folder) as robot,
        console_server(robot.endpoint) as server,
        network_to(server.port) as network,
    ):
        yield Bench(browser, robot, server, network, f"http://127.0.0.1:{network.port}/")


class Pages:
    """Pages in sequence, each used until it is closed: the end of a hold must not prevent the next
    hold."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._stack = contextlib.ExitStack()
        self._page: Tab | None = None

    def get(self) -> Tab:
        """A page that shows the arm."""
        if self._page is None:
            opened = self._bench.browser.open(
                self._bench.address, scripts=[keeps(speed=SPEED_PERCENT), EVENTS]
            )
            self._page = self._stack.enter_context(opened)
        self._page.until(RELOADED)
        return self._page

    def close(self) -> None:
        self._stack.close()
        self._page = None


def tried(bench: Bench, pages: Pages, end: End, watched_s: float) -> Stop:
    """Hold, end the hold, and measure the arm's motion for `watched_s` afterwards."""
    page, tcp = pages.get(), bench.robot.tcp
    until(lambda: not tcp.moving, "rest")
    began_s = time.monotonic()
    sign = 1 if tcp.here[0] < 0.5 else -1
    at = hold(page, end.page_input, jog("X", sign), lambda: _runs(bench, began_s))
    if end.logged or end.unheard:
        page.value("logged_events.length = 0")
    at_s = time.monotonic()
    end.act(Held(page, at, bench))
    threading.Event().wait(watched_s)
    found = tcp.stop_since(at_s)
    if end.logged or end.unheard:
        logged_events = "\n".join(page.value("logged_events"))
        assert re.search(end.logged, logged_events, re.MULTILINE), logged_events
        assert not (end.unheard and re.search(end.unheard, logged_events, re.MULTILINE)), (
            logged_events
        )
    if not end.lives:
        pages.close()
        return found
    # The page must consider the hold ended, even while the pointer is still pressed.
    page.until("document.querySelectorAll('.held').length === 0")
    with contextlib.suppress(RuntimeError):  # the finger may be gone
        end.page_input.let_go(page, at)
    return found


def _runs(bench: Bench, began_s: float) -> bool:
    tcp = bench.robot.tcp
    wide = tcp.speed(HELD_S) if time.monotonic() > began_s + HELD_S else 0.0
    return abs(wide / SPEED_M_S - 1.0) < 0.05


def rows(bench: Bench) -> dict[str, list[Stop]]:
    """Measure the stops of the arm after each end of a hold."""
    pages = Pages(bench)
    try:
        found: dict[str, list[Stop]] = {}
        for name, end in ENDS.items():
            found[name] = [tried(bench, pages, end, WATCHED_S) for _ in range(TIMES)]
            stops = (
                f"{1e3 * each.time_s:.0f} ms {1e3 * each.distance_m:.1f} mm" for each in found[name]
            )
            print(f"{name}: {', '.join(stops)}", file=sys.stderr, flush=True)
        return found
    finally:
        pages.close()


def table(found: dict[str, list[Stop]]) -> str:
    """Format the results as Markdown."""
    lines = ["| the hold ends by | stops within, ms | after, mm |", "|---|---|---|"]
    for name, stops in found.items():
        times = [1e3 * each.time_s for each in stops]
        ways = [1e3 * each.distance_m for each in stops]
        late = max(times) > 1e3 * ENDS[name].bound_s
        cells = [_cell(times, 0), _cell(ways, 1)]
        lines.append(
            f"| {name} | {' | '.join(f'**{each}**' if late else each for each in cells)} |"
        )
    return "\n".join(lines) + "\n"


def _cell(values: list[float], digits: int) -> str:
    return f"{statistics.median(values):.{digits}f} ({max(values):.{digits}f})"


def main() -> None:
    """Write the table into the page of the documentation, or print it with "-"."""
    program = find_chromium()
    if program is None:
        sys.exit("chromium is not installed: apt-get install chromium")
    with (
        tempfile.TemporaryDirectory(prefix="cardan-holds-") as folder,
        chromium(program, Path(folder) / "chromium") as browser,
        bench(browser, Path(folder)) as made,
    ):
        loads = [os.getloadavg()[0]]
        text = table(rows(made))
        loads.append(os.getloadavg()[0])
    text += (
        f"\nLoad before and after it was measured: {loads[0]:.1f} and {loads[1]:.1f} on "
        f"{os.cpu_count()} processors.\n"
    )
    if "-" in sys.argv[1:]:
        print(text)
    else:
        page = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(replaced(page, BEGIN, text), encoding="utf-8")


if __name__ == "__main__":
    main()
