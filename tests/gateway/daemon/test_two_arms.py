"""Two mice drive two arms under ``cardan daemon run``, as in examples/two-arms."""

import contextlib
import tempfile
from collections import deque
from pathlib import Path

import pytest

from cardan.gateway.daemon.config import read_daemon_config
from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions
from tests.gateway.daemon.test_serve import Lab
from tests.programs import Program
from tests.serving import free_endpoint
from tests.waiting import until

# Whole programs that start in sequence: all time limits are generous.
pytestmark = pytest.mark.matrix

EXAMPLE = Path(__file__).parents[3] / "examples/two-arms"

UP = (0.0, 0.0, 0.3, 0.0, 0.0, 0.0)
NEUTRAL = (0.0,) * 6
MOVED_M = 0.002

MOTION_PERIOD_S = 0.008


class AskedMotion:
    """Carries out the test's actions, one each period, in its device's thread."""

    def __init__(self):
        self.next_due_s = 0.0
        self.asked = deque()

    def advance(self, now_s, device):
        self.next_due_s = now_s + MOTION_PERIOD_S
        if self.asked:
            method, *arguments = self.asked.popleft()
            getattr(device, method)(*arguments)


class Mouse(SpaceMousePeer):
    """A simulated SpaceMouse at `path`."""

    def __init__(self, path):
        super().__init__(
            SpaceMousePeerOptions(
                hid=str(path), model="spacemouse-compact", jitter_lsb=0, start_on_connect=False
            )
        )
        self.motion = AskedMotion()

    def do(self, *words):
        self.motion.asked.append(words)

    def touch(self):
        """Send some reports with the cap deflected, then at rest: the driver detects rest."""
        until(lambda: self.opened, "the device's opening")
        for axes in (*[UP] * 5, NEUTRAL):
            self.do("set_axes", axes)

    @property
    def opened(self):
        return bool(self.backend.clients)


class TwoArms(Lab):
    """The daemon with these files, and the mice at their paths."""

    def __init__(self, folder, stack):
        super().__init__(folder)
        self.stack = stack

    def plug(self, *names):
        return [self.stack.enter_context(Mouse(self.folder / f"{name}.sock")) for name in names]

    def start(self, *files):
        self.write()
        self.program = Program("daemon", "run", self.file, *files, cwd=self.folder)
        self.program.wait_for("READY ")
        return self

    def snapshot(self, name):
        return self.ask("snapshot", name)

    def until_snapshot(self, name, found, what):
        def look():
            snapshot = self.snapshot(name)
            return snapshot if found(snapshot) else None

        return until(look, f"{name}: {what}")

    def until_moved(self, name):
        """Wait until the arm has moved a certain distance from now on."""
        begin_m = self.snapshot(name)["tracking"]["path_m"]
        return self.until_snapshot(
            name,
            lambda s: s["arm"]["phase"] == "moving" and s["tracking"]["path_m"] > begin_m + MOVED_M,
            "motion",
        )

    def arm(self, name, mouse):
        """Re-arm, from any state of the device."""
        mouse.do("release", "left")
        mouse.touch()
        self.until_snapshot(name, lambda s: s["device"]["link"] == "live", "its mouse at rest")
        self.until_snapshot(name, lambda s: s["robot"]["link"] == "live", "its robot")
        mouse.do("press", "left")
        self.until_snapshot(name, lambda s: s["arm"]["authority"] == "device", "re-arming")


@pytest.fixture
def lab():
    # tmp_path may be too long for a socket's path.
    with (
        tempfile.TemporaryDirectory(prefix="cardan-test-") as folder,
        contextlib.ExitStack() as stack,
    ):
        lab = TwoArms(Path(folder), stack)
        yield lab
        if lab.program is not None:
            lab.program.__exit__()


def test_two_mice_drive_two_arms_and_unplugging_one_stops_one(lab):
    left, right = lab.plug("left", "right")
    lab.start(EXAMPLE / "teo.toml", EXAMPLE / "simulated-mice.toml")
    for name in ("left", "right"):
        lab.until(name, robot_link="live", phase="disarmed")
    lab.arm("left", left)
    left.do("set_axes", UP)
    lab.until_moved("left")
    still = lab.snapshot("right")
    assert (still["arm"]["phase"], still["tracking"]["path_m"]) == ("disarmed", 0.0)

    lab.arm("right", right)
    right.do("set_axes", UP)
    lab.until_moved("right")
    lab.until_moved("left")
    # In the waist's frame one arm is on the left, the other on the right.
    assert lab.snapshot("left")["robot"]["pose"][1] > 0.3
    assert lab.snapshot("right")["robot"]["pose"][1] < -0.3

    left.do("unplug")
    stopped = lab.until_snapshot(
        "left",
        lambda s: s["device"]["link"] == "lost" and s["arm"]["phase"] == "disarmed",
        "its stop",
    )
    lab.until_moved("right")
    assert lab.snapshot("left")["tracking"]["path_m"] == stopped["tracking"]["path_m"]
    assert lab.snapshot("right")["arm"]["trips"] == 0

    # The mouse reconnects with its cap deflected and button pressed, then comes to rest: neither
    # may arm.
    left.do("replug")
    lab.until_snapshot("left", lambda s: s["device"]["link"] == "needs neutral", "its return")
    lab.until_moved("right")
    left.do("set_axes", NEUTRAL)
    lab.until_snapshot("left", lambda s: s["device"]["link"] == "live", "its mouse at rest")
    lab.until_moved("right")
    back = lab.snapshot("left")
    assert (back["arm"]["phase"], back["arm"]["authority"]) == ("disarmed", "")
    assert back["tracking"]["path_m"] == stopped["tracking"]["path_m"]
    lab.arm("left", left)
    left.do("set_axes", UP)
    lab.until_moved("left")
    assert lab.snapshot("right")["arm"]["trips"] == 0


def test_two_arms_that_know_each_other_move_while_they_hear_each_other(lab):
    (left,) = lab.plug("left")
    endpoint = free_endpoint()
    text = (EXAMPLE / "neighbors.toml").read_text(encoding="utf-8")
    network = "[sessions.network]\n"
    assert text.count(network) == 2
    (lab.folder / "arms.toml").write_text(
        text.replace(network, f'{network}router = "{endpoint}"\n')
    )
    lab.start(lab.folder / "arms.toml", EXAMPLE / "simulated-mice.toml")
    # The first state from the neighbor removes the message about it.
    lab.until_snapshot(
        "left",
        lambda s: s["arm"]["message"] and "neighbor" not in s["arm"]["message"],
        "the neighbor's states",
    )
    lab.arm("left", left)
    left.do("set_axes", UP)
    lab.until_moved("left")
    lab.ask("stop", "right")
    lab.until_snapshot(
        "left",
        lambda s: s["arm"]["phase"] == "disarmed" and "the neighbor right" in s["arm"]["message"],
        "the stop",
    )
    at = lab.snapshot("left")["robot"]["joints_rad"]
    lab.ask("start", "right")
    # After that, the message may still name the cause of the past stop.
    lab.until_snapshot(
        "left", lambda s: not s["arm"]["message"].startswith("where the neighbor"), "the return"
    )
    assert lab.snapshot("left")["robot"]["joints_rad"] == pytest.approx(at, abs=1e-3)


@pytest.mark.parametrize(("mice", "by"), [("mice", "serial"), ("simulated-mice", "path")])
def test_the_examples_mice_are_two_of_a_kind(mice, by):
    config = read_daemon_config([EXAMPLE / "teo.toml", EXAMPLE / f"{mice}.toml"])
    left, right = (config.sessions[name].config for name in ("left", "right"))
    assert left.device.driver == right.device.driver == "spacemouse"
    differ = {
        key for key, value in left.device.options.items() if right.device.options[key] != value
    }
    assert differ == {by}
    assert (left.arm.model, right.arm.model) == ("teo_left_arm", "teo_right_arm")
