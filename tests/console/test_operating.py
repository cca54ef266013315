"""The console page in a real browser: the arm's surroundings, goals, and two users."""

from __future__ import annotations

import contextlib
import time

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from cardan.errors import DriverError
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.interfaces import DUMMY_MEMBER
from tests.console.page_input import MOUSE, RELOADED, enable, hold, jog
from tests.console.served_arm import ARM, motion_of, served_arm, stops
from tests.gateway.servers.bench import WAIT_S

pytestmark = pytest.mark.matrix  # The browser draws by software.

TRIGGER = "std_srvs/srv/Trigger"
NO_VALUES = codec_of("std_srvs/srv/Trigger_Request").encode({DUMMY_MEMBER: 0})

AROUND = """
[limits]
workspace_z_m = [0.1, 1.0]

[[obstacles]]
name = "table"
box = [[0.3, -0.6, -0.2], [1.0, 0.6, 0.0]]

[[obstacles]]
name = "floor"
plane = [[0.0, 0.0, 1.0], -0.3]
"""

LABEL = "document.querySelector('.picture canvas').getAttribute('aria-label')"
STATE = "document.body.dataset.state"
VERDICT = "document.querySelector('.verdict').textContent"
WHY = "document.querySelector('.why').textContent"
FIRST_JOINT = "document.querySelectorAll('.joint-name output')[0].value"
REQUESTER = "document.querySelector('.requester').textContent"
AUTHORITY = "document.querySelector('.authority').textContent"


@pytest.fixture(scope="module")
def bus(built, tmp_path_factory):
    """Network of a session with obstacles, and the address of the page."""
    with served_arm(tmp_path_factory.mktemp("session"), built, AROUND) as running:
        yield running


@pytest.fixture
def moving(bus):
    """`moving()` returns true if the arm moves."""
    with motion_of(bus[0]) as moves:
        yield moves


@pytest.fixture
def page(bus, browser):
    """The page, showing the arm and its surroundings."""
    with browser.open(bus[1]) as page:
        page.until(RELOADED)
        page.until(f"{LABEL}.includes('table')")
        yield page


def press(page, *words):
    """Press the button with this label, or with one of these, even if it is scrolled out of
    view."""
    page.value(f"{_button(*words)}.click()")


def _button(*words):
    return (
        "[...document.querySelectorAll('button')]"
        f".find(each => {[*words]!r}.includes(each.textContent) && !each.hidden)"
    )


def press_until(page, words, watched, expression):
    """Press until a page shows the result: an action that a busy computer delays is refused, and a
    user would press again while the button is there. `words`: the button's label, or its possible
    labels."""
    end_s = time.monotonic() + WAIT_S
    words = (words,) if isinstance(words, str) else words
    page.until(f"Boolean({_button(*words)})")
    press(page, *words)
    while True:
        try:
            return watched.until(expression, 5.0)
        except DriverError:
            if time.monotonic() > end_s:
                raise
        page.value(f"{_button(*words)}?.click()")


def ask_and_hand_over(one, other):
    """Enable motion on page `one`, then request the arm on page `other` and get it. Repeat both on
    a failure: after a pause of the computer an arm has no owner for a moment."""
    end_s = time.monotonic() + WAIT_S
    has_it = f"{AUTHORITY}.startsWith('Authorityyou')"
    while not other.value(has_it):
        assert time.monotonic() < end_s
        with contextlib.suppress(DriverError):
            if not one.value(has_it):
                enable(one)
                one.until(has_it, 5.0)
            other.value(f"{_button('They keep it. Ask again', 'Ask for it')}?.click()")
            one.until(ASKED, 5.0)
            press(one, "Hand over")
            other.until(has_it, 5.0)


def wanted(page, label, value):
    """Set a slider's value; return the page's text about the goal."""
    page.value(
        f"(e => {{ e.value = {value}; e.dispatchEvent(new Event('change')) }})"
        f"(document.querySelector('input[type=number][aria-label^=\"{label},\"]'))"
    )
    page.until(f"!{VERDICT}.startsWith('Looking')")
    return page.value(VERDICT)


def test_the_picture_has_what_is_around_the_arm_and_each_part_is_switched_off(page):
    assert "table, floor" in page.value(LABEL)
    boxes = "[...document.querySelectorAll('.check input')]"
    assert page.value(f"{boxes}.map(each => each.checked)") == [True] * 9 + [False]
    page.value(f"{boxes}.forEach(each => each.click())")
    stored = "JSON.parse(localStorage.getItem('cardan-console')).hides"
    assert page.value(stored) == [
        *("ghost", "tcp", "commanded", "trail", "force", "axes", "workspace", "obstacles"),
        "visuals",
    ]
    page.value(f"{boxes}.forEach(each => each.click())")
    assert page.value(stored) == ["capsules"]


def test_a_dragged_gizmo_makes_a_ghost_and_nothing_moves(page, moving):
    page.click("#tab-goal")
    assert page.value(VERDICT).startswith("Drag")
    left, top, width, height = page.value(
        "(b => [b.x, b.y, b.width, b.height])"
        "(document.querySelector('canvas').getBoundingClientRect())"
    )
    # The upper arrow of the gizmo is about 50 pixels above the TCP, depending on the view.
    for share_y in (0.44, 0.42, 0.46, 0.40, 0.48, 0.38, 0.50):
        at = left + 0.693 * width, top + share_y * height
        page.ask("Input.dispatchMouseEvent", type="mouseMoved", x=at[0], y=at[1])
        page.mouse("mousePressed", at)
        for step in range(1, 5):
            page.mouse("mouseMoved", (at[0], at[1] - 8 * step))
        page.mouse("mouseReleased", (at[0], at[1] - 32))
        if not page.value(VERDICT).startswith("Drag"):
            break
    page.until(f"{VERDICT}.startsWith('Reachable')")
    assert not moving()


def test_a_goal_is_looked_at_and_the_arm_goes_there_while_it_is_held(page):
    before = float(page.until(FIRST_JOINT).rstrip("°"))
    page.click("#tab-goal")
    assert wanted(page, "X", 1400).startswith("Not reachable")
    assert page.value("document.querySelector('.send').disabled")
    lowest = "document.querySelector('input[type=range][aria-label=Z]').min"
    assert page.value(lowest) == "100"  # the workspace's wall
    press(page, "Here")
    page.value("[...document.querySelectorAll('#panel-goal .choice input')][1].click()")
    assert wanted(page, "shoulder pan", before + 4).startswith("Reachable")
    end_s = time.monotonic() + WAIT_S
    while "arrived" not in page.value(WHY):
        assert time.monotonic() < end_s, page.value(WHY)
        # A browser on a busy computer sometimes pauses, which correctly ends the hold.
        enable(page)
        page.until(f"!{VERDICT}.startsWith('Looking')")
        at = page.center(".send")
        page.mouse("mousePressed", at)
        while page.value(STATE) == "held":
            time.sleep(0.02)
        page.mouse("mouseReleased", at)
    page.click("#tab-move")
    page.until(f"Math.abs(parseFloat({FIRST_JOINT}) - {before + 4}) < 0.5")
    press(page, "Home")
    page.until(f"{VERDICT}.startsWith('Reachable')")


ASKED = "!document.querySelector('.requester').hidden"


@pytest.mark.real
def test_two_people_ask_for_the_arm_and_hand_it_over_and_both_can_stop_it(bus, browser, moving):
    with browser.open(bus[1]) as one, browser.open(bus[1]) as other:
        for each in (one, other):
            each.until(RELOADED)
        one.ask("Page.bringToFront")
        enable(one)
        one.until(f"{AUTHORITY}.startsWith('Authorityyou')")
        other.value(
            "(e => { e.value = 'Ana'; e.dispatchEvent(new Event('change')) })"
            "(document.querySelector('input[autocomplete=nickname]'))"
        )
        press_until(other, "Enable motion", other, f"{WHY}.includes('has authority over the arm')")
        press_until(other, "Ask for it", one, ASKED)
        assert one.value(REQUESTER).startswith("console Ana 127.0.0.1:")
        press_until(one, "Keep", other, f"{AUTHORITY}.includes('They keep it')")

        at = hold(one, MOUSE, jog("X"), moving)
        press(other, "StopEsc")
        stops(moving)
        # The arm refuses the hold at once; the report that a stop disarmed it follows a moment
        # later.
        one.until(f"{STATE} === 'watching'")
        MOUSE.let_go(one, at)

        ask_and_hand_over(one, other)
        one.until(f"{STATE} === 'watching'")
        other.ask("Page.bringToFront")
        enable(other)
        one.until(f"{AUTHORITY}.startsWith('Authorityconsole ')")
        press_until(other, "Release", one, f"{AUTHORITY}.startsWith('Authoritynobody')")


def test_after_a_stop_of_whomever_the_page_is_enabled_anew_before_the_arm_moves(
    bus, browser, moving
):
    network, address = bus
    with browser.open(address) as one, browser.open(address) as other:
        for each in (one, other):
            each.until(RELOADED)
        one.ask("Page.bringToFront")

        def by_the_other_page():
            other.value("document.querySelector('.stop').click()")

        def by_a_program():
            network.call(f"{ARM}/stop", TRIGGER, NO_VALUES, lambda _: None, WAIT_S)

        for stop, who in (
            (by_the_other_page, "ros2 /rosbridge_client_"),
            (by_a_program, "ros2 /console)"),
        ):
            # during the motion of a hold
            at = hold(one, MOUSE, jog("X"), moving)
            stop()
            stops(moving)
            one.until(f"{STATE} === 'watching'")
            one.until(f"{WHY}.includes('stopped: enable again ({who}')")
            MOUSE.let_go(one, at)
            presses_in_vain(one, moving)

            # without a hold
            enable(one)
            stop()
            one.until(f"{STATE} === 'watching'")
            one.until(f"{WHY}.includes('stopped: enable again ({who}')")
            presses_in_vain(one, moving)

        MOUSE.let_go(one, hold(one, MOUSE, jog("X"), moving))


def presses_in_vain(page, moving):
    """Press the buttons that normally move the arm, and check that none does."""
    at = page.center(jog("X"))
    page.mouse("mousePressed", at)
    end_s = time.monotonic() + 1.0
    while time.monotonic() < end_s:
        assert page.value(STATE) == "watching"
        assert not moving()
        time.sleep(0.02)
    page.mouse("mouseReleased", at)
