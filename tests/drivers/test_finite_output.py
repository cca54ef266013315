"""Finite output of all drivers, for all accepted limits and all commands."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st

from cardan.drivers.abb_egm import AbbEgmOptions
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.sim_arm.options import SimArmOptions
from cardan.drivers.sim_arm.session import SimArmSession
from cardan.errors import CommandError
from cardan.protocols.egm.decode import decode_from_pc
from cardan.protocols.egm.messages import MalformedEgmMessage
from cardan.protocols.joint_stream.codec import (
    ArmCommand,
    decode_command,
    encode_state,
)
from cardan.protocols.simple_message.codec import wire
from cardan.protocols.simple_message.messages import Message
from cardan.types import (
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    PathCorrectionCommand,
    Pose,
    PoseCommand,
    Quaternion,
    RobotCommand,
    TorqueCommand,
    Twist,
    TwistCommand,
    Vector3,
)
from tests.drivers.motoros_bench import SessionBench
from tests.drivers.test_egm_session import Bench
from tests.drivers.test_sim_arm import STATE
from tests.examples import examples
from tests.ranges import drawn

WILD = st.sampled_from(
    [0.0, 5e-324, 1e-12, 0.1, 3.0, 9.99e5, 1e6, 1e38, 3.5e38, 1e150, 1.7e308]
).flatmap(lambda size: st.sampled_from([size, -size])) | st.floats(
    allow_nan=False, allow_infinity=False
)
SENSIBLE = st.floats(-3.0, 3.0)
BROKEN = st.sampled_from([math.nan, math.inf, -math.inf])

SLOW_AND_FAST = {"max_examples": examples(120), "deadline": None}


def sixes(number: st.SearchStrategy[float]) -> st.SearchStrategy[tuple[float, ...]]:
    return st.tuples(*[number] * 6)


def vectors(number: st.SearchStrategy[float]) -> st.SearchStrategy[Vector3]:
    return made(Vector3, number, number, number)


def made(kind: Callable[..., Any], *numbers: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Return a strategy like `st.builds` that leaves fields with a default alone."""
    return st.tuples(*numbers).map(lambda values: kind(*values))


def unit(turn: Vector3) -> Quaternion:
    """Return the rotation by a rotation vector of at most a few rad."""
    angle = math.sqrt(sum(v * v for v in turn))
    if angle < 1e-6:
        return Quaternion(1.0, 0.0, 0.0, 0.0)
    x, y, z = (v / angle * math.sin(angle / 2.0) for v in turn)
    return Quaternion(math.cos(angle / 2.0), x, y, z)


def commands(number: st.SearchStrategy[float]) -> st.SearchStrategy[RobotCommand]:
    """Return commands of every type with such numbers; most orientations are valid."""
    twists = made(Twist, vectors(number), vectors(number))
    turned = vectors(SENSIBLE).map(unit) | made(Quaternion, number, number, number, number)
    poses = made(Pose, vectors(number), turned)
    externals = st.just(()) | st.tuples(number, number)
    return st.one_of(
        st.just(HoldCommand()),
        made(JointCommand, sixes(number), st.none() | sixes(number), externals),
        made(PoseCommand, poses, st.none() | twists, externals),
        made(JointVelocityCommand, sixes(number)),
        made(TwistCommand, twists),
        made(TorqueCommand, sixes(number)),
        made(PathCorrectionCommand, vectors(number), number.map(abs)),
    )


def flat(values: Any) -> list[float]:
    """Yield every number in the result of a decoder."""
    if isinstance(values, (int, float)):
        return [float(values)]
    if isinstance(values, (tuple, list)):
        return list(itertools.chain.from_iterable(map(flat, values)))
    return []


def all_finite(values: Any) -> bool:
    return all(map(math.isfinite, flat(values)))


# -- EGM ------------------------------------------------------------------------------------------

EGM_LIMITS = drawn(
    AbbEgmOptions,
    "joint_speed_deg_s",
    "joint_acceleration_deg_s2",
    "external_axis_speed",
    "external_axis_acceleration",
    "linear_speed_m_s",
    "linear_acceleration_m_s2",
    "angular_speed_deg_s",
    "angular_acceleration_deg_s2",
    "path_offset_m",
    "silence_s",
    "command_timeout_s",
)
EGM_MODES = st.sampled_from(
    [
        {"mode": mode, "speed_reference": speed}
        for mode, speed in itertools.product(("pose", "joint"), ("matched", "none", "only"))
    ]
    + [{"mode": "path-correction"}]
)
EGM_FRAMES = st.sampled_from(
    [
        {},
        {"robot": "gofa_crb15000_5"},
        {"workspace_lower_m": (0.5, -0.1, 0.8), "workspace_upper_m": (0.6, 0.1, 0.9)},
        {"workspace_lower_m": (-100.0,) * 3, "workspace_upper_m": (100.0,) * 3},
        {"joint_lower_deg": (-3600.0,) * 6, "joint_upper_deg": (3600.0,) * 6},
        {"external_axes": 2, "linear_external_axes": (1,)},
    ]
)


def egm_bench(mode: dict[str, Any], frame: dict[str, Any], limits: dict[str, Any]) -> Bench:
    if mode["mode"] == "path-correction":
        frame = {}
    bench = Bench(**mode, **frame, **limits)
    bench.controller.external = (0.0,) * 6
    return bench


def egm_answers(bench: Bench, command: RobotCommand, cycles: int) -> None:
    """Answer some datagrams with `command`, or hold if it is refused; check that all numbers are
    finite."""
    for _ in range(cycles):
        assert bench.hear() is not None
        try:
            answer = bench.session.reply(command, bench.now_s)
        except CommandError:
            answer = bench.session.hold(bench.now_s)
        bench.session.answered(bench.now_s)
        reported = decode_from_pc(answer)
        assert not isinstance(reported, MalformedEgmMessage), reported
        assert all_finite(reported), reported
        if bench.options.mode != "path-correction":
            bench.controller.follow(answer)


@settings(**SLOW_AND_FAST)
@given(EGM_MODES, EGM_FRAMES, EGM_LIMITS, st.lists(commands(WILD | SENSIBLE), max_size=8))
def test_egm_answers_are_finite(mode, frame, limits, asked):
    bench = egm_bench(mode, frame, limits)
    for command in asked:
        egm_answers(bench, command, 4)
    bench.now_s += 0.3  # late: the reference restarts from the controller's planned position
    egm_answers(bench, HoldCommand(), 2)


@settings(**SLOW_AND_FAST)
@given(EGM_MODES, EGM_FRAMES, commands(BROKEN))
def test_egm_refuses_what_is_not_finite(mode, frame, command):
    bench = egm_bench(mode, frame, {})
    egm_answers(bench, HoldCommand(), 1)
    assert bench.hear() is not None
    if not all_finite(command):
        with pytest.raises(CommandError):
            bench.session.reply(command, bench.now_s)
    bench.session.hold(bench.now_s)
    egm_answers(bench, command, 2)


# -- MotoROS --------------------------------------------------------------------------------------

MOTOROS_LIMITS = drawn(MotorosOptions, "speed_share", "lag_s", "queue_low", "reply_every")
MOTOROS_TUPLES = {
    name: st.just(()) | st.tuples(*[values] * 6)
    for name, values in {
        "velocity_rad_s": st.sampled_from([1e-4, 0.3, 8.0 * math.pi]),
        "acceleration_rad_s2": st.sampled_from([1e-3, 3.0, 100.0 * math.pi]),
    }.items()
}
MOTOROS_MODES = st.sampled_from(["velocity", "stream"])


def motoros_messages(run: SessionBench) -> list[Message]:
    """Return all messages that the session sends from now on, decoded by the controller."""
    sent: list[Message] = []
    outgoing = run.session.outgoing

    def recorded() -> Any:
        found = outgoing()
        for channel, data in found:
            if channel == "motion":
                sent.append(wire(run.session.feed.byte_order).decode(data))
        return found

    run.session.outgoing = recorded
    return sent


@settings(**SLOW_AND_FAST)
@given(
    MOTOROS_MODES,
    MOTOROS_LIMITS,
    st.fixed_dictionaries(MOTOROS_TUPLES),
    st.lists(commands(WILD | SENSIBLE | BROKEN), min_size=1, max_size=6),
)
def test_motoros_messages_are_finite(mode, limits, tuples, asked):
    turns = itertools.cycle(asked)

    def answer(state):
        return next(turns) if state.ready else HoldCommand()

    run = SessionBench({"mode": mode, **limits, **tuples}, tick_s=1e-3)
    run.ready()
    sent = motoros_messages(run)
    refuse, taken = run.session.command, []

    def command(asked_for, now_s):
        try:
            refuse(asked_for, now_s)
            taken.append(asked_for)
        except CommandError:
            refuse(HoldCommand(), now_s)

    run.session.command = command
    run.answer = answer
    run.run(0.2)
    assert sent
    assert all(isinstance(message, Message) for message in sent)
    assert all(map(all_finite, sent))
    assert all(map(all_finite, taken))


# -- the simulated arm's ---------------------------------------------------------------------------


@settings(**SLOW_AND_FAST)
@given(
    drawn(SimArmOptions, "period_s", "silence_s", "command_timeout_s"),
    st.lists(commands(WILD | SENSIBLE | BROKEN), max_size=20),
)
def test_commands_to_the_simulated_arm_are_finite(limits, asked):
    session = SimArmSession(SimArmOptions(**limits))
    assert session.receive(encode_state(STATE), 1.0) is not None
    for command in asked:
        with contextlib.suppress(CommandError):
            data = session.command(command, 1.0)
            assert all_finite(command)
            reported = decode_command(data)
            assert isinstance(reported, ArmCommand)
            assert all_finite(reported)
