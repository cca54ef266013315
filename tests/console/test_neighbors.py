"""The console page in a real browser draws a neighbor at its reported joint states."""

from __future__ import annotations

import base64
import contextlib
import json
import math
import threading
import time

import numpy as np
import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import default_message
from cardan.robots import load_arm
from tests.console.browser import WAIT_S
from tests.console.page_input import RELOADED
from tests.console.served_arm import served_arm

pytestmark = pytest.mark.matrix  # The browser draws by software.

TOPIC, STATE = "/right/joint_states", "sensor_msgs/msg/JointState"
NEIGHBOR = f"""
[[neighbors]]
name = "right"
model = "ur5"
topic = "{TOPIC}"
base_xyz_m = [0.15, 0.5, 0.0]
base_rpy_deg = [0.0, 0.0, 0.0]
max_age_s = 0.5
"""
PERIOD_S = 0.05

TURNED = 10.0
"""Least shift in the picture, pixels, of a neighbor that was turned; a quarter of a turn shifts it
farther."""

LEAST = 150
"""Least number of pixels of the picture that a neighbor covers."""

FOLDED = [0.0, 0.0, 2.9, 0.0, 0.0, 0.0]
"""Joints of a UR5 whose forearm is folded back along its upper arm, which points along x."""

PURPLE = """
(async (picture, [x, y, width, height]) => {
  const blob = await (await fetch("data:image/webp;base64," + picture)).blob();
  const bitmap = await createImageBitmap(blob);
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d");
  context.drawImage(bitmap, -x, -y);
  const { data } = context.getImageData(0, 0, width, height);
  const found = [];
  for (let at = 0; at < data.length; at += 4) {
    const [red, green, blue] = [data[at], data[at + 1], data[at + 2]];
    if (blue - green > 25 && red - green > 6 && blue > red) {
      found.push([(at / 4) % width, Math.floor(at / 4 / width)]);
    }
  }
  return found;
})
"""
"""JavaScript function that returns the pixels in a neighbor's color, in a section of a picture."""


class Neighbor:
    """Publishes the neighbor's joint states periodically until it falls silent."""

    def __init__(self, network):
        self.joints = list(FOLDED)
        self._names, self._codec = load_arm("ur5").joint_names, codec_of(STATE)
        self._publisher = network.advertise(TOPIC, STATE, False)
        self._silent = threading.Event()
        self._thread = threading.Thread(target=self._tell, daemon=True)
        self._thread.start()

    def _tell(self):
        while not self._silent.wait(PERIOD_S):
            now_ns = time.time_ns()
            stamp = {"sec": now_ns // 10**9, "nanosec": now_ns % 10**9}
            message = default_message(STATE) | {
                "header": {"stamp": stamp, "frame_id": ""},
                "name": list(self._names),
                "position": list(self.joints),
            }
            self._publisher.publish(self._codec.encode(message))

    def close(self):
        self._silent.set()
        self._thread.join()
        self._publisher.close()


@pytest.fixture(scope="module")
def arm(built, tmp_path_factory):
    """A session whose arm has a neighbor that has not yet published."""
    with served_arm(tmp_path_factory.mktemp("session"), built, NEIGHBOR) as served:
        yield served


def purple(page, blank):
    """Pixels of the arm's picture in the neighbor's color, right and up of its corner."""
    corner = page.value(
        "(b => [b.x, b.y, b.width, b.height].map(Math.round))"
        "(document.querySelector('.picture').getBoundingClientRect())"
    )
    words = json.dumps(base64.b64encode(page.picture()).decode()), json.dumps(corner)
    found = blank.value(f"{PURPLE}({', '.join(words)})")
    return np.array(found, dtype=float).reshape(-1, 2) * (1.0, -1.0)


def middle(page, blank, last):
    """Center of the neighbor, once it is at rest in the picture at another place than `last`."""
    end_s, before = time.monotonic() + WAIT_S, np.full(2, np.inf)
    while True:
        dots = purple(page, blank)
        here = dots.mean(axis=0) if len(dots) >= LEAST else np.full(2, np.inf)
        rests = np.isfinite(here).all() and np.abs(here - before).max() < 1.0
        if rests and (last is None or np.linalg.norm(here - last) > TURNED):
            return here
        before = here
        assert time.monotonic() < end_s, f"{len(dots)} dots are a neighbor's, at {here}"
        time.sleep(0.5)


def gone(page, blank):
    """Wait until no part of the neighbor is in the picture; fail after a time limit."""
    end_s = time.monotonic() + WAIT_S
    while len(dots := purple(page, blank)) >= LEAST:
        assert time.monotonic() < end_s, f"{len(dots)} dots are still a neighbor's"
        time.sleep(0.2)


@pytest.mark.timeout(300)
def test_a_neighbor_is_where_its_joint_states_have_it_and_gray_once_they_are_old(arm, browser):
    """Seen from above, the neighbor's outstretched arm turns about its base by the angle of its
    first joint."""
    network, address = arm
    with browser.open(address, 1440, 900) as page, browser.open("about:blank") as blank:
        page.until(RELOADED)
        page.value(
            "[...document.querySelectorAll('.view button')]"
            ".find(each => ['Top', 'Arriba'].includes(each.textContent)).click()"
        )
        gone(page, blank)
        seen = []
        with contextlib.closing(Neighbor(network)) as neighbor:
            for deg in (0.0, 90.0, 180.0):
                neighbor.joints[0] = math.radians(deg)
                seen.append(middle(page, blank, seen[-1] if seen else None))
        gone(page, blank)
    base = 0.5 * (seen[0] + seen[2])
    along, across = seen[0] - base, seen[1] - base
    size = np.linalg.norm(along)
    assert size > 15.0
    # Seen from above, x points down in the picture and y to the right.
    assert along[1] < -0.9 * size
    assert across[0] > 0.7 * size
    assert abs(across[1]) < 0.4 * size
