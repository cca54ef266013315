"""The RAPID side: the program's EGM instructions, their states, and what stops them.

Source: ABB Application manual, Externally Guided Motion (3HAC073318-001), EGM state transitions
and RAPID reference; event numbers from ABB's event logs as users published them.
"""

from __future__ import annotations

import enum
import math
from collections import Counter, deque
from collections.abc import Callable, Sequence

from cardan.protocols.egm.messages import (
    EgmRapidData,
    EgmSensor,
    EgmSensorPathCorr,
    MCIState,
)
from cardan.sim_peers.egm_controller.arguments import Act, Mode, PathMove, Run, Setup, StopMode
from cardan.sim_peers.egm_controller.events import (
    EMERGENCY_STOP,
    MODE_MISMATCH,
    MOTION_SUPERVISION,
    MOTORS_OFF,
    MOTORS_ON,
    MOVE_NOT_ALLOWED,
    NO_DATA,
    PROGRAM_STARTED,
    PROGRAM_STOPPED,
    Event,
)
from cardan.sim_peers.egm_controller.guidance import (
    JOINT_OUT_OF_RANGE,
    UNNUMBERED,
    Guidance,
    JointGuidance,
    MotionError,
    PathGuidance,
    PoseGuidance,
    Tuning,
)
from cardan.sim_peers.egm_controller.motion import Servo
from cardan.sim_peers.egm_controller.movements import Movements
from cardan.sim_peers.egm_controller.options import EgmControllerOptions
from cardan.sim_peers.egm_controller.program import Program

_LEVEL_1_DELAY_CYCLES = 2
"""Level 1 filters and so acts later than Level 0; the manual says that, but not how much."""

_STREAM_RATE_MS = 4
_PATH_RATE_MS = 48
_PATH_LEVEL = 2
_ECHO_AFTER_S = 0.024
"""How long a RAPID loop takes to read an input and set an output."""

_COLLISION_SHOWN_S = 0.2


class EgmState(enum.IntEnum):
    """RAPID's egmstate; ordered."""

    DISCONNECTED = 0
    CONNECTED = 1
    RUNNING = 2


class OnError(enum.Enum):
    """What happens some time after EGM ended with an error."""

    STOP = "stop"
    """Nothing: the program stands until somebody starts it."""
    RETRY = "retry"
    """The program's error handler runs EGM again; it gets recoverable errors only."""
    RESTART = "restart"
    """An operator moves the program pointer to main and starts the program."""


class RapidTask:
    """The motion task: one method per RAPID instruction or panel action, and `tick`."""

    def __init__(self, options: EgmControllerOptions, servo: Servo, noted: Counter[str]) -> None:
        self.options = options
        self.servo = servo
        self.events: list[Event] = []
        self.session = 0
        """Counts the times that sending began."""
        self.connections = 0
        """Counts the times that the UdpUc device was opened."""
        self.move_index = 0
        self.motors_on = True
        self.program_running = True
        self.streaming = False
        self.converged = False
        self.guidance: Guidance | None = None
        self.last_accepted_s = 0.0
        self.rapid_in: EgmRapidData | None = None
        """What the PC sent last in RAPIDtoRobot."""
        self.rapid_out = EgmRapidData(False, ())
        """What is sent in RAPIDfromRobot."""
        self.echo = options.rapid_echo
        self._noted = noted
        self._now_s = 0.0
        self._emergency = False
        self._failed = False
        self._needs_jog = False
        self._collision_until_s = -math.inf
        self._identity = False
        self._setup: Setup | None = None
        self._act: Act | None = None
        self._run: Run | None = None
        self._path: PathMove | None = None
        self._program = Program()
        self._at_main = False
        self._interrupted = False
        self._no_restart = False
        self._run_started_s = 0.0
        self._heard = False
        self._converged_since_s: float | None = None
        self._start_joints: list[float] = list(servo.planned)
        self._movements = Movements(servo)
        self._tail_until_s: float | None = None
        self._moved = False
        self._on_error = OnError.STOP
        self._on_error_after_s = 0.0
        self._loop = False
        self._then: tuple[float, Callable[[], None]] | None = None
        self._echoes: deque[tuple[float, EgmRapidData]] = deque()

    # ------------------------------------------------------------------------------------
    # What shows on the wire

    @property
    def state(self) -> EgmState:
        """RAPID's egmstate."""
        if not self._identity:
            return EgmState.DISCONNECTED
        return EgmState.RUNNING if self.streaming or self.guidance else EgmState.CONNECTED

    @property
    def mci_state(self) -> MCIState:
        """State of the motion correction interface."""
        if self.guidance is not None:
            return MCIState.RUNNING
        return MCIState.ERROR if self._failed else MCIState.STOPPED

    @property
    def sending(self) -> bool:
        """True while datagrams go out: streaming, guided, or coming to rest after that."""
        return self.streaming or self.guidance is not None or self._tail_until_s is not None

    @property
    def sample_rate_ms(self) -> int:
        """Nominal time between datagrams."""
        act = self._act
        if act is None:
            return _STREAM_RATE_MS
        if act.sample_rate_ms is not None:
            return act.sample_rate_ms
        return _PATH_RATE_MS if act.mode is Mode.PATH else _STREAM_RATE_MS

    @property
    def active_guidance_at_level_0(self) -> bool:
        """When torqueRef is filled."""
        return self.guidance is not None and self._level() == 0

    @property
    def collision(self) -> bool:
        """True just after a collision."""
        return self._now_s < self._collision_until_s

    def log(self, code: int, text: str) -> None:
        """Add a line to the event log."""
        self.events.append(Event(self._now_s, code, text))

    # ------------------------------------------------------------------------------------
    # RAPID instructions

    def execute(self, instruction: Callable[[], None]) -> None:
        """Reach `instruction` (one of those below) in the program, after those before it.

        Like RAPID's, instructions wait until a movement has come to its fine point.
        """
        if not self.program_running:
            self.log(UNNUMBERED, "an instruction is not reached: the program is stopped")
            return
        self._program.append(instruction)
        self._advance()

    def get_id(self) -> None:
        """EGMGetId."""
        if self._runs("EGMGetId") and not self._identity:
            self._identity = True
            self.connections += 1

    def setup(self, arguments: Setup) -> None:
        """EGMSetupUC."""
        if self._runs("EGMSetupUC") and self._needs("EGMSetupUC", self._identity, "EGMGetId"):
            self._setup = arguments
            self._act = None
            self._program.record("setup", lambda: self.setup(arguments))

    def act(self, arguments: Act) -> None:
        """EGMActJoint, EGMActPose or EGMActMove; the last one counts."""
        if not self._runs("EGMAct") or not self._needs("EGMAct", self._setup, "EGMSetupUC"):
            return
        if arguments.mode is Mode.PATH and (rate := arguments.sample_rate_ms) and rate % 24:
            self._rapid_error(UNNUMBERED, f"SampleRate {rate} is not a multiple of 24 ms")
            return
        self._act = arguments
        self._program.record("act", lambda: self.act(arguments))
        if arguments.stream_start:
            self._start_streaming()

    def stream_start(self) -> None:
        """EGMStreamStart."""
        if self._runs("EGMStreamStart") and self._needs("EGMStreamStart", self._act, "EGMAct"):
            self._program.record("stream", self.stream_start)
            self._start_streaming()

    def stream_stop(self) -> None:
        """EGMStreamStop."""
        if self._runs("EGMStreamStop"):
            self._program.forget("stream")
            self.streaming = False

    def run(self, arguments: Run) -> None:
        """EGMRunJoint or EGMRunPose."""
        if arguments.mode is Mode.PATH:
            self._rapid_error(UNNUMBERED, "there is no EGMRun for path correction: use EGMMoveL")
            return
        if not self._ready_to_move("EGMRun", arguments.mode):
            return
        self._program.record("motion", lambda: self.run(arguments))
        if arguments.axes:
            self._run, self._path = arguments, None
            self._start_joints = list(self.servo.planned)
            self._begin()

    def egm_move(self, arguments: PathMove) -> None:
        """EGMMoveL with path correction."""
        if not self._ready_to_move("EGMMoveL", Mode.PATH):
            return
        self._program.record("motion", lambda: self.egm_move(arguments))
        self._run, self._path = None, arguments
        self._start_joints = list(self.servo.planned)
        self._begin()

    def stop(self, mode: StopMode = StopMode.HOLD, ramp_out_s: float | None = None) -> None:
        """EGMStop."""
        if self._runs("EGMStop"):
            self.streaming = False
            if self.guidance is not None:
                ramp_s = self.options.ramp_time_s if ramp_out_s is None else ramp_out_s
                self._end(mode, ramp_s, ramp_s)

    def reset(self) -> None:
        """EGMReset."""
        if self._runs("EGMReset"):
            self._release()

    def move(self, joints: Sequence[float] | None) -> None:
        """MoveAbsJ to `joints` (rad; None: to where the arm is), to a fine point."""
        if not self._runs("MoveAbsJ"):
            return
        if self.guidance is not None:
            self._fail(
                MotionError(MOVE_NOT_ALLOWED, "Move not allowed in External Motion Interface")
            )
            return
        if not self.motors_on:
            self._rapid_error(UNNUMBERED, "MoveAbsJ: motors are off")
            return
        self._program.record("move", lambda: self.move(joints))
        self._moved = True
        here = self.servo.planned
        if joints is not None and any(abs(b - a) > 1e-9 for a, b in zip(here, joints, strict=True)):
            self._go(joints)

    # ------------------------------------------------------------------------------------
    # Panel, operator and world

    def on_error(self, policy: OnError, after_s: float) -> None:
        """Choose what happens `after_s` after EGM ended with an error."""
        self._on_error, self._on_error_after_s = policy, after_s

    def loop(self, on: bool) -> None:
        """Whether the program runs EGM again when a run ends, as WHILE TRUE does."""
        self._loop = on

    def pp_to_main(self) -> None:
        """Move the program pointer to main; a running program is stopped first."""
        self.program_stop()
        self._interrupted = False
        self._at_main = True

    def program_stop(self) -> None:
        """Stop the program."""
        if self.program_running:
            self._stop_program()
            self._interrupt(self.options.ramp_time_s)

    def program_start(self) -> None:
        """Start the program: from main, or where it was stopped."""
        if self.program_running:
            return
        if self._emergency or not self.motors_on:
            self.log(UNNUMBERED, "the program cannot start: motors are off")
            return
        self.program_running = True
        self._failed = False
        self.log(PROGRAM_STARTED, "Program started")
        if self._at_main:
            self._at_main = False
            self._when_standing(self._run_main)
        elif self._interrupted:
            self._interrupted = False
            if self._no_restart:
                self._no_restart = False
                self.log(UNNUMBERED, "EGM does not restart after motors off")
                return
            if self._path is not None:
                self._go(self._start_joints)
            self._when_standing(self._begin)

    def restart_program(self) -> None:
        """What an operator does to begin again: program pointer to main, start."""
        self.pp_to_main()
        self.program_start()

    def set_motors(self, on: bool) -> None:
        """Motors on (which also acknowledges an emergency stop) or off."""
        if on and not self.motors_on:
            self.motors_on = True
            self._emergency = False
            self.log(MOTORS_ON, "Motors ON state")
        elif not on and self.motors_on:
            self._motors_off()

    def emergency_stop(self) -> None:
        """Press the emergency stop."""
        if not self._emergency:
            self._emergency = True
            self.log(EMERGENCY_STOP, "Emergency stop state")
            self._motors_off()

    def collide(self) -> None:
        """Let the motion supervision see a collision."""
        self._collision_until_s = self._now_s + _COLLISION_SHOWN_S
        self._fail(MotionError(MOTION_SUPERVISION, "Motion supervision"))

    def jog(self, joints: Sequence[float]) -> bool:
        """Jog the arm to `joints` (rad) by hand; False when that is not possible now.

        At once while no datagrams go out, else as a movement.
        """
        if self.guidance is not None or not self.motors_on:
            self.log(UNNUMBERED, "jogging is not possible: EGM moves the arm, or motors are off")
            return False
        self._needs_jog = False
        self._moved = True
        if self.sending or self._movements.busy:
            self._go(joints)
        else:
            self.servo.place(joints)
        return True

    def power_cycle(self) -> None:
        """The controller restarts: nothing is left but the program itself."""
        self._release()
        self._movements.clear()
        self.servo.place(self.servo.actual)
        self._tail_until_s = None
        self._then = None
        self._failed = self._emergency = self._interrupted = False
        self._at_main = True
        self._moved = False
        self.motors_on = True
        self.program_running = False

    # ------------------------------------------------------------------------------------
    # Each cycle

    def accept(self, message: EgmSensor | EgmSensorPathCorr) -> str:
        """Give the PC's message to EGM; the reason when it is ignored, else empty."""
        if isinstance(message, EgmSensor) and message.rapid_to_robot is not None:
            self.rapid_in = message.rapid_to_robot
            if self.echo:
                self._echoes.append((self._now_s + _ECHO_AFTER_S, message.rapid_to_robot))
        if self.guidance is None:
            return "not in EGMRun"
        try:
            reason = self.guidance.accept(message)
        except MotionError as error:
            self._fail(error)
            return "out of bounds"
        if not reason:
            self.last_accepted_s = self._now_s
            self._heard = True
        return reason

    def set_time(self, now_s: float) -> None:
        """The time that events get, s since the start of the controller."""
        self._now_s = now_s

    def tick(self) -> None:
        """Move for one control cycle."""
        while self._echoes and self._echoes[0][0] <= self._now_s:
            self.rapid_out = self._echoes.popleft()[1]
        if self.guidance is not None:
            try:
                self._guide(self.guidance)
                return
            except MotionError as error:
                self._fail(error)
        self._follow_up()

    def _guide(self, guidance: Guidance) -> None:
        """One cycle of guidance. Raises MotionError before anything has moved."""
        servo = self.servo
        if self._now_s - self.last_accepted_s > self._comm_timeout_s():
            raise MotionError(NO_DATA, "No data from the UdpUc device")
        if (axis := servo.out_of_range()) is not None:
            raise MotionError(
                JOINT_OUT_OF_RANGE,
                f"Joint out of range: joint {axis + 1} = {math.degrees(servo.planned[axis]):.3f}",
            )
        act = self._act
        if self._run is None or act is None:
            cap = math.inf
        else:
            cap = math.radians(act.max_speed_deviation_deg_s)
            furthest = math.radians(act.max_pos_deviation_deg)
            for axis, (q, q0) in enumerate(zip(servo.planned, self._start_joints, strict=True)):
                if abs(q - q0) > furthest:
                    raise MotionError(
                        UNNUMBERED, f"joint {axis + 1} is beyond MaxPosDeviation of its start"
                    )
        speeds = guidance.speeds(self._now_s - self._run_started_s)
        factor = self.options.dynamic_load_factor
        if factor > 0.0 and servo.demanded_acceleration(speeds, cap) > factor:
            raise MotionError(UNNUMBERED, "Dynamic load too high")
        servo.drive(speeds, cap)
        if guidance.done:
            self._end(StopMode.HOLD, 0.0, 0.0)
        elif self._run is not None:
            self._watch_convergence(guidance, self._run)

    def _watch_convergence(self, guidance: Guidance, run: Run) -> None:
        # Before the first message there is nothing to converge to.
        self.converged = self._heard and guidance.converged()
        if not self.converged:
            self._converged_since_s = None
        elif self._converged_since_s is None:
            self._converged_since_s = self._now_s
        elif self._now_s - self._converged_since_s >= run.cond_time_s:
            ramp_s = self.options.ramp_time_s if run.ramp_out_s is None else run.ramp_out_s
            self._end(run.stop_mode, 0.0, ramp_s)

    def _follow_up(self) -> None:
        """One cycle without guidance: come to rest, go where told, then go on."""
        if not self._movements.tick():
            return
        if self._tail_until_s is not None and self._now_s >= self._tail_until_s:
            self._tail_until_s = None
        if self._then is not None and self._now_s >= self._then[0] and not self.tail:
            action = self._then[1]
            self._then = None
            action()
        self._advance()

    @property
    def tail(self) -> bool:
        """True while only the end of a session is being sent."""
        return self._tail_until_s is not None

    # ------------------------------------------------------------------------------------
    # Inside

    def _level(self) -> int:
        if self.options.level is not None:
            return self.options.level
        return _PATH_LEVEL if self._act is not None and self._act.mode is Mode.PATH else 1

    def _comm_timeout_s(self) -> float:
        if self._setup is None or self._setup.mode is Mode.PATH:
            return math.inf
        return self._setup.comm_timeout_s

    def _runs(self, instruction: str) -> bool:
        if not self.program_running:
            self.log(UNNUMBERED, f"{instruction} is not reached: the program is stopped")
        return self.program_running

    def _needs(self, instruction: str, there: object, before: str) -> bool:
        if there:
            return True
        self._rapid_error(UNNUMBERED, f"{instruction} before {before}")
        return False

    def _rapid_error(self, code: int, text: str) -> None:
        self.log(code, text)
        if self.guidance is not None:
            self._fail(MotionError(code, text), logged=True)
        elif self.program_running:
            self._stop_program()

    def _stop_program(self) -> None:
        self.program_running = False
        self._program.stop()
        self.log(PROGRAM_STOPPED, "Program stopped")

    def _advance(self) -> None:
        """Execute what is next in the program, as far as it goes without waiting."""
        while not self._program.finished and self.program_running and not self._movements.busy:
            self._program.step()

    def _run_main(self) -> None:
        """Execute the program from its first instruction, as far as it came so far."""
        self._release()
        self._program.restart(self.get_id)
        self._advance()

    def _ready_to_move(self, instruction: str, mode: Mode) -> bool:
        if not self._runs(instruction) or not self._needs(instruction, self._act, "EGMAct"):
            return False
        setup, act = self._setup, self._act
        if setup is None or act is None or not (setup.mode is act.mode is mode):
            self._rapid_error(
                MODE_MISMATCH,
                f"EGM mode mismatch: {instruction} {mode.value} after "
                f"EGMSetupUC {setup.mode.value if setup else '-'} and "
                f"EGMAct {act.mode.value if act else '-'}",
            )
            return False
        obstacle = ""
        if not self.motors_on:
            obstacle = "motors are off"
        elif self.guidance is not None:
            obstacle = "EGM is running already"
        elif not self._moved:
            obstacle = "the first movement after a controller start must not be EGM"
        elif not self.servo.at_rest or self._movements.busy:
            obstacle = "the robot does not stand in a fine point"
        elif (self._level() == _PATH_LEVEL) is not (mode is Mode.PATH):
            obstacle = f"Level {self._level()} is not for mode {mode.value}"
        elif self._needs_jog:
            obstacle = "close to a singularity: jog the robot away first"
        if obstacle:
            self._rapid_error(UNNUMBERED, f"{instruction}: {obstacle}")
        return not obstacle

    def _start_streaming(self) -> None:
        if not self.streaming:
            self._new_session()
            self.streaming = True
            self._failed = False

    def _new_session(self) -> None:
        if not self.streaming and self.guidance is None:
            self.session += 1
            self._tail_until_s = None

    def _begin(self) -> None:
        """Start guidance with the arguments of the last EGMRun or EGMMove."""
        act, options = self._act, self.options
        if act is None or (self._run is None and self._path is None):
            return
        if not self.motors_on or not self.program_running:
            return
        filter_hz = act.lp_filter_hz if act.lp_filter_hz > 0.0 else options.default_lp_filter_hz
        tuning = Tuning(
            options.k,
            filter_hz if filter_hz > 0.0 else None,
            _LEVEL_1_DELAY_CYCLES if self._level() == 1 else 0,
            options.singularity_threshold,
            options.path_correction_absolute,
        )
        guidance: Guidance
        try:
            if self._run is None:
                assert self._path is not None
                guidance = PathGuidance(self.servo, tuning, self._path, self._noted)
            elif self._run.mode is Mode.JOINT:
                guidance = JointGuidance(self.servo, tuning, act, self._run, self._noted)
            else:
                guidance = PoseGuidance(self.servo, tuning, act, self._run, self._noted)
        except MotionError as error:
            self._rapid_error(error.code, error.text)
            return
        self._new_session()
        self._failed = False
        self.guidance = guidance
        self.move_index += 1
        self.converged = False
        self._converged_since_s = None
        self._run_started_s = self.last_accepted_s = self._now_s
        self._heard = False

    def _end(self, mode: StopMode, brake_s: float, return_s: float) -> None:
        """Guidance ends as planned: convergence, EGMStop, end of the path."""
        self._movements.clear()
        self.guidance = None
        self.streaming = False
        self.converged = False
        self._movements.brake(brake_s)
        if mode is StopMode.RAMP_DOWN:
            self.move_index += 1
            self._movements.go(self._start_joints, return_s)
        if brake_s > 0.0 or mode is StopMode.RAMP_DOWN:
            self._tail_until_s = self._now_s
        if self._loop:
            self._when_standing(self._begin)

    def _interrupt(self, ramp_s: float) -> None:
        """Guidance is interrupted, to go on when the program does."""
        if self.guidance is None:
            return
        self._movements.clear()
        self.guidance = None
        self.converged = False
        self._interrupted = True
        self._movements.brake(ramp_s)
        self._tail_until_s = self._now_s + self.options.ramp_time_s

    def _motors_off(self) -> None:
        self.motors_on = False
        self.log(MOTORS_OFF, "Motors OFF state")
        self._no_restart = (
            self.guidance is not None and self.options.do_not_restart_after_motors_off
        )
        guided = self.guidance is not None
        self._interrupt(0.0)
        if not guided:
            self._movements.clear()
        if self.program_running:
            self._stop_program()

    def _fail(self, error: MotionError, logged: bool = False) -> None:
        """Guidance, or whatever moves, ends with an error."""
        if not logged:
            self.log(error.code, error.text)
        recoverable = error.code == NO_DATA and self._run is not None and not self._run.no_wait
        self._interrupted = self.guidance is not None
        self._movements.clear()
        self.guidance = None
        self.streaming = False
        self.converged = False
        self._failed = True
        self._needs_jog = self._needs_jog or error.needs_jog
        ramp_s = self.options.ramp_time_s if error.code == NO_DATA else 0.0
        self._movements.brake(ramp_s)
        self._tail_until_s = self._now_s + self.options.ramp_time_s
        if error.motors_off:
            self.motors_on = False
            self.log(MOTORS_OFF, "Motors OFF state")
        if self._on_error is OnError.RETRY and recoverable:
            self._interrupted = False
            self._when_standing(self._begin, self._on_error_after_s)
            return
        if self.program_running:
            self._stop_program()
        if self._on_error is OnError.RESTART and not self._needs_jog:
            self._when_standing(self._operator_restarts, self._on_error_after_s)

    def _operator_restarts(self) -> None:
        if self._emergency or self._needs_jog:
            return
        self.set_motors(True)
        if self.servo.out_of_range() is not None:
            arm = self.servo.arm
            self.jog(
                [
                    min(max(q, low), high)
                    for q, low, high in zip(self.servo.planned, arm.lower, arm.upper, strict=True)
                ]
            )
        self.restart_program()

    def _release(self) -> None:
        self.streaming = False
        if self.guidance is not None:
            self._interrupt(0.0)
            self._interrupted = False
            self._tail_until_s = None
        self._identity = False
        self._setup = self._act = self._run = self._path = None

    def _go(self, joints: Sequence[float]) -> None:
        self.move_index += 1
        self._movements.go(joints)

    def _when_standing(self, action: Callable[[], None], after_s: float = 0.0) -> None:
        """Do `action` once the arm stands, the session's end is sent and `after_s` is over."""
        self._then = (self._now_s + after_s, action)
