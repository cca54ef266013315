"""Base of robot drivers: open, close, the control loop, and checks of commands.

A driver of another controller is a :class:`LoopingRobot` with a transport, around a session that
implements the protocol without sockets, clocks and threads.
"""

from __future__ import annotations

import contextlib
import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from dataclasses import fields
from typing import Any, ClassVar, Final, Generic, Protocol, TypeVar

from cardan.common.bounds import (
    COORDINATE_M,
    JOINT_POSITION,
    JOINT_TORQUE,
    JOINT_VELOCITY,
    ROTATION_LENGTH,
    Range,
)
from cardan.common.forks import IN_CHILD, give_up_in_children
from cardan.drivers.base import RobotDriver
from cardan.errors import CommandError, NotOpenError, shown
from cardan.types import (
    CommandKind,
    JointCommand,
    JointVelocityCommand,
    RobotCapabilities,
    RobotCommand,
    RobotState,
    TorqueCommand,
)

WAKE_S: Final = 0.1
"""Longest period between reports of a silent robot (contract of `RobotDriver.cycles`)."""


class RobotSession(Protocol):
    """Interface between a driver and the session with its controller."""

    @property
    def capabilities(self) -> RobotCapabilities: ...

    def diagnosis(self, now_s: float) -> tuple[str, ...]: ...


SessionT = TypeVar("SessionT", bound=RobotSession)

JUMP_SHARE: Final = 2.0
"""Multiple of each joint's speed limit above which a measured joint is implausible."""

JUMP_NOISE_RAD: Final = 0.05
"""Tolerance added to that (m for a prismatic joint): measurements may come late or early."""


class LoopMixin(ABC, Generic[SessionT]):
    """Control loop, one at a time, which leaves the robot safe however it ends.

    A driver lists it before :class:`RobotDriver`, and defines `_acquire` and `_release`, the loop
    in `_states`, and in `_leave` how the robot is brought to rest. `_leave` is called once for each
    loop: when its generator ends or is closed, or by `close`, which first waits for the end of a
    loop in another thread.
    """

    # Of the driver.
    options: Any
    send: Callable[[RobotCommand], None]

    title: ClassVar[str]
    """Name of the driver in messages."""

    _session: SessionT
    """Set by the driver's __init__, from `self.options`."""

    def __init__(self, options: Any = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)  # type: ignore[call-arg]  # RobotDriver's
        self._open = False
        self._in_child = False
        """True if it was open in the parent process at a fork."""
        self._opening = threading.RLock()
        """Held while it is opened or released: one thread at a time."""
        self._loop = 0
        """Count of calls of `cycles` and `close`; only the newest loop continues."""
        self._loop_thread = 0
        self._loop_ended = threading.Event()
        self._loop_ended.set()

    @abstractmethod
    def _acquire(self) -> None:
        """Open the transport, with a new session. Raises a DriverError."""

    @abstractmethod
    def _release(self) -> None:
        """Close the transport. Never raises."""

    @abstractmethod
    def _states(self, loop: int) -> Generator[RobotState, None, None]:
        """Yield the states of `cycles` while `_loop` is `loop`, inside `_looping(loop)`."""

    @abstractmethod
    def _leave(self) -> None:
        """Leave the robot at rest."""

    @abstractmethod
    def _leave_within_s(self) -> float:
        """Longest time until a loop in another thread notices its end, s."""

    @abstractmethod
    def _now_s(self) -> float:
        """Time of the session's stamps, s."""

    def _forget(self) -> None:
        """Close in a forked child what `_acquire` opened, without a message to the controller."""

    @property
    def session(self) -> SessionT:
        """State of the protocol, with its counters; a new one with every open()."""
        return self._session

    @property
    def capabilities(self) -> RobotCapabilities:
        return self._session.capabilities

    def open(self) -> None:
        with self._opening:
            if not self._open:
                self._acquire()
                self._open, self._in_child = True, False
                give_up_in_children(self)

    def close(self) -> None:
        if not self._open:
            return
        self._loop += 1
        if self._loop_thread != threading.get_ident():
            # A loop in another thread notices that when it wakes up.
            self._loop_ended.wait(self._leave_within_s())
        with self._opening:
            if self._open:
                with contextlib.suppress(Exception):
                    self._leave()
                self._open = False
                self._release()

    def after_fork(self) -> None:
        """End the loop in a forked child without a message: the robot belongs to the parent."""
        if self._open:
            self._open, self._in_child = False, True
            self._loop += 1
            self._opening = threading.RLock()
            self._loop_ended = threading.Event()
            self._loop_ended.set()
            self._forget()

    def _not_open(self) -> NotOpenError:
        if self._in_child:
            return NotOpenError(f"{self.title} is not open in this process: {IN_CHILD}")
        return NotOpenError(f"{self.title} is not open; call open(), or use it in `with`")

    def _require_open(self) -> SessionT:
        if not self._open:
            raise self._not_open()
        return self._session

    def cycles(self) -> Generator[RobotState, None, None]:
        self._require_open()
        self._loop += 1
        return self._states(self._loop)

    @contextlib.contextmanager
    def _looping(self, loop: int) -> Iterator[None]:
        """Context of the loop: records that it runs, and leaves the robot when it ends."""
        self._loop_thread = threading.get_ident()
        self._loop_ended.clear()
        try:
            yield
        finally:
            try:
                if self._loop == loop:
                    self._leave()
            finally:
                self._loop_ended.set()

    def diagnosis(self) -> tuple[str, ...]:
        if not self._open:
            return (f"{self.title} is not open",)
        return self._session.diagnosis(self._now_s())


class LoopingRobot(LoopMixin[SessionT], RobotDriver):
    """Driver with one loop at a time, which leaves the robot safe however it ends."""


def counts(counters: Any) -> dict[str, float]:
    """Return the numbers of a dataclass by name, for `metrics`; other fields are left out."""
    found = ((each.name, getattr(counters, each.name)) for each in fields(counters))
    return {name: float(value) for name, value in found if isinstance(value, (int, float))}


def wrong_kind(who: str, command: object, kinds: Collection[CommandKind]) -> CommandError:
    """Make the error for a command of a kind that is not among `kinds`."""
    kind = getattr(command, "kind", None)
    name = kind.value if isinstance(kind, CommandKind) else shown(command)
    allowed = ", ".join(sorted(kind.value for kind in kinds))
    return CommandError(f"{who} takes no {name}; it takes {allowed}")


def check_command(who: str, command: RobotCommand, check: Callable[[RobotCommand], None]) -> None:
    """Call `check(command)`; values that contradict their annotations raise CommandError, too."""
    try:
        check(command)
    except _NOT_SUCH as error:
        raise _cannot(who, command, error) from None


_NOT_SUCH = (TypeError, ValueError, AttributeError, OverflowError)


def _cannot(who: str, command: RobotCommand, error: Exception) -> CommandError:
    return CommandError(f"{who} cannot take {shown(command)}: {error}")


def outside(name: str, values: Sequence[float], allowed: Range) -> str:
    """Explain why `values` are implausible; empty: all are in `allowed`, a range symmetric about
    zero."""
    largest = allowed.highest
    with contextlib.suppress(TypeError):
        # The usual case first; comparisons with NaN are false.
        if sum(map(abs, values)) <= largest or all(abs(value) <= largest for value in values):
            return ""
    return f"{name}: {tuple(values)}; every value must be finite, and {allowed}: {allowed.reason}"


def no_rotation(name: str, orientation: Sequence[float]) -> str:
    """Explain why a quaternion is no rotation; empty: it is one."""
    w, x, y, z = orientation
    squared = w * w + x * x + y * y + z * z
    if _SHORTEST <= squared <= _LONGEST:
        return ""
    return (
        f"{name}: {(w, x, y, z)} has length {math.hypot(w, x, y, z):g}; a rotation has length 1 "
        f"({ROTATION_LENGTH} is taken)"
    )


_SHORTEST, _LONGEST = ROTATION_LENGTH.lowest**2, ROTATION_LENGTH.highest**2


def implausible(state: RobotState) -> str:
    """Explain why `state` is implausible; empty: plausible.

    Its wrench is judged where forces are used (`cardan.gateway.force.sources`).
    """
    pose = state.pose
    return (
        outside("joints", state.joints, JOINT_POSITION)
        or outside("external_axes", state.external_axes, JOINT_POSITION)
        or outside("velocities", state.velocities, JOINT_VELOCITY)
        or outside("torques", state.torques, JOINT_TORQUE)
        or ("" if pose is None else outside("position", pose.position, COORDINATE_M))
        or ("" if pose is None else no_rotation("orientation", pose.orientation))
    )


def jump(
    joints: Sequence[float],
    before: Sequence[float],
    fastest: Sequence[float],
    continuous: Sequence[bool],
    time_s: float,
) -> tuple[int, float] | None:
    """Find a joint that cannot have moved from `before` to `joints` within `time_s`, and its
    distance, rad or m; None if all can. Whole turns of `continuous` joints do not count."""
    share = JUMP_SHARE * time_s
    # The usual case: no joint has moved farther than all of them together.
    alike = share >= 0.0 and len(joints) == len(before)
    if alike and math.dist(joints, before) <= JUMP_NOISE_RAD:
        return None
    for now, then, speed in zip(joints, before, fastest, strict=False):
        if not abs(now - then) <= JUMP_NOISE_RAD + share * speed:
            break
    else:
        return None
    worst, most, far = 0, 0.0, 0.0
    rows = zip(joints, before, fastest, continuous, strict=False)
    for index, (now, then, speed, turns) in enumerate(rows):
        away = abs(now - then)
        if not math.isfinite(away):
            return index, away
        if turns:
            away = abs(math.remainder(away, math.tau))
        excess = away - JUMP_NOISE_RAD - share * speed
        if excess > most:
            worst, most, far = index, excess, away
    return (worst, far) if most > 0.0 else None


def check_count(name: str, values: Sequence[float], count: int, what: str = "joints") -> None:
    """Raise CommandError unless there are `count` values."""
    if len(values) != count:
        raise CommandError(f"{name}: {len(values)} values for {count} {what}")


def check_numbers(
    name: str, values: Sequence[float], allowed: Range, count: int, what: str = "joints"
) -> None:
    """Raise CommandError unless there are `count` values and all are in `allowed`."""
    check_count(name, values, count, what)
    if refused := outside(name, values, allowed):
        raise CommandError(refused)


def check_joints(
    who: str, command: RobotCommand, kinds: Collection[CommandKind], joints: int
) -> None:
    """Raise CommandError for a command that is not of `kinds`, has another number of joints, or
    numbers that no robot can execute."""
    try:
        if type(command) is JointCommand:
            # The usual case by the norm, which a NaN does not pass.
            positions, speeds, axes, kind = command
            if (
                kind in kinds
                and not axes
                and len(positions) == joints
                and math.hypot(*positions) <= _POSITIONS
                and (speeds is None or (len(speeds) == joints and math.hypot(*speeds) <= _SPEEDS))
            ):
                return
        for name, values, allowed in joint_values(who, command, kinds):
            check_numbers(name, values, allowed, joints)
    except _NOT_SUCH as error:
        raise _cannot(who, command, error) from None


_POSITIONS, _SPEEDS = JOINT_POSITION.highest, JOINT_VELOCITY.highest


def joint_values(
    who: str, command: RobotCommand, kinds: Collection[CommandKind]
) -> Sequence[tuple[str, tuple[float, ...], Range]]:
    """Return the numbers of a command to joints, each with its name and plausible range; a hold has
    none.

    Raises CommandError for a kind that is not among `kinds`, and for external axes.
    """
    if getattr(command, "kind", None) not in kinds:
        raise wrong_kind(who, command, kinds)
    if isinstance(command, JointCommand):
        if command.external_axes:
            raise CommandError(f"external_axes: {who} has none")
        positions = ("positions", command.positions, JOINT_POSITION)
        speeds = command.velocities
        if speeds is None:
            return (positions,)
        return (positions, ("velocities", speeds, JOINT_VELOCITY))
    if isinstance(command, JointVelocityCommand):
        return (("velocities", command.velocities, JOINT_VELOCITY),)
    if isinstance(command, TorqueCommand):
        return (("torques", command.torques, JOINT_TORQUE),)
    return ()
