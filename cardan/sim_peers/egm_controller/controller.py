"""Sans-I/O core of the simulated controller's EGM side: datagrams in and out, in virtual time."""

from __future__ import annotations

import math
import random
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from typing import Any, NamedTuple

from cardan.errors import ScriptError
from cardan.protocols.egm.decode import decode_from_pc
from cardan.protocols.egm.encode import encode_robot
from cardan.protocols.egm.messages import (
    EgmCollisionInfo,
    EgmHeader,
    EgmMeasuredForce,
    EgmMessageType,
    EgmMotion,
    EgmPose,
    EgmRapidData,
    EgmRobot,
    EgmSensor,
    EgmSensorPathCorr,
    Fault,
    MalformedEgmMessage,
    MotorState,
    RapidState,
)
from cardan.sim_peers.base import TimedActions, load_script
from cardan.sim_peers.egm_controller.arguments import EgmAct, EgmRun, EgmSetup, PathMove, StopMode
from cardan.sim_peers.egm_controller.contact import ContactSurface, tcp_velocity, touch
from cardan.sim_peers.egm_controller.events import ControllerEventLog, EventMessage
from cardan.sim_peers.egm_controller.external_motion import EgmState
from cardan.sim_peers.egm_controller.faults import (
    CLOCK_STEP_AT_S,
    PAUSE_EVERY_S,
    RESTART_SILENCE_S,
)
from cardan.sim_peers.egm_controller.guidance import beyond_any_robot
from cardan.sim_peers.egm_controller.instructions import Instructions
from cardan.sim_peers.egm_controller.motion import ServoAxes
from cardan.sim_peers.egm_controller.options import EgmControllerOptions
from cardan.sim_peers.egm_controller.panel import Panel
from cardan.sim_peers.egm_controller.rapid import RapidTask
from cardan.sim_peers.egm_controller.scripts import (
    SCRIPT_VERBS,
    SCRIPTS,
    ScriptAction,
    compile_script,
)
from cardan.sim_peers.kinematics import AXES, GOFA, forward
from cardan.spatial import conjugate, norm, rotate, to_euler_zyx
from cardan.types import ZERO3, Pose, Vector3

SENDING_FAILED = 41830
SYSTEM_FAILURE = 10014

_CATCH_UP_CYCLES = 250
"""Most unserved cycles that are made up for silently; more are a pause of the whole process."""

_WRAP = 1 << 32
_FORCE_NOISE = (0.3, 0.3, 0.3, 0.02, 0.02, 0.02)
"""Standard deviation of the force sensor, N and N·m; a plausible one, none is published."""
_RAW_BIAS = (1.8, -2.6, 7.4, 0.11, -0.07, 0.05)
"""Reading of an uncompensated sensor without contact: its own offset and the tool, N and N·m."""
_NOISE_SAMPLES = 509
_INERTIA_KG_M2 = (4.0, 4.0, 1.8, 0.25, 0.2, 0.05)
_FRICTION_NM_S = (12.0, 12.0, 8.0, 2.0, 2.0, 1.0)
"""For torqueRef, which only has to vary plausibly: rough figures of a 28 kg arm."""
_QUIET_QUOTA = 3.0
_COLLISION_QUOTA = 130.0
"""Percent of the collision detection's threshold."""


class DatagramCounters(NamedTuple):
    """Counters of the datagrams."""

    sent: int
    accepted: int
    """Messages whose reference was used."""
    ignored: Mapping[str, int]
    """Ignored messages by reason."""
    flaws: Mapping[str, int]
    """Counts of messages that were accepted, but odd, by the reason."""


class EgmController:
    """A controller of a GoFa CRB 15000-5 as seen over EGM.

    Call `cycle` once per control period with increasing times, send the datagram that it returns to
    the PC, and pass the PC's datagrams to `receive`. The same calls with the same options give the
    same datagrams.
    """

    def __init__(
        self,
        options: EgmControllerOptions | None = None,
        wall_start_s: float = 1_700_000_000.0,
    ) -> None:
        self.options = options = EgmControllerOptions() if options is None else options
        self._wall_start_s = wall_start_s
        self._actions: deque[ScriptAction] = deque(
            compile_script(load_script(options.program, SCRIPTS, SCRIPT_VERBS))
        )
        self._profile = options.profile
        self._flaws: Counter[str] = Counter()
        self._ignored: Counter[str] = Counter()
        self._accepted = 0
        self._sent = 0
        start = [math.radians(q) for q in options.joints_deg]
        self.servo = ServoAxes(
            GOFA,
            options.period_s,
            options.servo_delay_s,
            start,
            math.radians(options.encoder_noise_deg),
            options.seed,
        )
        self._log = ControllerEventLog()
        self.rapid = RapidTask(options, self.servo, self._flaws, self._log)
        self._egm = self.rapid.egm
        self._instructions = Instructions(self.rapid)
        self._panel = Panel(self.rapid, self._instructions)
        self.port_changes = 0
        """Counts the changes of the local port that the shell has to make."""
        self._random = random.Random(options.seed)
        normal = random.Random(options.seed + 1).gauss
        self._force_noise = [
            [normal(0.0, deviation) for deviation in _FORCE_NOISE] for _ in range(_NOISE_SAMPLES)
        ]
        self._force_control = options.force_control
        self._contact = (0.0,) * AXES
        self._surface = options.surface
        self._pressing = ZERO3
        """The force that the TCP exerts on the surface, N, base axes."""
        self._hard = False
        self._queue: deque[bytes] = deque()
        self._first_s: float | None = None
        self._last_s = 0.0
        self._now_s = 0.0
        self._boot_s = 0.0
        self._tm_start_ms = options.tm_start_ms
        self._port_periods = 0
        self._off_until_s: float | None = None
        self._session = 0
        self._connections = 0
        self._seqno = options.seqno_start
        self._session_cycle = 0
        self._pc_seqno: int | None = None
        self._send_failing = False
        self._timed: TimedActions[Callable[[], None]] = TimedActions(
            options.faults,
            {
                "restart": self._restart,
                "estop": self._panel.emergency_stop,
                "motors-off": lambda: self._panel.set_motors(False),
            },
        )
        self._verbs = self._verb_table()

    # ------------------------------------------------------------------------------------
    # Datagrams in and out

    def receive(self, data: bytes) -> None:
        """Queue a datagram of the PC until a cycle takes it."""
        if self._off_until_s is not None:
            return
        if len(self._queue) >= self.options.queue_length:
            self._ignored["queue overflow"] += 1
        else:
            self._queue.append(data)

    def cycle(self, now_s: float) -> bytes | None:
        """Run a control cycle at `now_s`: measure, send, take one message, move.

        Returns the datagram of this cycle, None if none is due. Cycles skipped since the last call
        are made up for without datagrams.
        """
        if self._first_s is None:
            self._first_s = self._last_s = now_s
        missed = round((now_s - self._last_s) / self.options.period_s) - 1
        for n in range(min(missed, _CATCH_UP_CYCLES), 0, -1):
            self._set_time(now_s - self._first_s - n * self.options.period_s)
            self._move(self._due())
        self._last_s = now_s
        self._set_time(now_s - self._first_s)
        due = self._due()
        data = self._datagram() if due and not self._paused() else None
        self._move(due)
        return data

    def sending_failed(self) -> None:
        """Record that no program listens at the PC's address; called by the shell."""
        if not self._send_failing:
            self._send_failing = True
            self._log.add(SENDING_FAILED, "Error sending EGM UdpUc message (no program listens)")

    def sending_worked(self) -> None:
        """Record that the PC was heard; called by the shell."""
        self._send_failing = False

    # ------------------------------------------------------------------------------------
    # Diagnosis

    @property
    def state(self) -> EgmState:
        """RAPID's egmstate."""
        return self._egm.state

    @property
    def events(self) -> list[EventMessage]:
        """The event log, oldest first."""
        return self._log.events

    @property
    def counters(self) -> DatagramCounters:
        """Counters of the datagrams so far."""
        return DatagramCounters(self._sent, self._accepted, dict(self._ignored), dict(self._flaws))

    @property
    def joints_rad(self) -> tuple[float, ...]:
        """True joints of the arm."""
        return tuple(self.servo.actual)

    @property
    def planned_joints_rad(self) -> tuple[float, ...]:
        """Joints of the controller's reference; the arm reaches them `servo_delay_s` later."""
        return tuple(self.servo.planned)

    @property
    def joint_speeds_rad_s(self) -> tuple[float, ...]:
        """Speeds of the reference, which the arm has `servo_delay_s` later."""
        return tuple(self.servo.speeds)

    @property
    def joint_accelerations_rad_s2(self) -> tuple[float, ...]:
        """Accelerations of the reference, which the arm has `servo_delay_s` later."""
        return tuple(self.servo.accelerations)

    @property
    def tcp(self) -> Pose:
        """True pose of the TCP (tool0), base frame."""
        return forward(self.servo.actual, self.servo.arm.links).pose

    @property
    def contact_force(self) -> Vector3:
        """True force of the TCP on the surface, N, base axes; without noise and bias."""
        return self._pressing

    @property
    def planned_tcp(self) -> Pose:
        """Pose of the TCP by the controller's reference."""
        return self.servo.planned_frames.pose

    def jog_to(self, joints_deg: Sequence[float]) -> bool:
        """Jog the arm by hand; at once while no datagrams go out, else as a movement.

        Return False while EGM moves the arm or motors are off.
        """
        return self._panel.jog([math.radians(q) for q in joints_deg])

    def do(self, verb: str, **arguments: Any) -> None:
        """Execute a script's `verb` now; arguments as in `ScriptAction`. For tests and consoles."""
        if verb not in self._verbs:
            raise ScriptError(f"there is no verb {verb!r}; there are: {', '.join(self._verbs)}")
        self._verbs[verb](**arguments)

    # ------------------------------------------------------------------------------------
    # Time

    def _set_time(self, now_s: float) -> None:
        self._now_s = now_s
        self._log.now_s = now_s
        if self._off_until_s is not None:
            if now_s < self._off_until_s:
                return
            self._boot()
        every_s = self.options.faults.get("port-change", 0.0)
        if every_s > 0.0 and now_s >= (self._port_periods + 1) * every_s:
            self._port_periods = int(now_s / every_s)
            self.port_changes += 1
            self._queue.clear()
        for _, call in self._timed.due(now_s):
            call()
        while self._actions and self._actions[0].time_s <= now_s:
            action = self._actions.popleft()
            self._verbs[action.verb](**action.arguments)

    def _paused(self) -> bool:
        pause_s = self.options.faults.get("pause", 0.0)
        return self._now_s % PAUSE_EVERY_S > PAUSE_EVERY_S - pause_s

    def _restart(self) -> None:
        self._panel.power_cycle()
        self._queue.clear()
        self._off_until_s = self._now_s + RESTART_SILENCE_S

    def _boot(self) -> None:
        self._off_until_s = None
        self._boot_s = self._now_s
        self._tm_start_ms = 0
        self.port_changes += 1
        self._seqno = self.options.seqno_start
        self._panel.program_start()

    # ------------------------------------------------------------------------------------
    # Cycle

    def _due(self) -> bool:
        """True in the cycles in which EGM exchanges datagrams."""
        egm = self._egm
        if egm.connections != self._connections:
            self._connections = egm.connections
            self._queue.clear()
        if not egm.sending or self._off_until_s is not None:
            return False
        if egm.session != self._session:
            self._session = egm.session
            self._session_cycle = 0
            self._pc_seqno = None
            if self.options.seqno_restarts:
                self._seqno = self.options.seqno_start
        due = self._session_cycle % (egm.settings.sample_rate_ms // 4) == 0
        self._session_cycle += 1
        return due

    def _move(self, due: bool) -> None:
        if self._off_until_s is not None:
            return
        if due and self._queue and not self._paused():
            if self.options.newest_wins:
                data = self._queue.pop()
                if self._queue:
                    self._ignored["superseded"] += len(self._queue)
                    self._queue.clear()
            else:
                data = self._queue.popleft()
            self._take(data)
        self.rapid.tick()
        if self._surface is not None:
            self._touch(self._surface)

    def _take(self, data: bytes) -> None:
        message = decode_from_pc(data)
        if isinstance(message, MalformedEgmMessage):
            self._ignored[message.fault.value] += 1
            if message.fault is Fault.NOT_FINITE and self.options.nan_is_fatal:
                self._log.add(SYSTEM_FAILURE, "System failure state")
                self._restart()
                self._off_until_s = math.inf
            return
        reason = self._check_header(message)
        if not reason and beyond_any_robot(message):
            reason = "a number beyond any robot"
        reason = reason or self.rapid.accept(message)
        if reason:
            self._ignored[reason] += 1
        else:
            self._accepted += 1

    def _check_header(self, message: EgmSensor | EgmSensorPathCorr) -> str:
        header = message.header
        path = isinstance(message, EgmSensorPathCorr)
        expected = EgmMessageType.PATH_CORRECTION if path else EgmMessageType.CORRECTION
        if header is None or header.mtype != expected:
            if self.options.strict_mtype:
                return "unexpected mtype"
            self._flaws["unexpected mtype"] += 1
        if header is None or header.seqno is None:
            return ""
        last, self._pc_seqno = self._pc_seqno, header.seqno
        if last is not None and not 0 < (header.seqno - last) % _WRAP < _WRAP // 2:
            if self.options.strict_seqno:
                self._pc_seqno = last
                return "seqno did not advance"
            self._flaws["seqno did not advance"] += 1
        return ""

    # ------------------------------------------------------------------------------------
    # Content

    def _datagram(self) -> bytes:
        options, profile, servo = self.options, self._profile, self.servo
        rapid, egm = self.rapid, self._egm
        measured = servo.measured
        wall_s = self._wall_start_s + self._now_s
        if self._now_s >= CLOCK_STEP_AT_S:
            wall_s += options.faults.get("clock-step", 0.0)
        wall_ns = round(wall_s * 1e9)
        delay_ns = round(options.servo_delay_s * 1e9)
        tcp = forward(measured, servo.arm.links).pose
        if options.faults.get("rapid-undefined", 0.0) > 0.0:
            rapid_state = RapidState.UNDEFINED
        else:
            rapid_state = RapidState.RUNNING if rapid.program_running else RapidState.STOPPED
        tm_ms = self._tm_start_ms + round((self._now_s - self._boot_s) * 1e3)
        message = EgmRobot(
            header=EgmHeader(self._seqno % _WRAP, tm_ms % _WRAP, EgmMessageType.DATA),
            feed_back=self._motion(measured, tcp, wall_ns),
            planned=self._motion(servo.planned, servo.planned_frames.pose, wall_ns + delay_ns),
            motor_state=MotorState.ON if rapid.motors_on else MotorState.OFF,
            mci_state=egm.mci_state,
            mci_convergence_met=egm.converged,
            test_signals=(0.0,) * AXES,
            rapid_exec_state=rapid_state,
            measured_force=self._force(tcp) if options.force else None,
            utilization_rate=100.0 * servo.utilization if profile.utilization_rate else None,
            move_index=egm.move_index if profile.move_index else None,
            collision_info=self._collision() if profile.move_index else None,
            rapid_from_robot=rapid.rapid_out if profile.rapid_data else None,
            torque_ref=(self._torques() if profile.torque_ref and egm.guided_at_level_0 else None),
        )
        self._seqno += 1
        self._sent += 1
        return encode_robot(message)

    def _motion(self, joints: Sequence[float], tcp: Pose, wall_ns: int) -> EgmMotion:
        return EgmMotion(
            joints=tuple(joints),
            cartesian=EgmPose(
                tcp.position,
                tcp.orientation,
                to_euler_zyx(tcp.orientation) if self.options.euler else None,
            ),
            time_us=wall_ns // 1000,
            time_stamp_ns=wall_ns if self.options.ptp and self._profile.torque_ref else None,
        )

    def _force(self, tcp: Pose) -> EgmMeasuredForce:
        noise = self._force_noise[self._sent % _NOISE_SAMPLES]
        force = [c + n for c, n in zip(self._contact, noise, strict=True)]
        if self._pressing is not ZERO3:
            pressing = self._pressing
            if self.options.force_frame == "tool":
                pressing = rotate(conjugate(tcp.orientation), pressing)
            sense = 1.0 if self.options.force_sense == "exerted" else -1.0
            for n in range(3):
                force[n] += sense * pressing[n]
        if not self._force_control:
            force = [f + b for f, b in zip(force, _RAW_BIAS, strict=True)]
        return EgmMeasuredForce(
            tuple(force), self._force_control if self._profile.fc_active else None
        )

    def _touch(self, surface: ContactSurface) -> None:
        frames = forward(self.servo.actual, self.servo.arm.links)
        velocity = tcp_velocity(frames, self.servo.actual_speeds)
        self._pressing = touch(surface, frames.pose.position, velocity)
        most_n = self.options.collision_force_n
        hard = 0.0 < most_n < norm(self._pressing)
        if hard and not self._hard:
            self._panel.collide()
        self._hard = hard

    def _collision(self) -> EgmCollisionInfo:
        collision = self._panel.collision
        quota = _COLLISION_QUOTA if collision else _QUIET_QUOTA
        if self.options.collision_force_n:
            quota = max(quota, 100.0 * norm(self._pressing) / self.options.collision_force_n)
        return EgmCollisionInfo(collision, (quota,) * AXES)

    def _torques(self) -> tuple[float, ...]:
        servo = self.servo
        return tuple(
            i * a + f * v
            for i, a, f, v in zip(
                _INERTIA_KG_M2, servo.accelerations, _FRICTION_NM_S, servo.speeds, strict=True
            )
        )

    # ------------------------------------------------------------------------------------
    # Script verbs

    def _verb_table(self) -> dict[str, Callable[..., None]]:
        rapid, does, panel = self.rapid, self._instructions, self._panel
        return {
            "movej": self._movej,
            "getid": lambda: rapid.execute(does.get_id),
            "setup": self._executing(EgmSetup, does.setup),
            "act": self._executing(EgmAct, does.act),
            "stream-start": lambda: rapid.execute(does.stream_start),
            "stream-stop": lambda: rapid.execute(does.stream_stop),
            "run": self._executing(EgmRun, does.run),
            "egmmovel": self._egmmovel,
            "stop": self._stop,
            "reset": lambda: rapid.execute(does.reset),
            "loop": self._set_loop,
            "on-error": panel.on_error,
            "restart": panel.restart_program,
            "pp-to-main": panel.pp_to_main,
            "program-stop": panel.program_stop,
            "program-start": panel.program_start,
            "motors-off": lambda: panel.set_motors(False),
            "motors-on": lambda: panel.set_motors(True),
            "estop": panel.emergency_stop,
            "controller-restart": self._restart,
            "jog": self._jog,
            "collision": panel.collide,
            "contact": self._set_contact,
            "wall": self._set_surface,
            "force-control": self._set_force_control,
            "do": lambda on: self._set_output(dig_val=on),
            "dnum": lambda values: self._set_output(dnum=tuple(values)),
            "echo": self._set_echo,
        }

    def _with_defaults(self, kind: type[Any], arguments: Mapping[str, Any]) -> Any:
        """Return a script line's arguments as `kind`; options override them, and give the mode."""
        merged = {"mode": self.options.mode, **arguments}
        for field in fields(kind):
            override = getattr(self.options, field.name, None)
            if override is not None and field.name != "mode":
                merged[field.name] = override
        return kind(**merged)

    def _movej(self, joints_deg: Sequence[float] | None = None) -> None:
        target = None if joints_deg is None else [math.radians(q) for q in joints_deg]
        self.rapid.execute(lambda: self._instructions.move(target))

    def _jog(self, joints_deg: Sequence[float]) -> None:
        self.jog_to(joints_deg)

    def _executing(
        self, kind: type[Any], instruction: Callable[[Any], None]
    ) -> Callable[..., None]:
        """Return a verb that executes `instruction` with a script line's arguments as `kind`."""

        def execute(**arguments: Any) -> None:
            made = self._with_defaults(kind, arguments)
            self.rapid.execute(lambda: instruction(made))

        return execute

    def _egmmovel(self, **arguments: Any) -> None:
        move = PathMove(**arguments)
        self.rapid.execute(lambda: self._instructions.egm_move(move))

    def _stop(self, stop_mode: StopMode = StopMode.HOLD, ramp_out_s: float | None = None) -> None:
        self._instructions.stop(stop_mode, ramp_out_s)

    def _set_contact(self, wrench: Sequence[float]) -> None:
        self._contact = tuple(wrench)

    def _set_surface(self, surface: ContactSurface | None) -> None:
        self._surface = surface
        self._pressing = ZERO3

    def _set_force_control(self, on: bool) -> None:
        self._force_control = on

    def _set_output(
        self, dig_val: bool | None = None, dnum: tuple[float, ...] | None = None
    ) -> None:
        now = self.rapid.rapid_out
        self.rapid.rapid_out = EgmRapidData(
            now.dig_val if dig_val is None else dig_val, now.dnum if dnum is None else dnum
        )

    def _set_loop(self, on: bool) -> None:
        self.rapid.loop = on

    def _set_echo(self, on: bool) -> None:
        self.rapid.echo = on
