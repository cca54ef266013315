"""Operator actions at the controller, and external events such as collisions."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence

from cardan.sim_peers.egm_controller.arguments import PathMove
from cardan.sim_peers.egm_controller.events import (
    EMERGENCY_STOP,
    MOTION_SUPERVISION,
    MOTORS_OFF,
    MOTORS_ON,
    PROGRAM_STARTED,
    UNNUMBERED,
)
from cardan.sim_peers.egm_controller.guidance import MotionError
from cardan.sim_peers.egm_controller.instructions import Instructions
from cardan.sim_peers.egm_controller.rapid import RapidTask, Recovery

_COLLISION_SHOWN_S = 0.2


class OnError(enum.Enum):
    """Action some time after EGM ended with an error."""

    STOP = "stop"
    """No action: the program is stopped until it is started."""
    RETRY = "retry"
    """The program's error handler runs EGM again; it gets recoverable errors only."""
    RESTART = "restart"
    """An operator moves the program pointer to main and starts the program."""


class Panel:
    """The operator's panel: program, motors, emergency stop, jogging; and collisions."""

    def __init__(self, task: RapidTask, instructions: Instructions) -> None:
        self._task = task
        self._egm = task.egm
        self._log = task.log
        self._instructions = instructions
        self._emergency = False
        self._at_main = False
        """True when the program pointer was moved to main."""
        self._no_restart = False
        """True when the motors were switched off in a run that must not continue."""
        self._collision_until_s = -math.inf

    @property
    def collision(self) -> bool:
        """True just after a collision."""
        return self._log.now_s < self._collision_until_s

    def on_error(self, policy: OnError, after_s: float) -> None:
        """Choose the action `after_s` after EGM ended with an error."""
        self._task.recovery = Recovery(
            after_s,
            policy is OnError.RETRY,
            self._restart_after_error if policy is OnError.RESTART else None,
        )

    def pp_to_main(self) -> None:
        """Move the program pointer to main; a running program is stopped first."""
        self.program_stop()
        self._egm.interrupted = False
        self._at_main = True

    def program_stop(self) -> None:
        """Stop the program."""
        if self._task.program_running:
            self._task.stop_program()
            self._egm.interrupt(self._task.options.ramp_time_s)

    def program_start(self) -> None:
        """Start the program from main, or from the place where it was stopped."""
        task, egm = self._task, self._egm
        if task.program_running:
            return
        if self._emergency or not task.motors_on:
            self._log.add(UNNUMBERED, "the program cannot start: motors are off")
            return
        task.program_running = True
        egm.failed = False
        self._log.add(PROGRAM_STARTED, "Program started")
        if self._at_main:
            self._at_main = False
            task.when_standing(self._instructions.main)
        elif egm.interrupted:
            egm.interrupted = False
            if self._no_restart:
                self._no_restart = False
                self._log.add(UNNUMBERED, "EGM does not restart after motors off")
                return
            if egm.order is not None and isinstance(egm.order.arguments, PathMove):
                egm.go(egm.order.start_joints)
            task.when_standing(task.begin)

    def restart_program(self) -> None:
        """Restart as an operator does: program pointer to main, start."""
        self.pp_to_main()
        self.program_start()

    def set_motors(self, on: bool) -> None:
        """Motors on (which also acknowledges an emergency stop) or off."""
        if on and not self._task.motors_on:
            self._task.motors_on = True
            self._emergency = False
            self._log.add(MOTORS_ON, "Motors ON state")
        elif not on and self._task.motors_on:
            self._motors_off()

    def emergency_stop(self) -> None:
        """Press the emergency stop."""
        if not self._emergency:
            self._emergency = True
            self._log.add(EMERGENCY_STOP, "Emergency stop state")
            self._motors_off()

    def collide(self) -> None:
        """Trigger a collision in the motion supervision."""
        self._collision_until_s = self._log.now_s + _COLLISION_SHOWN_S
        self._task.fail(MotionError(MOTION_SUPERVISION, "Motion supervision"))

    def jog(self, joints: Sequence[float]) -> bool:
        """Jog the arm to `joints` (rad) by hand; False when that is not possible now.

        It takes effect at once while no datagrams are sent, else as a movement.
        """
        task, egm = self._task, self._egm
        if egm.run is not None or not task.motors_on:
            self._log.add(
                UNNUMBERED, "jogging is not possible: EGM moves the arm, or motors are off"
            )
            return False
        task.needs_jog = False
        task.moved = True
        if egm.sending or egm.movements.busy:
            egm.go(joints)
        else:
            task.servo.place(joints)
        return True

    def power_cycle(self) -> None:
        """Switch the controller off and on; `program_start` then begins at main."""
        self._task.power_cycle()
        self._emergency = False
        self._at_main = True

    def _motors_off(self) -> None:
        task, egm = self._task, self._egm
        task.motors_on = False
        self._log.add(MOTORS_OFF, "Motors OFF state")
        guided = egm.run is not None
        self._no_restart = guided and task.options.do_not_restart_after_motors_off
        if guided:
            egm.interrupt(0.0)
        else:
            egm.movements.clear()
        if task.program_running:
            task.stop_program()

    def _restart_after_error(self) -> None:
        task = self._task
        if self._emergency or task.needs_jog:
            return
        self.set_motors(True)
        if task.servo.out_of_range() is not None:
            arm = task.servo.arm
            self.jog(
                [
                    min(max(q, low), high)
                    for q, low, high in zip(task.servo.planned, arm.lower, arm.upper, strict=True)
                ]
            )
        self.restart_program()
