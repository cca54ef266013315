"""Compiled UR cycle: equal to the Python session's, byte for byte and number for number."""

import math
import random
import struct
from collections import Counter

import pytest

import cardan
from cardan.common.native import NativePartError
from cardan.drivers.missed_cycles import AgreedTime, ClockWatch
from cardan.drivers.ur_rtde import compiled
from cardan.drivers.ur_rtde.motion import UrMotion
from cardan.drivers.ur_rtde.options import UrRtdeOptions
from cardan.drivers.ur_rtde.session import UrSession
from cardan.errors import CommandError
from cardan.types import CommandKind, HoldCommand, JointCommand, JointVelocityCommand
from tests.drivers.ur_bench import SessionBench

STATE_BYTES, COMMAND_BYTES = 244, 112
DOUBLES = (*range(4, 204, 8), 216, 224)
"""Offsets of the doubles in a state."""
INTEGERS = (204, 208, 212, 232, 236, 240)
WRONG = (math.nan, math.inf, -math.inf, 1e300, 2001.0, -101.0, 11.0, -0.0, 0.5, 1.5)


def missing(*_):
    raise NativePartError("not there")


class Twins:
    """Two sessions that get the same calls and must return the same."""

    def __init__(self, quick, plain, changed):
        self.both, self._changed = (quick, plain), changed

    def __getattr__(self, name):
        found = [getattr(each, name) for each in self.both]
        if not callable(found[0]):
            assert str(found[0]) == str(found[1]), name
            return found[0]

        def call(*given):
            said = []
            for each in found:
                try:
                    said.append(each(*given))
                except CommandError as error:
                    said.append(str(error))
            # Compared as text, which distinguishes -0.0 from 0.0 and has every bit of a float; NaN
            # equals NaN.
            assert str(said[0]) == str(said[1]), (name, given)
            return said[0]

        return call

    def received(self, channel, data, now_s):
        parts = self._changed(data) if channel == "rtde" else [data]
        for part in parts:
            for each in self.both:
                each.received(channel, part, now_s)


def random_command(choice, state):
    kind = choice.random()
    if kind < 0.05:
        return HoldCommand()
    if kind < 0.1:
        return JointVelocityCommand(tuple(choice.uniform(-1.0, 1.0) for _ in range(6)))
    far = 0.5 if kind < 0.15 else 0.002
    positions = tuple(q + choice.uniform(-far, far) for q in state.joints)
    speeds = tuple(choice.uniform(-1.0, 1.0) for _ in range(6)) if choice.random() < 0.7 else None
    if kind > 0.98:
        wrong = choice.choice((math.nan, math.inf, 2001.0, 1, True, None, "1"))
        place = choice.randrange(6)
        if speeds is None or choice.random() < 0.5:
            positions = (*positions[:place], wrong, *positions[place + 1 :])
        else:
            speeds = (*speeds[:place], wrong, *speeds[place + 1 :])
    elif kind > 0.97:
        return choice.choice(
            (
                JointCommand(positions[:5], speeds),
                JointCommand(list(positions), speeds),
                JointCommand(positions, speeds, (0.1,)),
                JointCommand(positions, speeds, (), CommandKind.HOLD),
            )
        )
    return JointCommand(positions, speeds)


def changed_by(choice):
    """Return states with occasional changes by a network, another controller or a fault."""
    retained = []

    def changed(data):
        happens = choice.random()
        if retained:
            data = retained.pop() + data
        elif len(data) != STATE_BYTES:
            pass
        elif happens < 0.01:
            retained.append(data)
            return []
        elif happens < 0.02:
            cut = choice.randrange(STATE_BYTES)
            return [data[:cut], data[cut:]] if cut else [data]
        elif happens < 0.04:
            place, wrong = choice.choice(DOUBLES), struct.pack(">d", choice.choice(WRONG))
            return [data[:place] + wrong + data[place + 8 :]]
        elif happens < 0.0405:
            place, wrong = choice.choice(INTEGERS), struct.pack(">i", choice.randrange(-2, 40))
            return [data[:place] + wrong + data[place + 4 :]]
        elif happens < 0.043:
            return [data[:3] + b"\x63" + data[4:]]
        elif happens < 0.0435:
            (timestamp,) = struct.unpack_from(">d", data, 4)
            jump = choice.choice((-1.0, -0.002, 0.002, 0.004, 0.05))
            return [data[:4] + struct.pack(">d", timestamp + jump) + data[12:]]
        return [data]

    return changed


def clock_of(session):
    slots = (*ClockWatch.__slots__, *AgreedTime.__slots__)
    return {name: str(getattr(session.feed.clock, name)) for name in slots}


@pytest.mark.matrix(*map(str, range(1, 6)))
@pytest.mark.parametrize("seed", range(6))
def test_a_session_is_that_in_python_to_the_last_bit(monkeypatch, seed):
    choice = random.Random(seed)
    options = {"speed_share": choice.choice((1.0, 0.3))}
    bench = SessionBench(options, lambda state: random_command(choice, state))
    quick, library = bench.session, compiled.ur_library()
    plain = UrSession(bench.options, iter(range(1000, 2000)).__next__)
    bench.session = Twins(quick, plain, changed_by(choice))
    # The called session determines whether the compiled library is available.
    turn = []
    monkeypatch.setattr(compiled, "ur_library", lambda: library if not turn else missing())

    def without_library(method):
        def call(*given):
            turn.append(1)
            method(*given)
            turn.clear()

        return call

    plain.received = without_library(plain.received)
    plain.advance = without_library(plain.advance)
    taken, ends = Counter(), set()
    for _ in range(2500):
        if bench.session.phase == "idle":
            bench.session.ask("enable", bench.now_s)
        if choice.random() < 0.01:
            bench.stall(choice.choice((0.003, 0.006, 0.02)))
        if choice.random() < 0.0005:
            bench.stall(0.3)
        if choice.random() < 0.005:
            bench.controller.slider = choice.choice((0.0, 0.3, *[1.0] * 6))
        bench.run(0.002)
        assert str(quick.feed.values) == str(plain.feed.values)
        assert clock_of(quick) == clock_of(plain)
        assert str(quick.metrics()) == str(plain.metrics())
        assert not plain.feed.obeys
        taken[quick.feed.obeys] += 1
        if quick._motion is not None:
            assert quick._motion.reference == plain._motion.reference
            assert quick._motion._limiter.velocity == plain._motion._limiter.velocity
            assert quick._motion._answer is not None
            assert plain._motion._answer is None
        ends.add(quick.end_reason)
    assert quick.feed._compiled is not None
    assert plain.feed._compiled is None
    assert min(taken[True], quick.commands) > 300, (taken, quick.commands, ends)


def test_what_missed_cycles_leave_is_worked_off_as_in_python():
    options = UrRtdeOptions()
    for seed in range(6):
        choice = random.Random(seed)
        quick = UrMotion(options, 1, 0, bytes(compiled.HEAD))
        plain = UrMotion(options, 1, 0)
        place, speeds, worked_off = [0.1] * 6, [0.0] * 6, 0
        for motion in (quick, plain):
            motion.begin(place)
        time_s = 1.0
        for cycle in range(3000):
            time_s += choice.choice((0.002, 0.002, 0.006)) if cycle % 50 < 2 else 0.002
            if cycle % 200 == 0:
                swing = choice.choice((0.0, 0.0, 1e-6, 0.3, 0.8))
            speeds = [v + 0.02 * (swing * choice.uniform(-1.0, 2.0) - v) for v in speeds]
            if swing == 0.0 and cycle % 200 > 100:
                speeds = [0.0] * 6
            place = [q + v * 0.002 for q, v in zip(place, speeds, strict=True)]
            if cycle % 400 == 45:  # towards the robot, or away
                share = choice.uniform(-0.5, 1.2)
                place = [q + share * o for q, o in zip(place, plain._lost.offset, strict=True)]
            command = JointCommand(tuple(place), tuple(speeds))
            working = plain._lost.working
            if quick.usual(command, time_s, 0.002) is None:
                quick.command(command, time_s, 0.002, 1.0)
            else:
                worked_off += working
            plain.command(command, time_s, 0.002, 1.0)
            assert str(quick.reference) == str(plain.reference)
            for name in ("offset", "rate", "working", "_fastest", "_rested_s"):
                found = [getattr(motion._lost, name) for motion in (quick, plain)]
                assert str(found[0]) == str(found[1]), name
        assert worked_off > 500


def test_a_usual_cycle_never_needs_the_session_in_python(monkeypatch):
    still = HoldCommand()
    bench = SessionBench(
        answer=lambda at: JointCommand(at.joints, (1e-9,) * 6) if at.ready else still
    )
    bench.ready()
    bench.run(0.02)
    feed, motion = bench.session.feed, bench.session._motion
    fell_back = Counter()

    def counted(owner, name):
        original = getattr(owner, name)

        def call(*given):
            fell_back[name] += 1
            return original(*given)

        monkeypatch.setattr(owner, name, call)

    counted(feed, "_take_values")
    counted(motion, "command")
    packages, commands = feed.packages, bench.session.commands
    bench.run(0.2)
    assert feed.packages - packages > 90
    assert bench.session.commands - commands > 90
    assert fell_back["command"] == 0
    # In virtual time all states are equally fast, except for rounding; Python handles the fastest
    # so far.
    assert fell_back["_take_values"] < 10


def test_registers_of_other_types_are_not_written_by_the_compiled_part():
    bench = SessionBench()
    bench.ready()
    assert len(bench.session.feed.command_head) == compiled.HEAD
    bench.session.feed._inputs.types = ("UINT32",) * 15
    assert bench.session.feed.command_head == b""


def test_a_library_of_another_version_is_not_used(monkeypatch):
    monkeypatch.setattr(cardan, "__version__", "0.0.0")
    compiled.ur_library.cache_clear()
    with pytest.raises(NativePartError, match=r"cardan of 0\.0\.0"):
        compiled.ur_library()
    compiled.ur_library.cache_clear()


def test_wrong_numbers_of_arguments_are_refused():
    bench = SessionBench()
    bench.ready()
    with pytest.raises(TypeError, match="2 arguments"):
        bench.session.feed._compiled.take(b"")
    with pytest.raises(TypeError, match="4 arguments"):
        bench.session._motion._answer()
