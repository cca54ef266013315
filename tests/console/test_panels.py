"""Plots, records, sensors and programs of the console page in a real browser."""

from __future__ import annotations

import base64
import re

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from cardan.gateway.servers.console.server import ConsoleOptions, ConsoleServer
from cardan.protocols.ros2.cdr import codec_of
from tests.console.page_input import RELOADED
from tests.console.served_arm import served_arm
from tests.gateway.servers.bench import served
from tests.gateway.servers.console.test_cameras import camera
from tests.waiting import until

GRAY = base64.b64decode(
    "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDAFA3PEY8MlBGQUZaVVBfeMiCeG5uePWvuZHI////////////////////"
    "////////////////////////////////wAALCAAIAAgBAREA/8QAFAABAAAAAAAAAAAAAAAAAAAAAP/EABQQAQAA"
    "AAAAAAAAAAAAAAAAAAD/2gAIAQEAAD8AP//Z"
)
"""A JPEG picture of 8 × 8 pixels."""

IMU = "sensor_msgs/msg/Imu"

pytestmark = pytest.mark.matrix


@pytest.fixture(scope="module")
def bus(built, tmp_path_factory):
    """Network of a running session, and the address of the page."""
    with served_arm(tmp_path_factory.mktemp("session"), built) as running:
        yield running


@pytest.fixture
def page(bus, browser):
    """The page, showing the arm."""
    with browser.open(bus[1]) as page:
        page.until(RELOADED)
        yield page


def press(page, label):
    """Press a button of the plots panel."""
    page.value(
        "[...document.querySelectorAll('#panel-plots button')]"
        f".find(each => (each.ariaLabel ?? each.textContent) === {label!r}).click()"
    )


def test_a_plot_can_be_marked_stopped_and_saved(page):
    page.click("#tab-plots")
    page.until("document.querySelectorAll('#panel-plots .u-series').length === 7")
    page.value(
        "window.saved = []; const make = URL.createObjectURL;"
        "URL.createObjectURL = blob => { saved.push(blob); return make(blob); }"
    )
    press(page, "CSV")
    page.until("saved.length === 1")
    assert page.value("saved[0].text()").startswith('time_s,"')
    press(page, "Picture")
    page.until("saved.length === 2 && saved[1].type === 'image/png' && saved[1].size > 1000")
    stopped = "document.querySelector('#panel-plots [aria-pressed]').ariaPressed"
    x, y = page.center("#panel-plots .u-over")
    page.mouse("mousePressed", (x - 40, y))
    page.mouse("mouseMoved", (x + 40, y))
    page.mouse("mouseReleased", (x + 40, y))
    assert page.value(stopped) == "true"
    press(page, "Go on")
    assert page.value(stopped) == "false"
    page.value(
        "(s => { s.value = 'cycle'; s.dispatchEvent(new Event('change')); })"
        "(document.querySelector('#panel-plots select'))"
    )
    page.until("document.querySelectorAll('#panel-plots .u-series').length === 3")
    page.until("document.querySelectorAll('#panel-plots .bar b:not(:empty)').length > 0")
    assert not [each for each in page.complaints() if "GL Driver Message" not in each]


def test_a_record_is_made_and_shown_and_moves_nothing(page):
    page.click("#tab-plots")
    page.until("!document.querySelector('.record').disabled")
    page.value("document.querySelector('.record').click()")
    page.until("document.querySelector('.record').ariaPressed === 'true'")
    page.until(
        "/, [1-9]\\d* messages/.test(document.querySelector('.record')"
        ".closest('.card').textContent)"
    )
    page.value("document.querySelector('.record').click()")
    page.until("document.querySelector('.record').ariaPressed === 'false'")
    page.until("document.querySelectorAll('#panel-plots .rows button').length === 1")
    page.value("document.querySelector('#panel-plots .rows button').click()")
    page.until("document.querySelector('.replay-bar input:not(:disabled)') !== null")
    page.until("document.querySelector('.readout').textContent.startsWith('X ')")
    assert page.value("document.querySelector('.enable').disabled")
    assert page.value("document.querySelector('#panel-move').inert")
    assert "no arm moves" in page.value("document.querySelector('.why').textContent")
    assert not page.value("document.querySelector('.stop').disabled")
    at = "Number(document.querySelector('.replay-bar input').value)"
    page.until(f"{at} > 0")
    page.until("document.querySelectorAll('#panel-plots .u-series').length === 7")
    page.value(
        "(bar => { bar.value = 0.1; bar.dispatchEvent(new Event('input')); })"
        "(document.querySelector('.replay-bar input'))"
    )
    page.value("[...document.querySelectorAll('.replay-bar button')].at(-1).click()")
    page.until("!document.querySelector('.enable').disabled")
    assert not page.value("document.querySelector('#panel-move').inert")
    assert page.value("document.querySelector('.replay-bar').hidden")
    assert not [each for each in page.complaints() if "GL Driver Message" not in each]


def test_this_device_is_a_sensor_which_is_drawn_beside_a_camera(bus, built, browser):
    network, _ = bus
    heard = []
    handle = network.subscribe("/phone/imu", IMU, lambda cdr, _ns: heard.append(cdr))
    with (
        camera(image=GRAY) as (filmed, address),
        served(
            lambda: ConsoleServer(network, ConsoleOptions(port=0, camera=(address,)), built)
        ) as running,
        browser.open(f"http://127.0.0.1:{running.port}/") as page,
    ):
        page.until("document.body?.dataset.link === 'live'")
        page.click("#tab-sensors")
        page.value(SENSORS)
        page.value(button("Publish"))
        until(lambda: heard, "it is published")
        newest = codec_of(IMU).decode(heard[-1])
        assert newest["linear_acceleration"]["z"] == pytest.approx(9.75, abs=0.01)
        assert newest["orientation"]["w"] == pytest.approx(0.7071, abs=1e-3)
        page.until("document.querySelector('#panel-sensors .camera') !== null")
        page.until("!document.querySelector('#panel-sensors select[aria-label=Camera]').hidden")
        page.value(button("Start"))
        page.until("document.querySelector('.camera').naturalWidth === 8")
        # Every picture must be shown, or the next would not be sent, and the age would grow.
        shown = filmed.pictures
        until(lambda: filmed.pictures > shown + 100, "the camera gives pictures for a second")
        page.until("document.querySelector('.sight').dataset.age === 'fresh'")
        assert page.value(AGE).startswith("Age of the picture 0.")
        filmed.still.set()
        page.until("document.querySelector('.sight').dataset.age === 'old'")
        assert page.value(AGE).startswith("⚠ Old picture: ")
        color = page.value(COLOR)
        page.until("document.querySelector('.sight').dataset.age === 'gone'")
        assert re.fullmatch("✕ No picture for [2-9] s", page.value(AGE))
        assert page.value(COLOR) != color
        filmed.still.clear()
        page.until("document.querySelector('.sight').dataset.age === 'fresh'")
        page.until("document.querySelectorAll('#panel-sensors .u-series').length === 4")
        page.until("document.querySelector('#panel-sensors .u-legend') !== null")
        page.value(button("End"))
        page.until("document.querySelector('.sight').hidden")
        assert not [each for each in page.complaints() if "GL Driver Message" not in each]
    handle.close()


AGE = "document.querySelector('.sight figcaption').textContent"
COLOR = "getComputedStyle(document.querySelector('.sight figcaption')).color"

SENSORS = """
for (const kind of [DeviceOrientationEvent, DeviceMotionEvent]) {
  kind.requestPermission = async () => "granted";
}
setInterval(() => {
  const turned = new Event("deviceorientation");
  Object.assign(turned, { alpha: 0, beta: 90, gamma: 0 });
  dispatchEvent(turned);
  const moved = new Event("devicemotion");
  Object.assign(moved, {
    rotationRate: { alpha: 1, beta: 2, gamma: 3 },
    accelerationIncludingGravity: { x: 0, y: 0, z: 9.75 },
  });
  dispatchEvent(moved);
}, 20);
"""
"""Emulates the motion sensors of a phone held upright."""


def button(label):
    """Press a button of the sensors panel."""
    return (
        "[...document.querySelectorAll('#panel-sensors button')]"
        f".find(each => each.textContent === {label!r}).click()"
    )


def test_programs_are_asked_for_and_answer_in_words(page):
    page.click("#tab-setup")
    card = (
        "[...document.querySelectorAll('#panel-setup .card')].find(each => each.querySelector('h2')"
    )
    demos = f"{card}.textContent === 'Demos')"
    page.until("!document.querySelector('.enable').disabled")
    page.value(f"{demos}.querySelector('button').click()")
    page.until(f"{demos}.querySelectorAll('option').length > 5")
    assert page.value(f"{demos}.querySelector('button').textContent") == "Start"
    programs = f"{card}.textContent === 'Programs')"
    page.value(f"{programs}.querySelector('button').click()")
    page.until(f"!/^$|Asking/.test({programs}.querySelector('[role=status]').textContent)")
