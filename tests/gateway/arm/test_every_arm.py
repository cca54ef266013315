"""Every shipped arm with default options, on its simulated drives in virtual time."""

import numpy as np
import pytest

from cardan.drivers.sim_arm import SimArm, SimArmOptions
from cardan.gateway.arm.verb_methods import ArmVerbs
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.arm.vocab import State
from cardan.robots import arm_names, load_arm
from cardan.spatial import from_rotation_vector, rotate
from cardan.types import Pose, TorqueCommand, Vector3

pytestmark = pytest.mark.matrix


class Arm:
    """The verbs on the simulated arm, one cycle at a time; the arm must never hold for a reason."""

    def __init__(self, name):
        self.robot = SimArm(SimArmOptions(robot=name, pacing="virtual"))
        self.robot.open()
        self.verbs = ArmVerbs.alone(load_arm(name), self.robot.capabilities)
        self._cycles = self.robot.cycles()
        self.command = None
        self.run(0.2)

    def tick(self):
        state = self.state = next(self._cycles)
        self.command = self.verbs.controller.tick(state)
        self.robot.send(self.command)
        assert self.robot.arm.hold_reason == ""

    def run(self, seconds):
        for _ in range(round(seconds / 0.002)):
            self.tick()

    def finish(self, motion):
        for _ in range(10_000):
            self.verbs.start_pending()
            if motion.over:
                assert motion.outcome is Outcome.DONE, motion.reason
                return
            self.tick()
        raise AssertionError(f"{motion} is not over after 20 s")

    def rest(self):
        self.verbs.stop()
        for _ in range(1000):
            self.tick()
            if self.verbs.at_rest and self.verbs.state is State.NOT_CONTROLLING:
                return
        raise AssertionError("still moving 2 s after stop")

    def take_over(self):
        """Command the arm from another place to its present one; return that place, and the place
        of rest.

        Drives without integral action sag below their command.
        """
        here = self.six
        for step in ((-0.01, 0.0, 0.0), (0.0, 0.0, 0.0)):
            self.finish(self.verbs.movj([*(here[:3] + step), *here[3:]]))
        self.run(0.3)
        assert self.six[:3] == pytest.approx(here[:3], abs=8e-3)
        return here[:3], self.six[:3]

    @property
    def six(self):
        return np.array(self.verbs.stat().pose)

    @property
    def joints(self):
        return np.array(self.robot.arm.plant.positions)


@pytest.fixture(params=arm_names())
def arm(request):
    arm = Arm(request.param)
    yield arm
    arm.robot.close()


def test_stat_is_where_the_arm_is(arm):
    pose: Pose = arm.robot.arm.plant.pose
    assert arm.six[:3] == pytest.approx(pose.position, abs=1e-6)
    assert arm.verbs.state is State.NOT_CONTROLLING


@pytest.mark.parametrize("verb", ["movl", "movj"])
def test_it_goes_where_it_is_sent(arm, verb):
    commanded, start = arm.take_over()
    turned = arm.six[3:]
    for step in ((-0.02, 0.0, 0.0), (0.0, 0.0, -0.02)):
        arm.finish(getattr(arm.verbs, verb)([*(commanded + step), *turned]))
        arm.run(0.3)
        assert arm.six[:3] == pytest.approx(start + step, abs=1e-3)


def test_relj_goes_by_a_distance(arm):
    _, start = arm.take_over()
    arm.finish(arm.verbs.relj([-0.02, 0.0, 0.0, 0.0, 0.0, 0.0]))
    arm.run(0.3)
    assert arm.six[:3] - start == pytest.approx((-0.02, 0.0, 0.0), abs=1e-3)


def test_retract_goes_back_along_the_tools_axis(arm):
    _, start = arm.take_over()
    axis = rotate(from_rotation_vector(Vector3(*arm.six[3:])), Vector3(0.0, 0.0, 1.0))
    motion = arm.verbs.retract(0.02)
    arm.finish(motion)
    arm.run(0.3)
    assert (motion.verb, motion.ends) == ("retract", True)
    assert arm.six[:3] - start == pytest.approx([-0.02 * each for each in axis], abs=1e-3)


def test_movv_goes_on_until_stop(arm):
    _, start = arm.take_over()
    arm.verbs.movv([-0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
    arm.run(2.0)
    assert arm.verbs.state is State.MOVV
    arm.rest()
    arm.run(0.3)
    moved = arm.six[:3] - start
    assert -0.02 < moved[0] < -0.015  # less the distance lost while accelerating
    assert moved[1:] == pytest.approx((0.0, 0.0), abs=1e-3)
    before = arm.joints
    arm.run(0.5)
    assert arm.joints == pytest.approx(before, abs=1e-4)


def test_gcmp_holds_it_until_stop(arm):
    before = arm.joints
    arm.verbs.gcmp()
    arm.run(2.0)
    assert arm.verbs.state is State.GRAVITY
    assert isinstance(arm.command, TorqueCommand)
    assert arm.joints == pytest.approx(before, abs=2e-3)
    arm.rest()
    arm.run(0.5)
    assert arm.joints == pytest.approx(before, abs=0.01)  # the drives sag again


def test_stop_ends_a_line_at_once(arm):
    start = arm.six
    motion = arm.verbs.movl([start[0] - 0.02, *start[1:]])
    arm.run(0.3)
    arm.rest()
    assert motion.outcome is Outcome.ABORTED
    assert abs(arm.six[0] - start[0]) < 0.015
