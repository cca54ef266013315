"""The EGM session in virtual time: no sockets, no clocks."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st

from cardan.common.tables import read_table
from cardan.drivers.abb_egm import AbbEgmOptions, EgmSession
from cardan.drivers.abb_egm.options import SILENT_PERIODS
from cardan.drivers.abb_egm.slow_motion import SpeedCapDetector
from cardan.drivers.abb_egm.states import (
    EGM_ERROR,
    EGM_STOPPED,
    EGM_UNDEFINED,
    FIRST_ANSWER,
    MOTORS_OFF,
    RAPID_STOPPED,
)
from cardan.errors import CommandError, ConfigurationError
from cardan.protocols.egm.decode import decode_from_pc
from cardan.protocols.egm.messages import (
    EgmCollisionInfo,
    EgmHeader,
    EgmMeasuredForce,
    EgmMessageType,
    EgmMotion,
    EgmPose,
    EgmRapidData,
    EgmSensorPathCorr,
    MCIState,
    MotorState,
    RapidState,
)
from cardan.spatial import from_rotation_vector, multiply, rotation_between
from cardan.types import (
    CommandKind,
    Frame,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    PathCorrectionCommand,
    Pose,
    PoseCommand,
    Quaternion,
    RobotCommand,
    RobotLink,
    RobotState,
    Twist,
    TwistCommand,
    Vector3,
)
from tests.examples import examples

from .egm_controller import (
    HOME,
    ORIENTATION,
    PERIOD_S,
    POSITION,
    Controller,
    sensor_of,
    speeds_of,
)

PEER = ("192.168.125.1", 51000)
OTHER_PORT = (PEER[0], 50999)
HOLD = HoldCommand()
ZEROS = (0.0,) * 6

wild = st.one_of(st.floats(-400.0, 400.0), st.floats(allow_nan=False, allow_infinity=False))
"""Degrees or mm: values of a robot, or any finite number."""


class Bench:
    """Session and controller that alternate in virtual time."""

    def __init__(self, controller_ip: str | None = None, **options: Any) -> None:
        self.options = AbbEgmOptions(**({"mode": "joint"} | options))
        self.now_s = 1000.0
        self.session = EgmSession(self.options, self.now_s, controller_ip)
        self.controller = Controller()

    def hear(self, source: tuple[str, int] = PEER) -> RobotState | None:
        """Receive a datagram, a period later."""
        self.now_s += PERIOD_S
        return self.session.receive(self.controller.datagram(), source, self.now_s)

    def cycle(self, command: RobotCommand = HOLD) -> bytes:
        """Receive a datagram and answer it; the robot moves to the commanded position."""
        assert self.hear() is not None
        answer = self.session.reply(command, self.now_s + 1e-4)
        self.session.answered(self.now_s + 1e-4)
        self.controller.follow(answer)
        return answer

    def started(self) -> Bench:
        """Exchange the first datagrams of a session."""
        self.cycle()
        return self


def joint_target(first: float) -> JointCommand:
    return JointCommand((first, *HOME[1:]))


def pose_target(x: float = 0.0, turn: float = 0.0) -> PoseCommand:
    orientation = multiply(from_rotation_vector(Vector3(0.0, 0.0, turn)), ORIENTATION)
    return PoseCommand(Pose(Vector3(POSITION.x + x, POSITION.y, POSITION.z), orientation))


def joints_in(answer: bytes) -> tuple[float, ...]:
    planned = sensor_of(answer).planned
    assert planned is not None
    assert planned.joints is not None
    return planned.joints


def pose_in(answer: bytes) -> tuple[Vector3, Quaternion]:
    planned = sensor_of(answer).planned
    assert planned is not None
    assert planned.cartesian is not None
    position, orientation, _ = planned.cartesian
    assert position is not None
    assert orientation is not None
    return position, orientation


class TestBeginning:
    def test_waiting_until_something_is_heard(self) -> None:
        bench = Bench()
        state = bench.session.tick(1002.5)
        assert state is not None
        assert (state.link, state.stamp_s, state.session) == (RobotLink.WAITING, 1002.5, 0)
        assert "2.5 s" in state.hold_reason
        assert not state.ready

    def test_the_first_answer_is_the_measured_position_at_rest(self) -> None:
        bench = Bench()
        bench.controller.joints = (0.1, -0.2, 0.3, -0.4, 0.5, -0.6)
        state = bench.hear()
        assert state is not None
        assert (state.link, state.session, state.hold_reason) == (
            RobotLink.LIVE,
            1,
            FIRST_ANSWER,
        )
        answer = bench.session.reply(joint_target(1.0), bench.now_s)
        assert joints_in(answer) == pytest.approx(bench.controller.joints, abs=1e-12)
        assert speeds_of(answer) == ZEROS

    def test_the_first_answer_in_pose_mode(self) -> None:
        bench = Bench(mode="pose")
        bench.hear()
        answer = bench.session.reply(pose_target(0.1, 0.5), bench.now_s)
        position, orientation = pose_in(answer)
        assert position == pytest.approx(POSITION, abs=1e-12)
        assert orientation == pytest.approx(ORIENTATION, abs=1e-12)
        assert speeds_of(answer) == ZEROS

    def test_the_second_state_is_ready(self) -> None:
        state = Bench().started().hear()
        assert state is not None
        assert state.ready

    def test_a_first_datagram_overtaken_by_a_newer_one_changes_nothing(self) -> None:
        bench = Bench()
        bench.hear()
        state = bench.hear()
        assert state is not None
        assert state.hold_reason == FIRST_ANSWER
        answer = bench.session.reply(joint_target(1.0), bench.now_s)
        assert joints_in(answer) == pytest.approx(HOME)
        assert bench.session.counters.superseded == 1

    def test_headers_count_up_by_one_and_echo_the_clock(self) -> None:
        bench = Bench()
        for k in range(3):
            tm_ms = bench.controller.clock_us // 1000 & 0xFFFFFFFF
            header = sensor_of(bench.cycle()).header
            assert header == EgmHeader(k, tm_ms, EgmMessageType.CORRECTION)

    def test_a_missing_clock_is_replaced_by_our_own(self) -> None:
        bench = Bench()
        bench.controller.fields["header"] = EgmHeader(0, None, EgmMessageType.DATA)
        header = sensor_of(bench.cycle()).header
        assert header is not None
        assert header.tm_ms == int((bench.now_s + 1e-4) * 1000)

    def test_one_answer_per_datagram(self) -> None:
        bench = Bench().started()
        assert not bench.session.reply_pending
        with pytest.raises(CommandError, match="no datagram to answer"):
            bench.session.reply(HOLD, bench.now_s)


class TestPinning:
    def test_another_host_is_refused_for_good(self) -> None:
        bench = Bench().started()
        assert bench.hear(("192.168.125.77", PEER[1])) is None
        bench.session.tick(bench.now_s + 5.0)
        bench.now_s += 5.0
        assert bench.hear(("192.168.125.77", PEER[1])) is None
        for _ in range(2):
            assert bench.hear(PEER) is not None
            assert bench.hear(("192.168.125.77", PEER[1])) is None
        assert bench.session.counters.foreign == 4
        assert not bench.session.last_foreign_counts_on
        assert bench.session.peer == PEER
        assert "192.168.125.77:51000" in " ".join(bench.session.diagnosis(bench.now_s))

    def test_a_configured_controller_is_the_only_one(self) -> None:
        bench = Bench(controller_ip="192.168.125.1", controller_host="192.168.125.1")
        assert bench.hear(("10.0.0.1", 1)) is None
        assert bench.session.peer is None
        assert "controller_host" in " ".join(bench.session.diagnosis(bench.now_s))
        assert bench.hear() is not None

    def test_garbage_does_not_pin(self) -> None:
        bench = Bench()
        assert bench.session.receive(b"\xff" * 30, ("10.0.0.1", 1), bench.now_s) is None
        assert bench.session.peer is None
        assert bench.hear() is not None

    def test_the_answer_of_another_pc_does_not_pin(self) -> None:
        answer = Bench().cycle()
        bench = Bench()
        assert bench.session.receive(answer, ("10.0.0.1", 1), bench.now_s) is None
        assert bench.session.peer is None
        assert sum(bench.session.counters.malformed.values()) == 1

    def test_a_port_cannot_be_taken_over_while_the_controller_is_heard(self) -> None:
        bench = Bench().started()
        for _ in range(5):
            assert bench.hear((PEER[0], 50999)) is None
            bench.now_s -= PERIOD_S
            assert bench.hear() is not None
        assert bench.session.sessions == 1

    def test_a_port_that_begins_anew_after_a_silence_is_a_new_session(self) -> None:
        bench = Bench().started()
        bench.cycle(joint_target(1.0))
        assert bench.session.moving
        last = joints_in(bench.cycle(joint_target(1.0)))
        bench.controller.seqno = 0
        states = [bench.hear(OTHER_PORT) for _ in range(24)]
        assert states == [None] * 24
        assert bench.session.handover is None
        bench.now_s += PERIOD_S
        assert bench.session.tick(bench.now_s) is not None
        state = bench.hear(OTHER_PORT)
        assert state is not None
        assert (state.session, state.sequence) == (2, 24)
        assert bench.session.peer == OTHER_PORT
        # The final command to the previous port stops the robot at its last target.
        assert bench.session.handover is not None
        last_words, port = bench.session.handover
        assert port == PEER
        assert joints_in(last_words) == pytest.approx(last)
        assert speeds_of(last_words) == ZEROS
        assert bench.session.counters.final_commands == 1
        answer = bench.session.reply(joint_target(1.0), bench.now_s)
        assert joints_in(answer) == pytest.approx(bench.controller.joints)
        assert speeds_of(answer) == ZEROS

    @pytest.mark.parametrize("silence_s", [0.012, 0.05, 0.099])
    def test_a_hiccup_gives_no_other_port_the_robot(self, silence_s: float) -> None:
        bench = Bench(silence_s=0.012).started()
        bench.controller.seqno = 0
        bench.now_s += silence_s - PERIOD_S
        bench.session.tick(bench.now_s)
        assert bench.hear(OTHER_PORT) is None
        assert bench.session.peer == PEER
        assert bench.session.sessions == 1

    def test_another_program_on_the_controllers_address_does_not_take_over(self) -> None:
        """It sends continuously, and the controller pauses now and then."""
        bench = Bench().started()
        thief = Controller(seqno=0)
        answered: set[tuple[str, int]] = set()
        for k in range(1500):
            bench.now_s += PERIOD_S
            stolen = bench.session.receive(thief.datagram(), OTHER_PORT, bench.now_s)
            assert stolen is None
            data = bench.controller.datagram()
            if not (400 <= k < 420 or 800 <= k < 1050):  # silence of 80 ms and 1 s
                assert bench.session.receive(data, PEER, bench.now_s) is not None
                bench.session.reply(HOLD, bench.now_s)
                assert bench.session.peer is not None
                answered.add(bench.session.peer)
            bench.session.tick(bench.now_s)
        assert answered == {PEER}
        assert bench.session.counters.foreign == 1500
        assert bench.session.sessions == 2
        diagnosis = " ".join(bench.session.diagnosis(bench.now_s))
        assert "only 192.168.125.1:51000 is answered" in diagnosis

    def test_a_sequence_that_goes_on_from_another_port_takes_the_operators_consent(self) -> None:
        bench = Bench().started()
        bench.controller.seqno = 5000
        bench.now_s += 3.0
        bench.session.tick(bench.now_s)
        assert bench.hear(OTHER_PORT) is None
        diagnosis = " ".join(bench.session.diagnosis(bench.now_s))
        assert "began before the controller fell silent" in diagnosis
        assert "if it is the controller, open the driver again" in diagnosis
        opened_again = EgmSession(bench.options, bench.now_s)
        bench.now_s += PERIOD_S
        data = bench.controller.datagram()
        assert opened_again.receive(data, OTHER_PORT, bench.now_s) is not None

    def test_a_port_heard_beside_the_controllers_is_another_program_however_slow(self) -> None:
        """A second simulation, five times slower than the controller."""
        bench = Bench().started()
        thief = Controller(seqno=0)
        for k in range(500):
            if k % 5 == 0:
                assert bench.session.receive(thief.datagram(), OTHER_PORT, bench.now_s) is None
            assert bench.cycle(HOLD)
        for _ in range(100):
            bench.now_s += 5 * PERIOD_S
            bench.session.tick(bench.now_s)
            assert bench.session.receive(thief.datagram(), OTHER_PORT, bench.now_s) is None
        diagnosis = " ".join(bench.session.diagnosis(bench.now_s))
        assert "if it is the controller, open the driver again" in diagnosis
        assert bench.hear() is not None
        assert bench.session.peer == PEER

    def test_a_program_that_is_started_anew_at_once_is_distinguished_from_others(self) -> None:
        bench = Bench().started()
        bench.controller.seqno = 0
        assert [bench.hear(OTHER_PORT) for _ in range(20)] == [None] * 20
        bench.now_s += 0.1
        bench.session.tick(bench.now_s)
        assert bench.hear(OTHER_PORT) is not None
        diagnosis = " ".join(bench.session.diagnosis(bench.now_s))
        address = f"{OTHER_PORT[0]}:{OTHER_PORT[1]}"
        assert f"the last from {address} before the controller had that port" in diagnosis
        assert f"only {address} is answered" not in diagnosis

    def test_a_silence_that_the_application_slept_through_is_none(self) -> None:
        bench = Bench().started()
        waiting = [bench.controller.datagram() for _ in range(50)]
        bench.now_s += 0.2
        thief = Controller()
        assert bench.session.receive(thief.datagram(), OTHER_PORT, bench.now_s) is None
        for data in waiting:
            assert bench.session.receive(data, PEER, bench.now_s) is not None
        assert bench.session.sessions == 1

    def test_a_port_left_at_rest_or_long_ago_is_sent_nothing(self) -> None:
        for command, silence_s in ((HOLD, 0.11), (joint_target(1.0), 0.21)):
            bench = Bench().started()
            bench.cycle(command)
            bench.controller.seqno = 0
            bench.now_s += silence_s
            bench.session.tick(bench.now_s)
            assert bench.hear(OTHER_PORT) is not None
            assert bench.session.handover is None


class TestSequence:
    @pytest.mark.parametrize(
        ("last", "following", "counted"),
        [
            (100, 101, {}),
            (100, 104, {"lost": 3}),
            (100, 100, {"duplicates": 1}),
            (100, 99, {"old": 1}),
            (100, 60, {"old": 1}),
            (0xFFFFFFFF, 0, {}),
            (0xFFFFFFFE, 1, {"lost": 2}),
            (0, 0xFFFFFFFF, {"old": 1}),
            (2, 0xFFFFFFF0, {"old": 1}),
        ],
    )
    def test_within_a_session(self, last: int, following: int, counted: dict[str, int]) -> None:
        bench = Bench()
        bench.controller.seqno = last
        bench.cycle()
        step = ((following - last + 2**31) % 2**32) - 2**31
        bench.controller.seqno = following
        bench.controller.clock_us += round((step - 1) * PERIOD_S * 1e6)
        bench.now_s += max(step - 1, 0) * PERIOD_S
        state = bench.hear()
        assert bench.session.sessions == 1
        for name in ("lost", "duplicates", "old"):
            assert getattr(bench.session.counters, name) == counted.get(name, 0)
        if step > 0:
            assert state is not None
            assert state.sequence == following
            assert state.period_s == pytest.approx(step * PERIOD_S)
        else:
            assert state is None
            assert not bench.session.reply_pending

    @pytest.mark.parametrize(
        ("last", "following"), [(5000, 0), (5000, 3), (40, 0), (3, 0), (0, 0), (2**32 - 1, 2**31)]
    )
    def test_a_restart_is_a_new_session(self, last: int, following: int) -> None:
        bench = Bench()
        bench.controller.seqno = last
        bench.cycle()
        bench.controller.seqno = following
        state = bench.hear()
        assert state is not None
        assert (state.session, state.hold_reason) == (2, FIRST_ANSWER)
        answer = bench.session.reply(joint_target(2.0), bench.now_s)
        assert joints_in(answer) == pytest.approx(HOME)
        assert "sequence number" in " ".join(bench.session.diagnosis(bench.now_s))

    @pytest.mark.parametrize(("back", "new_session"), [(1, False), (16, False), (17, True)])
    def test_without_clocks_the_distance_decides(self, back: int, new_session: bool) -> None:
        bench = Bench()
        bench.controller.fields = {
            "header": EgmHeader(1000, None, EgmMessageType.DATA),
            "feed_back": EgmMotion(joints=HOME),
        }
        bench.cycle()
        bench.controller.fields["header"] = EgmHeader(1000 - back, None, EgmMessageType.DATA)
        state = bench.hear()
        assert (state is not None) == new_session
        assert bench.session.sessions == 1 + new_session

    def test_a_jump_forward_no_time_allows_is_a_new_session(self) -> None:
        bench = Bench().started()
        bench.controller.seqno += 1000
        state = bench.hear()
        assert state is not None
        assert state.session == 2
        assert bench.session.counters.lost == 0

    def test_silence_ends_the_session(self) -> None:
        bench = Bench().started()
        bench.cycle(joint_target(1.0))
        heard = bench.hear()
        assert heard is not None
        assert bench.session.tick(bench.now_s + 0.05) is None
        assert bench.session.reply_pending
        lost = bench.session.tick(bench.now_s + 0.11)
        assert lost is not None
        assert not bench.session.reply_pending
        assert (lost.link, lost.session, lost.joints) == (
            RobotLink.LOST,
            1,
            heard.joints,
        )
        assert not lost.ready
        bench.now_s += 0.11
        state = bench.hear()
        assert state is not None
        assert (state.link, state.session, state.hold_reason) == (RobotLink.LIVE, 2, FIRST_ANSWER)

    def test_silence_counts_without_a_tick_too(self) -> None:
        bench = Bench().started()
        bench.now_s += 1.0
        bench.controller.clock_us += 1_000_000
        state = bench.hear()
        assert state is not None
        assert state.session == 2
        assert "silence" in bench.session.last_cause

    def test_datagrams_that_waited_here_are_no_silence(self) -> None:
        bench = Bench().started()
        bench.now_s += 0.3
        for _ in range(70):
            assert bench.hear() is not None
            bench.now_s -= PERIOD_S
        assert bench.session.sessions == 1
        assert bench.session.counters.lost == 0

    def test_the_time_of_datagrams_nobody_acted_on_is_not_lost(self) -> None:
        bench = Bench().started()
        for k in range(1, 4):
            state = bench.hear()
            assert state is not None
            assert state.period_s == pytest.approx(k * PERIOD_S)
        bench.session.reply(HOLD, bench.now_s)
        state = bench.hear()
        assert state is not None
        assert state.period_s == pytest.approx(PERIOD_S)

    def test_a_wall_clock_that_is_set_does_not_make_a_long_step(self) -> None:
        bench = Bench().started()
        for change_us in (3_600_000_000, -7_200_000_000):
            bench.controller.clock_us += change_us
            state = bench.hear()
            assert state is not None
            assert state.session == 1
            assert state.period_s == pytest.approx(PERIOD_S)
            bench.session.reply(HOLD, bench.now_s)

    @given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.floats(0.0, 0.2)), max_size=30))
    def test_whatever_the_numbers_every_first_answer_is_the_measured_position(
        self, script: list[tuple[int, float]]
    ) -> None:
        bench = Bench().started()
        for seqno, pause_s in script:
            bench.controller.seqno = seqno
            bench.now_s += pause_s
            bench.controller.clock_us += round(pause_s * 1e6)
            session = bench.session.sessions
            state = bench.hear()
            if state is None:
                continue
            answer = bench.session.reply(joint_target(1.0), bench.now_s)
            if state.session != session:
                assert joints_in(answer) == pytest.approx(bench.controller.joints, abs=1e-12)
                assert speeds_of(answer) == ZEROS
            bench.controller.follow(answer)


class TestHolding:
    @pytest.mark.parametrize(
        ("motors", "mci", "rapid", "reason"),
        [
            (MotorState.OFF, MCIState.RUNNING, RapidState.RUNNING, MOTORS_OFF),
            (MotorState.OFF, MCIState.STOPPED, RapidState.STOPPED, MOTORS_OFF),
            (MotorState.ON, MCIState.RUNNING, RapidState.STOPPED, RAPID_STOPPED),
            (MotorState.ON, MCIState.STOPPED, RapidState.RUNNING, EGM_STOPPED),
            (MotorState.ON, MCIState.ERROR, RapidState.RUNNING, EGM_ERROR),
            (MotorState.ON, MCIState.UNDEFINED, RapidState.RUNNING, EGM_UNDEFINED),
            (MotorState.ON, None, RapidState.RUNNING, EGM_UNDEFINED),
            (MotorState.ON, 17, RapidState.RUNNING, EGM_UNDEFINED),
            (MotorState.ON, MCIState.RUNNING, RapidState.UNDEFINED, ""),
            (MotorState.ON, MCIState.RUNNING, None, ""),
            (None, MCIState.RUNNING, None, ""),
        ],
    )
    @pytest.mark.parametrize("mode", ["joint", "pose"])
    def test_commands_act_only_while_egm_runs(
        self, mode: str, motors: int, mci: int, rapid: int, reason: str
    ) -> None:
        bench = Bench(mode=mode).started()
        command = joint_target(1.0) if mode == "joint" else pose_target(0.2)
        for _ in range(50):
            bench.cycle(command)
        bench.controller.motors, bench.controller.mci = motors, mci
        bench.controller.rapid = rapid
        # Meanwhile something else moves the robot.
        bench.controller.joints = (0.7, *HOME[1:])
        bench.controller.position = Vector3(0.5, 0.1, 0.7)
        state = bench.hear()
        assert state is not None
        assert state.hold_reason == reason
        answer = bench.session.reply(command, bench.now_s)
        at_rest = speeds_of(answer) == ZEROS
        if mode == "joint":
            measured = joints_in(answer) == pytest.approx(bench.controller.joints)
        else:
            measured = pose_in(answer)[0] == pytest.approx(bench.controller.position)
        assert at_rest == measured == bool(reason)
        if reason:
            assert any(reason in words for words in bench.session.diagnosis(bench.now_s))

    def test_coming_back_is_bumpless_even_with_an_old_target(self) -> None:
        bench = Bench().started()
        for _ in range(100):
            bench.cycle(joint_target(0.5))
        bench.controller.mci = MCIState.STOPPED
        bench.controller.joints = (-1.0, *HOME[1:])
        bench.cycle(joint_target(0.5))
        bench.controller.mci = MCIState.RUNNING
        before, speed = -1.0, 0.0
        acceleration = math.radians(bench.options.joint_acceleration_deg_s2)
        for _ in range(20):
            answer = bench.cycle(joint_target(0.5))
            position, velocity = joints_in(answer)[0], speeds_of(answer)[0]  # type: ignore[index]
            assert abs(velocity - speed) <= acceleration * PERIOD_S + 1e-9
            assert position == pytest.approx(before + velocity * PERIOD_S)
            before, speed = position, velocity
        assert speed > 0.5

    def test_a_wrong_command_is_refused_while_holding_too(self) -> None:
        bench = Bench()
        bench.hear()
        with pytest.raises(CommandError, match="joint mode"):
            bench.session.reply(pose_target(), bench.now_s)
        assert bench.session.reply_pending


class TestCommands:
    @pytest.mark.parametrize(
        ("options", "taken"),
        [
            ({"mode": "joint"}, {CommandKind.JOINT}),
            ({"mode": "joint", "speed_reference": "none"}, {CommandKind.JOINT}),
            ({"mode": "joint", "speed_reference": "only"}, {CommandKind.JOINT_VELOCITY}),
            ({"mode": "pose"}, {CommandKind.POSE}),
            ({"mode": "pose", "speed_reference": "none"}, {CommandKind.POSE}),
            ({"mode": "pose", "speed_reference": "only"}, {CommandKind.TWIST}),
            ({"mode": "path-correction"}, {CommandKind.PATH_CORRECTION}),
        ],
    )
    def test_a_mode_takes_its_own_kinds_and_names_them(
        self, options: dict[str, Any], taken: set[CommandKind]
    ) -> None:
        bench = Bench(**options)
        twist = Twist(Vector3(0.0, 0.0, 0.0), Vector3(0.0, 0.0, 0.0))
        commands: tuple[RobotCommand, ...] = (
            HOLD,
            joint_target(0.0),
            pose_target(),
            JointVelocityCommand(ZEROS),
            TwistCommand(twist),
            PathCorrectionCommand(Vector3(0.0, 0.0, 0.0), 0.0),
        )
        allowed = taken | {CommandKind.HOLD}
        assert bench.session.capabilities.commands == allowed
        for command in commands:
            if command.kind in allowed:
                bench.session.check(command)
            else:
                with pytest.raises(CommandError) as refusal:
                    bench.session.check(command)
                for kind in allowed:
                    assert kind.value in str(refusal.value)
                assert command.kind.value in str(refusal.value)

    @pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300])
    def test_numbers_that_are_none_are_refused_and_change_nothing(self, bad: float) -> None:
        bench = Bench().started()
        for _ in range(30):
            before = bench.cycle(joint_target(0.5))
        bench.hear()
        for command in (
            JointCommand((bad, *HOME[1:])),
            JointCommand(HOME, (0.0, bad, 0.0, 0.0, 0.0, 0.0)),
            JointCommand(HOME[:5]),
            JointCommand(HOME, ZEROS[:3]),
            JointCommand(HOME, external_axes=(0.0,)),
        ):
            with pytest.raises(CommandError):
                bench.session.reply(command, bench.now_s)
        assert bench.session.reply_pending
        answer = bench.session.reply(joint_target(0.5), bench.now_s)
        change = speeds_of(answer)[0] - speeds_of(before)[0]  # type: ignore[index]
        assert 0.0 < change <= math.radians(720.0) * PERIOD_S + 1e-9

    @pytest.mark.parametrize("command", [None, 0, "hold", HOME])
    def test_what_is_no_command_is_refused(self, command: Any) -> None:
        bench = Bench().started()
        bench.hear()
        with pytest.raises(CommandError, match="it takes hold"):
            bench.session.reply(command, bench.now_s)
        assert bench.session.reply_pending

    @pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300])
    def test_bad_poses_and_twists(self, bad: float) -> None:
        session = Bench(mode="pose").session
        pose = pose_target().pose
        zero = Vector3(0.0, 0.0, 0.0)
        for command in (
            PoseCommand(Pose(Vector3(bad, 0.0, 0.0), ORIENTATION)),
            PoseCommand(Pose(POSITION, Quaternion(bad, 0.0, 0.0, 0.0))),
            PoseCommand(Pose(POSITION, Quaternion(0.0, 0.0, 0.0, 0.0))),
            PoseCommand(Pose(POSITION, Quaternion(2.0, 0.0, 0.0, 0.0))),
            PoseCommand(Pose(POSITION, ORIENTATION, Frame.TOOL)),
            PoseCommand(pose, Twist(Vector3(0.0, bad, 0.0), zero)),
            PoseCommand(pose, Twist(zero, zero, Frame.TOOL)),
        ):
            with pytest.raises(CommandError):
                session.check(command)
        speed = Bench(mode="pose", speed_reference="only").session
        with pytest.raises(CommandError):
            speed.check(TwistCommand(Twist(zero, Vector3(0.0, 0.0, bad))))

    def test_position_and_speed_agree(self) -> None:
        bench = Bench().started()
        before = HOME
        for k in range(200):
            answer = bench.cycle(joint_target(0.3 * math.sin(0.01 * k)))
            position, velocity = joints_in(answer), speeds_of(answer)
            moved = [b - a for a, b in zip(before, position, strict=True)]
            assert moved == pytest.approx([v * PERIOD_S for v in velocity or ()], abs=1e-9)
            before = position

    def test_pose_and_speed_agree(self) -> None:
        bench = Bench(mode="pose").started()
        before = (POSITION, ORIENTATION)
        for k in range(200):
            answer = bench.cycle(pose_target(0.05 * math.sin(0.01 * k), 0.2 * math.sin(0.02 * k)))
            now = pose_in(answer)
            velocity = speeds_of(answer)
            assert velocity is not None
            moved = [b - a for a, b in zip(before[0], now[0], strict=True)]
            turned = rotation_between(before[1], now[1])
            assert moved == pytest.approx([v * PERIOD_S for v in velocity[:3]], abs=1e-9)
            assert turned == pytest.approx([w * PERIOD_S for w in velocity[3:]], abs=1e-8)
            before = now
        assert now[0].x - POSITION.x == pytest.approx(0.05 * math.sin(1.99), abs=1e-6)

    def test_after_losses_the_reference_is_where_the_robot_went_by_itself(self) -> None:
        bench = Bench().started()
        for _ in range(200):
            bench.cycle(joint_target(1.5))
        speed = bench.options.joint_speeds_rad_s[0]
        for _ in range(50):
            bench.cycle(joint_target(3.0))
        for lost in (1, 3, 12):
            before = bench.controller.joints[0]
            bench.controller.seqno += lost
            bench.controller.clock_us += round(lost * PERIOD_S * 1e6)
            bench.now_s += lost * PERIOD_S
            # A controller without an answer continues at its last speed.
            bench.controller.joints = (before + lost * speed * PERIOD_S, *HOME[1:])
            answer = bench.cycle(joint_target(3.0))
            assert joints_in(answer)[0] - before == pytest.approx(
                (lost + 1) * speed * PERIOD_S, rel=1e-3
            )
        assert bench.session.sessions == 1

    @settings(max_examples=examples(60))
    @given(
        st.lists(
            st.tuples(
                st.floats(-10.0, 10.0),
                st.sampled_from(("track", "hold", "nothing", "lose", "stop", "restart")),
                st.integers(1, 25),
            ),
            max_size=12,
        )
    )
    def test_whatever_happens_no_message_contains_a_step(
        self, script: list[tuple[float, str, int]]
    ) -> None:
        bench = Bench(robot="gofa_crb15000_5").started()
        speed = math.radians(90.0)
        acceleration = math.radians(720.0)
        position, velocity, ready = 0.0, 0.0, True
        sessions = bench.session.metrics()["sessions"]
        for goal, event, times in script:
            bench.controller.mci = MCIState.STOPPED if event == "stop" else MCIState.RUNNING
            if event == "restart":
                bench.controller.seqno = 0
            for _ in range(times):
                lost = 2 if event == "lose" else 0
                bench.controller.seqno += lost
                bench.controller.clock_us += round(lost * PERIOD_S * 1e6)
                bench.now_s += lost * PERIOD_S
                state = bench.hear()
                assert state is not None
                if event == "nothing":
                    answer = bench.session.hold(bench.now_s)
                else:
                    command = HOLD if event == "hold" else joint_target(goal)
                    answer = bench.session.reply(command, bench.now_s)
                bench.controller.follow(answer)
                before, slower = position, velocity
                position, velocity = joints_in(answer)[0], speeds_of(answer)[0]  # type: ignore[index]
                ready = state.ready
                dt_s = state.period_s
                assert abs(velocity) <= speed + 1e-9
                assert abs(position) <= math.pi + 1e-9
                assert abs(position - before) <= speed * dt_s + 1e-9
                if ready:
                    assert abs(velocity - slower) <= acceleration * dt_s + 1e-9
                elif bench.session.metrics()["sessions"] > sessions:
                    assert velocity == 0.0
                else:
                    # A robot that reports no motion but moves is braked.
                    left = max(abs(slower) - acceleration * PERIOD_S, 0.0)
                    assert abs(velocity) == pytest.approx(left, abs=1e-9)
                sessions = bench.session.metrics()["sessions"]

    def test_position_only(self) -> None:
        bench = Bench(speed_reference="none").started()
        answer = bench.cycle(joint_target(0.5))
        assert sensor_of(answer).speed_ref is None
        assert joints_in(answer)[0] > 0.0

    def test_speed_only_joints(self) -> None:
        bench = Bench(speed_reference="only", robot="gofa_crb15000_5")
        answer = bench.cycle(JointVelocityCommand((1.0,) * 6))
        assert sensor_of(answer).planned is None
        assert speeds_of(answer) == ZEROS
        for _ in range(100):
            answer = bench.cycle(JointVelocityCommand((1.0, 9.0, 0.0, 0.0, 0.0, 0.0)))
        assert speeds_of(answer)[:2] == pytest.approx((1.0, math.radians(90.0)))  # type: ignore[index]
        # Near the end of its range a joint is stopped by its measured position.
        bench.controller.joints = (math.radians(179.9), *HOME[1:])
        for _ in range(100):
            answer = bench.cycle(JointVelocityCommand((1.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
        assert speeds_of(answer)[0] <= 0.1  # type: ignore[index]
        assert bench.session.slow_motion.commanded == 0.0  # No position is commanded.

    def test_speed_only_twist(self) -> None:
        bench = Bench(mode="pose", speed_reference="only", workspace_lower_m=(0.0, -1.0, 0.0),
                      workspace_upper_m=(0.7, 1.0, 1.0))  # fmt: skip
        twist = TwistCommand(Twist(Vector3(0.1, 0.0, 0.0), Vector3(0.0, 0.0, 0.3)))
        bench.cycle(twist)
        for _ in range(60):
            answer = bench.cycle(twist)
        assert sensor_of(answer).planned is None
        assert speeds_of(answer) == pytest.approx((0.1, 0, 0, 0, 0, 0.3), abs=1e-9)
        bench.controller.position = Vector3(0.7, 0.0, 0.8)
        for _ in range(60):
            answer = bench.cycle(twist)
        assert speeds_of(answer) == pytest.approx((0.0, 0, 0, 0, 0, 0.3), abs=1e-9)

    def test_path_correction(self) -> None:
        bench = Bench(mode="path-correction")
        assert bench.session.capabilities.period_s == pytest.approx(0.048384)
        answers = []
        for k in range(40):
            bench.now_s += 0.048384 - PERIOD_S
            bench.hear()
            command = PathCorrectionCommand(Vector3(9.0, 0.005, -0.5), 0.0014 * k)
            answers.append(decode_from_pc(bench.session.reply(command, bench.now_s)))
        first, last = answers[0], answers[-1]
        assert isinstance(first, EgmSensorPathCorr)
        assert isinstance(last, EgmSensorPathCorr)
        assert first.pos == (0.0, 0.0, 0.0)
        assert last.pos == pytest.approx((0.0, 0.005, -0.02), abs=1e-6)
        assert last.age_ms == round(1.4 * 39)
        bench.controller.seqno = 0
        bench.hear()
        begun_anew = decode_from_pc(bench.session.reply(HOLD, bench.now_s))
        assert isinstance(begun_anew, EgmSensorPathCorr)
        assert begun_anew.age_ms == 0
        offset = Vector3(0.0, 0.0, 0.0)
        bench.session.check(PathCorrectionCommand(offset, 4294967.295))
        for wrong_s in (-1e-6, 4294967.296):
            with pytest.raises(CommandError, match="age_s"):
                bench.session.check(PathCorrectionCommand(offset, wrong_s))
        assert last.header is not None
        assert last.header.mtype == EgmMessageType.PATH_CORRECTION
        with pytest.raises(CommandError, match="outputs"):
            bench.session.set_outputs(True)

    def test_joints_stay_in_their_range(self) -> None:
        bench = Bench(robot="gofa_crb15000_5").started()
        for _ in range(2500):
            answer = bench.cycle(JointCommand((9.0, 9.0, 9.0, 9.0, 9.0, 9.0)))
        limits = bench.options.joint_limits
        assert limits is not None
        assert joints_in(answer) == pytest.approx(limits.upper, abs=1e-6)

    def test_the_workspace_box_holds_the_pose(self) -> None:
        corner = (POSITION.x + 0.05, 1.0, 1.0)
        bench = Bench(mode="pose", workspace_lower_m=(0, -1, 0), workspace_upper_m=corner).started()
        for _ in range(300):
            position, _ = pose_in(bench.cycle(pose_target(0.5)))
            assert position.x <= corner[0] + 1e-9
        assert position.x == pytest.approx(corner[0])


class TestStopping:
    def test_a_hold_brakes_within_the_limits_and_then_stays(self) -> None:
        bench = Bench().started()
        for _ in range(100):
            answer = bench.cycle(joint_target(1.5))
        speed = speeds_of(answer)[0]  # type: ignore[index]
        assert speed == pytest.approx(math.radians(90.0))
        for _ in range(60):
            answer = bench.cycle(HOLD)
            slower = speeds_of(answer)[0]  # type: ignore[index]
            assert 0.0 <= speed - slower <= math.radians(720.0) * PERIOD_S + 1e-9
            speed = slower
        assert speed == 0.0
        assert joints_in(bench.cycle(HOLD)) == joints_in(answer)
        assert not bench.session.moving

    def test_the_driver_holds_for_an_application_that_says_nothing(self) -> None:
        bench = Bench().started()
        for _ in range(50):
            answer = bench.cycle(joint_target(1.5))
        speed = speeds_of(answer)[0]  # type: ignore[index]
        bench.hear()
        held = speeds_of(bench.session.hold(bench.now_s))
        assert held is not None
        assert 0.0 < held[0] < speed
        assert bench.session.counters.driver_holds == 1

    @pytest.mark.parametrize("noise_rad", [0.0, 0.003])
    def test_a_late_command_brakes_from_what_the_controller_does_by_itself(
        self, noise_rad: float
    ) -> None:
        bench = Bench().started()
        for _ in range(100):
            bench.cycle(joint_target(1.5))
        # The application is silent for half a second; the robot moves on.
        speed = math.radians(90.0)
        first, *rest = bench.controller.joints
        for k in range(120):
            first += speed * PERIOD_S
            if k == 119:  # A datagram is lost, and the controller's clock does not show it.
                first += speed * PERIOD_S
                bench.controller.seqno += 1
            # Measurements have noise; the plan of the controller has none.
            bench.controller.fields["planned"] = EgmMotion(joints=(first, *rest))
            bench.controller.joints = (first + noise_rad * (-1) ** k, *rest)
            bench.hear()
        answer = bench.session.reply(joint_target(1.5), bench.now_s + 0.2)
        slower = speeds_of(answer)[0]  # type: ignore[index]
        assert 0.0 < speed - slower <= math.radians(720.0) * PERIOD_S + 1e-9
        assert joints_in(answer)[0] == pytest.approx(first + slower * PERIOD_S)
        assert bench.session.counters.late_commands == 1
        bench.session.answered(bench.now_s + 0.2)
        metrics = bench.session.metrics()
        assert metrics["reply_latency_median_s"] == pytest.approx(1e-4, rel=0.1)
        assert metrics["reply_latency_max_s"] == pytest.approx(0.2)
        words = " ".join(bench.session.diagnosis(bench.now_s))
        assert "half of the answers left within 0.1 ms of their datagram, 99 % within " in words
        assert "the slowest after 200 ms; 1 times it was too late" in words

    @pytest.mark.parametrize("mode", ["joint", "pose"])
    def test_missed_cycles_are_not_made_up_for(self, mode: str) -> None:
        bench = Bench(mode=mode).started()
        speed, target, fastest = 0.1, 0.0, 0.0
        still = Vector3(0.0, 0.0, 0.0)
        for k in range(120):
            if k == 60:  # Meanwhile the robot moves at a fifth of the speed.
                bench.now_s += 10.0 * PERIOD_S
                bench.controller.clock_us += round(1e7 * PERIOD_S)
                bench.controller.seqno += 10
                target += 10.0 * speed * PERIOD_S
                way = 2.0 * speed * PERIOD_S
                first, *rest = bench.controller.joints
                bench.controller.joints = (first + way, *rest)
                x, y, z = bench.controller.position
                bench.controller.position = Vector3(x + way, y, z)
            target += speed * PERIOD_S
            command: RobotCommand = JointCommand((target, *HOME[1:]), (speed, *ZEROS[1:]))
            if mode == "pose":
                twist = Twist(Vector3(speed, 0.0, 0.0), still)
                command = PoseCommand(pose_target(target).pose, twist)
            speeds = speeds_of(bench.cycle(command))
            assert speeds is not None
            fastest = max(fastest, speeds[0]) if k > 60 else 0.0
        assert fastest == pytest.approx(speed)

    def test_a_late_pose_command_brakes_likewise(self) -> None:
        bench = Bench(mode="pose").started()
        x, angle = 0.0, 0.0
        for _ in range(120):
            x, angle = x + 0.2 * PERIOD_S, angle + 0.5 * PERIOD_S
            bench.controller.position = Vector3(POSITION.x + x, POSITION.y, POSITION.z)
            bench.controller.orientation = pose_target(x, angle).pose.orientation
            bench.hear()
        velocity = speeds_of(bench.session.reply(pose_target(), bench.now_s + 0.2))
        assert velocity is not None
        assert velocity[0] == pytest.approx(0.2 - 2.0 * PERIOD_S, abs=1e-6)
        braked = 0.5 - math.radians(720.0) * PERIOD_S
        assert velocity[5] == pytest.approx(braked, abs=1e-6)

    def test_a_late_command_brakes_the_external_axes_likewise(self) -> None:
        bench = Bench(external_axes=1, linear_external_axes=(0,))
        bench.controller.external = (0.0,)
        bench.cycle()
        for k in range(1, 120):
            bench.controller.external = (1e3 * 0.05 * k * PERIOD_S,)
            bench.hear()
        command = JointCommand(HOME, None, (1.0,))
        sensor = sensor_of(bench.session.reply(command, bench.now_s + 0.2))
        assert sensor.speed_ref is not None
        braked = 1e3 * (0.05 - 0.5 * PERIOD_S)
        assert sensor.speed_ref.external_joints == pytest.approx((braked,), abs=1e-6)

    @pytest.mark.parametrize("mode", ["joint", "pose"])
    @pytest.mark.parametrize("speed_reference", ["matched", "only", "none"])
    def test_the_last_message_has_no_speed(self, mode: str, speed_reference: str) -> None:
        bench = Bench(mode=mode, speed_reference=speed_reference).started()
        commands: dict[tuple[str, bool], RobotCommand] = {
            ("joint", False): joint_target(0.5),
            ("pose", False): pose_target(0.1),
            ("joint", True): JointVelocityCommand((0.5,) * 6),
            ("pose", True): TwistCommand(Twist(Vector3(0.1, 0, 0), Vector3(0, 0, 0))),
        }
        for _ in range(20):
            answer = bench.cycle(commands[mode, speed_reference == "only"])
        last_words = bench.session.final_command(bench.now_s)
        assert last_words is not None
        assert speeds_of(last_words) == (None if speed_reference == "none" else ZEROS)
        assert sensor_of(last_words).planned == sensor_of(answer).planned
        assert bench.session.final_command(bench.now_s) is None

    def test_nobody_to_take_leave_from(self) -> None:
        assert Bench().session.final_command(1000.0) is None

    def test_the_last_message_is_no_answer(self) -> None:
        bench = Bench().started()
        bench.cycle(joint_target(0.5))
        assert bench.session.final_command(bench.now_s + 0.15) is not None
        metrics = bench.session.metrics()
        assert (metrics["answers"], metrics["final_commands"]) == (2, 1)
        assert metrics["reply_latency_max_s"] < 0.001

    def test_a_run_that_is_over_is_sent_no_last_message(self) -> None:
        for options in ({}, {"comm_timeout_s": 0.5}):
            bench = Bench(**options).started()
            bench.cycle(joint_target(0.5))
            late_s = bench.options.comm_timeout_s + 0.01
            assert bench.session.final_command(bench.now_s + late_s) is None
            assert bench.session.final_command(bench.now_s + late_s - 0.02) is not None
            assert bench.session.counters.final_commands == 1

    def test_a_first_datagram_never_answered_is_left_with_the_measured_position(self) -> None:
        bench = Bench()
        bench.hear()
        last_words = bench.session.final_command(bench.now_s)
        assert last_words is not None
        assert joints_in(last_words) == pytest.approx(HOME)


class TestContent:
    def test_both_layouts_of_the_force(self) -> None:
        force = (1.5, -2.25, 10.0, 0.125, 0.0, -0.5)
        for active in (None, True, False):
            bench = Bench(force_frame="base")
            bench.controller.fields["measured_force"] = EgmMeasuredForce(force, active)
            state = bench.hear()
            assert state is not None
            assert state.wrench is not None
            assert (*state.wrench.force, *state.wrench.torque) == force
            assert state.wrench.frame is Frame.BASE

    def test_utilization_and_clock(self) -> None:
        bench = Bench()
        bench.controller.fields["utilization_rate"] = 112.5
        state = bench.hear()
        assert state is not None
        assert state.utilization == pytest.approx(1.125)
        assert state.clock_s == pytest.approx(1_700_000_000.0)
        assert bench.session.metrics()["utilization"] == pytest.approx(1.125)

    def test_quaternions_stay_on_one_side_and_at_length_one(self) -> None:
        bench = Bench(mode="pose")
        previous: Quaternion | None = None
        for k in range(20):
            sign = -1.009 if k % 3 else 0.991
            bench.controller.orientation = Quaternion(*(sign * c for c in ORIENTATION))
            state = bench.hear()
            assert state is not None
            assert state.pose is not None
            orientation = state.pose.orientation
            assert sum(c * c for c in orientation) == pytest.approx(1.0)
            if previous is not None:
                assert sum(a * b for a, b in zip(previous, orientation, strict=True)) > 0.99
            previous = orientation

    def test_the_orientation_may_come_as_euler_angles(self) -> None:
        bench = Bench(mode="pose")
        euler = Vector3(math.pi, math.radians(60.0), math.pi)
        pose = EgmPose(POSITION, None, euler)
        bench.controller.fields["feed_back"] = EgmMotion(cartesian=pose)
        state = bench.hear()
        assert state is not None
        assert state.pose is not None
        turned = rotation_between(state.pose.orientation, ORIENTATION)
        assert turned == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
        assert (state.joints, state.clock_s) == ((), None)

    def test_seven_joints_are_in_kinematic_order_both_ways(self) -> None:
        bench = Bench(joints=7, external_axes=1, linear_external_axes=(0,))
        bench.controller.joints = (0.0, 0.1, 0.3, 0.4, 0.5, 0.6)
        bench.controller.external = (math.degrees(0.2), 250.0)
        state = bench.hear()
        assert state is not None
        assert state.joints == pytest.approx((0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
        assert state.external_axes == pytest.approx((0.25,))
        sensor = sensor_of(bench.session.reply(HOLD, bench.now_s))
        assert sensor.planned is not None
        assert sensor.speed_ref is not None
        assert sensor.planned.joints == pytest.approx(bench.controller.joints)
        assert sensor.planned.external_joints == pytest.approx(bench.controller.external)
        assert sensor.speed_ref.joints == ZEROS
        assert sensor.speed_ref.external_joints == (0.0, 0.0)
        target = JointCommand((0.0, 0.1, 0.5, 0.3, 0.4, 0.5, 0.6), None, (0.3,))
        for _ in range(400):
            bench.hear()
            sensor = sensor_of(bench.session.reply(target, bench.now_s))
        assert sensor.planned is not None
        assert sensor.planned.external_joints == pytest.approx((math.degrees(0.5), 300.0))
        assert sensor.planned.joints == pytest.approx(bench.controller.joints)

    def test_external_axes_go_along_with_a_pose(self) -> None:
        bench = Bench(mode="pose", external_axes=2, linear_external_axes=(1,))
        bench.controller.external = (10.0, 100.0)
        bench.cycle()
        command = PoseCommand(pose_target().pose, None, (math.radians(11.0), 0.2))
        for _ in range(400):
            answer = bench.cycle(command)
        sensor = sensor_of(answer)
        assert sensor.planned is not None
        assert sensor.speed_ref is not None
        assert sensor.planned.external_joints == pytest.approx((11.0, 200.0))
        assert sensor.speed_ref.external_joints == pytest.approx((0.0, 0.0), abs=1e-6)
        assert sensor.speed_ref.cartesians == ZEROS
        with pytest.raises(CommandError, match="external_axes"):
            bench.session.check(PoseCommand(pose_target().pose, None, (0.0,)))

    def test_outputs_travel_with_every_message(self) -> None:
        bench = Bench(output_values=(3.0,)).started()
        assert sensor_of(bench.cycle()).rapid_to_robot == EgmRapidData(None, (3.0,))
        bench.session.set_outputs(True)
        assert sensor_of(bench.cycle()).rapid_to_robot == EgmRapidData(True, (3.0,))
        bench.session.set_outputs(values=range(40))  # type: ignore[arg-type]
        for _ in range(2):
            assert sensor_of(bench.cycle()).rapid_to_robot == EgmRapidData(
                True, tuple(map(float, range(40)))
            )
        for values in ((0.0,) * 41, (math.nan,)):
            with pytest.raises(CommandError, match="values"):
                bench.session.set_outputs(values=values)

    def test_no_outputs_unless_asked_for(self) -> None:
        assert sensor_of(Bench().cycle()).rapid_to_robot is None


class TestBadBytes:
    @given(st.lists(st.binary(max_size=200), max_size=40))
    def test_garbage_is_counted_and_changes_nothing(self, garbage: list[bytes]) -> None:
        bench, twin = Bench(), Bench()
        for k in range(3):
            for data in garbage:
                before = bench.session.state
                assert bench.session.receive(data, PEER, bench.now_s) is None
                assert bench.session.state is before
            assert bench.cycle(joint_target(0.1 * k)) == twin.cycle(joint_target(0.1 * k))
        assert sum(bench.session.counters.malformed.values()) == 3 * len(garbage)
        assert sum(bench.session.protocol_errors().values()) == 3 * len(garbage)

    @pytest.mark.parametrize("mode", ["pose", "joint"])
    @pytest.mark.parametrize(
        ("part", "words"),
        [
            ({"joints": (0.0, 1e300, 0.0, 0.0, 0.0, 0.0)}, "feedBack.joints"),
            ({"joints": (math.radians(1e6), *HOME[1:])}, "-2000 to 2000 rad or m: 250 turns"),
            ({"position": Vector3(1e6, 0.0, 0.8)}, "feedBack.pos: .* -100 to 100 m"),
            ({"external": (0.0, 0.0, math.degrees(-2001.0))}, "feedBack.externalJoints"),
        ],
    )
    def test_what_no_robot_measures_is_no_state(
        self, mode: str, part: dict[str, Any], words: str
    ) -> None:
        bench = Bench(mode=mode)
        sane = dict(vars(bench.controller))
        vars(bench.controller).update(part)
        for _ in range(3):
            assert bench.hear() is None
        assert bench.session.peer is None
        assert bench.session.counters.malformed == {"implausible": 3}
        assert re.search(words, bench.session.last_malformed)
        for name in part:
            setattr(bench.controller, name, sane[name])
        answer = bench.cycle(pose_target() if mode == "pose" else joint_target(0.0))
        if mode == "pose":
            assert pose_in(answer)[0] == pytest.approx(POSITION)
        else:
            assert joints_in(answer) == pytest.approx(HOME)

    @pytest.mark.parametrize("length", [0.5, 2.0])
    def test_an_orientation_that_is_no_rotation_is_refused_for_its_length(
        self, length: float
    ) -> None:
        bench = Bench(mode="pose").started()
        bench.controller.orientation = Quaternion(*(length * c for c in ORIENTATION))
        assert bench.hear() is None
        assert bench.session.last_malformed.startswith("feedBack.orient")
        assert f"has length {length:g}" in bench.session.last_malformed

    @pytest.mark.parametrize("mode", ["pose", "joint"])
    def test_a_place_that_no_arm_comes_to_in_a_period_is_no_state(self, mode: str) -> None:
        """A single such reading changes nothing."""
        bench, twin = Bench(mode=mode).started(), Bench(mode=mode).started()
        command = pose_target(0.1) if mode == "pose" else joint_target(0.1)
        for k in range(20):
            place, joints = bench.controller.position, bench.controller.joints
            if k == 10:
                bench.controller.position = Vector3(10.0, 0.0, 0.8)
                bench.controller.joints = (10.0, *HOME[1:])
                assert bench.hear() is None
                twin.hear()
                bench.controller.position, bench.controller.joints = place, joints
                assert " from the one before" in bench.session.last_malformed
            else:
                bench.cycle(command)
                twin.cycle(command)
        assert bench.session.sessions == 1
        assert bench.session.counters.lost == 1
        if mode == "joint":
            assert bench.controller.joints == pytest.approx(twin.controller.joints, abs=0.01)
        else:
            assert bench.controller.position == pytest.approx(twin.controller.position, abs=0.01)

    def test_a_wrong_first_reading_is_not_commanded_for_ever(self) -> None:
        bench = Bench()
        bench.controller.joints = (1900.0, *HOME[1:])
        bench.hear()
        answer = bench.session.reply(HOLD, bench.now_s)
        assert joints_in(answer)[0] == pytest.approx(1900.0)
        bench.controller.joints = HOME
        states = []
        for _ in range(30):
            states.append(bench.hear())
            bench.session.tick(bench.now_s)
        after = next(state for state in states if state is not None)
        assert states.index(after) <= 25
        assert (after.session, after.hold_reason) == (2, FIRST_ANSWER)
        assert joints_in(bench.cycle()) == pytest.approx(HOME)

    def test_joint_mode_needs_no_orientation(self) -> None:
        for first in (0.0, 120.0):
            bench = Bench()
            bench.controller.orientation = Quaternion(0.5, 0.0, 0.0, 0.0)
            bench.controller.joints = (first, *HOME[1:])
            state = bench.hear()
            assert state is not None
            assert (state.pose, state.joints[0]) == (None, pytest.approx(first))
        for pose in (EgmPose(POSITION, None), EgmPose(None, ORIENTATION)):
            bench = Bench()
            bench.controller.fields = {"feed_back": EgmMotion(joints=HOME, cartesian=pose)}
            state = bench.hear()
            assert state is not None
            assert state.pose is None

    @given(st.lists(wild, min_size=6, max_size=6), st.tuples(wild, wild, wild))
    def test_what_is_a_state_may_be_sent_back(
        self, degrees: list[float], millimeters: tuple[float, float, float]
    ) -> None:
        for mode in ("joint", "pose"):
            bench = Bench(mode=mode)
            bench.controller.joints = tuple(map(math.radians, degrees))
            bench.controller.position = Vector3(*(0.001 * value for value in millimeters))
            state = bench.hear()
            if state is None:
                assert bench.session.counters.malformed["implausible"] == 1
            elif mode == "joint":
                bench.session.check(JointCommand(state.joints))
            elif state.pose is not None:
                bench.session.check(PoseCommand(state.pose))

    def test_a_reference_of_the_controller_that_no_robot_has_is_not_followed(self) -> None:
        bench, twin = Bench().started(), Bench().started()
        bench.controller.fields["planned"] = EgmMotion(joints=(1e9,) * 6)
        twin.controller.fields["planned"] = None
        for each in (bench, twin):
            for k in range(40):
                if k == 20:
                    each.now_s += 0.05
                    each.controller.clock_us += 50_000
                    each.controller.seqno += 12
                each.cycle(joint_target(0.5))
        assert joints_in(bench.cycle()) == joints_in(twin.cycle())

    def test_every_cut_of_a_datagram_is_refused_or_whole(self) -> None:
        bench = Bench(mode="pose")
        data = bench.controller.datagram()
        for end in range(len(data)):
            bench.session.receive(data[:end], PEER, bench.now_s)
        assert bench.session.sessions <= 1
        bench.session.diagnosis(bench.now_s)

    @pytest.mark.parametrize("mode", ["joint", "pose"])
    def test_what_no_answer_depends_on_is_judged_when_it_is_looked_at(self, mode: str) -> None:
        bench, twin = Bench(mode=mode), Bench(mode=mode)
        command = joint_target(0.5) if mode == "joint" else pose_target(0.2)
        nan = (math.nan,) * 6
        bench.controller.fields["planned"] = EgmMotion(joints=nan)
        for k in range(60):
            if k == 40:  # after a pause the session examines the controller's planned position
                bench.now_s += 1.0
                twin.now_s += 1.0
                twin.controller.fields["planned"] = None
            bench.hear(), twin.hear()
            answer = bench.session.reply(command, bench.now_s)
            assert answer == twin.session.reply(command, twin.now_s)
            bench.controller.follow(answer)
            twin.controller.follow(answer)
        assert bench.session.counters.accepted == 60
        assert bench.session.message is None
        assert bench.session.message is None
        assert bench.session.counters.malformed["not_finite"] >= 1
        assert "planned.joints" in bench.session.last_malformed
        del bench.controller.fields["planned"]
        bench.hear()
        message = bench.session.message
        assert message is not None
        assert message.planned is not None
        assert message is bench.session.message

    @pytest.mark.parametrize(
        ("mode", "fields", "words"),
        [
            ("joint", {"header": None}, "sequence number"),
            ("joint", {"header": EgmHeader(None, 1, EgmMessageType.DATA)}, "sequence number"),
            ("joint", {"header": EgmHeader(0, 1, EgmMessageType.CORRECTION)}, "mtype"),
            ("joint", {"feed_back": None}, "feedBack"),
            ("joint", {"feed_back": EgmMotion(joints=HOME[:4])}, "6 joints"),
            ("joint", {"feed_back": EgmMotion(cartesian=EgmPose(POSITION, ORIENTATION))}, "joints"),
            ("pose", {"feed_back": EgmMotion(joints=HOME)}, "position and orientation"),
            (
                "pose",
                {"feed_back": EgmMotion(cartesian=EgmPose(POSITION, Quaternion(0, 0, 0, 0)))},
                "feedBack.orient: (0.0, 0.0, 0.0, 0.0) has length 0",
            ),
        ],
    )
    def test_what_lacks_the_measured_position_is_refused(
        self, mode: str, fields: dict[str, Any], words: str
    ) -> None:
        bench = Bench(mode=mode)
        bench.controller.fields = fields
        assert bench.hear() is None
        assert bench.session.peer is None
        diagnosis = " ".join(bench.session.diagnosis(bench.now_s))
        assert "malformed" in diagnosis
        assert words in diagnosis
        metrics = bench.session.metrics()
        assert metrics["malformed"] == 1
        assert sum(n for name, n in metrics.items() if name.startswith("malformed_")) == 1


class TestInsight:
    def words(self, bench: Bench, later_s: float = 0.0) -> str:
        return "\n".join(bench.session.diagnosis(bench.now_s + later_s))

    def test_silence_from_the_start(self) -> None:
        bench = Bench()
        assert bench.session.diagnosis(1000.1) == ()
        words = self.words(bench, 3.0)
        for part in ("6510", "3.0 s", "Remote Address", "firewall", "OmniCore", "listen_host"):
            assert part in words
        assert "listen_host" not in self.words(
            Bench(listen_host="192.168.125.10", controller_host=PEER[0]), 3.0
        )

    def test_silence_after_a_session(self) -> None:
        bench = Bench().started()
        bench.session.tick(bench.now_s + 0.5)
        assert "no EGM datagram from 192.168.125.1:51000" in self.words(bench, 0.5)

    def test_a_run_that_converged(self) -> None:
        bench = Bench().started()
        bench.controller.fields["mci_convergence_met"] = True
        bench.cycle()
        bench.session.tick(bench.now_s + 0.5)
        assert "CondTime" in self.words(bench, 0.5)
        assert bench.session.counters.ended_by_convergence == 1

    def test_a_run_that_converged_while_streaming(self) -> None:
        bench = Bench().started()
        bench.controller.fields["mci_convergence_met"] = True
        bench.cycle()
        bench.controller.mci = MCIState.STOPPED
        bench.cycle()
        assert "CondTime" in self.words(bench)

    @pytest.mark.parametrize(
        ("mode", "command"), [("joint", joint_target(1.5)), ("pose", pose_target(0.4))]
    )
    def test_motion_capped_by_max_speed_deviation(self, mode: str, command: RobotCommand) -> None:
        bench = Bench(mode=mode).started()
        crawl = math.radians(1.0) * PERIOD_S
        for k in range(400):
            bench.hear()
            bench.session.reply(command, bench.now_s)
            bench.session.answered(bench.now_s)
            bench.controller.joints = (k * crawl, *HOME[1:])
            bench.controller.position = Vector3(POSITION.x + 0.5 * k * crawl, 0.0, POSITION.z)
            if k == 100:
                assert "MaxSpeedDeviation" not in self.words(bench)
        assert "1 deg/s" in self.words(bench)
        # Messages end as soon as the robot keeps up.
        for _ in range(100):
            bench.cycle(HOLD)
        assert "MaxSpeedDeviation" not in self.words(bench)

    @pytest.mark.parametrize("mode", ["joint", "pose"])
    def test_motion_that_keeps_up_is_not_called_slow(self, mode: str) -> None:
        bench = Bench(mode=mode).started()
        for k in range(500):
            target = 0.3 * math.sin(0.01 * k)
            bench.cycle(joint_target(target) if mode == "joint" else pose_target(0.2 * target))
            assert not bench.session.slow_motion.capped

    def test_two_looks_at_one_time_say_nothing_of_a_speed(self) -> None:
        detector = SpeedCapDetector()
        for reported in (0.0, 0.1):
            detector.look(((reported,), (0.0,)), 1000.0)
        assert (detector.commanded, detector.done, detector.capped) == (0.0, 0.0, False)

    def test_the_hint_about_max_speed_deviation(self) -> None:
        assert "\\MaxSpeedDeviation is 20 deg/s" in self.words(Bench(max_speed_deviation_deg_s=20))
        assert self.words(Bench(max_speed_deviation_deg_s=90)) == ""

    def test_loss_and_restarts(self) -> None:
        bench = Bench().started()
        bench.controller.seqno += 2
        bench.cycle()
        assert "2 of 4 datagrams were lost (50.0 %)" in self.words(bench)
        bench.controller.seqno = 0
        bench.cycle()
        assert "2 sessions" in self.words(bench)
        for _ in range(5):
            bench.cycle(joint_target(1.5))
        bench.controller.seqno = 0
        bench.cycle()
        assert bench.session.sessions == 3
        assert bench.session.handover is None  # It is still the same port.

    @pytest.mark.parametrize(
        ("fields", "profile"),
        [
            ({}, "6.07.01 or later"),
            ({"feed_back": EgmMotion(joints=HOME)}, "before 6.07.01"),
            ({"utilization_rate": 1.0}, "6.10"),
            ({"measured_force": EgmMeasuredForce(ZEROS, None)}, "6.07.01"),
            ({"measured_force": EgmMeasuredForce(ZEROS, False)}, "RobotWare 7"),
            ({"move_index": 0}, "7.6"),
            ({"collision_info": EgmCollisionInfo(False, ())}, "7.6"),
            ({"rapid_from_robot": EgmRapidData(False, ())}, "7.7"),
            ({"torque_ref": ZEROS}, "7.16"),
        ],
    )
    def test_the_robotware_profile(self, fields: dict[str, Any], profile: str) -> None:
        bench = Bench()
        bench.controller.fields = fields
        bench.cycle()
        assert profile in self.words(bench)

    def test_metrics(self) -> None:
        bench = Bench()
        for _ in range(11):
            bench.cycle()
        metrics = bench.session.metrics()
        assert metrics["sessions"] == 1
        assert metrics["datagrams"] == metrics["answers"] == 11
        assert metrics["period_s"] == pytest.approx(PERIOD_S)
        assert metrics["period_jitter_p99_s"] < 1e-6
        assert metrics["reply_latency_median_s"] == pytest.approx(1e-4, rel=0.03)
        assert metrics["reply_latency_max_s"] == pytest.approx(1e-4, rel=1e-3)

    def test_send_errors_are_reported(self) -> None:
        bench = Bench()
        bench.session.send_failed("Network is unreachable")
        assert "Network is unreachable" in self.words(bench)


class TestOptions:
    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("listen_port", 70000),
            ("listen_port", -1),
            ("listen_port", 1.5),
            ("listen_host", ""),
            ("listen_host", "fe80::1"),
            ("listen_host", "224.0.0.1"),
            ("listen_host", "255.255.255.255"),
            ("controller_host", "0.0.0.0"),
            ("controller_host", "224.0.0.1"),
            ("controller_host", "255.255.255.255"),
            ("comm_timeout_s", 0.0),
            ("comm_timeout_s", 10.1),
            ("controller_host", "two words"),
            ("mode", "force"),
            ("speed_reference", "always"),
            ("sample_rate_ms", 5),
            ("sample_rate_ms", 0),
            ("joints", 8),
            ("external_axes", 7),
            ("linear_external_axes", (6,)),
            ("force_frame", "world"),
            ("robot", "r2d2"),
            ("joint_lower_deg", (1.0, 2.0)),
            ("joint_speed_deg_s", 0.0),
            ("joint_acceleration_deg_s2", math.nan),
            ("linear_speed_m_s", -1.0),
            ("linear_acceleration_m_s2", math.inf),
            ("workspace_lower_m", (0.0, 0.0)),
            ("silence_s", 0.0),
            ("command_timeout_s", -0.1),
            ("max_speed_deviation_deg_s", 0.0),
            ("output_values", (0.0,) * 41),
            ("output_values", (math.nan,)),
        ],
    )
    def test_a_bad_value_is_named(self, name: str, value: object) -> None:
        with pytest.raises(ValueError, match=name) as refusal:
            AbbEgmOptions(**{name: value})  # type: ignore[arg-type]
        assert repr(value) in str(refusal.value)
        assert "must be" in str(refusal.value)

    @pytest.mark.parametrize(
        "options",
        [
            {"joints": 7, "mode": "pose"},
            {"joints": 7, "mode": "joint", "external_axes": 6},
            {"joints": 7, "mode": "joint", "robot": "gofa_crb15000_5"},
            {"mode": "path-correction", "speed_reference": "only"},
            {"mode": "path-correction", "digital_output": True},
            {"mode": "path-correction", "sample_rate_ms": 4},
            {"joint_upper_deg": (1.0,) * 6},
            {"joint_lower_deg": (1.0,) * 6, "joint_upper_deg": (1.0,) * 6},
            {"robot": "gofa_crb15000_5", "joint_lower_deg": (181.0,) * 6},
            {"workspace_lower_m": (0.0,) * 3},
            {"workspace_lower_m": (0.0,) * 3, "workspace_upper_m": (1.0, 1.0, 0.0)},
        ],
    )
    def test_values_that_do_not_fit_together(self, options: dict[str, Any]) -> None:
        with pytest.raises(ValueError, match="must be"):
            AbbEgmOptions(**options)

    def test_a_command_is_late_after_its_time_and_some_periods(self) -> None:
        assert AbbEgmOptions(command_timeout_s=0.5).late_after_s == 0.5
        slow = AbbEgmOptions(command_timeout_s=0.01, sample_rate_ms=48)
        assert slow.late_after_s == SILENT_PERIODS * slow.period_s

    def test_a_configuration_file_can_be_checked_against_them(self) -> None:
        options = read_table(AbbEgmOptions, {"mode": "joint", "output_values": [1, 2]})
        assert options == AbbEgmOptions(mode="joint", output_values=(1.0, 2.0))
        for table in ({"mode": "fast"}, {"listen_port": 70000}, {"joints": "many"}):
            with pytest.raises(ConfigurationError):
                read_table(AbbEgmOptions, table)

    def test_limits_of_a_known_robot(self) -> None:
        session = EgmSession(AbbEgmOptions(mode="joint", robot="gofa_crb15000_5"), 0.0)
        limits = session.capabilities.limits
        assert limits is not None
        assert limits.lower[2] == pytest.approx(math.radians(-225.0))
        assert limits.velocity == pytest.approx((math.radians(90.0),) * 6)
        fast = AbbEgmOptions(robot="gofa_crb15000_5", joint_speed_deg_s=1000.0)
        assert fast.joint_speeds_rad_s[0] == pytest.approx(math.radians(125.0))
        assert EgmSession(AbbEgmOptions(), 0.0).capabilities.limits is None
