"""Teleoperation of a GP8 over MotoROS: sessions of the examples, including the wire, in virtual
time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cardan.common.tables import as_table
from cardan.drivers.motoros import Motoros
from cardan.errors import MotionRefusedError
from cardan.gateway.arm.status import Phase
from cardan.gateway.arm.verb_methods import ArmVerbs
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.session.arm_assembly import make_arm
from cardan.gateway.session.assembly import load_config, make_controller
from cardan.robots import load_arm
from cardan.types import DeviceLink, DeviceState
from tests.drivers.motoros_bench import SessionBench

pytestmark = pytest.mark.matrix

EXAMPLES = Path(__file__).parents[1] / "examples"
REST = (0.0,) * 6
BOTH = pytest.mark.parametrize(
    ("example", "velocity_mode"),
    [("spacemouse-gp8-simulated.toml", True), ("spacemouse-gp8-stream.toml", False)],
    ids=["velocity", "stream"],
)


class Hand:
    """Device motion: deflections by time since the press of the dead-man."""

    def __init__(self, example, velocity_mode, axes, plant="ideal", **options):
        config = load_config(EXAMPLES / example)
        table = {k: v for k, v in as_table(config.robot).items() if k not in ("driver", "enable")}
        self.bench = SessionBench(
            {**table, **options},
            self._answer,
            velocity_mode=velocity_mode,
            plant=plant,
        )
        robot = Motoros(self.bench.options)
        self.core = make_controller(config, robot)
        self.follower = self.core.commanded
        self.obstacles = config.obstacles
        self.axes = axes
        self.pressed_s = None
        self.joints, self.phases, self.said = [], [], set()
        self.farthest_m = 0.0
        self.model = ArmKinematics(load_arm("gp8"))

    def _answer(self, state):
        now_s = state.stamp_s
        if self.pressed_s is None and state.ready and self.core.phase is Phase.DISARMED:
            self.pressed_s = now_s + 0.1
        held = self.pressed_s is not None and now_s >= self.pressed_s
        device = DeviceState(
            now_s,
            DeviceLink.LIVE,
            self.axes(now_s - self.pressed_s) if held else REST,
            frozenset({"left"}) if held else frozenset(),
        )
        command = self.core.tick(state, device)
        here = self.core.reference.pose
        if here is not None and state.ready:
            away = np.array(here.position) - self.forward(state.joints)
            self.farthest_m = max(self.farthest_m, float(np.linalg.norm(away)))
        self.joints.append(self.bench.controller.measured_rad(0))
        self.phases.append(self.core.phase)
        self.said.add(self.core.message)
        return command

    def run(self, seconds):
        self.bench.ready()
        self.bench.run(seconds)
        return self

    def forward(self, joints):
        return self.model.forward(np.array(joints)).translation.copy()


@BOTH
def test_joint_and_cartesian_axes_at_once(example, velocity_mode):
    """Equation 7 of Baklouti et al. 2021."""
    hand = Hand(example, velocity_mode, lambda t: (0.0, 0.5, 0.0, 0.0, 0.0, 0.8)).run(2.0)
    first, last = hand.joints[0], hand.joints[-1]
    moved = hand.forward(last) - hand.forward(first)
    assert moved[1] > 0.08
    assert abs(moved[0]) < 0.005
    assert abs(moved[2]) < 0.005
    assert last[5] - first[5] > 0.5
    assert hand.core.phase is Phase.MOVING


@BOTH
def test_letting_go_stops_in_a_ramp_and_holds(example, velocity_mode):
    hand = Hand(
        example, velocity_mode, lambda t: (-0.5, 0.0, 0.0, 0.0, 0.0, 0.0) if t < 1.0 else REST
    )
    hand.run(2.5)
    path = np.array([hand.forward(q) for q in hand.joints[:: max(1, len(hand.joints) // 200)]])
    assert hand.core.phase is Phase.HOLDING
    assert np.linalg.norm(path[-1] - path[-10]) < 1e-4
    # 75 mm/s for a second, without a return motion at the end.
    assert path[:, 0].min() == pytest.approx(path[-1, 0], abs=5e-4)


@BOTH
@pytest.mark.parametrize("plant", ["ideal", "paper"])
def test_nothing_of_the_arm_comes_into_the_forbidden_zone(example, velocity_mode, plant):
    hand = Hand(
        "spacemouse-gp8-simulated.toml",
        velocity_mode,
        lambda t: (0.3, -1.0, 0.0, 0.0, 0.0, 0.0),
        plant,
        mode="velocity" if velocity_mode else "stream",
    )
    hand.run(4.0)
    # The servo's own model, at the arm's joint positions.
    distances = [min(hand.follower.servo.collision.at(np.array(q))) for q in hand.joints[::5]]
    assert 0.015 < min(distances) < 0.04
    assert hand.core.phase is not Phase.NO_ROBOT


@BOTH
def test_through_the_wrist_singularity_inside_joint_limits(example, velocity_mode):
    hand = Hand(
        example,
        velocity_mode,
        lambda t: (0.0, 0.0, 1.0, 0.0, 1.0, 0.0),
        speed_share=0.3,
    )
    hand.run(4.0)
    joints = np.array(hand.joints)
    period_s = hand.bench.session.capabilities.period_s
    rates = np.abs(np.diff(joints, axis=0)).max(axis=0) / period_s
    arm = load_arm("gp8")
    # Joint 5 starts at -70 deg and is rotated through zero or past it: no joint runs away.
    assert np.ptp(joints[:, 4]) > 0.5
    assert (rates <= 0.3 * np.array(arm.velocity) * 1.05 + 1e-3).all()
    lower, upper = np.array(arm.lower), np.array(arm.upper)
    assert ((joints >= lower) & (joints <= upper)).all()


@BOTH
def test_a_stretched_elbow_is_held_still_whatever_the_period(example, velocity_mode):
    hand = Hand(
        "spacemouse-gp8-stream.toml",
        velocity_mode,
        lambda t: (0.4, -0.8, 0.0, 0.0, 0.0, 0.8) if t < 5.5 else REST,
        mode="velocity" if velocity_mode else "stream",
    )
    hand.bench.ready()
    hand.bench.run(5.0)
    pushed = []
    for _ in range(20):
        hand.bench.run(0.025)
        pushed.append(hand.forward(hand.bench.controller.command_rad(0)))
    assert "singular (0.000)" in hand.core.status().arm.in_words()
    assert np.ptp(np.array(pushed), axis=0).max() < 0.004
    hand.bench.run(1.0)
    assert hand.core.phase is Phase.HOLDING
    after = hand.forward(hand.bench.controller.command_rad(0))
    assert np.linalg.norm(after - pushed[-1]) < 0.01


def test_a_lagging_arm_is_not_taken_for_one_that_is_held():
    hand = Hand(
        "spacemouse-gp8-simulated.toml",
        True,
        lambda t: (-1.0, 0.0, 0.0, 0.0, 0.0, 0.0) if t < 1.5 else REST,
        "paper",
    )
    hand.run(3.0)
    assert hand.core.status().trips == 0
    path = np.array([hand.forward(q)[0] for q in hand.joints])
    # 150 mm/s: the arm arrives 40 mm after the release, and does not return.
    assert path[-1] - path[0] == pytest.approx(-0.2, abs=0.03)
    assert path.min() == pytest.approx(path[-1], abs=5e-4)


@BOTH
@pytest.mark.parametrize("plant", ["ideal", "paper"])
def test_what_a_speed_limit_took_is_not_made_up_for_when_the_hand_has_let_go(
    example, velocity_mode, plant
):
    hand = Hand(
        example,
        velocity_mode,
        lambda t: (-1.0, 0.3, 0.0, 0.0, 0.0, 0.0) if t < 1.0 else REST,
        plant,
    )
    hand.bench.ready()
    hand.bench.run(0.5)
    hand.bench.controller.speed_limit(0.01, hand.bench.now_s)
    hand.bench.run(0.4)
    hand.bench.controller.speed_limit(None, hand.bench.now_s)
    hand.bench.run(0.9)
    before = hand.forward(hand.bench.controller.command_rad(0))
    hand.bench.run(6.0)
    after = hand.forward(hand.bench.controller.command_rad(0))
    assert np.linalg.norm(after - before) < 0.02
    assert not any(hand.bench.controller.velocity_rad_s(0))
    assert hand.core.at_rest


@BOTH
def test_short_pauses_of_this_computer_leave_no_distance(example, velocity_mode):
    """Each pause is shorter than every watchdog; a remaining offset would show at the release."""
    hand = Hand(
        example,
        velocity_mode,
        lambda t: (0.0, np.sin(4.0 * t), 0.0, 0.0, 0.0, 0.0) if t < 6.0 else REST,
    )
    hand.bench.ready()
    for _ in range(16):
        hand.bench.run(0.35)
        hand.bench.stall(0.03)
    hand.bench.run(1.5)
    before = hand.bench.controller.command_rad(0)
    hand.bench.run(4.0)
    assert hand.bench.controller.command_rad(0) == pytest.approx(before, abs=0.006)
    assert not any(hand.bench.controller.velocity_rad_s(0))


def test_an_arm_that_somebody_holds_is_noticed_and_not_pulled_at():
    hand = Hand("spacemouse-gp8-simulated.toml", True, lambda t: (-1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    hand.bench.ready()
    held = hand.bench.controller.measured_rad(0)
    feedback = hand.bench.controller.feedback
    # Commands continue, but the joints do not move.
    hand.bench.controller.feedback = lambda group: feedback(group)._replace(
        pos=(*held, 0.0, 0.0, 0.0, 0.0)
    )
    hand.bench.run(6.0)
    status = hand.core.status()
    assert status.trips == 1
    assert any("something else holds it" in words for words in hand.said)
    max_lead_m = hand.core.reference.limits.max_lead_m
    lag_s = hand.bench.session.capabilities.lag_s
    # At most the maximum lead, the normal lag and a braking distance.
    assert hand.farthest_m <= max_lead_m + 0.15 * lag_s + 0.02
    # If measured joints stand still, their real command is hidden; motion ends nevertheless.
    commanded = hand.forward(hand.bench.controller.command_rad(0))
    assert np.linalg.norm(commanded - hand.forward(held)) <= 2.0 * (max_lead_m + 0.15 * lag_s)
    assert not any(hand.bench.controller.velocity_rad_s(0))


@pytest.mark.parametrize(
    "example",
    ["spacemouse-gp8.toml", "spacemouse-gp8-simulated.toml", "spacemouse-gp8-stream.toml"],
)
def test_the_examples_keep_their_distance_at_home(example):
    config = load_config(EXAMPLES / example)
    table = {k: v for k, v in as_table(config.robot).items() if k != "driver"}
    follower = make_arm(config, Motoros(Motoros.Options(**table)))
    distances = follower.servo.collision.at(np.array(load_arm("gp8").home))
    assert min(distances) > config.arm.safety_distance_m


@pytest.mark.parametrize("mode", ["velocity", "stream"])
@pytest.mark.parametrize("plant", ["ideal", "paper"])
def test_the_cartesian_controller_drives_it_too(mode, plant):
    bench = SessionBench({"mode": mode, "speed_share": 0.2}, plant=plant)
    arm = load_arm("gp8")
    controller = ArmVerbs.alone(arm, Motoros(bench.options).capabilities)
    bench.answer = controller.controller.tick
    bench.ready()

    def run(motion):
        bench.run(20.0, until=lambda: controller.start_pending() or motion.over)
        assert motion.outcome is Outcome.DONE, motion
        bench.run(0.6)
        return ArmKinematics(arm).forward(np.array(bench.controller.measured_rad(0))).translation

    bench.run(0.1)
    start = np.array(controller.stat().pose)
    goal = start + np.array([-0.05, 0.1, 0.05, 0.0, 0.0, 0.0])
    there = run(controller.movl(list(goal)))
    assert there == pytest.approx(goal[:3], abs=2e-3)
    back = run(controller.movj(list(start)))
    assert back == pytest.approx(start[:3], abs=2e-3)


@pytest.mark.parametrize("velocity_mode", [True, False])
def test_every_verb_with_default_options(velocity_mode):
    bench = SessionBench(velocity_mode=velocity_mode)
    verbs = ArmVerbs.alone(load_arm("gp8"), Motoros(bench.options).capabilities)
    bench.answer = verbs.controller.tick
    bench.ready().run(0.1)

    def over(motion):
        bench.run(20.0, until=lambda: verbs.start_pending() or motion.over)
        assert motion.outcome is Outcome.DONE, motion
        bench.run(0.3)
        return verbs.stat().pose[:3]

    start = verbs.stat().pose
    assert over(verbs.movl([start[0] - 0.02, *start[1:]]))[0] == pytest.approx(
        start[0] - 0.02, abs=1e-3
    )
    assert over(verbs.movj(start)) == pytest.approx(start[:3], abs=1e-3)
    assert over(verbs.relj([0.0, 0.0, -0.02, 0.0, 0.0, 0.0]))[2] == pytest.approx(
        start[2] - 0.02, abs=1e-3
    )
    verbs.movv([-0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
    bench.run(2.0)
    verbs.stop()
    bench.run(1.0)
    assert verbs.at_rest
    assert -0.02 < verbs.stat().pose[0] - start[0] < -0.015
    with pytest.raises(MotionRefusedError, match="this needs torque"):
        verbs.gcmp()
    bench.run(0.1)
    assert bench.states[-1].hold_reason == ""
