"""The RAPID motion task: state of program and motors, and its reaction to an error of EGM.

Event numbers are those of ABB's event logs as users published them.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from typing import NamedTuple

from cardan.protocols.egm.messages import EgmRapidData, EgmSensor, EgmSensorPathCorr
from cardan.sim_peers.egm_controller.arguments import EgmRun
from cardan.sim_peers.egm_controller.events import (
    MOTORS_OFF,
    NO_DATA,
    PROGRAM_STOPPED,
    UNNUMBERED,
    ControllerEventLog,
)
from cardan.sim_peers.egm_controller.external_motion import ExternalMotion
from cardan.sim_peers.egm_controller.guidance import GuidedMotion, MotionError
from cardan.sim_peers.egm_controller.guided_run import Ending, GuidedRun
from cardan.sim_peers.egm_controller.motion import ServoAxes
from cardan.sim_peers.egm_controller.options import EgmControllerOptions
from cardan.sim_peers.egm_controller.program import Instruction, RapidProgram

_ECHO_AFTER_S = 0.024
"""Time of a RAPID loop from reading an input to setting an output."""


class Recovery(NamedTuple):
    """Recovery `after_s` after EGM ended with an error; default: none."""

    after_s: float = 0.0
    retries: bool = False
    """The program's error handler runs EGM again; it gets recoverable errors only."""
    restart: Callable[[], None] | None = None
    """Action of an operator then, unless the arm has to be jogged first."""


class RapidTask:
    """The motion task: its program, the motors, and `tick`, which moves the arm.

    Instructions act on it through `Instructions`, the operator through `Panel`.
    """

    def __init__(
        self,
        options: EgmControllerOptions,
        servo: ServoAxes,
        flaws: Counter[str],
        log: ControllerEventLog,
    ) -> None:
        self.options = options
        self.servo = servo
        self.log = log
        self.egm = ExternalMotion(options, servo, flaws, log)
        self.program = RapidProgram()
        self.program_running = True
        self.motors_on = True
        self.moved = False
        """True once the arm has moved since the start of the controller."""
        self.needs_jog = False
        """True after an error that only jogging the arm away by hand ends."""
        self.loop = False
        """True if the program runs EGM again when a run ends, as in a WHILE TRUE loop."""
        self.recovery = Recovery()
        self.rapid_in: EgmRapidData | None = None
        """The PC's newest RAPIDtoRobot."""
        self.rapid_out = EgmRapidData(False, ())
        """Data sent in RAPIDfromRobot."""
        self.echo = options.rapid_echo
        """True if the program copies RAPIDtoRobot to RAPIDfromRobot."""
        self._echoes: deque[tuple[float, EgmRapidData]] = deque()
        self._then: tuple[float, Callable[[], None]] | None = None

    @property
    def guidance(self) -> GuidedMotion | None:
        """Guided motion of the active run."""
        return None if self.egm.run is None else self.egm.run.guidance

    # ------------------------------------------------------------------------------------
    # Each cycle

    def accept(self, message: EgmSensor | EgmSensorPathCorr) -> str:
        """Pass the PC's message to EGM; return the reason if it is ignored, else empty."""
        if isinstance(message, EgmSensor) and message.rapid_to_robot is not None:
            self.rapid_in = message.rapid_to_robot
            if self.echo:
                self._echoes.append((self.log.now_s + _ECHO_AFTER_S, message.rapid_to_robot))
        if self.egm.run is None:
            return "not in EGMRun"
        try:
            return self.egm.run.accept(message, self.log.now_s)
        except MotionError as error:
            self.fail(error)
            return "out of bounds"

    def tick(self) -> None:
        """Move for one control cycle."""
        while self._echoes and self._echoes[0][0] <= self.log.now_s:
            self.rapid_out = self._echoes.popleft()[1]
        run = self.egm.run
        if run is not None:
            try:
                ending = run.tick(self.log.now_s)
            except MotionError as error:
                self.fail(error)
            else:
                if ending is not None:
                    self.end(run, ending)
                return
        if self.egm.tick():
            self._go_on()

    # ------------------------------------------------------------------------------------
    # The program

    def execute(self, instruction: Instruction) -> None:
        """Execute `instruction` of the program after all earlier ones.

        Like RAPID's, instructions wait until a movement has come to its fine point.
        """
        if not self.program_running:
            self.log.add(UNNUMBERED, "an instruction is not reached: the program is stopped")
            return
        self.program.append(instruction)
        self.advance()

    def advance(self) -> None:
        """Execute the next instructions of the program until one has to wait."""
        while not self.program.finished and self.program_running and not self.egm.movements.busy:
            self.program.step()

    def stop_program(self) -> None:
        """Stop the running program; the instructions that it has not reached are dropped."""
        self.program_running = False
        self.program.stop()
        self.log.add(PROGRAM_STOPPED, "Program stopped")

    def when_standing(self, action: Callable[[], None], after_s: float = 0.0) -> None:
        """Do `action` once the arm stands, the session's end is sent and `after_s` is over.

        The last action counts.
        """
        self._then = (self.log.now_s + after_s, action)

    def power_cycle(self) -> None:
        """Restart the controller: only the program itself remains."""
        self.egm.power_cycle()
        self._then = None
        self.moved = False
        self.motors_on = True
        self.program_running = False

    # ------------------------------------------------------------------------------------
    # Runs of EGM

    def begin(self) -> None:
        """Run the last EGMRun or EGMMoveL, if motors and program are on."""
        if not self.motors_on or not self.program_running:
            return
        try:
            self.egm.begin()
        except MotionError as error:
            self.rapid_error(error.code, error.text)

    def end(self, run: GuidedRun, ending: Ending) -> None:
        """End `run`, which is under way, as planned."""
        self.egm.end(run, ending)
        if self.loop:
            self.when_standing(self.begin)

    def rapid_error(self, code: int, text: str) -> None:
        """Stop the program, and a run under way, for an error in an instruction."""
        self.log.add(code, text)
        if self.egm.run is not None:
            self._fail(MotionError(code, text))
        elif self.program_running:
            self.stop_program()

    def fail(self, error: MotionError) -> None:
        """End the run, or any other motion, with an error; then recover as set in `recovery`."""
        self.log.add(error.code, error.text)
        self._fail(error)

    # ------------------------------------------------------------------------------------
    # Inside

    def _fail(self, error: MotionError) -> None:
        silence = error.code == NO_DATA
        self.needs_jog = self.needs_jog or error.needs_jog
        self.egm.fail(self.options.ramp_time_s if silence else 0.0)
        if error.motors_off:
            self.motors_on = False
            self.log.add(MOTORS_OFF, "Motors OFF state")
        after_s, retries, restart = self.recovery
        if retries and silence and self._waits_for_run():
            self.egm.interrupted = False
            self.when_standing(self.begin, after_s)
            return
        if self.program_running:
            self.stop_program()
        if restart is not None and not self.needs_jog:
            self.when_standing(restart, after_s)

    def _waits_for_run(self) -> bool:
        """True when the program waits for its EGMRun and thus receives its errors."""
        order = self.egm.order
        return (
            order is not None
            and isinstance(order.arguments, EgmRun)
            and not order.arguments.no_wait
        )

    def _go_on(self) -> None:
        """Continue the program once the arm stands."""
        if self._then is not None and self.log.now_s >= self._then[0] and not self.egm.tail:
            action = self._then[1]
            self._then = None
            action()
        self.advance()
