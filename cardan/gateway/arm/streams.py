"""Streaming commands: poses, jogs, twists, wrenches and joint speeds, each valid for a moment.

A stream has to be chosen first (parameter streamingCommand). Its freshness is judged by local
reception; numbers and stamps of the sender only sort out late commands.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from cardan.common.arm_libraries import np
from cardan.errors import MotionRefusedError
from cardan.gateway.arm.backlog import Delays
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.joint_space_arm import JointSpaceArm
from cardan.gateway.arm.motions.base import CommandedMotion
from cardan.gateway.arm.motions.joint_stream import FollowJointStream
from cardan.gateway.arm.motions.pose_stream import FollowPoseStream
from cardan.gateway.arm.motions.reference_motion import FollowTwistStream
from cardan.gateway.arm.motions.torque import TorqueMotion
from cardan.gateway.arm.replay_requests import CommandHeader, argument_text
from cardan.gateway.arm.status import OPERATOR, VERBS
from cardan.gateway.arm.validation import (
    LONGEST_NAME,
    FramedPose,
    Target,
    checked_pose,
    checked_sequence,
    checked_source,
    joint_numbers,
    six_numbers,
)
from cardan.gateway.arm.verb_plans import VerbPlans
from cardan.gateway.arm.vocab import Parameter, State, Stream, vocab_text
from cardan.gateway.kinematics.base import FloatArray
from cardan.gateway.motion.planner import check_workspace
from cardan.spatial import (
    add,
    compose,
    multiply,
    norm,
    normalized,
    rotation_between,
    subtract,
)
from cardan.types import NEVER_S, ZERO_TWIST, Frame, Pose, Twist, Vector3, Wrench

CLOCK_SET_BACK_S = 1.0
"""Difference by which a stamp must be older than the one before for the sender's clock to count as
set back: more than any network delay."""


class _Link:
    """The sender of the present stream, and the newest command from it."""

    def __init__(self, kind: Stream) -> None:
        self.kind = kind
        self.owner: str | None = None
        self.sequence: int | None = None
        self.sent_s = NEVER_S


def _is_time(stamp_s: object) -> bool:
    return isinstance(stamp_s, (int, float)) and math.isfinite(stamp_s)


class Streams:
    """The streaming commands of one arm. Each returns why it was refused, or ""."""

    def __init__(
        self, controller: ArmController, commanded: JointSpaceArm, plans: VerbPlans
    ) -> None:
        self._controller, self._commanded, self._plans = controller, commanded, plans
        self._link: _Link | None = None
        self._delays = Delays()
        """Kept when a stream is chosen again: a queued command would measure its delay wrongly."""
        self._ended = ""
        self._heard_s = NEVER_S
        """Time of reception of the newest command, robot's clock."""
        self.silenced: str | None = None
        """Owner of the last stream if it ended by silence and nothing has happened since; None
        otherwise."""
        self.late = 0
        """Count of streamed commands that came late or twice."""
        self.scaled = 0
        """Count of streamed twists that were too fast and were slowed, direction kept."""

    @property
    def kind(self) -> Stream:
        """The streaming command that is chosen."""
        return Stream.NONE if self._link is None else self._link.kind

    @property
    def owner(self) -> str:
        """The owner of the stream; empty before the first command, or without a name."""
        return "" if self._link is None else self._link.owner or ""

    @property
    def age_s(self) -> float:
        """Time since the newest streamed command, s; infinite before the first."""
        motion = self._controller.motion
        if self._link is None or self._link.owner is None or motion is None:
            return math.inf
        return self._controller.stamp_s - motion.heard_s

    def end(self, reason: str) -> bool:
        """Choose no streaming command any more; return False if none was chosen."""
        if self._link is None:
            self.silenced = None
            return False
        silent_s = self._controller.stamp_s - self._heard_s
        silent = silent_s > self._plans.parameters[Parameter.STREAM_TIMEOUT]
        began = self._link.owner is not None
        self.silenced = self.owner or VERBS if silent and began else None
        self._link, self._ended = None, reason
        return True

    def choose(self, kind: Stream, start: Callable[[str], FloatArray], source: str = VERBS) -> None:
        """Make `kind` the streaming command; `start` checks that a motion can begin by `source`.

        Raises MotionRefusedError. The source that streams first then gets the authority.
        """
        controller, plans = self._controller, self._plans
        verb = f"streaming {vocab_text(kind)}"
        owner = controller.authority.owner
        if owner == OPERATOR or (owner and owner == self.owner and owner != source):
            raise MotionRefusedError(f"{verb}: {owner!r} has authority over the arm")
        if kind is Stream.NONE:
            self.end("no streaming command is chosen")
            controller.drop()
            return
        if kind is Stream.WRENCH:
            plans.require_torque(verb)
        else:
            plans.require_drive(verb)
        at = start(verb)
        motion = self._motion(kind, at)
        motion.silence_s = plans.parameters[Parameter.STREAM_TIMEOUT]
        motion.heard_s = NEVER_S
        controller.begin(motion)
        controller.authority.release(source)
        self._link, self._ended = _Link(kind), ""

    def _motion(self, kind: Stream, at: FloatArray) -> CommandedMotion:
        plans, options, commanded = self._plans, self._plans.options, self._commanded
        if kind is Stream.WRENCH:
            torque = plans.torque_motion(State.NOT_CONTROLLING)
            torque.check_weight(at)
            self._controller.engage()
            return torque
        self._controller.engage()
        if kind is Stream.JOINT:
            return FollowJointStream(
                commanded,
                plans.parameters[Parameter.JOINT_SPEED],
                plans.parameters[Parameter.JOINT_ACCELERATION],
            )
        reference = plans.reference(
            options.streams.linear_acceleration_m_s2, options.streams.angular_acceleration_rad_s2
        )
        if kind is Stream.POSE:
            return FollowPoseStream(
                commanded,
                reference,
                plans.deceleration,
                plans.pose_shaper(reference.limits),
                options.stream_prediction_s,
            )
        return FollowTwistStream(commanded, reference, plans.deceleration)

    # -- commands --------------------------------------------------------------------------------

    def hear(self, sender: CommandHeader) -> None:
        """Learn from the stamp of a command before it is accepted or refused: a command queued
        while its sender was refused would measure its delay wrongly."""
        owner, _, stamp_s, heard_s = sender
        if isinstance(owner, str) and len(owner) <= LONGEST_NAME and _is_time(stamp_s):
            assert stamp_s is not None
            with self._controller.lock:
                retained = self._controller.authority.owner
                self._delays.hear(owner, stamp_s, heard_s, retained)

    def pose(self, x: Target | FramedPose, sender: CommandHeader) -> None:
        """Go to the pose `x` now. Raises MotionRefusedError, as all of these do."""
        relative = self._plans.tcp_frame
        if isinstance(x, FramedPose):
            relative, x = x.frame is Frame.TOOL, x.pose

        def of(given: Pose, now: Pose, _before: Pose) -> Pose:
            return compose(now, given) if relative else given

        self._aim("pose", x, of, sender)

    def jog(self, dx: Target, sender: CommandHeader) -> None:
        """Move the target pose by `dx` (m, rotation vector in rad).

        The deltas of a stream add up, so none is lost. In base axes p + d and exp(dr)·R, with the
        TCP frame H·X. Needs the stream command `pose`, follows the parameter poseDamping, and is
        refused if the sum would run away from the arm.
        """

        def of(given: Pose, _now: Pose, before: Pose) -> Pose:
            if self._plans.tcp_frame:
                return compose(before, given)
            return Pose(
                add(before.position, given.position),
                normalized(multiply(given.orientation, before.orientation)),
                Frame.BASE,
            )

        self._aim("jog", dx, of, sender)

    def _aim(
        self,
        verb: str,
        given: Target,
        of: Callable[[Pose, Pose, Pose], Pose],
        sender: CommandHeader,
    ) -> None:
        """Aim the pose stream at the result of `of`, called with the given pose, the commanded pose
        and the previous target."""
        controller, plans = self._controller, self._plans
        pose = checked_pose(verb, given)
        with controller.lock:
            motion = self._streaming(Stream.POSE, sender)
            assert isinstance(motion, FollowPoseStream)
            start = self._commanded.servo.q.copy()
            now = self._commanded.servo.pose
            target = of(pose, now, motion.target or now)
        check_workspace(verb, target.position, plans.options.streams.workspace_m)
        self._check_step(now, target)
        plans.planner.inverse_nearby(verb, target, start)
        with controller.lock:
            if controller.motion is not motion or self._link is None:
                raise MotionRefusedError(f"{verb}: {self._ended}")
            waited_s = controller.stamp_s - sender.heard_s
            if waited_s > motion.silence_s:
                raise MotionRefusedError(
                    f"{verb}: it waited for {waited_s:.2f} s until it was planned; commands that "
                    "old are not executed"
                )
            self._aim_at(motion, target, sender)

    def aim(self, target: Pose, sender: CommandHeader) -> None:
        """Go to a pose in the base that is checked already, as in the replay of a record."""
        with self._controller.lock:
            motion = self._streaming(Stream.POSE, sender)
            assert isinstance(motion, FollowPoseStream)
            self._aim_at(motion, target, sender)

    def _aim_at(self, motion: FollowPoseStream, target: Pose, sender: CommandHeader) -> None:
        self._tell("aim", target, sender=sender)
        motion.aim(target, self._controller.stamp_s)
        self._note_command(motion, sender)

    def _check_step(self, now: Pose, target: Pose) -> None:
        options = self._plans.options
        step_m = norm(subtract(target.position, now.position))
        step_rad = norm(rotation_between(now.orientation, target.orientation))
        if step_m > options.stream_step_m or step_rad > options.stream_step_rad:
            raise MotionRefusedError(
                f"pose: a step of {step_m:.3f} m and {step_rad:.3f} rad; allowed: "
                f"{options.stream_step_m:.3f} m and {options.stream_step_rad:.3f} rad"
            )

    def twist(self, xdot: Sequence[float] | Twist, sender: CommandHeader) -> None:
        """Move with the twist `xdot` (m/s, rad/s) now. A twist that is too fast is slowed. A Twist
        is along its own frame, numbers along that of the parameter referenceFrame."""
        frame = Frame.TOOL if self._plans.tcp_frame else Frame.BASE
        if isinstance(xdot, Twist):
            frame, xdot = xdot.frame, (*xdot.linear, *xdot.angular)
        with self._controller.lock:
            x, y, z, rx, ry, rz = six_numbers("twist", xdot)
            motion = self._streaming(Stream.TWIST, sender)
            assert isinstance(motion, FollowTwistStream)
            self._tell("twist", (x, y, z, rx, ry, rz), frame.value, sender=sender)
            linear, angular, share = self._plans.slowed(Vector3(x, y, z), Vector3(rx, ry, rz))
            self.scaled += share < 1.0
            asked = any((*linear, *angular))
            motion.wanted = Twist(linear, angular, frame) if asked else ZERO_TWIST
            self._note_command(motion, sender)

    def wrench(self, w: Sequence[float] | Wrench, sender: CommandHeader) -> None:
        """Exert the wrench `w` (N, N·m, at the TCP) on the world now. A Wrench is along its own
        frame, numbers along that of the parameter referenceFrame."""
        frame = Frame.TOOL if self._plans.tcp_frame else Frame.BASE
        if isinstance(w, Wrench):
            frame, w = w.frame, (*w.force, *w.torque)
        with self._controller.lock:
            numbers = six_numbers("wrench", w)
            motion = self._streaming(Stream.WRENCH, sender)
            assert isinstance(motion, TorqueMotion)
            self._tell("wrench", numbers, frame.value, sender=sender)
            motion.set_wrench(Wrench(Vector3(*numbers[:3]), Vector3(*numbers[3:]), frame))
            self._note_command(motion, sender)

    def joints(self, rates: Sequence[float], sender: CommandHeader) -> None:
        """Move the joints at `rates` (rad/s or m/s, one a joint) now. Speeds that are too high are
        scaled down."""
        with self._controller.lock:
            count = self._commanded.servo.joints
            values = np.array(joint_numbers("joints", rates, count))
            motion = self._streaming(Stream.JOINT, sender)
            assert isinstance(motion, FollowJointStream)
            self._tell("joints", values.tolist(), sender=sender)
            self.scaled += motion.aim(values)
            self._note_command(motion, sender)

    # -- permission to stream --------------------------------------------------------------------

    def _streaming(self, kind: Stream, sender: CommandHeader) -> CommandedMotion:
        """Return the motion of the stream if this command may act on it."""
        owner, sequence, stamp_s, _ = sender
        controller = self._controller
        name, link, motion = vocab_text(kind), self._link, controller.motion
        if link is None or motion is None:
            why = f": {self._ended}" if self._ended else ""
            raise MotionRefusedError(
                f"{name}: select {kind.name.lower()} streaming first (parameter streamingCommand; "
                f"ROS 2: preset_streaming_cmd){why}"
            )
        if sequence is not None:
            checked_sequence(name, sequence)
        if stamp_s is not None and not _is_time(stamp_s):
            raise MotionRefusedError(f"{name}: the stamp {stamp_s!r} is not a time in seconds")
        if owner:
            checked_source(name, owner)
        refusal = controller.authority.refuses(owner or VERBS)
        if refusal:
            controller.authority.take(owner or VERBS, controller.stamp_s)  # Notes the refusal.
            raise MotionRefusedError(f"{name}: {refusal}")
        if link.kind is not kind:
            raise MotionRefusedError(f"{name}: the streaming command is {vocab_text(link.kind)}")
        if link.owner == owner:
            self._check_order(name, link, sender)
        late = self._delays.late(owner) if stamp_s is not None else ""
        if late:
            self.late += 1
            raise MotionRefusedError(f"{name}: {late}")
        return motion

    def _check_order(self, name: str, link: _Link, sender: CommandHeader) -> None:
        _, sequence, stamp_s, _ = sender
        if sequence is not None and link.sequence is not None and sequence <= link.sequence:
            self.late += 1
            raise MotionRefusedError(f"{name}: number {sequence} came after number {link.sequence}")
        if stamp_s is not None and 0.0 <= link.sent_s - stamp_s < CLOCK_SET_BACK_S:
            self.late += 1
            raise MotionRefusedError(
                f"{name}: sent at {stamp_s:.6f} s, after one of {link.sent_s:.6f} s"
            )

    def _tell(self, name: str, *values: Any, sender: CommandHeader) -> None:
        """Report an accepted command to the controller's recorder."""
        controller = self._controller
        if controller.recorder is not None:
            controller.record_request(name, argument_text(*values, sender))

    def _note_command(self, motion: CommandedMotion, sender: CommandHeader) -> None:
        owner, sequence, stamp_s, _ = sender
        link, now_s = self._link, self._controller.stamp_s
        assert link is not None
        if link.owner != owner:
            link.owner, link.sequence, link.sent_s = owner, None, NEVER_S
        self._controller.authority.take(owner or VERBS, now_s)
        motion.heard_s = self._heard_s = now_s
        if sequence is not None:
            link.sequence = sequence
        if stamp_s is not None:
            link.sent_s = stamp_s
