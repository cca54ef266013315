"""The RAPID instructions of EGM, and MoveAbsJ, as the program executes them.

Source: ABB Application manual, Externally Guided Motion (3HAC073318-001), RAPID reference; event
numbers from ABB's event logs as users published them.
"""

from __future__ import annotations

from collections.abc import Sequence

from cardan.sim_peers.egm_controller.arguments import (
    EgmAct,
    EgmMode,
    EgmRun,
    EgmSetup,
    PathMove,
    StopMode,
)
from cardan.sim_peers.egm_controller.events import MODE_MISMATCH, MOVE_NOT_ALLOWED, UNNUMBERED
from cardan.sim_peers.egm_controller.guidance import MotionError
from cardan.sim_peers.egm_controller.guided_run import Ending, RunRequest
from cardan.sim_peers.egm_controller.rapid import RapidTask
from cardan.sim_peers.egm_controller.settings import PATH_LEVEL


class Instructions:
    """RAPID instructions, a method for each; a failed instruction stops the program."""

    def __init__(self, task: RapidTask) -> None:
        self._task = task
        self._egm = task.egm
        self._settings = task.egm.settings
        self._program = task.program

    def main(self) -> None:
        """Execute the program from its first instruction to the last one reached so far."""
        self._egm.reset()
        self._program.restart(self.get_id)
        self._task.advance()

    def get_id(self) -> None:
        """EGMGetId."""
        if self._runs("EGMGetId"):
            self._egm.connect()

    def setup(self, arguments: EgmSetup) -> None:
        """EGMSetupUC."""
        if self._runs("EGMSetupUC") and self._needs("EGMSetupUC", self._egm.connected, "EGMGetId"):
            self._settings.setup = arguments
            self._settings.act = None
            self._program.record("setup", lambda: self.setup(arguments))

    def act(self, arguments: EgmAct) -> None:
        """EGMActJoint, EGMActPose or EGMActMove; the last one counts."""
        if not self._runs("EGMAct") or not self._needs(
            "EGMAct", self._settings.setup, "EGMSetupUC"
        ):
            return
        if arguments.mode is EgmMode.PATH and (rate := arguments.sample_rate_ms) and rate % 24:
            self._task.rapid_error(UNNUMBERED, f"SampleRate {rate} is not a multiple of 24 ms")
            return
        self._settings.act = arguments
        self._program.record("act", lambda: self.act(arguments))
        if arguments.stream_start:
            self._egm.start_streaming()

    def stream_start(self) -> None:
        """EGMStreamStart."""
        if self._runs("EGMStreamStart") and self._needs(
            "EGMStreamStart", self._settings.act, "EGMAct"
        ):
            self._program.record("stream", self.stream_start)
            self._egm.start_streaming()

    def stream_stop(self) -> None:
        """EGMStreamStop."""
        if self._runs("EGMStreamStop"):
            self._program.forget("stream")
            self._egm.streaming = False

    def run(self, arguments: EgmRun) -> None:
        """EGMRunJoint or EGMRunPose."""
        if arguments.mode is EgmMode.PATH:
            self._task.rapid_error(
                UNNUMBERED, "there is no EGMRun for path correction: use EGMMoveL"
            )
            return
        if not self._ready_to_move("EGMRun", arguments.mode):
            return
        self._program.record("motion", lambda: self.run(arguments))
        if arguments.axes:
            self._begin(arguments)

    def egm_move(self, arguments: PathMove) -> None:
        """EGMMoveL with path correction."""
        if not self._ready_to_move("EGMMoveL", EgmMode.PATH):
            return
        self._program.record("motion", lambda: self.egm_move(arguments))
        self._begin(arguments)

    def stop(self, mode: StopMode = StopMode.HOLD, ramp_out_s: float | None = None) -> None:
        """EGMStop."""
        if self._runs("EGMStop"):
            self._egm.streaming = False
            if self._egm.run is not None:
                ramp_s = self._task.options.ramp_time_s if ramp_out_s is None else ramp_out_s
                self._task.end(self._egm.run, Ending(mode, ramp_s, ramp_s))

    def reset(self) -> None:
        """EGMReset."""
        if self._runs("EGMReset"):
            self._egm.reset()

    def move(self, joints: Sequence[float] | None) -> None:
        """MoveAbsJ to `joints` (rad; None: to where the arm is), to a fine point."""
        task = self._task
        if not self._runs("MoveAbsJ"):
            return
        if self._egm.run is not None:
            task.fail(
                MotionError(MOVE_NOT_ALLOWED, "Move not allowed in External Motion Interface")
            )
            return
        if not task.motors_on:
            task.rapid_error(UNNUMBERED, "MoveAbsJ: motors are off")
            return
        self._program.record("move", lambda: self.move(joints))
        task.moved = True
        here = task.servo.planned
        if joints is not None and any(abs(b - a) > 1e-9 for a, b in zip(here, joints, strict=True)):
            self._egm.go(joints)

    # ------------------------------------------------------------------------------------
    # Inside

    def _begin(self, arguments: EgmRun | PathMove) -> None:
        self._egm.order = RunRequest(arguments, list(self._task.servo.planned))
        self._task.begin()

    def _runs(self, instruction: str) -> bool:
        running = self._task.program_running
        if not running:
            self._task.log.add(UNNUMBERED, f"{instruction} is not reached: the program is stopped")
        return running

    def _needs(self, instruction: str, there: object, before: str) -> bool:
        if there:
            return True
        self._task.rapid_error(UNNUMBERED, f"{instruction} before {before}")
        return False

    def _ready_to_move(self, instruction: str, mode: EgmMode) -> bool:
        task, egm = self._task, self._egm
        setup, act, level = self._settings.setup, self._settings.act, self._settings.level
        if not self._runs(instruction) or not self._needs(instruction, act, "EGMAct"):
            return False
        if setup is None or act is None or not (setup.mode is act.mode is mode):
            task.rapid_error(
                MODE_MISMATCH,
                f"EGM mode mismatch: {instruction} {mode.value} after "
                f"EGMSetupUC {setup.mode.value if setup else '-'} and "
                f"EGMAct {act.mode.value if act else '-'}",
            )
            return False
        obstacle = ""
        if not task.motors_on:
            obstacle = "motors are off"
        elif egm.run is not None:
            obstacle = "EGM is running already"
        elif not task.moved:
            obstacle = "the first movement after a controller start must not be EGM"
        elif not task.servo.at_rest or egm.movements.busy:
            obstacle = "the robot does not stand in a fine point"
        elif (level == PATH_LEVEL) is not (mode is EgmMode.PATH):
            obstacle = f"Level {level} is not for mode {mode.value}"
        elif task.needs_jog:
            obstacle = "close to a singularity: jog the robot away first"
        if obstacle:
            task.rapid_error(UNNUMBERED, f"{instruction}: {obstacle}")
        return not obstacle
