"""Compiled EGM answers: equal to the Python session's byte for byte, or left to Python."""

import contextlib
import gc
import math
import random
import sys
from collections import Counter
from collections.abc import Callable

import pytest

import cardan
from cardan.common.native import NativePartError
from cardan.drivers.abb_egm import AbbEgmOptions, compiled, reference_generator as generator_module
from cardan.drivers.abb_egm.compiled import AnsweringLimiter, CompiledCycle, CompiledReader
from cardan.drivers.abb_egm.session import EgmSession
from cardan.drivers.abb_egm.statistics import PlainCycleState
from cardan.drivers.limiters import JointLimiter
from cardan.drivers.missed_cycles import SLACK_S
from cardan.errors import CommandError
from cardan.protocols.egm.messages import EgmMeasuredForce
from cardan.protocols.egm.reader import FeedbackReader
from cardan.spatial import from_rotation_vector, multiply, normalized
from cardan.types import (
    Frame,
    HoldCommand,
    JointCommand,
    JointVelocityCommand,
    Pose,
    PoseCommand,
    Quaternion,
    RobotLink,
    RobotState,
    Twist,
    TwistCommand,
    Vector3,
    Wrench,
)
from tests.drivers.egm_controller import HOME, PERIOD_S, POSITION, Controller

ADDRESS = ("192.168.125.1", 6510)


def without_compiled(options: AbbEgmOptions) -> EgmSession:
    with pytest.MonkeyPatch.context() as patch:

        def missing(*_: object) -> None:
            raise NativePartError("not there")

        patch.setattr(generator_module, "AnsweringLimiter", missing)
        patch.setattr(generator_module, "AnsweringPose", missing)
        patch.setattr(compiled, "CompiledReader", missing)
        return EgmSession(options, 0.0)


def random_command(choice: random.Random, at: list[float]) -> object:
    """Return mostly targets near `at`, which it advances, and some holds and invalid targets."""
    kind = choice.random()
    if kind < 0.05:
        return HoldCommand()
    far = 1.0 if kind < 0.15 else 0.01
    for i in range(6):
        at[i] += choice.uniform(-far, far)
    positions: tuple[object, ...] = tuple(at)
    velocities: tuple[object, ...] | None = None
    if choice.random() < 0.7:
        velocities = tuple(choice.uniform(-2.0, 2.0) for _ in range(6))
    if kind > 0.95:
        wrong = choice.choice((math.nan, math.inf, 1e300, 2001.0, -3000.0, 1, True, None, "1"))
        place = choice.randrange(6)
        if velocities is None or choice.random() < 0.5:
            positions = (*positions[:place], wrong, *positions[place + 1 :])
        else:
            velocities = (*velocities[:place], wrong, *velocities[place + 1 :])
    elif kind > 0.94:
        positions = positions[: choice.randrange(6)]
    elif kind > 0.93:
        return JointCommand(tuple(at), velocities, (0.1,))
    elif kind > 0.92:
        return JointVelocityCommand(tuple(at))
    return JointCommand(positions, velocities)  # type: ignore[arg-type]


def reported(session: EgmSession, command: object, now_s: float) -> object:
    try:
        return session.reply(command, now_s)  # type: ignore[arg-type]
    except CommandError as error:
        return str(error), session.hold(now_s)


@pytest.mark.matrix(*map(str, range(1, 12)))
@pytest.mark.parametrize("seed", range(12))
def test_answers_are_those_of_the_session_in_python_byte_for_byte(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    choice = random.Random(seed)
    options = AbbEgmOptions(
        mode="joint",
        robot=choice.choice(("gofa_crb15000_5", None)),
        speed_reference="none" if seed % 3 == 0 else "matched",
        joint_acceleration_deg_s2=choice.choice((100.0, 1000.0)),
        digital_output=None if seed % 2 else True,
    )
    quick, plain = EgmSession(options, 0.0), without_compiled(options)
    assert isinstance(quick._generator._limiter, AnsweringLimiter)
    assert type(plain._generator._limiter) is JointLimiter
    assert isinstance(quick._reader, CompiledReader)
    assert type(plain._reader) is FeedbackReader
    compiled_answers = []
    answer = quick._generator.answer
    monkeypatch.setattr(
        quick._generator,
        "answer",
        lambda *given: compiled_answers.append(answer(*given)) or compiled_answers[-1],
    )
    controllers = Controller(), Controller()
    now_s, at = 1.0, list(HOME)
    answers = shift_us = 0
    for cycle in range(1500):
        happens = choice.random()
        now_s += PERIOD_S * (1.0 if happens > 0.02 else choice.choice((2.0, 4.0, 30.0, 300.0)))
        came_s = now_s + PERIOD_S * choice.choice((0.0, 0.0, 0.0, 0.1, 0.3, 0.8))
        shift_us, before_us = choice.choice((0, 0, 0, 900, -900)), shift_us
        late_s = choice.choice((1e-4, 1e-4, 1e-4, 0.3)) if happens > 0.97 else 1e-4
        motors = None if 0.02 < happens < 0.03 else 1
        rapid = 1 if 0.03 < happens < 0.04 else 2
        skipped = choice.randrange(1, 6) if 0.04 < happens < 0.06 else 0
        datagrams = []
        for controller in controllers:
            for _ in range(skipped):
                controller.message()
            controller.joints, controller.rapid = tuple(at), rapid
            controller.clock_us += shift_us - before_us
            if motors is None:
                controller.motors = 2
            else:
                controller.motors = 1
            datagrams.append(controller.datagram())
        states: list[RobotState | None] = [
            session.receive(data, ADDRESS, came_s)
            for session, data in zip((quick, plain), datagrams, strict=True)
        ]
        assert states[0] == states[1]
        if states[0] is None:
            continue
        command = random_command(choice, at)
        found = [reported(session, command, came_s + late_s) for session in (quick, plain)]
        assert found[0] == found[1], (cycle, command)
        for session in (quick, plain):
            session.answered(came_s + late_s)
        one, two = quick._generator, plain._generator
        assert list(one._limiter.reference) == two._limiter.reference
        assert list(one._limiter.velocity) == two._limiter.velocity
        assert quick.moving == plain.moving
        answers += 1
    assert quick.counters == plain.counters
    assert answers > 1200
    # The compiled part does not answer while the clocks disagree, which the gaps cause.
    assert sum(each is not None for each in compiled_answers) > 0.2 * answers


@pytest.mark.parametrize("make", [lambda o: EgmSession(o, 0.0), without_compiled])
@pytest.mark.parametrize("rate", [1.6, 4.0, 40.0])
def test_datagrams_that_come_too_fast_advance_no_faster_than_time_here(
    make: Callable[[AbbEgmOptions], EgmSession], rate: float
) -> None:
    session, controller = make(AbbEgmOptions(mode="joint")), Controller()
    now_s, passed_s, began_s = 1.0, 0.0, 0.0
    for cycle in range(400):
        now_s += PERIOD_S / (rate if cycle > 200 else 1.0)
        controller.joints = tuple(HOME)
        state = session.receive(controller.datagram(), ADDRESS, now_s)
        assert state is not None
        session.reply(JointCommand((HOME[0] + 0.05 * passed_s, *HOME[1:])), now_s)
        session.answered(now_s)
        if cycle == 200:
            began_s, passed_s = now_s, 0.0
        elif cycle > 200:
            passed_s += state.period_s
            assert passed_s <= now_s - began_s + SLACK_S + 1e-9
    assert passed_s == pytest.approx(now_s - began_s, abs=0.002)


MODES = [
    (mode, speed, box)
    for mode in ("joint", "pose")
    for speed in ("matched", "none", "only")
    for box in ((False, True) if mode == "pose" else (False,))
]
NEAR = Quaternion(0.5, 0.0, math.sqrt(0.75), 0.0)


def random_turn(choice: random.Random, at: Quaternion, far: float) -> Quaternion:
    turned = multiply(from_rotation_vector(Vector3(*random_vector(choice, far))), at)
    return normalized(turned)


def random_vector(choice: random.Random, far: float) -> list[float]:
    return [choice.uniform(-far, far) for _ in range(3)]


class Operator:
    """Commands that mostly advance a little, sometimes jump, and sometimes are invalid."""

    def __init__(self, choice: random.Random, mode: str, speed: str) -> None:
        self.choice = choice
        self.mode, self.speed = mode, speed
        self.joints = list(HOME)
        self.position = list(POSITION)
        self.orientation = NEAR

    def command(self) -> object:
        kind = self.choice.random()
        if kind < 0.1:
            return HoldCommand()
        far = 1.0 if kind < 0.15 else 0.01
        made = self._speed(far) if self.speed == "only" else self._target(far)
        return self._spoilt(made) if kind > 0.95 else made

    def _speed(self, far: float) -> object:
        if self.mode == "joint":
            return JointVelocityCommand(tuple(self.choice.uniform(-far, far) for _ in range(6)))
        return TwistCommand(self._twist(far))

    def _twist(self, far: float) -> Twist:
        linear, angular = (Vector3(*random_vector(self.choice, 30.0 * far)) for _ in range(2))
        return Twist(linear, angular, self._frame())

    def _frame(self) -> Frame:
        return Frame.TOOL if self.choice.random() < 0.01 else Frame.BASE

    def _target(self, far: float) -> object:
        choice = self.choice
        said = choice.random() < 0.6
        if self.mode == "joint":
            self.joints = [q + choice.uniform(-far, far) for q in self.joints]
            speeds = tuple(choice.uniform(-2.0, 2.0) for _ in range(6))
            return JointCommand(tuple(self.joints), speeds if said else None)
        if choice.random() < 0.8:
            moved = zip(self.position, random_vector(choice, 0.3 * far), strict=True)
            self.position = [min(max(p + by, -3.0), 3.0) for p, by in moved]
            self.orientation = random_turn(choice, self.orientation, far)
        w, x, y, z = self.orientation
        length = choice.choice((*(1.0, 1.0, -1.0, 1.0 + 1e-9, 1.005) * 4, 0.9, 1.1))
        orientation = Quaternion(w * length, x * length, y * length, z * length)
        pose = Pose(Vector3(*self.position), orientation, self._frame())
        return PoseCommand(pose, self._twist(far) if said else None)

    def _spoilt(self, command: object) -> object:
        """Return `command` with one invalid number, or of another type."""
        choice = self.choice
        wrong = choice.choice((math.nan, math.inf, 1e300, 2001.0, -3000.0, 1, True, None, "1", ()))

        def spoil(part: object) -> object:
            if not isinstance(part, tuple) or not part:
                return wrong
            place = choice.randrange(len(part))
            items = [spoil(item) if i == place else item for i, item in enumerate(part)]
            return type(part)(*items) if hasattr(part, "_fields") else tuple(items)

        others = (
            JointCommand(HOME, None, (0.1,)),
            JointVelocityCommand((0.1,) * 6),
            PoseCommand(Pose(POSITION, NEAR), None, (0.1,)),
            TwistCommand(Twist(Vector3(0.1, 0.0, 0.0), Vector3(0.0, 0.0, 0.1))),
            JointCommand(HOME[:5]),
            None,
        )
        return choice.choice(others) if choice.random() < 0.3 else spoil(command)


class Line:
    """Controller whose datagrams arrive in order, except for some faults."""

    def __init__(self, choice: random.Random) -> None:
        self.choice = choice
        self.controller = Controller()
        self.before = b""

    def datagrams(self, operator: Operator) -> list[tuple[bytes, tuple[str, int]]]:
        choice, controller = self.choice, self.controller
        happens = choice.random()
        controller.joints = tuple(q + choice.uniform(-1e-3, 1e-3) for q in operator.joints)
        controller.position = Vector3(*(p + choice.uniform(-1e-3, 1e-3) for p in operator.position))
        w, x, y, z = random_turn(choice, operator.orientation, 1e-3)
        length = choice.choice((1.0, 1.0, -1.0, 1.0 + 1e-8, 0.993))
        controller.orientation = Quaternion(w * length, x * length, y * length, z * length)
        controller.motors, controller.rapid = 1, 2
        controller.fields = {"utilization_rate": 12.5} if choice.random() < 0.5 else {}
        if choice.random() < 0.5:
            force = tuple(choice.uniform(-50.0, 50.0) for _ in range(6))
            controller.fields["measured_force"] = EgmMeasuredForce(force, True)
        if happens < 0.01:
            controller.joints = (*controller.joints[:5], choice.choice((math.nan, 40.0, 7.0)))
        elif happens < 0.02:
            controller.position = Vector3(0.0, choice.choice((math.inf, 101.0, 8.0, 6.3)), 0.0)
        elif happens < 0.03:
            controller.orientation = Quaternion(0.5, 0.0, 0.0, choice.uniform(0.0, 1.0))
        elif happens < 0.04:
            controller.clock_us += choice.choice((-(10**9), 10**9, 20_000))
        elif happens < 0.05:
            controller.motors = 2
        elif happens < 0.06:
            controller.rapid = choice.choice((0, 1))
        elif happens < 0.08:
            for _ in range(choice.choice((1, 2, 5, 300))):
                controller.message()
        elif happens < 0.085:
            controller.seqno = choice.choice((0, 2**32 - 1, 127))
        sent = [controller.datagram()]
        if happens > 0.99:
            sent.append(sent[0])
        elif happens > 0.98:
            sent.insert(0, self.before)
        elif happens > 0.97:
            sent = [sent[0][: choice.randrange(len(sent[0]))], controller.datagram()]
        elif happens > 0.96:
            sent.append(controller.datagram())
        elif happens > 0.958:
            sent = [b"\x0a\x00"] * 60 + sent
        self.before = sent[-1]
        other = ("192.168.125.1", 7777)
        return [(data, other if happens > 0.993 else ADDRESS) for data in sent]


SEEDS = 3
LATER = [
    f"{seed}-{mode}-{speed}-{box}"
    for number, (mode, speed, box) in enumerate(MODES)
    for seed in range(SEEDS)
    if seed != number % SEEDS
]
"""Cases of the matrix: `make test` has each mode once, and each seed's options with some modes."""


@pytest.mark.matrix(*LATER)
@pytest.mark.parametrize(("mode", "speed", "box"), MODES)
@pytest.mark.parametrize("seed", range(SEEDS))
def test_all_that_a_session_says_is_that_of_the_one_in_python(
    mode: str, speed: str, box: bool, seed: int
) -> None:
    choice = random.Random(f"{mode} {speed} {box} {seed}")
    options = AbbEgmOptions(
        mode=mode,  # type: ignore[arg-type]
        speed_reference=speed,  # type: ignore[arg-type]
        digital_output=None if seed % 2 else True,
        output_values=() if seed == 1 else (1.5, -2.0),
        workspace_lower_m=(0.59, -0.01, 0.82) if box else (),
        workspace_upper_m=(0.62, 0.02, 0.85) if box else (),
    )
    quick, plain = EgmSession(options, 0.0), without_compiled(options)
    assert isinstance(quick._reader, CompiledReader)
    assert type(plain._reader) is FeedbackReader
    assert isinstance(plain._cycle_state, PlainCycleState)
    done: Counter[str] = Counter()

    def counted(what: str, call: Callable[..., object]) -> Callable[..., object]:
        def counting(*given: object) -> object:
            found = call(*given)
            done[what] += found is not None
            return found

        return counting

    quick._take = counted("taken", quick._take)
    quick._generator.answer = counted("answered", quick._generator.answer)  # type: ignore[assignment]
    operator, line = Operator(choice, mode, speed), Line(choice)
    now_s = 1.0
    for cycle in range(800):
        happens = choice.random()
        now_s += PERIOD_S * (1.0 if happens > 0.02 else choice.choice((0.0, 2.0, 4.0, 30.0, 300.0)))
        late_s = choice.choice((1e-4, 0.002, 0.05, 0.3)) if happens > 0.97 else 1e-4
        if 0.02 < happens < 0.025:
            assert quick.tick(now_s) == plain.tick(now_s)
        for data, source in line.datagrams(operator):
            states = [session.receive(data, source, now_s) for session in (quick, plain)]
            assert states[0] == states[1]
            assert repr(states[0]) == repr(states[1])
        assert quick.reply_pending == plain.reply_pending
        if quick.reply_pending and happens < 0.99:
            command = operator.command()
            found = [reported(session, command, now_s + late_s) for session in (quick, plain)]
            assert found[0] == found[1], (cycle, command)
            for session in (quick, plain):
                session.answered(now_s + late_s)
        for name in BOOKED:
            one, two = getattr(quick._cycle_state, name), getattr(plain._cycle_state, name)
            assert (list(one) == list(two)) if name == "states" else one == two, name
        for part in ("_limiter", "_point", "_turn"):
            limiter, other = (getattr(session._generator, part, None) for session in (quick, plain))
            if limiter is not None and other is not None:
                assert tuple(limiter.reference) == tuple(other.reference)
                assert tuple(limiter.velocity) == tuple(other.velocity)
        assert quick.moving == plain.moving
        assert quick._newest == plain._newest
        if happens > 0.998:
            assert quick.final_command(now_s) == plain.final_command(now_s)
    assert quick.counters == plain.counters
    assert quick.metrics() == plain.metrics()
    assert quick.diagnosis(now_s) == plain.diagnosis(now_s)
    assert quick.message == plain.message
    assert done["taken"] > 250
    assert done["answered"] > 200


BOOKED = (
    *("states", "tm_ms", "time_us", "last_step_s", "since_reply_s", "replied_s"),
    *("out_seqno", "said_speed"),
)


def test_a_command_that_is_none_changes_nothing() -> None:
    cycle = CompiledCycle(late_after_s=0.2, longest_gap_s=0.006)
    limiter = AnsweringLimiter((-1.0,) * 6, (1.0,) * 6, (1.0,) * 6, (5.0,) * 6, 0.016, True)
    answer = limiter.compiled_reply(cycle)
    session, controller = EgmSession(AbbEgmOptions(), 0.0), Controller()
    for _ in range(2):
        state = session.receive(controller.datagram(), ADDRESS, 1.0)
        session.hold(1.0)
    assert state is not None
    assert state.ready
    still = (0.0,) * 6
    for positions, velocities, dt_s in (
        ((math.nan, *still[1:]), still, 0.004),
        (still, (math.inf, *still[1:]), 0.004),
        ((2001.0, *still[1:]), None, 0.004),
        (still[:5], (*still, 0.0), 0.004),
        ((1, *still[1:]), None, 0.004),
        (still, still, 0.0),
        (still, still, -0.004),
        (still, still, math.nan),
    ):
        cycle.cycle_state.steady, cycle.cycle_state.since_reply_s, cycle.cycle_state.replied_s = (
            True,
            dt_s,
            1.0,
        )
        assert answer(JointCommand(positions, velocities), 1.0, state, b"") is None
        assert list(limiter.reference) == list(limiter.velocity) == list(still)
        assert limiter._target is None
        assert cycle.cycle_state.out_seqno == 0
    cycle.cycle_state.since_reply_s = 0.004
    assert answer(JointCommand(still, still), 1.0, state, b"") is not None
    assert cycle.cycle_state.out_seqno == 1


def test_a_layout_that_is_not_sound_is_not_read_by() -> None:
    """Python writes no such layout, but the memory is shared: the reader checks all of it."""
    data = Controller().datagram()
    for field, place, value in (
        ("place", 5, len(data)),
        ("place", 5, -1),
        ("size", 5, 4),
        ("size", 0, 6),
        ("size", 16, 0),
        ("forces", None, 7),
        ("forces", None, -1),
    ):
        reader = CompiledReader()
        expected = reader.read(data)
        reader.learn()
        assert reader._call(reader._address, data, len(data)) >= 0
        assert reader.read(data) == expected
        layout = reader._shared.layouts[0]
        if place is None:
            setattr(layout, field, value)
        else:
            getattr(layout, field)[place] = value
        assert reader._call(reader._address, data, len(data)) == -1
        assert reader.read(data) == expected


@pytest.fixture
def loaded_anew():
    compiled.egm_library.cache_clear()
    yield
    compiled.egm_library.cache_clear()


@pytest.mark.usefixtures("loaded_anew")
@pytest.mark.parametrize(
    ("target", "name", "value"),
    [
        (cardan, "__version__", "0.0.0"),
        (compiled, "expected_layout", lambda: [1]),
    ],
)
def test_a_library_that_does_not_fit_is_not_used(monkeypatch, target, name, value) -> None:
    monkeypatch.setattr(target, name, value)
    with pytest.raises(NativePartError, match="tools/native"):
        compiled.egm_library()
    session = EgmSession(AbbEgmOptions(mode="joint"), 0.0)
    assert type(session._generator._limiter) is JointLimiter
    assert type(session._reader) is FeedbackReader


def test_what_it_does_not_take_goes_the_long_way() -> None:
    for options in (
        AbbEgmOptions(mode="joint", joints=7),
        AbbEgmOptions(mode="joint", external_axes=1),
        AbbEgmOptions(mode="pose", external_axes=1),
        AbbEgmOptions(mode="path-correction"),
    ):
        session = EgmSession(options, 0.0)
        assert getattr(session._generator, "_compiled", None) is None


@pytest.mark.parametrize("mode", ["joint", "pose"])
def test_nothing_is_left_behind(mode: str) -> None:
    """A cycle frees every object that it makes, and returns every borrowed reference."""
    session = EgmSession(AbbEgmOptions(mode=mode), 0.0)  # type: ignore[arg-type]
    controller = Controller(seqno=1000)
    controller.fields = {"measured_force": EgmMeasuredForce((1.0,) * 6, True)}
    lent = (RobotState, Pose, Vector3, Quaternion, Wrench, RobotLink.LIVE, Frame.BASE, Frame.TOOL)
    datagrams = [controller.datagram() for _ in range(1200)]
    cut = (tuple.__new__(kind, (1,)) for kind in (JointCommand, PoseCommand, TwistCommand))
    wrong_commands = (None, "wrong", *cut)

    def cycles(these: list[bytes], now_s: float) -> float:
        for count, data in enumerate(these):
            now_s += PERIOD_S
            state = session.receive(data, ADDRESS, now_s)
            assert state is not None
            session._take(b"\x0a", now_s, state)
            session._take(data, now_s, None)
            for wrong in wrong_commands:
                assert session._generator.answer(wrong, now_s, state, b"") is None  # type: ignore[arg-type]
            assert state.pose is not None
            target = JointCommand(state.joints) if mode == "joint" else PoseCommand(state.pose)
            session.reply(HoldCommand() if count % 3 == 0 else target, now_s)
            session.answered(now_s)
        return now_s

    now_s = cycles(datagrams[:200], 1.0)
    gc.collect()
    before = [sys.getrefcount(each) for each in lent]
    blocks = sys.getallocatedblocks()
    cycles(datagrams[200:], now_s)
    gc.collect()
    assert abs(sys.getallocatedblocks() - blocks) < 100
    after = [sys.getrefcount(each) for each in lent]
    assert all(abs(a - b) < 10 for a, b in zip(after, before, strict=True))
    for call in (session._take, session._generator.answer):
        for given in ((), (b"",) * 3, (1, 2, 3, 4), (b"", "1", session.state, b"")):
            with contextlib.suppress(TypeError):
                assert call(*given) is None
