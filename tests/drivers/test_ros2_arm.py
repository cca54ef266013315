"""The ROS 2 arm driver in virtual time: messages accepted as states of its arm, and commands."""

import itertools
import math
import re

import pytest

from cardan.drivers.robot_core import WAKE_S
from cardan.drivers.ros2_arm import Ros2Arm, Ros2ArmOptions, Ros2ArmSession
from cardan.drivers.ros2_arm.session import COMMAND_TYPES
from cardan.errors import CommandError, ConfigurationError, DriverError, OptionError
from cardan.protocols.ros2.cdr import codec_of
from cardan.robots import limits_in, load_arm
from cardan.types import (
    CommandKind,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    RobotLink,
    TorqueCommand,
)
from tests.drivers.ros2_bench import KEY, Wire, WiredArm, follow, joint_states, received

NAMES = load_arm("ur5").joint_names
HOME = load_arm("ur5").home
SPEED = 0.5
BEGINS_S, ENDS_S = 0.5, 2.5


def session(**options):
    return Ros2ArmSession(Ros2ArmOptions(**options))


def message(positions=HOME, names=NAMES, sequence=1, stamp_s=1.0, sender=1, **more):
    return received(joint_states(names, positions, stamp_s=stamp_s, **more), sequence, sender)


class Ramp:
    """Command that turns joint 1 at SPEED between BEGINS_S and `ends_s`, with gentle ends.

    It continues from its last command like a good controller, and restarts with each session.
    """

    def __init__(self, ends_s=ENDS_S, velocity=False):
        self.ends_s, self.velocity = ends_s, velocity
        self.at = None
        self.speed = 0.0
        self.session = 0

    def __call__(self, state, now_s):
        if state.session != self.session or self.at is None:
            self.session, self.at, self.speed = state.session, list(state.joints), 0.0
        wanted = SPEED if BEGINS_S <= now_s < self.ends_s else 0.0
        step = 2.0 * state.period_s
        self.speed += min(max(wanted - self.speed, -step), step)
        self.at[0] += self.speed * state.period_s
        speeds = (self.speed, *[0.0] * 5)
        if self.velocity:
            return JointVelocityCommand(speeds)
        return JointCommand(tuple(self.at), speeds)


# -- joint states -----------------------------------------------------------------------------


def test_joints_are_ordered_by_their_names():
    ours = session()
    order = [3, 0, 5, 1, 4, 2]
    names = [NAMES[index] for index in order]
    state = ours.receive(
        message(
            [HOME[index] for index in order],
            names,
            velocity=[0.1 * index for index in order],
            effort=[float(index) for index in order],
        ),
        0.0,
    )
    assert state.joints == pytest.approx(HOME)
    assert state.velocities == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert state.torques == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    assert (state.link, state.session, state.clock_s) == (RobotLink.LIVE, 1, 1.0)
    assert state.ready


def test_joints_of_others_in_the_message_are_no_matter():
    names = ("finger", *NAMES, "base")
    state = session().receive(message((9.0, *HOME, 9.0), names), 0.0)
    assert state.joints == pytest.approx(HOME)


def test_names_with_a_prefix():
    prefixed = tuple(f"left_{name}" for name in NAMES)
    ours = session(joints=prefixed)
    assert ours.receive(message(HOME, prefixed), 0.0).joints == pytest.approx(HOME)
    assert ours.receive(message(HOME, NAMES, sequence=2, stamp_s=2.0), 0.0) is None


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (message(HOME[:5], NAMES[:5]), "without wrist_3_joint"),
        (message((*HOME, 0.0), (*NAMES, NAMES[0])), "twice"),
        (message(HOME[:5]), "5 numbers of position for 6 joints"),
        (message((), NAMES), "0 numbers of position"),
        (message(velocity=[0.0]), "1 numbers of velocity"),
        (message((math.nan, *HOME[1:])), "implausible"),
        (message((*HOME[:5], 1e9)), "implausible"),
        (message((*HOME[:5], math.inf)), "implausible"),
        (received(b"\0\1\0\0\1\2", 1), "bytes are too few"),
        (received(b"", 1), "no plain CDR"),
        (received(joint_states(NAMES, HOME), key=KEY.replace("JointState_", "Joy_")), "another ty"),
        (received(joint_states(NAMES, HOME))._replace(attachment=None), "without the attachment"),
    ],
)
def test_what_is_no_state_of_the_arm_is_reported(data, reason):
    ours = session()
    assert ours.receive(data, 0.0) is None
    assert ours.link(0.0) is RobotLink.WAITING
    assert [why for why in ours.ignored if re.search(reason, why)], ours.ignored
    assert any("ignored" in line for line in ours.diagnosis(0.0))


def test_another_nodes_joints_are_no_mistake():
    ours = session()
    ours.receive(message(), 0.0)
    for sequence in range(1, 200):
        gripper = message((0.01,), ("finger",), sequence=sequence, sender=9)
        assert ours.receive(gripper, 0.0) is None
    state = ours.receive(message(sequence=2, stamp_s=1.01), 0.01)
    assert state.ready
    assert state.alarm == ""
    assert ours.sessions == 1
    assert not ours.ignored
    assert ours.metrics()["others"] == 199


def test_a_flood_of_nonsense_is_an_alarm():
    ours = session()
    ours.receive(message(), 0.0)
    for _ in range(60):
        ours.receive(received(b"junk", 1, 3), 0.0)
    assert "flooded" in ours.receive(message(sequence=2, stamp_s=1.01), 0.01).alarm


def test_an_interface_that_there_is_not_is_no_measurement():
    """A joint_state_broadcaster fills in NaN for a missing interface."""
    state = session().receive(message(velocity=[math.nan] * 6, effort=[math.nan] * 6), 0.0)
    assert state.velocities == state.torques == ()


def test_late_and_double_messages_have_no_effect():
    ours = session()
    for sequence in (1, 2, 4):
        assert ours.receive(message(sequence=sequence, stamp_s=sequence), 0.0) is not None
    for sequence in (4, 3, 1):
        assert ours.receive(message(sequence=sequence, stamp_s=sequence), 0.0) is None
    assert ours.ignored == {"late or double": 3}
    assert ours.protocol_errors() == {"order": 3, "implausible": 0, "malformed": 0}
    assert ours.metrics()["lost"] == 1
    assert ours.sessions == 1


def test_the_stamps_give_the_period_whatever_their_clock():
    ours = session()
    ours.receive(message(stamp_s=5e8), 0.0)
    state = ours.receive(message(sequence=2, stamp_s=5e8 + 0.008), 0.008)
    assert state.period_s == pytest.approx(0.008, abs=1e-6)
    state = ours.receive(message(sequence=3, stamp_s=9e8), 0.018)
    assert state.period_s == pytest.approx(0.01)
    assert state.session == 1


def test_stamps_of_zero_do_without():
    ours = session(rate_hz=50.0)
    ours.receive(message(stamp_s=0.0), 0.0)
    state = ours.receive(message(sequence=3, stamp_s=0.0), 0.04)
    assert state.period_s == pytest.approx(0.04)
    assert (state.session, state.clock_s) == (1, None)


def test_stamps_that_go_back_are_a_new_session():
    """A reset simulation has its arm at another position."""
    ours = session()
    ours.receive(message(stamp_s=100.0), 0.0)
    assert ours.receive(message(sequence=2, stamp_s=1.0), 0.0).session == 2


def test_a_state_that_repeats_itself_is_no_state():
    ours = session()
    ours.receive(message(), 0.0)
    for sequence in range(2, 30):
        assert ours.receive(message(sequence=sequence), 0.01 * sequence) is None
    assert ours.link(0.3) is RobotLink.LOST
    assert any("the robot is frozen" in line for line in ours.diagnosis(0.3))


def test_a_node_that_was_started_anew_is_a_new_session():
    ours = session()
    assert ours.receive(message(sequence=700, stamp_s=7.0), 0.0).session == 1
    new = [message(sequence=n, stamp_s=8.0 + 0.1 * n, sender=2) for n in (1, 2, 3)]
    assert ours.receive(new[0], 1.1) is None
    state = ours.receive(new[1], 1.25)
    assert state.session == 2
    assert state.ready
    assert ours.receive(message(sequence=701, stamp_s=7.02), 1.25) is None  # the old one


# -- two publishers ---------------------------------------------------------------------------

OWN, OTHER = (bytes([number]) * 16 for number in (1, 2))


def sent_by_two(ours, until_s=3.0, begins_s=1.0, hz=10.0, **other):
    """Publish the arm's node at 100 Hz, and from `begins_s` on a second publisher at `hz`.

    Returns (time, state, commanded position of joint 4) for each message. While the arm is ready,
    commands are 2 mrad ahead of the measured position.
    """
    decode = codec_of(COMMAND_TYPES["position"]).decode
    other = {"positions": (0.0,) * 6, "sender": 2} | other
    found, reported = [], 0
    for n in range(1, round(until_s * 100.0)):
        now_s = 0.01 * n
        came = [message(sequence=n, stamp_s=5.0 + now_s)]
        if now_s >= begins_s + reported / hz:
            reported += 1
            came.append(message(sequence=reported, stamp_s=5.0 + now_s, **other))
        for data in came:
            state = ours.receive(data, now_s)
            sent = None
            if state is not None:
                asked = JointCommand(tuple(q + 0.002 for q in state.joints))
                sent = ours.command(asked if state.ready else HoldCommand(), now_s)
            value = None if sent is None else decode(sent)["data"][3]
            found.append((now_s, state, value))
    return found


@pytest.mark.parametrize("hz", [2.0, 10.0, 100.0, 400.0])
def test_two_publishers_of_a_joint_at_once_are_named_and_nothing_is_commanded(hz):
    ours = session()
    ours.named = {OWN: "/arm", OTHER: "/joint_state_publisher"}.get
    found = sent_by_two(ours, hz=hz)
    assert max(abs(value - HOME[3]) for *_, value in found if value is not None) < 0.01
    assert all(state.ready for now_s, state, _ in found if now_s < 0.995)
    after = [state for now_s, state, _ in found if now_s > 1.005 and state is not None]
    assert len(after) >= 198
    assert not any(state.ready for state in after)
    for state in after:
        assert state.joints == pytest.approx(HOME)
        assert state.session == 1
    assert after[-1].hold_reason == (
        "2 publishers of shoulder_lift_joint are heard at once on /joint_states, /arm (at -1.571) "
        "and /joint_state_publisher (at 0): end all but the arm's own, or give them another topic"
    )
    assert after[-1].hold_reason in ours.diagnosis(3.0)
    assert sum(ours.ignored.values()) == sum(state is None for *_, state, _ in found)


def test_a_second_publisher_that_ends_is_over_after_a_second():
    ours = session()
    sent_by_two(ours, until_s=1.5)
    ready = {}
    for n in range(150, 300):
        now_s = 0.01 * n
        state = ours.receive(message(sequence=n, stamp_s=5.0 + now_s), now_s)
        ready[n] = state.ready
    assert not any(ready[n] for n in range(150, 235))
    assert all(ready[n] for n in range(250, 300))


def test_a_second_publisher_of_some_of_the_joints_is_one_too():
    ours = session()
    found = sent_by_two(ours, names=NAMES[:2], positions=(0.0, 0.0))
    assert not found[-1][1].ready
    assert "publishers of shoulder" in found[-1][1].hold_reason
    ours = session()
    found = sent_by_two(ours, names=NAMES, positions=())
    assert "publisher 0202" in found[-1][1].hold_reason
    assert "(without a position)" in found[-1][1].hold_reason


@pytest.mark.parametrize("names", [("finger_joint",), ("wheel_left", "wheel_right")])
def test_publishers_of_other_joints_are_usual(names):
    found = sent_by_two(session(), names=names, positions=(0.0,) * len(names))
    assert all(state.ready for *_, state, _ in found if state is not None)


def test_what_is_heard_first_may_be_the_wrong_one():
    """The session listens before it is ready; the reason reports the second publisher."""
    ours = session()
    ours.listens_until_s = 1.0
    first = ours.receive(message((0.0,) * 6, sender=2), 0.0)
    assert first.hold_reason.startswith("listening for 1 s for another publisher")
    assert ours.command(JointCommand((0.002,) * 6), 0.0) is None
    for n in range(1, 300):
        now_s = 0.01 * n
        assert ours.receive(message(sequence=n), now_s) is None
        if n % 10 == 0:
            state = ours.receive(
                message((0.0,) * 6, sequence=n, stamp_s=1 + now_s, sender=2), now_s
            )
            assert "2 publishers of" in state.hold_reason
    # The second publisher ends; states of the arm's node count once the arm can have moved there.
    states = []
    for n in range(300, 500):
        now_s = 0.01 * n
        state = ours.receive(message(sequence=n, stamp_s=1 + now_s), now_s)
        states += [] if state is None else [(now_s, state)]
    assert states[0][0] == pytest.approx(3.9, abs=0.02)
    assert states[0][1].joints == pytest.approx(HOME)
    assert states[0][1].session == 2
    assert states[-1][1].ready


def test_a_process_that_stood_still_does_not_take_the_second_publisher_for_the_arms():
    ours = session()
    sent_by_two(ours, until_s=2.0)
    # Messages queued meanwhile are read at once, those of the second publisher first.
    assert ours.receive(message((0.0,) * 6, sequence=50, stamp_s=9.0, sender=2), 6.0) is None
    state = ours.receive(message(sequence=600, stamp_s=11.0), 6.001)
    assert state.joints == pytest.approx(HOME)
    assert not state.ready


def test_the_simulated_second_publisher_moves_no_arm():
    wire = Wire({"second-publisher": 1.5})
    ramp = Ramp(ends_s=9.0)
    with WiredArm(wire) as robot:
        states = follow(robot, 4.0, ramp)
        assert "2 publishers of" in states[-1].hold_reason
        assert {state.session for state in states if state.link is RobotLink.LIVE} == {1}
    assert wire.fastest() <= 1.1 * SPEED
    assert max(wire.fastest(joint) for joint in range(1, 6)) < 0.05
    assert wire.rests()


# -- jumps ------------------------------------------------------------------------------------


def test_a_state_out_of_the_arms_reach_is_reported_and_not_commanded_from():
    ours = session()
    for n in range(1, 100):
        ours.receive(message(sequence=n, stamp_s=5.0 + 0.01 * n), 0.01 * n)
        ours.command(JointCommand(HOME), 0.01 * n)
    away, ours.reply_pending = (HOME[0], HOME[1] + 1.0, *HOME[2:]), False
    state = ours.receive(message(away, sequence=100, stamp_s=6.0), 1.0)
    assert ours.reply_pending
    assert not state.ready
    assert state.joints == pytest.approx(HOME)
    assert state.hold_reason == (
        f"joint {NAMES[1]} jumped from {HOME[1]:.4g} to {away[1]:.4g}, by 1, and its limit is "
        "3.142 per s: check that the robot's joint state publisher measures this arm and that "
        "nothing else sends its states; if the position is right, restart the session"
    )
    assert ours.command(JointCommand(away), 1.0) is None
    assert state.hold_reason in ours.diagnosis(1.0)
    # A repeated implausible position stays implausible.
    for n in range(101, 500):
        now_s = 0.01 * n
        state = ours.receive(message(away, sequence=n, stamp_s=5.0 + now_s), now_s)
        assert not state.ready
        assert state.joints == pytest.approx(HOME)
        assert state.link is (RobotLink.LIVE if n <= 108 else RobotLink.LOST)
        assert ours.command(JointCommand(away), now_s) is None
    # After a silence the arm may have moved there.
    state = ours.receive(message(away, sequence=500, stamp_s=10.3), 5.3)
    assert (state.session, state.ready) == (2, True)
    sent = ours.command(JointCommand(away), 5.3)
    assert codec_of(COMMAND_TYPES["position"]).decode(sent)["data"][1] == pytest.approx(away[1])


def test_one_state_that_jumps_ends_readiness_for_as_long_as_it_is_there():
    ours = session(command="velocity")
    ours.receive(message(stamp_s=5.0), 0.0)
    ours.command(JointVelocityCommand((0.1,) * 6), 0.0)
    state = ours.receive(message((0.0,) * 6, sequence=2, stamp_s=5.01), 0.01)
    assert not state.ready
    zeros = ours.command(JointVelocityCommand((0.1,) * 6), 0.01)
    assert codec_of(COMMAND_TYPES["velocity"]).decode(zeros)["data"] == [0.0] * 6
    state = ours.receive(message(sequence=3, stamp_s=5.02), 0.02)
    assert (state.session, state.ready) == (2, True)


def test_a_simulation_that_was_reset_waits_until_its_arm_can_be_there():
    ours = session()
    for n in range(1, 50):
        ours.receive(message(sequence=n, stamp_s=5.0 + 0.01 * n), 0.01 * n)
    away = (HOME[0] + 2.0, *HOME[1:])
    states = []
    for n in range(50, 100):
        state = ours.receive(message(away, sequence=n, stamp_s=0.01 * n), 0.01 * n)
        states.append((state.ready, state.session))
    assert states == [(False, 1)] * 31 + [(True, 2)] * 19


def test_a_continuous_joint_that_is_counted_anew_has_not_jumped():
    limits = limits_in(BRANCHED, ("two", "one"))
    ours = Ros2ArmSession(Ros2ArmOptions(robot="", joints=("two", "one")), limits)
    ours.receive(message((3.13, 0.0), ("two", "one"), stamp_s=5.0), 0.0)
    state = ours.receive(message((-3.13, 0.0), ("two", "one"), sequence=2, stamp_s=5.01), 0.01)
    assert state.ready
    state = ours.receive(message((-3.13, 0.9), ("two", "one"), sequence=3, stamp_s=5.02), 0.02)
    assert "joint one jumped from 0 to 0.9" in state.hold_reason


def test_silence_is_reported_in_words():
    ours = session(silence_s=0.1)
    assert ours.diagnosis(0.0)[0].startswith(
        "nothing was received from the robot's joint state pub"
    )
    assert ours.advice in ours.diagnosis(0.0)[0]
    assert ours.silence(0.0).joints == ()
    ours.receive(message(), 0.0)
    assert ours.reply_pending
    assert ours.link(0.1) is RobotLink.LIVE
    assert ours.link(0.11) is RobotLink.LOST
    assert ours.silence(0.2).hold_reason
    assert ours.silence(0.2).joints == pytest.approx(HOME)


def test_a_controller_that_is_not_there_is_reported():
    ours = session()
    ours.taken = lambda: False
    state = ours.receive(message(), 0.0)
    assert "no controller subscribes to /forward_position_controller/commands" in state.hold_reason
    ours.taken = lambda: True
    assert ours.receive(message(sequence=2, stamp_s=1.01), 0.01).ready


def test_a_joint_beyond_its_range_is_not_driven():
    state = session().receive(message((7.0, *HOME[1:])), 0.0)
    assert "shoulder_pan_joint is at 7, beyond its range" in state.hold_reason


# -- commands ---------------------------------------------------------------------------------


def test_an_arm_that_is_only_looked_at_gets_no_messages():
    wire = Wire()
    with WiredArm(wire) as robot:
        states = follow(robot, 1.0, lambda state, now_s: HoldCommand())
    assert len(states) > 90
    assert not wire.sent


@pytest.mark.parametrize("command", ["position", "joint_state", "trajectory"])
def test_it_follows_positions(command):
    wire = Wire(controller=command)
    ramp = Ramp()
    with WiredArm(wire) as robot:
        follow(robot, 4.0, ramp)
    assert wire.core.plant.positions[0] == pytest.approx(ramp.at[0], abs=2e-3)
    assert ramp.at[0] - HOME[0] == pytest.approx(SPEED * (ENDS_S - BEGINS_S), rel=0.02)
    assert wire.fastest() <= 1.1 * SPEED
    assert not wire.core.ignored


def test_it_follows_speeds():
    wire = Wire(controller="velocity")
    with WiredArm(wire) as robot:
        follow(robot, 4.0, Ramp(velocity=True))
    moved = wire.core.plant.positions[0] - HOME[0]
    assert moved == pytest.approx(SPEED * (ENDS_S - BEGINS_S), rel=0.03)
    assert wire.fastest() <= 1.1 * SPEED
    assert wire.rests()


def test_no_step_is_sent_whatever_is_asked_for():
    wire = Wire(drive="ideal")
    with WiredArm(wire) as robot:
        follow(robot, 1.0, lambda state, now_s: JointCommand((HOME[0] + 3.0, *HOME[1:])))
    codec, limits = codec_of(COMMAND_TYPES["position"]), load_arm("ur5").limits
    before, before_s, speed, dt_s = HOME[0], 0.0, 0.0, 0.01
    for now_s, data in wire.sent:
        if now_s == before_s:
            continue  # the final command
        value = codec.decode(data)["data"][0]
        now = (value - before) / (now_s - before_s)
        assert abs(now) <= limits.velocity[0] * 1.001
        between_s = 0.5 * (dt_s + now_s - before_s)
        assert abs(now - speed) <= limits.acceleration[0] * between_s * 1.001
        before, before_s, speed, dt_s = value, now_s, now, now_s - before_s


def test_commands_that_it_cannot_take_are_refused():
    ours = session()
    ours.receive(message(), 0.0)
    for command, words in (
        (TorqueCommand((0.0,) * 6), "takes no torque"),
        (JointVelocityCommand((0.0,) * 6), "takes no joint velocity"),
        (JointCommand((0.0,) * 5), "5 values for 6 joints"),
        (JointCommand((math.nan,) * 6), "finite"),
        (JointCommand(HOME, external_axes=(1.0,)), "external_axes"),
    ):
        with pytest.raises(CommandError, match=words):
            ours.command(command, 0.0)
    assert session(command="velocity").capabilities.commands == {
        CommandKind.HOLD,
        CommandKind.JOINT_VELOCITY,
    }


def test_a_second_command_for_a_state_is_not_sent():
    ours = session()
    ours.receive(message(), 0.0)
    assert ours.command(JointCommand(HOME), 0.0) is not None
    assert ours.command(JointCommand(HOME), 0.0) is None


@pytest.mark.parametrize("answer", ["hold", "go on"])
def test_states_that_were_kept_while_this_computer_stood_still_hide_nothing(answer):
    """The controller held the last position for that long: the arm rests, and does not resume at
    its last speed."""
    ours, period_s = session(), 0.01
    place = HOME[0]

    def cycle(number, now_s, hold=False):
        nonlocal place
        ours.receive(message((place, *HOME[1:]), sequence=number, stamp_s=1 + 0.01 * number), now_s)
        speed = 0.0 if hold else min(SPEED, 0.02 * number)
        place += speed * period_s
        asked = JointCommand((place, *HOME[1:]), (speed, *[0.0] * 5))
        sent = ours.command(HoldCommand() if hold else asked, now_s)
        return codec_of(COMMAND_TYPES["position"]).decode(sent)["data"][0]

    for number in range(1, 60):
        last = cycle(number, number * period_s)
    woken_s = 59 * period_s + 1.0
    after = [cycle(60 + n, woken_s + n * period_s, answer == "hold") for n in range(20)]
    first = after[0] - last
    assert abs(first) < 0.05 * SPEED * period_s
    if answer == "hold":
        assert after[-1] == pytest.approx(last, abs=1e-6)


def test_closing_brakes_by_ramp():
    wire = Wire()
    ramp = Ramp(ends_s=9.0)
    robot = WiredArm(wire)
    robot.open()
    follow(robot, 1.5, ramp)
    robot.close()
    assert wire.speeds(0)[-5] == pytest.approx(SPEED, rel=0.1)
    wire.run_on(1.0)
    assert wire.rests()
    speeds = wire.speeds(0)
    hardest = max(abs(b - a) for a, b in itertools.pairwise(speeds)) / wire.period_s
    assert hardest <= 1.1 * load_arm("ur5").limits.acceleration[0]


def test_closing_stops_an_arm_that_is_sent_speeds():
    wire = Wire(controller="velocity")
    robot = WiredArm(wire)
    robot.open()
    follow(robot, 1.5, Ramp(ends_s=9.0, velocity=True))
    robot.close()
    wire.run_on(1.0)
    assert wire.rests()


def test_what_the_application_does_not_answer_brakes():
    wire = Wire()
    ramp = Ramp(ends_s=9.0)
    with WiredArm(wire) as robot:
        for state in robot.cycles():
            if state.stamp_s > 2.5:
                break
            if state.ready and state.stamp_s < 1.5:
                robot.send(ramp(state, state.stamp_s))
        assert wire.rests()


# -- faults -----------------------------------------------------------------------------------


@pytest.mark.matrix(
    *("duplicate-0.2", "reorder-0.05", "jitter-8.0", "absurd-0.05", "extra-1.0", "gripper-1.0"),
    "nan-0.05",  # Similar to a lost message and to an arm with far more NaN.
)
@pytest.mark.parametrize(
    ("fault", "value"),
    [
        ("drop", 0.05),
        ("duplicate", 0.2),
        ("reorder", 0.05),
        ("delay", 20.0),
        ("jitter", 8.0),
        ("nan", 0.05),
        ("absurd", 0.05),
        ("extra", 1.0),
        ("gripper", 1.0),
        ("no-stamps", 1.0),
    ],
)
def test_faults_that_are_ridden_out(fault, value):
    wire = Wire({fault: value})
    ramp = Ramp(ends_s=6.5)
    with WiredArm(wire) as robot:
        states = follow(robot, 10.0, ramp)
    assert {state.session for state in states if state.link is RobotLink.LIVE} == {1}
    # A delay that shortens by a cycle makes the arm move a cycle's distance more in 50 ms.
    assert wire.fastest() <= 1.3 * SPEED
    assert wire.rests()
    moved = wire.core.plant.positions[0] - HOME[0]
    assert moved == pytest.approx(SPEED * (6.5 - BEGINS_S), rel=0.06)


@pytest.mark.parametrize("stamped", [True, False])
def test_states_at_four_times_their_rate_advance_the_command_no_faster(stamped):
    ours = session(rate_hz=100.0)
    now_s, passed_s, first = 0.0, 0.0, None
    for n in range(1, 400):
        now_s += 0.0025
        stamp_s = 100.0 + 0.01 * n if stamped else 0.0
        state = ours.receive(message(sequence=n, stamp_s=stamp_s), now_s)
        if n > 1:
            passed_s += state.period_s
        speeds = (SPEED, *[0.0] * 5)
        at = HOME[0] + SPEED * passed_s
        if ours.command(JointCommand((at, *HOME[1:]), speeds), now_s) and first is None:
            first = now_s
        assert passed_s <= now_s - 0.0025 + 0.0011
        if first is not None:
            sent = ours._limiter.reference[0] - HOME[0]
            assert sent <= SPEED * (now_s - first + 0.0125)
    assert passed_s == pytest.approx(now_s, abs=0.01)


def test_a_simulation_at_half_speed_is_ready_with_the_option_and_reported_it_without():
    for simulated in (False, True):
        ours = session(rate_hz=100.0, simulated_time=simulated)
        for n in range(1, 300):
            state = ours.receive(message(sequence=n, stamp_s=5.0 + 0.005 * n), 0.01 * n)
            if n > 1:
                assert state.period_s == pytest.approx(0.005, abs=1e-6)
        assert state.ready is simulated
        assert ("simulated_time = true" in state.hold_reason) is not simulated


def test_stamps_that_jump_ahead_are_said_and_end_readiness():
    wire = Wire({"clock-step": 3600.0})
    with WiredArm(wire) as robot:
        states = follow(robot, 10.0, Ramp(ends_s=6.5))
    assert {state.session for state in states if state.link is RobotLink.LIVE} == {1}
    held = [state for state in states if "clock jumped ahead by 3.6e+03 s" in state.hold_reason]
    assert held[0].stamp_s - states[0].stamp_s == pytest.approx(5.0, abs=0.1)
    assert held[-1].stamp_s - held[0].stamp_s <= 1.5, "clocks that agree again are no fault"
    assert states[-1].ready
    assert wire.fastest() <= 1.05 * SPEED


@pytest.mark.parametrize(
    ("fault", "value", "words"),
    [
        ("stale", 1.5, "the robot is frozen"),
        ("wrong-names", 1.5, "is silent"),
        ("missing", 1.5, "without wrist_3_joint"),
        ("inactive", 1.5, "no controller subscribes"),
    ],
)
def test_faults_that_stop_the_arm(fault, value, words):
    wire = Wire({fault: value})
    with WiredArm(wire) as robot:
        states = follow(robot, 3.0, Ramp(ends_s=9.0))
        assert not states[-1].ready
        assert any(words in line for line in (*robot.diagnosis(), states[-1].hold_reason))
    assert wire.rests()
    assert wire.fastest() <= 1.1 * SPEED


@pytest.mark.parametrize("fault", [{"restart": 1.5}, {"silence": 0.3}])
def test_a_silence_is_not_made_up_for(fault):
    wire = Wire(fault)
    with WiredArm(wire) as robot:
        states = follow(robot, 7.0, Ramp(ends_s=6.8))
    links = {state.link for state in states}
    assert RobotLink.LOST in links
    assert states[-1].ready
    assert states[-1].session == (2 if "restart" in fault else 1)
    assert wire.fastest() <= 1.15 * SPEED


@pytest.mark.matrix("0.01", "0.02", "0.04", "0.1")
@pytest.mark.parametrize("stall_s", [0.01, 0.02, 0.04, 0.1, 0.5])
def test_lost_time_is_lost(stall_s):
    wire, ramp = Wire(), Ramp(ends_s=3.5)
    with WiredArm(wire) as robot:
        follow(robot, 7.0, ramp, stall=(1.5, stall_s))
    assert wire.fastest() <= (1.2 if stall_s <= 0.02 else 1.01) * SPEED
    missing = ramp.at[0] - wire.core.plant.positions[0]
    assert abs(missing) <= 0.01  # compensated at rest, without a remainder
    assert wire.rests()


def test_an_arm_that_lost_too_much_way_begins_anew():
    wire = Wire({"nan": 0.4})
    with WiredArm(wire) as robot:
        states = follow(robot, 12.0, Ramp(ends_s=8.0))
    assert states[-1].session > 1
    assert wire.fastest() <= 1.3 * SPEED
    assert wire.rests()


def test_silence_is_reported_at_least_every_tenth_of_a_second():
    wire = Wire({"stale": 0.5})
    with WiredArm(wire) as robot:
        states = follow(robot, 2.0, lambda state, now_s: HoldCommand())
    stamps = [state.stamp_s for state in states]
    assert max(b - a for a, b in itertools.pairwise(stamps)) <= 2.1 * WAKE_S


def test_an_arm_that_is_sent_speeds_is_stopped_where_nobody_measures_it():
    """Without measured positions its controller would keep the last speed."""
    wire = Wire({"missing": 1.5}, controller="velocity")
    with WiredArm(wire) as robot:
        follow(robot, 3.0, Ramp(ends_s=9.0, velocity=True))
        assert wire.rests()


# -- the robot's description --------------------------------------------------------------------


def test_limits_of_the_description():
    wire = Wire()
    with WiredArm(wire, robot="", joints=NAMES) as robot:
        assert robot.capabilities.limits == load_arm("ur5").limits
        follow(robot, 4.0, ramp := Ramp())
    assert wire.core.plant.positions[0] == pytest.approx(ramp.at[0], abs=2e-3)


def test_without_a_description_it_is_not_opened():
    class Silent(Wire):
        def description(self):
            return ""

    with pytest.raises(DriverError, match="no node published a URDF on /robot_description"):
        WiredArm(Silent(), robot="", joints=NAMES).open()
    with pytest.raises(DriverError, match="no joint 'elbow'"):
        WiredArm(Wire(), robot="", joints=("elbow",)).open()


BRANCHED = """<robot name="two">
<link name="world"/><link name="a"><visual><geometry><mesh filename="a.stl"/></geometry></visual>
</link><link name="b"/><link name="c"/>
<joint name="one" type="revolute"><parent link="world"/><child link="a"/>
  <limit lower="-1" upper="2" velocity="3" effort="4"/></joint>
<joint name="two" type="continuous"><parent link="world"/><child link="b"/>
  <limit velocity="1" effort="4"/></joint>
<joint name="fast" type="fixed"><parent link="b"/><child link="c"/></joint>
</robot>"""


def test_the_nearest_joint_of_a_description_is_named():
    with pytest.raises(ConfigurationError, match=r"has no joint 'tow'; .*; did you mean 'two'\?$"):
        limits_in(BRANCHED, ("tow", "one"))


def test_limits_of_a_whole_robot_that_branches_and_has_meshes():
    limits = limits_in(BRANCHED, ("two", "one"))
    assert (limits.lower, limits.upper) == ((-math.inf, -1.0), (math.inf, 2.0))
    assert limits.velocity == (1.0, 3.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"joints": ("a", "b")}, "6 names, as ur5 has"),
        ({"joints": ("a",) * 6}, "a name of its own"),
        ({"robot": ""}, "names of the joints"),
        ({"states_topic": "joint states"}, "a name of ROS 2"),
        ({"command_topic": "a//b"}, "a name of ROS 2"),
        ({"name": "two words"}, "a name of ROS 2"),
        ({"rate_hz": 1.0}, "10 to 2000"),
        ({"command": "torque"}, "position"),
    ],
)
def test_options_that_cannot_be(options, words):
    with pytest.raises(OptionError, match=words):
        Ros2ArmOptions(**options)


def test_cautions_of_ways_that_are_not_the_best():
    for command, words in (("trajectory", "follows late"), ("velocity", "keeps the last speed")):
        assert any(words in line for line in Ros2Arm(command=command).cautions())
    assert Ros2Arm().cautions() == ()


def test_its_own_port_is_met_without_a_router():
    options = Ros2ArmOptions(port=7777, mode="client")
    assert (options.bus.router, options.bus.mode) == ("tcp/127.0.0.1:7777", "peer")
    assert Ros2ArmOptions().bus.router == "tcp/127.0.0.1:7447"
    assert Ros2Arm.peer == "ros2-arm"
