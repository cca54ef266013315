"""Arm that takes actions and gives observations, a few dozen times a second. Its session does the
rest at the robot's rate: limits, collisions, and the reaction to silence."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from cardan.errors import CommandError, MotionRefusedError
from cardan.gateway.arm.interface import CartesianArm
from cardan.gateway.arm.verb_results import Stat
from cardan.gateway.arm.vocab import Action, Parameter, Stream
from cardan.gateway.operator.mapping import MappingOptions
from cardan.spatial import (
    add,
    conjugate,
    multiply,
    normalized,
    rotate,
    subtract,
    to_rotation_vector,
)
from cardan.types import IDENTITY, Frame, Pose, Quaternion, Vector3
from cardan_learning.device_actions import turns_with_tool
from cardan_learning.features import (
    CLOSE,
    CLOSED,
    CLOSING,
    GRIPPERS,
    MOTIONS,
    OPEN,
    OPENING,
    STAY,
    WIDE,
    ActionKind,
    Continuous,
    action_names,
    observation_names,
    pose_of,
    six_of,
)
from cardan_learning.goal import Approach

SILENCE_S = 0.3
"""Silence of a stream after which a moving arm is braked: ten frames at 30 Hz."""

STREAMS: Mapping[ActionKind, Stream] = {
    ActionKind.DELTA: Stream.TWIST,
    ActionKind.TARGET: Stream.POSE,
    ActionKind.POSE: Stream.POSE,
}


class ArmActions:
    """Open arm with the verbs, driven by actions. For one thread; has no clock."""

    def __init__(
        self,
        arm: CartesianArm,
        joints: Sequence[str],
        kind: ActionKind,
        mapping: MappingOptions,
        gripper: bool,
        reference: Vector3 | None = None,
    ) -> None:
        """`joints`: their names; `mapping`: frame of deltas and targets, full speeds, and the
        approach; `reference`: reference of rotation vectors, for :class:`Continuous`."""
        self._arm, self.kind, self._mapping = arm, kind, mapping
        self._gripper = gripper
        self.action_names = action_names(kind, gripper)
        self.observation_names = observation_names(joints, gripper)
        self.why_not = ""
        """Reason why the newest action moved nothing; empty: it was sent."""
        self._approach = Approach(mapping)
        self._written = Continuous(reference)
        self._latched: Pose | None = None
        """Commanded pose of the TCP when a target was first enabled."""
        self._before_s: float | None = None
        self._stat: Stat | None = None
        self._streaming = self._closed = False

    # -- observations ----------------------------------------------------------------------------

    def observe(self) -> dict[str, float]:
        """Return the measured joints and TCP, and the gripper's last command.

        Raises MotionRefusedError while the robot is silent, MotionLoopError after its session has
        ended.
        """
        stat = self._stat = self._arm.stat()
        if not stat.heard:
            raise MotionRefusedError("stat: the robot is silent, and its measurements are old")
        numbers = (*stat.joints, *self._written.of(stat.pose))
        if self._gripper:
            numbers = (*numbers, self._grip_now())
        return dict(zip(self.observation_names, numbers, strict=True))

    def _grip_now(self) -> float:
        return CLOSED if self._closed else WIDE

    # -- actions ---------------------------------------------------------------------------------

    def act(self, action: Mapping[str, float], now_s: float) -> dict[str, float]:
        """Send an action within the arm's limits, and return the action really sent, by the same
        names.

        If nothing can be sent, `why_not` has the reason, and the returned action is that of an arm
        that holds. Raises CommandError for missing or invalid numbers, and the errors of `observe`.
        """
        numbers = self._checked(action)
        dt_s = 0.0 if self._before_s is None else now_s - self._before_s
        self._before_s = now_s
        self.why_not = ""
        reported = self._act_gripper(numbers)
        if self.kind is ActionKind.DELTA:
            sent = self._act_delta(numbers)
        elif self.kind is ActionKind.TARGET:
            sent = self._act_target(numbers, dt_s)
        else:
            sent = self._act_pose(numbers, dt_s)
        names = MOTIONS[self.kind]
        return {**dict(zip(names, sent, strict=True)), **reported}

    def _checked(self, action: Mapping[str, float]) -> dict[str, float]:
        numbers = {}
        for name in self.action_names:
            if name not in action:
                raise CommandError(
                    f"an action without {name!r}: one of kind {self.kind.value!r} has "
                    + ", ".join(self.action_names)
                )
            numbers[name] = float(action[name])
            if not math.isfinite(numbers[name]):
                raise CommandError(f"an action whose {name!r} is {numbers[name]}: nothing is sent")
        return numbers

    def _act_delta(self, numbers: Mapping[str, float]) -> tuple[float, ...]:
        shares = [min(max(numbers[name], -1.0), 1.0) for name in MOTIONS[self.kind]]
        ways, turns = self._axes(self._newest())
        fast, turning = self._mapping.linear_speed_m_s, self._mapping.angular_speed_rad_s
        linear = rotate(ways, Vector3(*(each * fast for each in shares[:3])))
        angular = rotate(turns, Vector3(*(each * turning for each in shares[3:])))
        self._stream(lambda: self._arm.twist([*linear, *angular]), begins=any(shares))
        stat = self._stat = self._arm.stat()
        linear = rotate(conjugate(ways), Vector3(*stat.twist[:3]))
        angular = rotate(conjugate(turns), Vector3(*stat.twist[3:]))
        return (*(each / fast for each in linear), *(each / turning for each in angular))

    def _axes(self, tcp: Pose) -> tuple[Quaternion, Quaternion]:
        """Return the rotation from the axes of an action's translations and rotations to the base's
        axes."""
        tool = tcp.orientation
        return (
            tool if self._mapping.frame is Frame.TOOL else IDENTITY,
            tool if turns_with_tool(self._mapping) else IDENTITY,
        )

    def _act_target(self, numbers: Mapping[str, float], dt_s: float) -> tuple[float, ...]:
        enabled, *six = (numbers[name] for name in MOTIONS[self.kind])
        if enabled < 0.5:
            self._latched = None
            self._approach.release()
            self._stream(lambda: self._arm.pose(self._newest_six()), begins=False)
            self._stat = self._arm.stat()
            return (0.0,) * 7
        if self._latched is None:
            self._latched = self._commanded()
        latched, wanted = self._latched, pose_of(six)
        ways, turns = self._axes(latched)
        place = add(latched.position, rotate(ways, wanted.position))
        if turns == IDENTITY:
            orientation = multiply(wanted.orientation, latched.orientation)
        else:
            orientation = multiply(latched.orientation, wanted.orientation)
        self._go_to(Pose(place, normalized(orientation), Frame.BASE), dt_s)
        at = self._commanded()
        way = rotate(conjugate(ways), subtract(at.position, latched.position))
        if turns == IDENTITY:
            turn = multiply(at.orientation, conjugate(latched.orientation))
        else:
            turn = multiply(conjugate(latched.orientation), at.orientation)
        return (1.0, *way, *to_rotation_vector(normalized(turn)))

    def _act_pose(self, numbers: Mapping[str, float], dt_s: float) -> tuple[float, ...]:
        self._go_to(pose_of([numbers[name] for name in MOTIONS[self.kind]]), dt_s)
        return self._written.of(self._newest_six())

    def _go_to(self, goal: Pose, dt_s: float) -> None:
        tcp = self._newest()
        if not self._approach.engaged:
            self._approach.engage(self._commanded())
        place = six_of(self._approach.step(goal, tcp, dt_s))
        self._stream(lambda: self._arm.pose(list(place)))
        if self.why_not:
            self._approach.release()
        self._stat = self._arm.stat()

    # -- commanded pose of the TCP --------------------------------------------------------

    def _commanded(self) -> Pose:
        self._stat = self._arm.stat()
        return self._newest()

    def _newest(self) -> Pose:
        return pose_of(self._newest_six())

    def _newest_six(self) -> Sequence[float]:
        stat = self._stat
        if stat is None:
            stat = self._stat = self._arm.stat()
        return stat.pose if stat.target is None else stat.target

    # -- streams ---------------------------------------------------------------------------------

    def _stream(self, send: Callable[[], str], begins: bool = True) -> None:
        """Send a streamed command. If no stream is running, select it first; without `begins`, send
        nothing in that case."""
        if self._streaming:
            refusal = send()
            if not refusal or self._goes_on():
                self.why_not = refusal or self.why_not
                return
            self._streaming = False
        if begins:
            self.why_not = self._choose() or send() or self.why_not

    def _goes_on(self) -> bool:
        return self._arm.get_parameter(Parameter.STREAM) == STREAMS[self.kind]

    def _choose(self) -> str:
        """Select the stream: the arm is engaged at its measured position. Return the reason for a
        refusal, or ""."""
        try:
            self._arm.set_parameters(
                {Parameter.STREAM_TIMEOUT: SILENCE_S, Parameter.STREAM: STREAMS[self.kind]}
            )
        except MotionRefusedError as error:
            return str(error)
        self._streaming = True
        return ""

    # -- the gripper -----------------------------------------------------------------------------

    def _act_gripper(self, numbers: Mapping[str, float]) -> dict[str, float]:
        """Close or open the gripper if the request is new; return the command really sent."""
        if not self._gripper:
            return {}
        name = GRIPPERS[self.kind]
        asked = numbers[name]
        if self.kind is ActionKind.POSE:
            wanted: bool | None = asked < 0.5 * (CLOSED + WIDE)
        else:
            middle, half = (STAY, 0.5 * (OPEN - STAY))
            if self.kind is ActionKind.TARGET:
                middle, half = 0.0, 0.5 * OPENING
            wanted = None if abs(asked - middle) < half else asked < middle
        reported = False
        if wanted is not None and wanted is not self._closed:
            try:
                self._arm.act(Action.CLOSE if wanted else Action.OPEN)
            except MotionRefusedError as error:
                self.why_not = str(error)
            else:
                self._closed, reported = wanted, True
        if self.kind is ActionKind.POSE:
            return {name: self._grip_now()}
        if self.kind is ActionKind.DELTA:
            return {name: (CLOSE if self._closed else OPEN) if reported else STAY}
        return {name: (CLOSING if self._closed else OPENING) if reported else 0.0}
