"""Every end of a hold on the page stops the arm, which does not move again by itself."""

from __future__ import annotations

import time

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from tests.console.hold_table import ENDS, SPEED_M_S, Pages, tried
from tests.console.page_input import FINGER, MOUSE, RELOADED, STATE, WHY, enable, hold, jog, keeps
from tests.console.robot_and_server import console_server
from tests.waiting import until

pytestmark = pytest.mark.matrix  # The browser draws by software.

LATE_S = 1.0
"""Tolerance for a busy computer, where all programs of a test share few cores."""
WATCHED_S = 0.6
"""Time of watching after the end of a fault."""
AGAIN_M = 0.003
"""Distance that the controller's position loop still closes after the first standstill."""


@pytest.mark.real
def test_nothing_moves_before_rearming(bench, page):
    at = MOUSE.press(page, jog("X"))
    page.until(f"{WHY}.length > 0")
    at_s = time.monotonic()
    time.sleep(0.5)
    assert bench.robot.tcp.stop_since(at_s).distance_m < 1e-5
    MOUSE.let_go(page, at)


@pytest.mark.real
def test_a_script_of_the_page_cannot_hold(bench, page):
    """Only trusted events of the browser start a hold, not events that a script creates."""
    enable(page)
    at_s = time.monotonic()
    page.value(
        f"document.querySelector('{jog('X')}').dispatchEvent("
        "new PointerEvent('pointerdown', {pointerId: 1, button: 0, bubbles: true}))"
    )
    page.value(
        f"document.querySelector('{jog('X')}').dispatchEvent("
        "new KeyboardEvent('keydown', {key: ' ', bubbles: true}))"
    )
    time.sleep(0.3)
    assert page.value(STATE) == "armed"
    assert bench.robot.tcp.stop_since(at_s).distance_m < 1e-5


ECHOES = """
window.echoes = [];
const [out, back] = [new BroadcastChannel("echo"), new BroadcastChannel("echo")];
back.onmessage = () => echoes.push(performance.now());
window.ticks = [];
setInterval(() => { ticks.push(performance.now()); out.postMessage(0); }, 20);
"""
LONGEST_GAP = "(all => Math.max(...all.slice(1).map((each, at) => each - all[at])))"


def test_what_proves_that_the_browser_lives_passes_through_its_main_process(bench, page, browser):
    """If the main process alone is stopped, the page keeps running and gets no echo of its
    pulse."""
    page.value(ECHOES)
    page.until("echoes.length > 10")
    browser.hang(2.0)
    page.until("performance.now() - echoes.at(-1) < 100")
    silent_ms, still_ms = (page.value(f"{LONGEST_GAP}({each})") for each in ("echoes", "ticks"))
    assert silent_ms > 3 * still_ms, (silent_ms, still_ms)


NO_CHROMIUM = "delete Navigator.prototype.userAgentData"
"""Makes the page treat the browser as an unknown one, whose echo proves nothing."""


def test_a_hold_without_a_sign_of_the_person_ends_and_is_announced(bench, browser):
    """The mouse is held without motion, in a browser that does not identify as Chromium. A browser
    on a busy computer may end a hold for other reasons; the hold is then repeated."""
    tcp, end_s = bench.robot.tcp, time.monotonic() + 30.0
    scripts = [keeps(speed=2), NO_CHROMIUM]
    with (
        console_server(bench.robot.endpoint, ["--hold", "1.5"]) as server,
        browser.open(server.address, scripts=scripts) as page,
    ):
        page.until(RELOADED)
        page.value(
            "window.announced = false; setInterval(() => {"
            f"announced ||= {WHY}.startsWith('Still there?'); }}, 50)"
        )
        while "without a sign of the operator" not in page.value(WHY):
            assert time.monotonic() < end_s, page.value(WHY)
            at = hold(page, MOUSE, jog("X", -1), lambda: tcp.moving)
            page.until(f"{STATE} !== 'held'")
            until(lambda: not tcp.moving, "rest")
            MOUSE.let_go(page, at)
        assert page.value("announced")


FRAMES_SENT = """
window.sent = [];
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (data) {
  if (typeof data !== "string") sent.push(performance.now());
  return send.call(this, data);
};
"""


def test_a_touch_goes_on_sending_while_the_browser_looks_for_a_gesture(bench, page):
    """Chromium delays timers by 100 ms after the start of a touch; a busy computer sometimes does
    the same."""
    page.value(FRAMES_SENT)
    most = 0
    for _ in range(5):
        enable(page)
        page.value("sent.length = 0")
        at = FINGER.press(page, jog("X"))
        page.value("new Promise(over => setTimeout(over, 250))")
        most = max(most, page.value("sent.filter(each => each - sent[0] < 90).length"))
        FINGER.let_go(page, at)
    assert most >= 3


def test_a_second_finger_on_another_button_moves_nothing_else(bench, page):
    """Only the first hold counts and continues; the second finger does not keep any hold alive."""
    tcp = bench.robot.tcp
    at = hold(page, FINGER, jog("X", -1), lambda: tcp.moving)
    other = page.value(
        "(b => [b.x + b.width / 2, b.y + b.height / 2])"
        f"(document.querySelector('{jog('Z')}').getBoundingClientRect())"
    )
    page.touch("touchStart", at, tuple(other))
    assert page.value("document.querySelectorAll('.held').length") <= 1
    page.touch("touchEnd")
    page.until(f"{STATE} !== 'held'")
    at_s = time.monotonic() + 1.0
    time.sleep(1.5)
    assert tcp.stop_since(at_s).distance_m < 1e-3


@pytest.fixture(scope="module")
def pages(bench):
    pages = Pages(bench)
    yield pages
    pages.close()


@pytest.mark.real(
    "*Stop* tapped with another finger",
    "mouse button let go",
    "connection cut",
)
@pytest.mark.parametrize("name", [name for name, end in ENDS.items() if end.tested])
def test_every_end_of_a_hold_stops_the_arm(bench, pages, name):
    end = ENDS[name]
    stop = tried(bench, pages, end, WATCHED_S)
    assert stop.time_s < end.bound_s + LATE_S, stop
    assert stop.distance_m < 1.2 * SPEED_M_S * (end.bound_s + LATE_S), stop
    assert stop.again_m < AGAIN_M, stop
