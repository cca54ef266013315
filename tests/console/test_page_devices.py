"""A phone's sensors and a headset's controllers, emulated in a real browser, move the arms of
sessions."""

from __future__ import annotations

import contextlib
import math
import time
from functools import partial

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from tests.console.page_input import RELOADED
from tests.console.page_sessions import hands
from tests.npm import installed

pytestmark = pytest.mark.matrix

TILT_DEG = 20.0


@pytest.fixture(scope="module")
def lab(built, tmp_path_factory):
    with hands(tmp_path_factory.mktemp("hands")) as made:
        yield made


def allow_sensors(browser, lab):
    with browser.control() as control:
        control.ask("Browser.grantPermissions", permissions=["sensors"], origin=lab.server.address)


SPEAKING = """
window.silent = false;
let newest = null;
addEventListener("deviceorientation", (event) => { if (event.isTrusted) newest = event; });
setInterval(() => {
  if (!newest || window.silent) return;
  dispatchEvent(new DeviceOrientationEvent("deviceorientation", newest));
}, 16);
"""
"""Repeats the orientation: a phone's sensor reports it also at rest, the emulated one does not."""


def turn(page, alpha=0.0, beta=0.0, gamma=0.0):
    """Set the phone's orientation."""
    page.ask("DeviceOrientation.setDeviceOrientationOverride", alpha=alpha, beta=beta, gamma=gamma)


def turn_slowly(page, began, ended):
    """Turn the phone about the vertical at the speed of a human hand: a jump would invalidate the
    alignment."""
    for step in range(1, 10):
        turn(page, alpha=began + (ended - began) * step / 9)
        time.sleep(0.05)


CLUTCH = "#panel-device section:nth-child(1) .clutch"
START = "#panel-device section:nth-child(1) .row button:nth-child(1)"
ALIGN = "#panel-device section:nth-child(1) .row button:nth-child(2)"
NO_SENSOR = "This device gives no orientation"
NOTE = "document.querySelector('#panel-device section:nth-child(1) p').textContent"


def held_until(session, wanted, press, let_go, act, before):
    end_s = time.monotonic() + 35.0
    while True:
        before()
        known = {"began": session.now.robot.pose}
        press()
        for goal in ("'hold' in device.buttons", wanted):
            give_up_s = time.monotonic() + 1.5
            while (
                not (done := eval(goal, known, vars(session.now))) and time.monotonic() < give_up_s
            ):
                time.sleep(0.02)
            if not done:
                break
            if goal is wanted:
                return session.now
            act()
        let_go()
        time.sleep(0.2)
        assert time.monotonic() < end_s, (
            wanted,
            session.now.device.reason,
            session.now.device.axes,
        )


class Phone:
    """The page on a phone."""

    def __init__(self, page, session):
        self.page, self.session = page, session
        page.ask("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=5)
        page.until(RELOADED)
        page.click("#tab-device")

    def start(self):
        """Start the sensors, and align."""
        turn(self.page)
        self.page.click(START)
        self.page.until(f"!document.querySelector('{ALIGN}').disabled")
        at = self.page.center(ALIGN)
        self.page.mouse("mousePressed", at)
        self.session.until("device.link == 'live'")
        self.page.mouse("mouseReleased", at)

    def press(self):
        self.at = self.page.center(CLUTCH)
        self.page.touch("touchStart", self.at)

    def hold_until(self, wanted, act=lambda: None, before=lambda: None):
        """Hold with the thumb and repeat an action, until the session reports the expected state. A
        browser on a busy computer sometimes pauses, which correctly ends the hold; it is then
        repeated."""
        return held_until(self.session, wanted, self.press, self.let_go, act, before)

    def let_go(self):
        self.page.touch("touchEnd")

    def turned(self):
        """Hold and tilt the phone until the tool turns."""
        flat, up = partial(turn, self.page), partial(turn, self.page, beta=TILT_DEG)
        return self.hold_until("abs(device.axes[4]) > 0.5 and abs(arm.twist[4]) > 0.2", up, flat)

    def drag(self, right, down):
        """Drag a second finger next to the thumb."""
        x, y = self.at
        self.page.touch("touchStart", (x, y), (x + 30, y + 5))
        self.page.touch("touchMove", (x, y), (x + 30 + right, y + 5 + down))


@pytest.fixture(scope="module")
def started(lab, browser):
    """A phone's page after alignment."""
    allow_sensors(browser, lab)
    with browser.open(lab.server.address, 360, 740, scripts=[SPEAKING]) as page:
        phone = Phone(page, lab.phone)
        phone.start()
        yield phone


@pytest.fixture
def phone(started):
    """The aligned phone, upright on the table, without a hold."""
    turn(started.page)
    started.session.until(
        "device.link == 'live' and 'hold' not in device.buttons and not any(device.axes)"
    )
    yield started
    with contextlib.suppress(RuntimeError):  # if the thumb is still down
        started.let_go()


REFUSED = "DeviceOrientationEvent.requestPermission = async () => 'denied';"
"""Script that denies the permission, which a headless browser always grants."""


def test_sensors_that_are_not_allowed_move_nothing(lab, browser):
    with browser.open(lab.server.address, 360, 740, scripts=[REFUSED]) as page:
        phone = Phone(page, lab.phone)
        turn(page)
        page.click(START)
        page.until(f"{NOTE}.startsWith({NO_SENSOR!r})")
        page.until(f"document.querySelector('{CLUTCH}').disabled")
        phone.press()
        lab.phone.rests()
        phone.let_go()


def test_a_phone_without_angles_says_so(lab, browser):
    """Permission without a sensor: one event whose angles are null."""
    allow_sensors(browser, lab)
    with browser.open(lab.server.address, 360, 740) as page:
        Phone(page, lab.phone)
        page.click(START)
        page.until(f"{NOTE}.startsWith({NO_SENSOR!r})")
        page.until(f"document.querySelector('{CLUTCH}').disabled")


def test_a_phone_turns_the_tool_while_it_is_held(phone):
    turn(phone.page, beta=TILT_DEG)
    phone.session.rests()
    # About the axis to the right, which is -y for an operator who looks along x.
    now = phone.turned()
    assert max(map(abs, (*now.device.axes[:4], now.device.axes[5]))) < 0.05
    # A phone at rest repeats its angles and stays live.
    end_s = time.monotonic() + 0.6
    while time.monotonic() < end_s:
        assert phone.session.now.device.link == "live", phone.session.now
        time.sleep(0.02)
    phone.let_go()
    phone.session.until("'hold' not in device.buttons and not any(device.axes)")
    phone.session.rests()


PORTRAIT = {"width": 360, "height": 740, "deviceScaleFactor": 1, "mobile": True}


def test_the_second_finger_moves_the_tool_as_the_screen_is_turned(phone):
    """A drag up the screen, away from the operator, moves forward in every orientation of the
    screen."""
    for quarter, alpha in ((0, 0.0), (1, 90.0)):
        kind = "portraitPrimary" if quarter == 0 else "landscapePrimary"
        phone.page.ask(
            "Emulation.setDeviceMetricsOverride",
            width=740 if quarter else 360,
            height=360 if quarter else 740,
            deviceScaleFactor=1,
            mobile=True,
            screenOrientation={"type": kind, "angle": 90 * quarter},
        )
        phone.page.until(f"screen.orientation.angle === {90 * quarter}")
        turn_slowly(phone.page, 0.0, alpha)
        # If the new orientation arrives after the press, it counts as a turn of the hand.
        straight = "device.axes[0] > 0.3 and max(map(abs, device.axes[1:])) < 0.1"
        phone.hold_until(straight, lambda: phone.drag(0, -60))
        phone.let_go()
        phone.session.until("not any(device.axes)")
    turn_slowly(phone.page, 90.0, 0.0)
    phone.page.ask("Emulation.setDeviceMetricsOverride", **PORTRAIT)


def test_a_page_that_was_hidden_needs_a_new_press(phone, browser):
    phone.turned()
    with browser.in_front():
        phone.session.until("device.link != 'live' and not any(device.axes)")
    phone.page.until("document.visibilityState === 'visible'")
    phone.session.rests()
    phone.let_go()
    phone.session.until("device.link == 'live'")
    phone.turned()
    phone.let_go()


def test_a_sensor_that_ends_disarms(phone):
    phone.turned()
    phone.page.value("window.silent = true")
    phone.page.value(
        "window.dispatchEvent(new DeviceOrientationEvent('deviceorientation', {alpha: null}))"
    )
    phone.session.until("device.link == 'needs neutral' and not any(device.axes)")
    phone.session.rests()
    phone.page.value("window.silent = false")


def test_sensors_that_fall_silent_are_lost_and_need_a_new_press(phone):
    """The thumb stays down on a tilted phone whose sensors fall silent."""
    phone.turned()
    phone.page.value("window.silent = true")
    phone.session.until("device.link == 'needs neutral' and not any(device.axes)")
    phone.session.rests()
    phone.page.value("window.silent = false")
    phone.session.rests()
    phone.let_go()
    phone.session.until("device.link == 'live'")


# -- headsets -------------------------------------------------------------------------------------

HEADSET = """
const headset = new IWER.XRDevice(IWER.metaQuest3);
headset.installRuntime({ forceInstall: true });
window.headset = headset;
// The emulator says of every place that it is a guess.
window.guessed = false;
window.looks = 0;
const getPose = XRFrame.prototype.getPose;
XRFrame.prototype.getPose = function (...spaces) {
  const pose = getPose.apply(this, spaces);
  window.looks += 1;
  Object.defineProperty(pose, "emulatedPosition", { value: window.guessed });
  return pose;
};
"""


class Headset:
    """The page in a headset."""

    def __init__(self, page, lab):
        self.page, self.lab = page, lab
        page.until(RELOADED)
        page.click("#tab-device")
        start = "#panel-device section:nth-child(3) .row button"
        page.until(f"!document.querySelector('{start}').disabled")
        for side in ("left", "right"):
            self.place(side)
        page.click(start)
        for side, session in (("left", lab.left), ("right", lab.right)):
            session.until("device.link == 'needs neutral' and 'aligned' in device.reason")
            self.align(side)

    def align(self, side):
        """Align a controller at its present pose."""
        self.look()
        self.press(side, "thumbstick", 1)
        self.look()
        {"left": self.lab.left, "right": self.lab.right}[side].until("device.link == 'live'")
        self.press(side, "thumbstick", 0)

    def look(self):
        """Wait until the page has read both hands in two new frames."""
        looks = self.page.value("window.looks")
        self.page.until(f"window.looks >= {looks + 6}")

    def back(self, side):
        """Move a controller back to its first place in one jump, which invalidates the alignment,
        and align again."""
        self.place(side)
        self.align(side)

    def place(self, side, x=0.0, y=1.2, z=-0.4):
        offset = {"left": -0.2, "right": 0.2}[side]
        self.page.value(f"headset.controllers.{side}.position.set({x + offset}, {y}, {z}); 1")

    def go(self, side, way, steps=12, **at):
        """Move a controller along an axis at the speed of a human hand, without a jump."""
        axis, end = way
        start = {"x": 0.0, "y": 1.2, "z": -0.4, **at}[axis]
        for step in range(1, steps + 1):
            self.place(side, **{**at, axis: start + (end - start) * step / steps})
            time.sleep(0.02)

    def press(self, side, button, value):
        self.page.value(f"headset.controllers.{side}.updateButtonValue('{button}', {value}); 1")

    def hold_until(self, side, wanted, way=None):
        """Squeeze and move, until the session of that hand reports the expected state."""
        session = {"left": self.lab.left, "right": self.lab.right}[side]
        return held_until(
            session,
            wanted,
            partial(self.press, side, "squeeze", 1),
            partial(self.press, side, "squeeze", 0),
            (lambda: self.go(side, way)) if way else (lambda: None),
            partial(self.back, side),
        )

    def raised(self):
        """Hold and raise the right hand until its tool rises."""
        return self.hold_until("right", "device.axes[2] > 0.3 and arm.twist[2] > 0.02", ("y", 1.26))


@pytest.fixture(scope="module")
def worn(lab, browser):
    iwer = installed("iwer", "2.5.0") / "node_modules/iwer/build/iwer.min.js"
    # A small window limits the drawing without a graphics card.
    with browser.open(lab.server.address, 640, 480, scripts=[iwer.read_text() + HEADSET]) as page:
        yield Headset(page, lab)


@pytest.fixture
def headset(worn):
    """The headset with both hands tracked and released."""
    for side in ("left", "right"):
        worn.press(side, "squeeze", 0)
    for each in BACK.values():
        worn.page.value(each)
    for side in ("left", "right"):
        worn.back(side)
    worn.lab.right.until("device.link == 'live' and 'hold' not in device.buttons")
    return worn


def test_both_hands_of_a_headset_move_an_arm_each(headset):
    left, right = headset.lab.left, headset.lab.right
    # Forward is -z in the headset and x here: the tool moves as far as the hand since the squeeze.
    headset.hold_until("left", "abs(robot.pose[0] - began[0] - 0.05) < 0.003", ("z", -0.45))
    headset.press("left", "squeeze", 0)
    left.until("'hold' not in device.buttons")
    headset.raised()
    assert not any(left.now.device.axes)
    headset.press("right", "squeeze", 0)
    right.until("not any(device.axes)")
    right.rests()


def gone(headset):
    """The controller's battery is empty."""
    headset.page.value("headset.controllers.right.connected = false; 1")


def guessed(headset):
    """The controller is out of the cameras' view, so that its position is estimated."""
    headset.page.value("window.guessed = true")


def taken_off(headset):
    """The system shows another view: the session gets no frames, or is hidden."""
    headset.page.value("headset.updateVisibilityState('hidden'); 1")


def jumped(headset):
    headset.place("right", y=1.6)


BACK = {
    gone: "headset.controllers.right.connected = true; 1",
    guessed: "window.guessed = false",
    taken_off: "headset.updateVisibilityState('visible'); 1",
    jumped: "1",
}


@pytest.mark.parametrize("loss", BACK, ids=lambda loss: loss.__name__)
def test_a_hand_that_is_lost_stops_and_comes_back_by_a_new_press(headset, loss):
    right = headset.lab.right
    headset.raised()
    loss(headset)
    right.until("device.link != 'live' and not any(device.axes)")
    right.rests()
    headset.page.value(BACK[loss])
    # A squeeze that never ended does not count as a new one.
    right.rests(0.6)
    headset.press("right", "squeeze", 0)
    if loss is jumped:
        right.until("'not aligned any more' in device.reason")
        headset.align("right")
    right.until("device.link == 'live'")
    headset.hold_until("right", "'hold' in device.buttons")
    headset.press("right", "squeeze", 0)
    right.until("'hold' not in device.buttons")


def test_a_session_of_a_headset_that_ends_stops_its_hands(headset):
    right = headset.lab.right
    headset.raised()
    headset.page.value("headset.activeSession.end().then(() => 1)")
    right.until("device.link != 'live' and not any(device.axes)")
    right.rests()
    assert math.isfinite(right.now.robot.pose[0])
