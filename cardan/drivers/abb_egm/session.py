"""The PC's side of an EGM session without sockets and clocks: datagrams in, answers out."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from cardan.common.bounds import COORDINATE_M, JOINT_POSITION, OUTPUT_VALUE
from cardan.common.histogram import LatencyHistogram
from cardan.drivers.abb_egm.compiled import (
    CompiledCycle,
    CompiledReader,
    feedback_reader,
    no_answer,
)
from cardan.drivers.abb_egm.counters import EgmCounters
from cardan.drivers.abb_egm.diagnosis import diagnose
from cardan.drivers.abb_egm.options import AbbEgmOptions
from cardan.drivers.abb_egm.reference_generator import reference_generator_for, wire_factors
from cardan.drivers.abb_egm.slow_motion import SpeedCapDetector
from cardan.drivers.abb_egm.states import EGM_UNDEFINED, FIRST_ANSWER, hold_reason
from cardan.drivers.abb_egm.statistics import NO_STATES, UNKNOWN, CycleState, PlainCycleState
from cardan.drivers.datagram_robot import FLOOD_DATAGRAMS, AnsweringSession
from cardan.drivers.missed_cycles import PAUSE_S, SLACK_S, ClockWatch, believed_s
from cardan.drivers.robot_core import check_command, implausible, no_rotation, outside
from cardan.errors import CommandError
from cardan.protocols.egm.decode import decode_robot
from cardan.protocols.egm.encode import encode_rapid_to_robot
from cardan.protocols.egm.messages import (
    DNUM_MAX,
    EgmFeedback,
    EgmRapidData,
    EgmRobot,
    MalformedEgmMessage,
    MCIState,
    MotorState,
    RapidState,
)
from cardan.spatial import from_euler_zyx, normalized
from cardan.types import (
    NEVER_S,
    Frame,
    Pose,
    Quaternion,
    RobotCapabilities,
    RobotCommand,
    RobotLink,
    RobotState,
    Vector3,
    Wrench,
)

Address = tuple[str, int]


class Measured(NamedTuple):
    """Decoded contents of a datagram."""

    feedback: EgmFeedback
    joints: tuple[float, ...]
    """Joint positions in kinematic order; the next fields are likewise in SI units."""
    external: tuple[float, ...]
    pose: Pose | None


Heard = tuple[RobotState | None, bytes, float]
"""State, its datagram, and the deviation of its arrival from its clock, s."""

_new = tuple.__new__
"""Makes a named tuple in half the time of its constructor, for objects made in every cycle."""
_LIVE = RobotLink.LIVE
_BASE = Frame.BASE

_MASK = 0xFFFFFFFF
_HALF = 0x80000000
"""Modulus of sequence numbers and of the ms clock; differences are signed."""

_ROUNDING = 1e-9
"""Largest deviation of a quaternion's squared length from 1 that needs no normalization."""

_REORDERED_MAX = 16
"""Largest step back in the sequence (64 ms) of a late datagram without a clock."""
_LATE_MAX = 250
"""A larger step back (1 s) is a restart, whatever the datagram's clock says."""

NEW_PORT_SILENCE_S = 0.1
"""Shortest silence of the controller after which another port of its address may be its new one: no
other program there may take over the robot during network jitter."""
_EARLY_DATAGRAMS = 4
"""Tolerance of the datagram count of a new port against the time of the silence: clocks and network
are not exact."""

_JUMP, _JUMP_PER_S = math.tau, 30.0
"""Farthest motion of an arm between two datagrams, rad or m, and per second: a whole turn, and the
sum of all joints. Code that knows the arm checks for smaller jumps."""

_GAP_PERIODS = 1.5
"""Time since the last answer from which on at least one period was missed."""

_COAST_PERIODS = 4
"""Gap after which the controller slows down by itself, so its own reference is used."""


class EgmSession(AnsweringSession):
    """Protocol session with one controller on one port.

    The shell calls `receive` for each datagram and, for the newest state that comes back, `reply`
    once; `tick` when nothing came for a while. All times are local monotonic seconds.
    """

    def __init__(
        self, options: AbbEgmOptions, now_s: float, controller_ip: str | None = None
    ) -> None:
        """Pin the controller's address to `controller_ip`; None: learn it from the first valid
        datagram."""
        super().__init__(options.lost_after_s)
        self.options = options
        self.opened_s = now_s
        self.counters = EgmCounters()
        self.peer: Address | None = None
        """Controller's address, to which answers go."""
        self.last_cause = ""
        """Reason why the present session is a new one."""
        self.last_malformed = ""
        self.last_foreign = ""
        self.last_foreign_counts_on = False
        """True if `last_foreign` is another port of the controller's address, whose sequence began
        before the controller fell silent."""
        self.handover: tuple[bytes, Address] | None = None
        """Final message to the controller's previous port, and that port; sent once, then None."""
        self.last_send_error = ""
        self.jitter = LatencyHistogram()
        """Deviation of the time between two receptions from the controller's period."""
        self.reply_latency = LatencyHistogram()
        """Time from the reception of a datagram to sending its answer."""
        self.slow_motion = SpeedCapDetector()
        self.clock = ClockWatch()
        """Check of the ms clock in the headers; the wall clock may be set at any time."""
        self._tm_ms, self._tm_s = UNKNOWN, 0.0
        """The ms clock at the last check, and the time since the first."""
        self.port = options.listen_port
        """Actual UDP port, if the options leave the choice (0: any)."""
        self._foreign: Address | None = None
        """Sender refused since the last accepted datagram."""
        self._rivals: set[Address] = set()
        """Ports of the controller's address heard besides its own: other programs, at any rate."""
        self._ip = controller_ip
        self._nominal_s = options.period_s
        self._late_after_s = options.late_after_s
        self._comm_timeout_s = options.comm_timeout_s
        self._joints = options.joints
        self._needs_pose = options.mode == "pose"
        self._needs_joints = options.mode == "joint"
        self._needs_external = options.joints - 6 + options.external_axes
        self._external_factors = tuple(1.0 / factor for factor in wire_factors(options))
        self._force_frame = Frame(options.force_frame)
        self._reader = feedback_reader()
        cycle = None
        self._cycle_state: CycleState = PlainCycleState()
        self._take: Callable[..., Any] = no_answer
        if isinstance(self._reader, CompiledReader):
            cycle = self._compiled_cycle()
            self._cycle_state = cycle.cycle_state
            if not self._needs_external:
                self._take = self._reader.compiled_receive(cycle, self._force_frame)
        self._generator = reference_generator_for(options, cycle)
        self.capabilities = self._capabilities()
        """Command kinds that `reply` takes in the mode of the options."""
        self._suffix = b""
        self._outputs = EgmRapidData(None, ())
        if options.digital_output is not None or options.output_values:
            self.set_outputs(options.digital_output, options.output_values)
        self._silent = False
        self._fresh = False
        self._alarm = ""
        self._session_s = NEVER_S
        self._session_first = 0
        self._newest: Heard = (None, b"", 0.0)
        """Newest state; the next are the one before, and the last answered."""
        self._before: Heard = self._newest
        self._answered: Heard = self._newest
        self._past: Heard | None = None
        """State before `_before`; keeping it defers its deallocation until the answer is sent."""
        self._full: tuple[bytes, EgmRobot | None] = (b"", None)
        """Newest datagram and its contents."""
        self._held = False
        """True if the last answer braked a robot that reports that commands do not act."""
        self._hold_reason = EGM_UNDEFINED
        self._orientation: Quaternion | None = None
        """Last measured orientation, unless `state` has a newer one."""

    # -- reception ------------------------------------------------------------------------------

    def _compiled_cycle(self) -> CompiledCycle:
        cycle = CompiledCycle(
            nominal_s=self._nominal_s,
            lost_after_s=self._lost_after_s,
            late_after_s=self._late_after_s,
            longest_gap_s=_GAP_PERIODS * self._nominal_s,
            jump=_JUMP,
            jump_per_s=_JUMP_PER_S,
            usual=_USUAL,
            rounding=_ROUNDING,
            slack_s=SLACK_S,
            most_credit_s=PAUSE_S,
            credit_s=SLACK_S,
            by_joints=self._needs_joints,
            tm_ms=UNKNOWN,
            time_us=UNKNOWN,
            replied_s=NEVER_S,
        )
        cycle.cycle_state.states[:] = NO_STATES
        return cycle

    def receive(self, data: bytes, source: Address, now_s: float) -> RobotState | None:
        """Process a datagram. Return the robot's state if it is to be answered, None if it is
        refused."""
        peer = self.peer
        if source == peer and not (self.reply_pending or self._flood or self.clock.fault):
            # The usual case: the next datagram of a controller that executes commands.
            found = self._take(data, now_s, self.state)
            if found is not None:
                self._past = self._before
                self._before = self._newest
                self._newest = found
                self.state = state = found[0]
                self.counters.accepted += 1
                self.reply_pending = True
                return state  # type: ignore[no-any-return]
        if not self._admit(source, now_s):
            return None
        measured = self._decode(data, source, now_s)
        if measured is None:
            return None
        step, cause = self._sequence(measured, source, now_s)
        if not step:
            return None
        if cause:
            self._begin(cause, source, now_s)
        return self._publish(measured, data, 0 if cause else step, now_s)

    def _admit(self, source: Address, now_s: float) -> bool:
        """True if a datagram from `source` may be processed; count it otherwise."""
        if source == self.peer or self._admissible(source, now_s):
            return True
        self._refuse_foreign(source, counts_on=source in self._rivals)
        return False

    def _decode(self, data: bytes, source: Address, now_s: float) -> Measured | None:
        """Return the contents of a complete and plausible datagram; count any other."""
        feedback = self._reader.read(data)
        if isinstance(feedback, MalformedEgmMessage):
            self._refuse(feedback)
            return None
        peer, position, orientation = self.peer, feedback.pos, feedback.orient
        joints, external = feedback.joints, feedback.external_joints
        if (
            source != peer
            and peer is not None
            and not self._began_in_silence(feedback.seqno, now_s)
        ):
            self._refuse_foreign(source, counts_on=True)
            return None
        pose = None
        if position is not None and orientation is not None:
            pose = _pose(position, orientation, self._last_orientation())
        if (
            (self._needs_pose and (position is None or orientation is None))
            or (self._needs_joints and len(joints) != 6)
            or (self._needs_external and len(external) < self._needs_external)
        ):
            self.counters.malformed["incomplete"] += 1
            self.last_malformed = self._missing_field(feedback)
            return None
        if external:
            joints, external = self._ordered(joints, external)
        numbers = joints if position is None else joints + position
        if external:
            numbers += external
        # The usual case by one comparison, which a NaN does not pass.
        turn = orientation if self._needs_pose else None
        usual = sum(map(abs, numbers)) <= _USUAL and (pose is not None or turn is None)
        if not usual and (wrong := _implausible(joints, external, position, turn)):
            self.counters.malformed["implausible"] += 1
            self._note_refused()
            self.last_malformed = wrong
            return None
        return Measured(feedback, joints, external, pose)

    def _sequence(self, measured: Measured, source: Address, now_s: float) -> tuple[int, str]:
        """Return the step in the sequence since the newest datagram, and the reason if it begins a
        new session. The step is 0 for a late, double or implausible datagram, which is counted."""
        feedback, peer = measured.feedback, self.peer
        seqno, before, step = feedback.seqno, self._seqno, 1
        if peer is None:
            return step, "the first datagram"
        if source != peer:
            return step, f"the controller's port changed from {peer[1]} to {source[1]}"
        silence_s = now_s - self._last_s
        if self._silent or (silence_s > self._lost_after_s and not self._was_queued(feedback)):
            return step, f"{silence_s:.2f} s of silence"
        if seqno != (before + 1) & _MASK:
            step = ((seqno - before + _HALF) & _MASK) - _HALF
            if step <= 0:
                if self._restarted(feedback, step):
                    return 1, f"the sequence number fell from {before} to {seqno}"
                if step:
                    self.counters.old += 1
                else:
                    self.counters.duplicates += 1
                return 0, ""
            if (step - 1) * self._nominal_s > 2.0 * silence_s + self._lost_after_s:
                return step, f"the sequence number jumped from {before} to {seqno}"
        if wrong := self._jump(measured.joints, feedback.pos, now_s):
            self.counters.malformed["implausible"] += 1
            self.last_malformed = wrong
            return 0, ""
        return step, ""

    def _publish(self, measured: Measured, data: bytes, step: int, now_s: float) -> RobotState:
        """Make the state of a datagram `step` after the newest; 0: the first of a session."""
        cycle_state, (feedback, joints, external, pose) = self._cycle_state, measured
        tm_ms, time_us, force, rate = (
            feedback.tm_ms,
            feedback.time_us,
            feedback.force,
            feedback.utilization_rate,
        )
        superseded = None
        if step:
            self.counters.lost += step - 1
            period_s = self._period(time_us, step, now_s - self._last_s)
            jitter_s = abs(now_s - self._last_s - period_s)
            superseded = self.state if self.reply_pending else None
            if superseded is not None:
                self.counters.superseded += 1
        else:
            period_s, jitter_s = self._nominal_s, self._newest[2]
        cycle_state.tm_ms = UNKNOWN if tm_ms is None else tm_ms
        cycle_state.time_us = UNKNOWN if time_us is None or time_us > _CLOCK_MAX_US else time_us
        cycle_state.last_step_s = period_s
        cycle_state.since_reply_s += period_s
        if superseded is not None:
            period_s += superseded.period_s  # that one stays unanswered: its time counts here
        self.counters.accepted += 1
        if self._flood:
            self._note_accepted()
        if feedback.states != tuple(cycle_state.states):
            self._enter(feedback.states)
        self._orientation = self._last_orientation() if pose is None else pose.orientation
        wrench = None
        if len(force) == 6:
            fx, fy, fz, tx, ty, tz = force
            wrench = Wrench(Vector3(fx, fy, fz), Vector3(tx, ty, tz), self._force_frame)
        self.reply_pending = True
        self._before = self._newest
        self.state = state = _new(
            RobotState,
            (
                now_s,
                _LIVE,
                self.sessions,
                feedback.seqno,
                period_s,
                joints,
                external,
                pose,
                self._hold_reason or self.clock.fault or (FIRST_ANSWER if self._fresh else ""),
                wrench,
                None if rate is None else 0.01 * rate,
                None if time_us is None else 1e-6 * time_us,
                self._alarm,
                (),
                (),
            ),
        )
        self._newest = (state, data, jitter_s)
        cycle_state.known = False
        return state

    def _note_accepted(self) -> None:
        """Offset an accepted datagram against the refused ones; report or end a flood."""
        peer, foreign = self.peer, self._foreign
        if foreign is not None:
            self._foreign = None
            if peer is not None and foreign[0] == peer[0] and foreign[1] != peer[1]:
                self._rivals.add(foreign)
        self._flood -= 1
        if self._flood >= FLOOD_DATAGRAMS:
            self._alarm = (
                f"port {self.port} is flooded with datagrams that are not the controller's"
            )
        elif not self._flood:
            self._alarm = ""

    def tick(self, now_s: float) -> RobotState | None:
        """Return the state of a silent controller: WAITING or LOST; None while it is not silent.

        Call it when nothing was received for a while, even from the start.
        """
        if self.state is None:
            reason = f"no datagram in {now_s - self.opened_s:.1f} s"
            return RobotState(now_s, RobotLink.WAITING, 0, 0, 0.0, (), (), None, reason)
        silence_s = now_s - self._last_s
        if silence_s < self._lost_after_s:
            return None
        if not self._silent:
            self._silent = True
            self.reply_pending = False
            self._note_end()
        return self.state._replace(
            stamp_s=now_s,
            link=RobotLink.LOST,
            period_s=0.0,
            hold_reason=f"no datagram for {silence_s:.1f} s",
        )

    def skip(self) -> None:
        """Leave the accepted datagram unanswered, because it is too old."""
        self.reply_pending = False
        self.counters.superseded += 1

    def _admissible(self, source: Address, now_s: float) -> bool:
        """True if a datagram from another source than the peer may be processed."""
        if self.peer is None:
            return self._ip is None or source[0] == self._ip
        # The controller's port may change, but not while the old one is still heard, and only
        # after a silence that `tick` has seen: one that the application slept through may be none.
        silence_s = now_s - self._last_s
        return (
            source[0] == self.peer[0]
            and self._silent
            and silence_s >= NEW_PORT_SILENCE_S
            and source not in self._rivals
        )

    def _began_in_silence(self, seqno: int, now_s: float) -> bool:
        """True if the sequence that has come to `seqno` began after the controller fell silent."""
        return seqno <= (now_s - self._last_s) / self._nominal_s + _EARLY_DATAGRAMS

    def _refuse_foreign(self, source: Address, counts_on: bool = False) -> None:
        self.counters.foreign += 1
        self._note_refused()
        self._foreign = source
        self.last_foreign = f"{source[0]}:{source[1]}"
        self.last_foreign_counts_on = counts_on

    def _jump(self, joints: tuple[float, ...], position: Vector3 | None, now_s: float) -> str:
        """Explain a position jump since the last measurement; empty if the step is possible.

        If the robot stays there, the link is lost, and a new session begins there.
        """
        before = self.state
        if before is None:
            return ""
        way = 0.0
        if self._needs_joints:
            way = math.dist(joints, before.joints)
        elif position is not None and before.pose is not None:
            way = math.dist(position, before.pose.position)
        if way <= _JUMP + _JUMP_PER_S * (now_s - self._last_s):
            return ""
        unit = "rad" if self._needs_joints else "m"
        return f"the measured position is {way:.3g} {unit} from the one before"

    def _refuse(self, malformed: MalformedEgmMessage) -> None:
        self.counters.malformed[malformed.fault.name.lower()] += 1
        self._note_refused()
        self.last_malformed = f"{malformed.fault.value}: {malformed.detail}"

    def _missing_field(self, feedback: EgmFeedback) -> str:
        """Name of the missing field of an incomplete message; empty if it is complete."""
        external = len(feedback.external_joints)
        if external < self._needs_external:
            return (
                f"feedBack has {external} externalJoints, the options need {self._needs_external}"
            )
        if self._needs_joints:
            return f"joint mode needs 6 joints in feedBack, it has {len(feedback.joints)}"
        return (
            "pose mode needs position and orientation in feedBack, it has "
            f"{feedback.pos} and {feedback.orient}"
        )

    def _clock_steps_ms(self, feedback: EgmFeedback) -> list[float]:
        """Time since the last message by each clock that the controller sends, ms."""
        steps: list[float] = []
        tm_ms, time_us = self._cycle_state.tm_ms, self._cycle_state.time_us
        if feedback.tm_ms is not None and tm_ms != UNKNOWN:
            steps.append(((feedback.tm_ms - tm_ms + _HALF) & _MASK) - _HALF)
        if feedback.time_us is not None and time_us != UNKNOWN:
            steps.append((feedback.time_us - time_us) * 1e-3)
        return steps

    def _was_queued(self, feedback: EgmFeedback) -> bool:
        """True if `feedback` waited here unread while the controller was not silent."""
        return any(0.0 < step < 1e3 * self._lost_after_s for step in self._clock_steps_ms(feedback))

    def _restarted(self, feedback: EgmFeedback, step: int) -> bool:
        """True if a sequence number that did not rise means a restart, not a late datagram."""
        clocks = [ms for ms in self._clock_steps_ms(feedback) if ms]
        if clocks:
            return max(clocks) > 0.0 or step < -_LATE_MAX
        return step < -_REORDERED_MAX

    def _period(self, time_us: int | None, step: int, waited_s: float) -> float:
        """Time since the previous message, received `waited_s` earlier: by the controller's clock
        as far as it is plausible, and by ours, s."""
        cycle_state = self._cycle_state
        reported_s = nominal_s = self._nominal_s * step
        before_us = cycle_state.time_us
        if time_us is not None and before_us != UNKNOWN:
            measured_s = (time_us - before_us) * 1e-6
            # Outside of this range the clock was set.
            if 0.25 * nominal_s < measured_s < 4.0 * nominal_s:
                reported_s = measured_s
        found_s, cycle_state.credit_s = believed_s(
            reported_s, nominal_s, waited_s, cycle_state.credit_s
        )
        return found_s

    def _begin(self, cause: str, source: Address, now_s: float) -> None:
        peer = self.peer
        if peer is not None and source != peer:
            last_words = self.final_command(now_s)
            self.handover = None if last_words is None else (last_words, peer)
        self._session_s, self._session_first = now_s, self.counters.accepted
        if self.sessions and not self._silent:
            self._note_end()
        self.sessions += 1
        self.last_cause = cause
        self.peer = source
        self._silent = False
        self._fresh = True
        self.clock.begin()
        self._tm_ms, self._tm_s = UNKNOWN, 0.0
        self._cycle_state.credit_s = SLACK_S
        self._cycle_state.since_reply_s = 0.0
        self._cycle_state.replied_s = NEVER_S
        self._cycle_state.states[:] = NO_STATES
        self._hold_reason = EGM_UNDEFINED

    def _note_end(self) -> None:
        """Count a run that ended while the robot stood in its convergence window."""
        message = self.message
        if message and message.mci_convergence_met and message.mci_state == MCIState.RUNNING:
            self.counters.ended_by_convergence += 1

    def _enter(self, states: tuple[int, int, int]) -> None:
        motors, mci, rapid = states
        if (
            self._cycle_state.states[1] == MCIState.RUNNING
            and mci == MCIState.STOPPED
            and motors != MotorState.OFF
            and rapid != RapidState.STOPPED
        ):
            self._note_end()
        self._cycle_state.states[:] = states
        self.slow_motion.reset()
        self._hold_reason = hold_reason(motors, mci, rapid)

    def _heading(self, message: EgmRobot | None, state: RobotState | None) -> RobotState | None:
        """Return `state` with the controller's own reference in place of the measurements.

        None if its message lacks a part of it.
        """
        planned = message and message.planned
        if not planned or state is None:
            return None
        joints, pose = planned.joints or (), None
        if planned.external_joints:
            joints, _ = self._ordered(joints, planned.external_joints)
        if planned.cartesian is not None:
            position, orientation, euler = planned.cartesian
            if orientation is None and euler is not None:
                orientation = from_euler_zyx(*euler)
            if position is not None and orientation is not None:
                pose = _pose(position, orientation, self._last_orientation())
        if (self._needs_pose and pose is None) or (
            self._needs_joints and len(joints) != self._joints
        ):
            return None
        heading = state._replace(joints=joints, pose=pose)
        return None if implausible(heading) else heading

    def _follow_controller(self, state: RobotState, gap_s: float) -> None:
        """Update the reference for the controller's own motion in `gap_s`."""
        if gap_s < _COAST_PERIODS * self._nominal_s:
            self._generator.coast(gap_s)
            return
        known = []
        (earlier, data_before, _), (answered, data, _) = self._before, self._answered
        before = earlier or state
        for each, datagram in (
            (state, self._newest[1]),
            (before, data_before),
            (answered or before, data or data_before),
        ):
            message = decode_robot(datagram)
            known.append(
                None if isinstance(message, MalformedEgmMessage) else self._heading(message, each)
            )
        heading, heading_before, then = known
        if heading is None or heading_before is None or then is None:
            heading, heading_before, then = state, before, answered or before
        # The agreed time may be shorter than the robot's, whose speed would then seem higher.
        states = (state.sequence - before.sequence) & 0xFFFFFFFF
        step_s = max(self._cycle_state.last_step_s, states * self._nominal_s)
        self._generator.resync((heading, heading_before, then), step_s, gap_s)

    def _ordered(
        self, joints: tuple[float, ...], outside: tuple[float, ...]
    ) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Reorder joints to kinematic order and true external axes, in SI units."""
        if self._joints == 7 and joints:
            joints = (*joints[:2], math.radians(outside[0]), *joints[2:])
            outside = outside[1:]
        return joints, tuple(
            value * factor for value, factor in zip(outside, self._external_factors, strict=False)
        )

    # -- answers --------------------------------------------------------------------------------

    def _capabilities(self) -> RobotCapabilities:
        outputs = self.options.mode != "path-correction"
        return RobotCapabilities(
            self._generator.kinds,
            self._nominal_s,
            self._joints,
            self.options.joint_limits,
            1 if outputs else 0,
            DNUM_MAX if outputs else 0,
            self.options.linear_speed_m_s if self._needs_pose else None,
            math.radians(self.options.angular_speed_deg_s) if self._needs_pose else None,
            robot=self.options.robot or "",
        )

    @property
    def outputs(self) -> EgmRapidData:
        """Values sent to the RAPID program with every answer."""
        return self._outputs

    def check(self, command: RobotCommand) -> None:
        """Raise CommandError, saying what is allowed, unless `reply` can take `command`."""
        check_command("EGM", command, self._generator.check)

    def reply(self, command: RobotCommand, now_s: float) -> bytes:
        """Return the answer to the last accepted datagram, once.

        While commands do not act, it is the measured position. Raises CommandError for a command
        that cannot be sent in this mode; the datagram is then still to be answered.
        """
        state = self.state
        if self.reply_pending and state is not None:
            generator = self._generator
            # The usual case of every cycle after the first.
            answer = generator.answer(command, now_s, state, self._suffix)
            if answer is not None:
                generator.asked = command
                self.counters.answers += 1
                self._answered = self._newest
                self.reply_pending = False
                return answer
            self.check(command)
        return self._reply(command, now_s)

    def _reply(self, command: RobotCommand | None, now_s: float) -> bytes:
        state = self.state
        if state is None or not self.reply_pending:
            raise CommandError("there is no datagram to answer")
        generator = self._generator
        nominal_s = self._nominal_s
        dt_s = self._cycle_state.since_reply_s
        gap_s = 0.0
        if dt_s > _GAP_PERIODS * nominal_s:
            gap_s, dt_s = dt_s - nominal_s, nominal_s
        if state.hold_reason:
            # If commands act after all, the robot brakes and does not halt within one period.
            obeys = self._cycle_state.said_speed and not self._fresh and generator.near(state)
            if not obeys:
                generator.reset(state)
            elif dt_s > 0.0:
                generator.step(None, state, dt_s)
            self._held = obeys
        else:
            timeout_s = self._late_after_s
            if self._held and not generator.near(state):
                generator.reset(state)
            self._held = False
            if now_s - self._cycle_state.replied_s > timeout_s:
                self.counters.late_commands += 1
            if gap_s:
                self._follow_controller(state, gap_s)
            # If no time has passed by both clocks, the answer is repeated.
            if dt_s > 0.0:
                late = now_s - state.stamp_s > timeout_s
                generator.step(None if late else command, state, dt_s)
        self.counters.answers += 1
        self._cycle_state.steady = generator.steady and not self._held
        return self._encode(now_s)

    def hold(self, now_s: float) -> bytes:
        self.counters.driver_holds += 1
        return self._reply(None, now_s)

    def answered(self, now_s: float) -> None:
        """Record that the answer was sent at `now_s`, and do deferred work."""
        state = self.state
        if state is None:
            return
        self._past = None
        self.reply_latency.add(now_s - state.stamp_s)
        self.jitter.add(self._newest[2])
        self._reader.learn()
        tm_ms, before_ms = self._cycle_state.tm_ms, self._tm_ms
        if tm_ms != UNKNOWN:
            self._tm_ms = tm_ms
            if before_ms != UNKNOWN:
                self._tm_s += 1e-3 * (((tm_ms - before_ms + _HALF) & _MASK) - _HALF)
            self.clock.heard(self._tm_s, state.stamp_s)
        if not state.hold_reason and self.slow_motion.due():
            heading = self._heading(self.message, state)
            self.slow_motion.look(heading and self._generator.progress(heading), now_s)

    def send_failed(self, reason: str) -> None:
        """Record that the answer could not be sent."""
        self.counters.send_errors += 1
        self.last_send_error = reason

    def final_command(self, now_s: float) -> bytes | None:
        """Return the final message to the controller: the last position with zero speed.

        None if the last message had that already, no controller is known, or its run is over. It is
        neither counted nor timed as an answer.
        """
        if (
            not (self.reply_pending or self._cycle_state.said_speed)
            or self.peer is None
            or self.state is None
        ):
            return None
        if self.is_over(now_s):
            return None
        if self._cycle_state.replied_s == NEVER_S:
            self._generator.reset(self.state)
        self.counters.final_commands += 1
        return self._encode(now_s, still=True)

    def is_over(self, now_s: float) -> bool:
        """True if the run of the newest datagram is over, because none came for the controller's
        CommTimeout. A message sent now would be the first of its next run."""
        return now_s - self._last_s > self._comm_timeout_s

    @property
    def moving(self) -> bool:
        return bool(self._cycle_state.said_speed)

    def _encode(self, now_s: float, still: bool = False) -> bytes:
        data = self._generator.encode(
            self._cycle_state.out_seqno, self._stamp_ms(now_s), self._suffix, still
        )
        self._note_sent(now_s, not still and self._generator.moving)
        return data

    def _stamp_ms(self, now_s: float) -> int:
        """Time stamp of a message: the controller's own, or ours if it sends none."""
        tm_ms = self._cycle_state.tm_ms
        return int(now_s * 1e3) & _MASK if tm_ms == UNKNOWN else tm_ms

    def _note_sent(self, now_s: float, said_speed: bool) -> None:
        cycle_state = self._cycle_state
        cycle_state.out_seqno = (cycle_state.out_seqno + 1) & _MASK
        cycle_state.said_speed = said_speed
        cycle_state.replied_s = now_s
        cycle_state.since_reply_s = 0.0
        self._fresh = False
        self._answered = self._newest
        self.reply_pending = False

    def set_outputs(self, digital: bool | None = None, values: Sequence[float] = ()) -> None:
        """Set RAPIDtoRobot of all further messages; None and () leave the previous values.

        Raises CommandError for values EGM cannot carry.
        """
        if self.options.mode == "path-correction":
            raise CommandError("path correction carries no outputs; use pose or joint mode")
        if len(values) > DNUM_MAX:
            raise CommandError(f"values has {len(values)} numbers; EGM carries up to {DNUM_MAX}")
        if refused := outside("values", values, OUTPUT_VALUE):
            raise CommandError(refused)
        before = self._outputs
        self._outputs = EgmRapidData(
            before.dig_val if digital is None else bool(digital),
            tuple(map(float, values)) or before.dnum,
        )
        if digital is not None or values:
            self._suffix = encode_rapid_to_robot(self._outputs)

    # -- insight --------------------------------------------------------------------------------

    @property
    def message(self) -> EgmRobot | None:
        """Newest accepted message in full. None before the first, and if a part that no answer
        depends on is malformed (which is counted here)."""
        data = self._newest[1]
        known, message = self._full
        if data and known is not data:
            decoded = decode_robot(data)
            message = None
            if isinstance(decoded, MalformedEgmMessage):
                self._refuse(decoded)
            else:
                message = decoded
            self._full = (data, message)
        return message

    @property
    def _last_s(self) -> float:
        """Time at which the newest datagram was accepted, s."""
        state = self.state
        return NEVER_S if state is None else state.stamp_s

    @property
    def _seqno(self) -> int:
        """Sequence number of the newest datagram."""
        state = self.state
        return 0 if state is None else state.sequence

    def _last_orientation(self) -> Quaternion | None:
        state = self.state
        if state is None or state.pose is None:
            return self._orientation
        return state.pose.orientation

    @property
    def hold_reason(self) -> str:
        """Reason why the controller's states inhibit commands; empty if they do not."""
        return self._hold_reason

    @property
    def silent(self) -> bool:
        """True if the controller was heard and is lost now."""
        return self._silent

    def silence_s(self, now_s: float) -> float:
        """Time since the last accepted datagram, or since the start, s."""
        return now_s - (self.opened_s if self.state is None else self._last_s)

    def metrics(self) -> dict[str, float]:
        counters = self.counters
        state = self.state
        intervals = counters.accepted - self._session_first - 1
        figures: dict[str, float] = {
            "sessions": self.sessions,
            "datagrams": counters.accepted,
            "answers": counters.answers,
            "final_commands": counters.final_commands,
            "lost": counters.lost,
            "duplicates": counters.duplicates,
            "old": counters.old,
            "superseded": counters.superseded,
            "foreign": counters.foreign,
            "malformed": sum(counters.malformed.values()),
            "late_commands": counters.late_commands,
            "driver_holds": counters.driver_holds,
            "send_errors": counters.send_errors,
            "period_s": (self._last_s - self._session_s) / intervals if intervals > 0 else 0.0,
            "period_jitter_p99_s": self.jitter.percentile(99.0),
            "reply_latency_median_s": self.reply_latency.percentile(50.0),
            "reply_latency_p99_s": self.reply_latency.percentile(99.0),
            "reply_latency_max_s": self.reply_latency.max,
        }
        if state is not None and state.utilization is not None:
            figures["utilization"] = state.utilization
        figures.update({f"malformed_{kind}": n for kind, n in counters.malformed.items()})
        return figures

    def protocol_errors(self) -> dict[str, int]:
        counters = self.counters
        return {**counters.malformed, "order": counters.duplicates + counters.old}

    def diagnosis(self, now_s: float) -> tuple[str, ...]:
        return diagnose(self, now_s)


_CLOCK_MAX_US = 2**62
"""Largest plausible time of a controller's clock, µs: 146 000 years."""

_USUAL = COORDINATE_M.highest
"""Largest sum of magnitudes that proves every number to be within its range."""


def _implausible(
    joints: tuple[float, ...],
    external: tuple[float, ...],
    position: Vector3 | None,
    orientation: Quaternion | None,
) -> str:
    """Explain why values are implausible; empty if they are plausible."""
    return (
        outside("feedBack.joints", joints, JOINT_POSITION)
        or outside("feedBack.externalJoints", external, JOINT_POSITION)
        or ("" if position is None else outside("feedBack.pos", position, COORDINATE_M))
        or ("" if orientation is None else no_rotation("feedBack.orient", orientation))
    )


def _pose(position: Vector3, orientation: Quaternion, previous: Quaternion | None) -> Pose | None:
    """Make a pose whose quaternion is near that of `previous`; None if it is no rotation."""
    w, x, y, z = orientation
    squared = w * w + x * x + y * y + z * z
    if not -_ROUNDING < squared - 1.0 < _ROUNDING:
        if no_rotation("", orientation):
            return None
        w, x, y, z = orientation = normalized(orientation)
    if previous is not None:
        pw, px, py, pz = previous
        if w * pw + x * px + y * py + z * pz < 0.0:
            orientation = Quaternion(-w, -x, -y, -z)
    return _new(Pose, (position, orientation, _BASE))
