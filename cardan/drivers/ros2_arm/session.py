"""Session with a ROS 2 arm, without I/O: converts joint states to robot states, and commands to
messages.

Joint states are ordered only by their publisher's sequence numbers: stamps may be of any clock. A
single publisher of the arm's joints counts. While another is heard, nothing is commanded, because
one of them is not the arm. A new publisher counts when the previous one has fallen silent (its node
was restarted), and begins a new session, as do stamps that go back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from cardan.bus.node import Received
from cardan.drivers.datagram_robot import DatagramSession
from cardan.drivers.limiters import JointLimiter
from cardan.drivers.missed_cycles import SIMULATED_TIME, AgreedTime, SlipCompensation
from cardan.drivers.robot_core import check_joints
from cardan.drivers.ros2_arm.options import Ros2ArmOptions
from cardan.protocols.ros2.cdr import MalformedCdr, Message, Template, codec_of
from cardan.protocols.ros2.messages import default_message
from cardan.protocols.ros2.names import dds_type
from cardan.types import (
    NEVER_S,
    CommandKind,
    JointCommand,
    JointLimits,
    JointVelocityCommand,
    RobotCapabilities,
    RobotCommand,
    RobotLink,
    RobotState,
)

STATE_TYPE = "sensor_msgs/msg/JointState"
COMMAND_TYPES = {
    "position": "std_msgs/msg/Float64MultiArray",
    "velocity": "std_msgs/msg/Float64MultiArray",
    "joint_state": "sensor_msgs/msg/JointState",
    "trajectory": "trajectory_msgs/msg/JointTrajectory",
}
"""Message types by command kind."""

BRIDGED_S, BRIDGED_PERIODS = 0.015, 3.1
"""Longest time between two commands that is bridged as if the robot had continued, in s or in
periods: a lost state, a suspended process. After a longer time a robot commanded by positions has
stopped, and the step would overshoot."""

FARTHEST_BEHIND = 0.2
"""Largest distance, rad or m, lost in repeated stops that is handled as missed cycles; more would
move the joint long after the operator's release, so a new session begins."""

POINT_AHEAD_S = 0.05
"""Time of a trajectory's point from now, at least three periods: nearer points are reached, and the
arm stands until the next."""

STOP_TOLERANCE = 0.05
"""Tolerance of a joint measured beyond its stop, rad or m."""

LIVING_S = 1.0
"""Time since the last message within which a publisher counts as present: the slowest usual one, a
joint_state_publisher, sends at 10 Hz."""

NO_GAP_S = 0.5 * LIVING_S
"""Longest gap in the messages of a publisher that counts as heard without a gap. After a longer one
this computer may have paused, and messages of the publisher that counts come next."""

MAX_RIVALS = 64
"""Most other publishers of the arm's joints that are tracked."""

NS = 1_000_000_000

ADVICE = {
    "zenoh": (
        "is it running with RMW_IMPLEMENTATION=rmw_zenoh_cpp, by the same router and domain, and "
        "is states_topic its topic?"
    ),
    "dds": (
        "is it running with a middleware of DDS in the same domain, on this computer unless "
        "dds_config says otherwise, and is states_topic its topic?"
    ),
}
"""Advice on missing joint states, by transport."""


class JointStates(NamedTuple):
    """Message with joint states, joints in kinematic order."""

    session: int
    sequence: int
    stamp_ns: int
    """Stamp by the robot's clock; 0 if it has none."""
    positions: tuple[float, ...]
    velocities: tuple[float, ...]
    """Empty if they are not reported."""
    efforts: tuple[float, ...]


class _Sender:
    """Publisher of joint states that counts."""

    __slots__ = ("gid", "heard_s", "sequence", "stamp_ns")

    def __init__(self, gid: bytes, now_s: float) -> None:
        self.gid, self.heard_s = gid, now_s
        self.sequence = self.stamp_ns = -1


class _Rival(NamedTuple):
    """Another publisher of the arm's joints."""

    since_s: float
    """Time since which only this one was heard, without a gap."""
    heard_s: float
    positions: dict[str, float]
    """Positions of its last message, by joint name."""


class Ros2ArmSession(DatagramSession[JointStates]):
    """Protocol session with an arm: its newest state, and the reference sent to it.

    The reference stays within the joints' ranges, speeds and accelerations, whatever is commanded.
    Nothing is sent before the first motion command: an arm that is only observed gets no messages.
    """

    controller = "the robot's joint state publisher"

    def __init__(self, options: Ros2ArmOptions, limits: JointLimits | None = None) -> None:
        """Set `limits`, those of the robot's description, if `robot` is empty."""
        self.options = options
        self.advice = ADVICE[options.transport]
        self.names = options.names
        self._count = n = len(self.names)
        self._limits = options.limits or limits
        moves = CommandKind.JOINT_VELOCITY if options.command == "velocity" else CommandKind.JOINT
        capabilities = RobotCapabilities(
            frozenset({CommandKind.HOLD, moves}),
            options.period_s,
            n,
            self._limits,
            lag_s=options.lag_s,
            robot=options.robot,
        )
        super().__init__(
            capabilities,
            options.lost_after_s,
            AgreedTime(options.period_s, option=SIMULATED_TIME, simulated=options.simulated_time),
        )
        self.taken: Callable[[], bool] = lambda: True
        """True if the commands have a subscriber."""
        self.named: Callable[[bytes], str] = lambda gid: ""
        """Returns the node whose publisher has this GID; empty if unknown."""
        self.listens_until_s = NEVER_S
        """Time until which a second publisher may still be unheard; nothing is commanded before."""
        self.others = 0
        """Messages about other joints than the arm's."""
        self._codec = codec_of(STATE_TYPE)
        self._dds_type = dds_type(STATE_TYPE)
        self._ours = frozenset(self.names)
        self._order: tuple[tuple[str, ...], tuple[int, ...]] = ((), ())
        """Joint names of the previous message, and the index of each of ours among them."""
        self._sender: _Sender | None = None
        self._rivals: dict[bytes, _Rival] = {}
        self._numbered = 0
        """Number of publisher sessions so far."""
        self._bridged_s = max(BRIDGED_S, BRIDGED_PERIODS * options.period_s)
        self._limiter = None if self._limits is None else _limiter(self._limits, self._bridged_s)
        self._lost = SlipCompensation(n)
        self._asked: tuple[Sequence[float], Sequence[float] | None] | None = None
        """Commanded positions of the previous cycle, and their speeds."""
        self._answered: tuple[int, int] | None = None
        """Session and sequence of the last answered state."""
        self._since_s = self._answered_s = 0.0
        """Time since that state by the robot's periods, and the local time of the answer."""
        self._commanded = False
        """True once a motion command came in this session."""
        self._messages = _Commands(options, self.names)

    # -- states ---------------------------------------------------------------------------------

    def _decode(self, data: Received, now_s: float) -> JointStates | str | None:
        if data.key.split("/")[-2:-1] != [self._dds_type]:
            return f"messages of another type than {STATE_TYPE}"
        attachment = data.attachment
        if attachment is None:
            return "messages without the attachment that nodes of ROS 2 have"
        message = self._codec.decode(data.data)
        if isinstance(message, MalformedCdr):
            return message.reason
        names = tuple(message["name"])
        known = names == self._order[0]
        if not (known or self._ours.intersection(names)):
            self.others += 1
            return None
        sender = self._heard(attachment.gid, message, now_s)
        if sender is None:
            self.ignored["joint states of another publisher than the one in use"] += 1
            return None
        if not known:
            missing = self._ours.difference(names)
            if missing:
                return f"joint states without {', '.join(sorted(missing))}"
            if len(set(names)) < len(names):
                return "joint states with a joint twice"
            self._order = names, tuple(names.index(name) for name in self.names)
        values = self._values(message, len(names))
        if isinstance(values, str):
            return values
        stamp = message["header"]["stamp"]
        stamp_ns = stamp["sec"] * NS + stamp["nanosec"]
        if attachment.sequence > sender.sequence:
            if 0 < stamp_ns == sender.stamp_ns:
                self.ignored["joint states with an unchanged stamp: the robot is frozen"] += 1
                return None
            if sender.stamp_ns > stamp_ns > 0:
                self._numbered += 1
            sender.sequence, sender.stamp_ns = attachment.sequence, stamp_ns
        sequence = attachment.sequence & 0xFFFFFFFF
        return JointStates(self._numbered, sequence, stamp_ns, *values)

    def _values(
        self, message: Message, count: int
    ) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]] | str:
        """Return positions, velocities and efforts in kinematic order, or what is wrong."""
        found: list[tuple[float, ...]] = []
        for key in ("position", "velocity", "effort"):
            given = message[key]
            if len(given) == count:
                values = tuple([given[index] for index in self._order[1]])
            elif not given and key != "position":
                values = ()
            else:
                return f"joint states with {len(given)} numbers of {key} for {count} joints"
            if key != "position" and any(map(math.isnan, values)):
                # A joint_state_broadcaster fills in NaN for a missing interface.
                values = ()
            found.append(values)
        return found[0], found[1], found[2]

    def _heard(self, gid: bytes, message: Message, now_s: float) -> _Sender | None:
        """Record that the publisher `gid` of one of our joints is heard; return None unless it
        counts.

        Another publisher counts once the present one is silent and the other was heard meanwhile
        for as long as a link may be silent.
        """
        sender, rivals = self._sender, self._rivals
        if sender is not None and sender.gid == gid:
            sender.heard_s = now_s
            return sender
        if sender is not None:
            rival = rivals.get(gid)
            since_s = now_s
            if rival is not None and now_s - rival.heard_s <= NO_GAP_S:
                since_s = rival.since_s if rival.since_s > sender.heard_s else now_s
            if now_s - sender.heard_s < LIVING_S or now_s - since_s < self._lost_after_s:
                if rival is None and len(rivals) >= MAX_RIVALS:
                    rivals.pop(next(iter(rivals)))
                # If there are fewer positions than names, some are unknown.
                reported = dict(zip(message["name"], message["position"], strict=False))
                rivals[gid] = _Rival(since_s, now_s, reported)
                return None
            rivals.pop(gid, None)
        self._sender = sender = _Sender(gid, now_s)
        self._numbered += 1
        return sender

    def _rivalry(self, message: JointStates, now_s: float) -> str:
        """Describe other publishers of our joints than the one that counts; empty if there are
        none."""
        there = {gid: each for gid, each in self._rivals.items() if now_s - each.heard_s < LIVING_S}
        if not there or self._sender is None:
            return ""
        ours = dict(zip(self.names, message.positions, strict=True))
        name, least = self.names[0], -1.0
        for each in there.values():
            for joint, at in ours.items():
                distance = abs(at - each.positions.get(joint, at))
                if joint in each.positions and distance > least:
                    name, least = joint, distance
        found = {self._sender.gid: ours} | {gid: each.positions for gid, each in there.items()}
        said = " and ".join(
            f"{self.named(gid) or f'publisher {gid.hex()}'} "
            + (f"(at {positions[name]:.4g})" if name in positions else "(without a position)")
            for gid, positions in found.items()
        )
        return (
            f"{len(found)} publishers of {name} are heard at once on {self.options.states_topic}, "
            f"{said}: end all but the arm's own, or give them another topic"
        )

    def _begin(self, message: JointStates) -> None:
        if self._limiter is not None:
            self._limiter.reset(message.positions)
        self._lost.reset()
        self._asked = self._answered = None
        # A velocity controller keeps the last speed, unless it is sent zeros.
        self._commanded = self._commanded and self.options.command == "velocity"

    def receive(self, data: Received, now_s: float) -> RobotState | None:
        """Return the state in a message, stamped `now_s`; None if it is invalid, late or a
        duplicate."""
        state = super().receive(data, now_s)
        if state is None or self.message is None:
            return None
        self._since_s += state.period_s
        if max(map(abs, self._lost.offset)) > FARTHEST_BEHIND:
            self.sessions += 1
            self._begin(self.message)
            self.state = state = state._replace(session=self.sessions)
        return state

    def _time_s(self, message: JointStates) -> float | None:
        return message.stamp_ns / NS if message.stamp_ns else None

    def _state_of(
        self, message: JointStates, before: JointStates | None, now_s: float
    ) -> RobotState:
        return RobotState(
            stamp_s=now_s,
            link=RobotLink.LIVE,
            session=self.sessions,
            sequence=message.sequence,
            period_s=self._period(message, before, now_s),
            joints=message.positions,
            external_axes=(),
            pose=None,
            hold_reason=self._hold_reason(message, now_s),
            clock_s=self._time_s(message),
            velocities=message.velocities,
            torques=message.efforts,
        )

    def _period(self, message: JointStates, before: JointStates | None, now_s: float) -> float:
        """Time since the previous state, by plausible stamps."""
        if before is None:
            return self.options.period_s
        if message.stamp_ns and before.stamp_ns:
            period_s = (message.stamp_ns - before.stamp_ns) / NS
            if 0.0 < period_s <= self._lost_after_s:
                return period_s
        missed = (message.sequence - before.sequence) & 0xFFFFFFFF
        return min(missed * self.options.period_s, self._lost_after_s)

    def _joint_name(self, index: int) -> str:
        return f"joint {self.names[index]}"

    def _hold_reason(self, message: JointStates, now_s: float) -> str:
        if rivalry := self._rivalry(message, now_s):
            return rivalry
        if self._limits is None:
            return "the limits of the joints are not known"
        if not self.taken():
            return (
                f"no controller subscribes to {self.options.topic}: is it loaded and active, and "
                "is its name right?"
            )
        limits = self._limits
        for name, value, low, high in zip(
            self.names, message.positions, limits.lower, limits.upper, strict=True
        ):
            if not low - STOP_TOLERANCE <= value <= high + STOP_TOLERANCE:
                return (
                    f"joint {name} is at {value:.4g}, beyond its range of {low:.4g} to {high:.4g}: "
                    "is this the robot's model?"
                )
        if now_s < self.listens_until_s:
            return (
                f"listening for {LIVING_S:g} s for another publisher of the arm's joints on "
                f"{self.options.states_topic}"
            )
        return ""

    # -- commands -------------------------------------------------------------------------------

    def check(self, command: RobotCommand) -> None:
        check_joints("the ROS 2 arm", command, self.capabilities.commands, self._count)

    @property
    def moving(self) -> bool:
        return self._commanded and self._limiter is not None and any(self._limiter.velocity)

    def command(self, command: RobotCommand, now_s: float) -> bytes | None:
        """Return the message that answers the newest state; none if it has been answered."""
        self.check(command)
        message, limiter = self.message, self._limiter
        if message is None or limiter is None:
            return None
        number = message.session, message.sequence
        if number == self._answered:
            return None
        if self._answered is not None and self._since_s <= 0.0:
            # No time has passed by both clocks: the last message stays in force.
            return None
        if self.state is not None and self.state.hold_reason:
            return self.keepalive(now_s)
        dt_s = self.options.period_s
        if self._answered is not None:
            dt_s = self._catch_up(limiter, dt_s, now_s)
        self._answered, self._since_s, self._answered_s = number, 0.0, now_s
        if isinstance(command, JointCommand):
            self._commanded = True
            self._track(limiter, command.positions, command.velocities, dt_s)
        elif isinstance(command, JointVelocityCommand):
            self._commanded = True
            limiter.relocate(message.positions)
            limiter.drive(command.velocities, dt_s)
        else:
            self._asked = None
            self._lost.reset()
            if self.options.command == "velocity":
                limiter.relocate(message.positions)
            limiter.brake(dt_s)
        if not self._commanded:
            return None
        return self._messages.message(limiter.reference, limiter.velocity)

    def _catch_up(self, limiter: JointLimiter, dt_s: float, now_s: float) -> float:
        """Account for the time without a command; return the time that the next command is for,
        s."""
        waited_s = now_s - self._answered_s
        if waited_s > self._bridged_s:
            # States queued for a suspended process tell nothing about that time.
            self._since_s = max(self._since_s, waited_s)
        state = self.state
        if state is not None and state.period_s > 0.0:
            dt_s = min(state.period_s, self._bridged_s)
        gap_s = self._since_s - dt_s
        bridged = self._since_s <= self._bridged_s
        if (bridged and gap_s <= 1e-6) or self.options.command == "velocity":
            return dt_s
        if bridged:
            limiter.coast(gap_s)
            self._lost.passed(gap_s)
            return dt_s
        # A forward_command_controller holds its last position: the arm has stopped there.
        dt_s = self.options.period_s
        gap_s = self._since_s - dt_s
        speeds = tuple(limiter.velocity)
        limiter.reset(tuple(limiter.reference))
        back = tuple(-v for v in speeds)
        self._lost.passed(gap_s, tuple(v * gap_s for v in back), back)
        return dt_s

    def _track(
        self,
        limiter: JointLimiter,
        positions: Sequence[float],
        speeds: Sequence[float] | None,
        dt_s: float,
    ) -> None:
        asked, self._asked = self._asked, (positions, speeds)
        if self._lost.working:
            positions, speeds = self._lost.follow(asked, positions, speeds, dt_s)
        limiter.track(positions, speeds, dt_s)

    def keepalive(self, now_s: float) -> bytes | None:
        """Return zeros if speeds were sent, because the controller would keep the last ones: the
        arm is not measured, or must not be driven."""
        return self.final_command(now_s) if self.options.command == "velocity" else None

    def final_command(self, now_s: float) -> bytes | None:
        """Return the message that stops the arm if none follows: its reference, at rest."""
        if not self._commanded or self._limiter is None:
            return None
        return self._messages.message(self._limiter.reference, (0.0,) * self._count)

    # -- diagnosis ------------------------------------------------------------------------------

    def metrics(self) -> dict[str, float]:
        return {**super().metrics(), "others": float(self.others)}


def _limiter(limits: JointLimits, longest_period_s: float) -> JointLimiter:
    return JointLimiter(*limits, longest_period_s=longest_period_s)


class _Commands:
    """Encoder of commands in place."""

    def __init__(self, options: Ros2ArmOptions, names: Sequence[str]) -> None:
        self._kind = options.command
        self._ahead_s = max(POINT_AHEAD_S, 3.0 * options.period_s)
        type_name = COMMAND_TYPES[self._kind]
        zeros = [0.0] * len(names)
        message = default_message(type_name)
        if self._kind == "joint_state":
            message |= {"name": list(names), "position": zeros, "velocity": zeros}
        elif self._kind == "trajectory":
            point = default_message("trajectory_msgs/msg/JointTrajectoryPoint")
            ahead_ns = round(self._ahead_s * NS)
            point["positions"] = zeros
            point["time_from_start"] = {"sec": ahead_ns // NS, "nanosec": ahead_ns % NS}
            message |= {"joint_names": list(names), "points": [point]}
        else:
            message["data"] = zeros
        template = Template(type_name, message)
        self._data = template.data
        self._slots: list[Callable[..., Any]] = [
            template.slot(path)
            for path in {
                "joint_state": ("position", "velocity"),
                "trajectory": ("points.0.positions",),
            }.get(self._kind, ("data",))
        ]

    def message(self, positions: Sequence[float], velocities: Sequence[float]) -> bytes:
        """Encode a reference."""
        if self._kind == "velocity":
            self._slots[0](*velocities)
        elif self._kind == "trajectory":
            ahead_s = self._ahead_s
            self._slots[0](*[q + v * ahead_s for q, v in zip(positions, velocities, strict=True)])
        else:
            self._slots[0](*positions)
            if self._kind == "joint_state":
                self._slots[1](*velocities)
        return bytes(self._data)
