"""A robot whose operator device another process shares through a router: reaction of the arm when
that process is killed."""

import contextlib
import time
from typing import NamedTuple

import pytest

from bench.killed import REST_M_S, ROBOTS, WINDOW_S, Watch, driven
from cardan.demos.pauses import Pauses
from cardan.drivers.remote import Remote
from cardan.errors import DeviceAccessError
from tests.programs import Program
from tests.serving import free_endpoint
from tests.test_ending import toml

pytestmark = [
    pytest.mark.matrix,  # Whole programs that move an arm.
    pytest.mark.usefixtures("zenoh"),
]

ROBOT = "GP8, MotoROS velocity"
"""Pair of robot and driver that executes commands without lag."""
SPEED_M_S = 0.1
MAX_AGE_S = 0.15
BRAKES_S = 0.2
BUSY_S = 1.5
"""Additional time for a computer with other work. Without the watchdog the arm would move on for
seconds, to the end of its reach."""
LATE_AT_EACH = 4
"""Session, robot, router and this test may each be delayed as much as the computer paused."""


@pytest.fixture
def zenoh():
    pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')


class Joined(NamedTuple):
    """A robot, and the device in another process that moves it."""

    watch: Watch
    router: str
    share: Program

    def wait_until_moving(self):
        self.watch.until(lambda found: found > 0.8 * SPEED_M_S, 0.2)

    def rests_in_time_after(self, act):
        with Pauses() as pauses:
            at_s = time.monotonic()
            act()
            rested_s = self.watch.until(lambda found: found < REST_M_S, 1.0)
        took_s = rested_s - WINDOW_S - at_s
        late_s = LATE_AT_EACH * pauses.longest_s
        assert took_s <= MAX_AGE_S + BRAKES_S + BUSY_S + late_s, f"{took_s:.3f} s, {late_s:.3f} s"


@pytest.fixture
def joined(tmp_path):
    router = free_endpoint()
    with driven(ROBOT, SPEED_M_S, tmp_path) as (robot, tables), contextlib.ExitStack() as stack:
        served = stack.enter_context(Program("net", "server", "router", "--endpoint", router))
        served.wait_for("READY")
        operators = tmp_path / "operator.toml"
        operators.write_text(toml({"device": tables["device"]}))
        share = Program("devices", "share", operators, "--router", router, "--name", "mouse")
        stack.enter_context(share).wait_for("READY /shared/mouse/state")
        session = tmp_path / "session.toml"
        remote = {"driver": "remote", "router": router, "device": "mouse"}
        session.write_text(toml({**tables, "device": remote | {"max_age_s": MAX_AGE_S}}))
        run = stack.enter_context(Program("run", session))
        found = Joined(Watch(ROBOTS[ROBOT].arm, robot.joints), router, share)
        try:
            found.wait_until_moving()
        except TimeoutError as error:
            raise AssertionError(run.out + run.err + share.err) from error
        yield found


@pytest.mark.real
def test_a_killed_process_stops_the_arm_and_the_second_session_is_refused(joined):
    with pytest.raises(DeviceAccessError, match=r"mouse is used by cardan_device_\w+ at .*: end"):
        Remote(router=joined.router, device="mouse").open()
    joined.share.wait_for("refused: claims while another session has it", "stderr")
    joined.wait_until_moving()
    joined.rests_in_time_after(joined.share.process.kill)
