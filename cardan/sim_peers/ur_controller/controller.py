"""The controller of a simulated UR5 or UR5e, sans I/O: its arm, its modes, and the program it runs.

It runs in frames of its control loop (2 ms, CB3: 8 ms). Programs are received as text; only a
program moves the arm. `UrServers` adds the connections.

Sources: UR's script manual, RTDE guide and dashboard pages. Unpublished values (deceleration of
stops, time of the brakes) are chosen here, and listed in docs/simulated-peers.md.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable, Coroutine, Mapping
from typing import Final, NoReturn

from cardan.protocols.ur.dashboard import UNLOCK_AFTER_S
from cardan.protocols.ur.primary import (
    ReportLevel,
    error_message,
    exception_message,
    key_message,
    popup_message,
    text_message,
)
from cardan.protocols.ur.script import ParseFailure, parsed
from cardan.protocols.ur.states import MOVES_IN, RobotMode, RuntimeState, SafetyMode
from cardan.sim_peers.kinematics import UR_LINKS
from cardan.sim_peers.ur_controller.contact import ContactPlane
from cardan.sim_peers.ur_controller.dynamics import Dynamics
from cardan.sim_peers.ur_controller.dynamics_functions import dynamics_functions
from cardan.sim_peers.ur_controller.io import Registers, RobotIo
from cardan.sim_peers.ur_controller.io_functions import (
    io_functions,
    message_functions,
    register_functions,
)
from cardan.sim_peers.ur_controller.kinematics import UrKinematics
from cardan.sim_peers.ur_controller.language import Action, Function, HaltError, ProgramError
from cardan.sim_peers.ur_controller.machine import Machine
from cardan.sim_peers.ur_controller.math_functions import math_functions
from cardan.sim_peers.ur_controller.motion import ArmMotion
from cardan.sim_peers.ur_controller.motion_functions import motion_functions
from cardan.sim_peers.ur_controller.options import UrControllerOptions
from cardan.sim_peers.ur_controller.popups import Popup, Popups
from cardan.sim_peers.ur_controller.pose_functions import pose_functions
from cardan.sim_peers.ur_controller.socket_functions import socket_functions
from cardan.sim_peers.ur_controller.sockets import ProgramSockets
from cardan.sim_peers.ur_controller.watchdogs import RtdeWatchdogs

LONGEST_STALL_S: Final = 0.5
"""Longest delay of a slow computer that is made up for; further frames are skipped."""
JOINT_RANGE: Final = math.radians(363.0)
"""Range of every joint, by the safety system; the arm's file keeps the elbow to half of that."""
STOP_CODE: Final = 204
"""Error of a protective stop by the safety system: UR's for a failed path check."""
ORDERED_STOP_CODE: Final = 209
"""Error of a protective stop that a program calls for."""
READ_ONLY_CODE: Final = 210
"""Error of a program or an order in local control: the interface is read-only."""
_MAX_EVENTS = 10_000
_MOST_MESSAGES = 1_000
"""Most waiting messages; further messages of a program are lost."""
_ITS_END = "its end"
_PORTIONS = 2
"""Portions of parsing and compiling in a frame: about a millisecond."""
_MOST_PORTIONS = 32
"""Portions in a frame after idle ones: a program of a few pages begins at once."""
MOST_WAITING: Final = 16
"""Most received programs that are not compiled yet; the rest waits in its sockets."""


class UrController:
    """UR controller. Call `advance` at `next_s`; it is switched on at the first time given."""

    def __init__(self, options: UrControllerOptions | None = None) -> None:
        self.options = options = UrControllerOptions() if options is None else options
        arm = options.arm
        self.period_s = 1.0 / options.rate_hz
        count = len(arm.joints)
        low, high = (-JOINT_RANGE,) * count, (JOINT_RANGE,) * count
        plane = None
        if options.contact_z_m is not None:
            plane = ContactPlane(options.contact_z_m, options.contact_stiffness_n_m)
        self.dynamics = Dynamics(arm)
        self.motion = ArmMotion(
            UrKinematics(UR_LINKS[options.robot], low, high),
            options.start or arm.home,
            arm.velocity,
            low,
            high,
            self.dynamics,
            plane=plane,
            say=self._said,
        )
        self.registers = Registers()
        self.io = RobotIo()
        self.popups = Popups(self._popped)
        self.watchdogs = RtdeWatchdogs()
        closed = options.faults.get("no-sockets", 0.0) > 0.0
        self.sockets = ProgramSockets(options.allowed_hosts, self._note, closed)
        self.functions: Mapping[str, Function] = {
            **math_functions(random.Random(options.seed)),
            **register_functions(self.registers),
            **io_functions(self.io),
            **message_functions(
                self._said, self.popups, self.watchdogs, self.period_s, lambda: self.time_s
            ),
            **socket_functions(self.sockets),
            **pose_functions(),
            **motion_functions(self.motion),
            **dynamics_functions(self.motion, self.dynamics),
            "protective_stop": self._order(
                lambda: self.protective_stop("the program", ORDERED_STOP_CODE)
            ),
            "powerdown": self._order(self.power_off),
        }
        self.mode = RobotMode.RUNNING if options.running else RobotMode.POWER_OFF
        self.safety = SafetyMode.NORMAL
        self.runtime = RuntimeState.STOPPED
        self.remote = options.remote
        self.slider = options.faults.get("slider", 1.0)
        """Speed slider, 0 to 1."""
        self.frames = 0
        self.program_name = ""
        self.messages: list[bytes] = []
        """Next messages of the primary interface; the sender removes them."""
        self.events: deque[tuple[float, str]] = deque(maxlen=_MAX_EVENTS)
        """The newest events, (time_s, text)."""
        self._program: Machine | None = None
        self._ordered: Callable[[], None] | None = None
        self._uploads: deque[tuple[str, str]] = deque()
        """Received programs and their names."""
        self._preparing: Coroutine[None, None, None] | None = None
        """The upload that is being parsed and compiled."""
        self._portions = _MOST_PORTIONS
        """Portions of that upload left in this frame."""
        self._waiting: tuple[float, Machine] | None = None
        """A program, and the time at which it begins."""
        self._mode_at: tuple[float, RobotMode] | None = None
        self._stopped_s = -math.inf
        self._slow_reported = False
        self._start_s = math.nan
        self._now_s = 0.0

    # -- time -------------------------------------------------------------------------------------

    @property
    def next_s(self) -> float:
        """Time of the next frame."""
        if math.isnan(self._start_s):
            return self._now_s
        return self._start_s + (self.frames + 1) * self.period_s

    @property
    def time_s(self) -> float:
        """Time since it was switched on, by its own clock: `timestamp` of RTDE."""
        return self.frames * self.period_s

    def advance(self, now_s: float) -> bool:
        """Run one frame if one is due by `now_s`; return True if one was."""
        if math.isnan(self._start_s):
            self._start_s = now_s
        self._now_s = now_s
        if now_s < self.next_s - 1e-9:
            return False
        late_s = now_s - self.next_s
        if late_s > LONGEST_STALL_S:
            # A real one never pauses: its clock advances, and the arm has not moved.
            self._start_s += late_s
            if not self._slow_reported:
                self._slow_reported = True
                what = f"this computer is too slow: {late_s:.2f} s are left out"
                self._note(f"{what} (further ones are not reported)")
        self.frames += 1
        self._frame()
        return True

    def _frame(self) -> None:
        now_s = self.time_s
        self._portions = min(max(self._portions, 0) + _PORTIONS, _MOST_PORTIONS)
        self._prepare()
        if self._mode_at is not None and now_s >= self._mode_at[0]:
            self.mode, self._mode_at = self._mode_at[1], None
            self._note(f"robot mode {self.mode.name}")
        if self._waiting is not None and now_s >= self._waiting[0]:
            self._program, self._waiting = self._waiting[1], None
            self.program_name = self._program.name
            self.runtime = RuntimeState.PLAYING
            self._key("PROGRAM_XXX_STARTED", self.program_name)
        self._look_at_watchdogs()
        action = self._acting()
        ordered, self._ordered = self._ordered, None
        if ordered is not None:
            ordered()
            action = None
        self.motion.paused = self.runtime is RuntimeState.PAUSED
        stopped = self.motion.step(action, self.period_s, self.slider)
        if stopped:
            self.protective_stop(stopped)

    def _look_at_watchdogs(self) -> None:
        if self.runtime is not RuntimeState.PLAYING:
            return
        expired = self.watchdogs.expired(self.time_s)
        if expired is None:
            return
        name, action = expired
        self._note(f"RTDE watchdog: {name} was not written in time: {action}")
        if action == "pause":
            self.pause()
        elif action == "stop":
            self._end_program("RTDE watchdog")

    def _acting(self) -> Action | None:
        """Return the program's action in this frame; None if nothing moves the arm."""
        program = self._program
        if program is None or self.runtime is not RuntimeState.PLAYING:
            return None
        try:
            action = program.step(self._left_of)
        except ProgramError as error:
            self._exception(error.line, error.reason, program.source)
            self._end_program(f"runtime exception in line {error.line}: {error.reason}")
            return None
        if program.ended and self._ordered is None:
            self._end_program(_ITS_END)
        return action

    def _order(self, action: Callable[[], None]) -> Function:
        """Return a function that ends its program, also a secondary one, and acts after that
        program's frame."""

        def order() -> NoReturn:
            self._ordered = action
            raise HaltError

        return Function((), {}, order)

    def _left_of(self, action: Action) -> Action | None:
        return self.motion.left_of(action, self.period_s)

    # -- programs ---------------------------------------------------------------------------------

    def upload(self, text: str, name: str = "") -> None:
        """Accept a program, which replaces the running one. `name`: its name, if not the one in its
        text."""
        if not self.remote:
            self.refuse_in_local_control()
            return
        why = self._why_no_program()
        if why:
            self.refuse(why)
            return
        self._uploads.append((text, name))
        self._prepare()

    def refuse(self, why: str) -> None:
        """Refuse a program."""
        self._said(why)
        self._note(f"a program is not taken: {why}")

    def refuse_in_local_control(self) -> None:
        """Refuse a program or an order in local control."""
        why = "the robot is in local control"
        if len(self.messages) < _MOST_MESSAGES:
            self._error(READ_ONLY_CODE, why)
        self._note(f"a program is not taken: {why}")

    def _prepare(self) -> None:
        """Continue the compilation of received programs, as far as this frame allows."""
        while self._portions > 0 and (self._preparing is not None or self._uploads):
            if self._preparing is None:
                self._preparing = self._prepared(*self._uploads.popleft())
            self._portions -= 1
            try:
                self._preparing.send(None)
            except StopIteration:
                self._preparing = None

    async def _prepared(self, text: str, name: str) -> None:
        """Parse and compile a program in portions, and start it."""
        program = await parsed(text)
        if isinstance(program, ParseFailure):
            self._exception(program.line, program.reason, text)
            self._note(f"a program is refused, line {program.line}: {program.reason}")
            return
        try:
            machine = Machine(self.period_s, text)
            await machine.load(program, self.functions)
        except ProgramError as error:
            self._exception(error.line, error.reason, text)
            return
        if program.secondary:
            self._portions = 0  # One of them in a frame.
            self._run_beside(machine)
            return
        if self._program is not None:
            self._end_program("another program")
        if self.options.faults.get("no-script", 0.0):
            self._note("fault: the program is never started")
            return
        machine.name = name or machine.name
        self._waiting = (self.time_s + self.options.program_start_s, machine)
        self._note(f"program {machine.name}")

    def _run_beside(self, machine: Machine) -> None:
        """Run a secondary program whole in this frame; the other one continues."""
        try:
            machine.run_at_once()
        except ProgramError as error:
            self._exception(error.line, error.reason, machine.source)
            self._note(f"secondary program {machine.name}, line {error.line}: {error.reason}")
        machine.close()

    def _why_no_program(self) -> str:
        if self.safety not in MOVES_IN:
            return f"the robot's safety mode is {self.safety.name}"
        if self.mode is not RobotMode.RUNNING:
            return f"the robot's mode is {self.mode.name}"
        return ""

    def stop_program(self, why: str = "stopped at the pendant") -> bool:
        """Stop the program; return False if there was none."""
        if not self.has_program:
            return False
        self._end_all(why)
        return True

    def pause(self) -> bool:
        """Pause the program, as the pendant does."""
        if self._program is None or self.runtime is not RuntimeState.PLAYING:
            return False
        self.runtime = RuntimeState.PAUSED
        self._note("the program is paused")
        return True

    def resume(self) -> bool:
        """Resume a paused program."""
        if self._program is None or self.runtime is not RuntimeState.PAUSED:
            return False
        if self.safety not in MOVES_IN:
            return False
        self.runtime = RuntimeState.PLAYING
        self._note("the program is resumed")
        return True

    @property
    def has_program(self) -> bool:
        """True if a program runs, is paused, or begins."""
        return (
            self._program is not None
            or self._waiting is not None
            or self._preparing is not None
            or bool(self._uploads)
        )

    @property
    def is_full(self) -> bool:
        """True if so many programs wait for the compiler that no more are read."""
        return len(self._uploads) >= MOST_WAITING

    @property
    def script_line(self) -> int:
        """Line of the program's statement that moves the arm now; 0: none."""
        return 0 if self._program is None else self._program.mover_line

    def _end_all(self, why: str) -> None:
        """End all programs, also received ones that have not begun."""
        self._uploads.clear()
        if self._preparing is not None:
            self._preparing.close()
            self._preparing = None
        self._end_program(why)

    def _end_program(self, why: str) -> None:
        name = self.program_name
        if why == _ITS_END:
            self.motion.end_modes()
        else:
            self.motion.halt()
        if self._program is not None:
            self._program.close()
        self._program = self._waiting = None
        self.watchdogs.clear()
        self.sockets.close_all()
        self.popups.close()
        self.runtime = RuntimeState.STOPPED
        self._key("PROGRAM_XXX_STOPPED", name)
        self._note(f"program {name} has ended: {why}")

    def _said(self, text: str) -> None:
        if len(self.messages) < _MOST_MESSAGES:
            self.messages.append(text_message(self.time_s, text))

    def _popped(self, popup: Popup) -> None:
        self.messages.append(popup_message(self.time_s, *popup))
        self._note(f"popup {popup.title}: {popup.text}")

    def _key(self, title: str, text: str) -> None:
        self.messages.append(key_message(self.time_s, title, text))

    def _exception(self, line: int, reason: str, text: str) -> None:
        """Report an error in a line of the program `text`, at the column of its first word."""
        if not self.options.faults.get("no-exceptions", 0.0):
            found = text.split("\n")[line - 1 : line]
            column = 1 + sum(len(each) - len(each.lstrip()) for each in found)
            self.messages.append(exception_message(self.time_s, line, reason, column))

    def _error(self, code: int, why: str) -> None:
        self.messages.append(error_message(self.time_s, code, 0, ReportLevel.VIOLATION, why))

    # -- power and safety ------------------------------------------------------------------------

    def power_on(self) -> None:
        """Switch the power on, which takes time."""
        if self.mode is RobotMode.POWER_OFF and self.safety in MOVES_IN:
            self.mode = RobotMode.POWER_ON
            self._mode_at = (self.time_s + self.options.boot_s, RobotMode.IDLE)
            self._note("power on")

    def release_brakes(self) -> None:
        """Release the brakes, which takes time; switch the power on first if it is off."""
        if self.safety not in MOVES_IN or self.mode is RobotMode.RUNNING:
            return
        after_s = self.options.release_s
        if self.mode is not RobotMode.IDLE:
            after_s += self.options.boot_s
        self._mode_at = (self.time_s + after_s, RobotMode.RUNNING)
        self._note("brakes are being released")

    def power_off(self) -> None:
        """Switch the power off; the brakes hold."""
        if self.has_program:
            self._end_all("power off")
        self.motion.halt()
        self.mode, self._mode_at = RobotMode.POWER_OFF, None
        self._note("power off")

    def protective_stop(self, why: str, code: int = STOP_CODE) -> None:
        """Stop the arm; the program ends. `code`: of the error."""
        if self.safety not in MOVES_IN:
            return
        self._error(code, why)
        self._stop(SafetyMode.PROTECTIVE_STOP, why)

    def unlock_protective_stop(self) -> str:
        """Release a protective stop if the dashboard may; return its reply."""
        stopped = self.safety is SafetyMode.PROTECTIVE_STOP
        if stopped and self.time_s - self._stopped_s < UNLOCK_AFTER_S:
            return (
                "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of "
                "protective stop before unlocking"
            )
        self.release_protective_stop()
        return "Protective stop releasing"

    def release_protective_stop(self) -> None:
        """Release a protective stop, also at once: the pause is the dashboard's."""
        if self.safety is SafetyMode.PROTECTIVE_STOP:
            self.safety = SafetyMode.NORMAL
            self._note("the protective stop is unlocked")

    def safeguard_stop(self) -> None:
        """Open a guard: the arm stops, the program is paused."""
        if self.safety in MOVES_IN:
            self.safety = SafetyMode.SAFEGUARD_STOP
            if not self.pause():
                self.motion.halt()
            self._note("safeguard stop")

    def safeguard_reset(self) -> None:
        """Close the guard again; the program stays paused."""
        if self.safety is SafetyMode.SAFEGUARD_STOP:
            self.safety = SafetyMode.NORMAL

    def emergency_stop(self) -> None:
        """Press the button: the arm stops, power goes off."""
        self._stop(SafetyMode.ROBOT_EMERGENCY_STOP, "emergency stop")
        self.mode, self._mode_at = RobotMode.POWER_OFF, None

    def release_emergency_stop(self) -> None:
        """Release the emergency stop button; the power stays off."""
        if self.safety is SafetyMode.ROBOT_EMERGENCY_STOP:
            self.safety = SafetyMode.NORMAL

    def restart(self) -> None:
        """Restart after a power failure: all registers are lost, and the robot is off."""
        if self.has_program:
            self._end_all("restart")
        for name, values in vars(Registers()).items():
            getattr(self.registers, name)[:] = values
        vars(self.io).update(vars(RobotIo()))
        self.motion.sensor, self.motion.sensed = None, (0.0,) * len(self.motion.sensed)
        self.mode, self._mode_at = RobotMode.POWER_OFF, None
        self.frames, self._start_s = 0, self._now_s
        self._note("restart")

    def _stop(self, mode: SafetyMode, why: str) -> None:
        if self.has_program:
            self._end_all(mode.name)
        self.motion.halt()
        self.safety = mode
        self._stopped_s = self.time_s
        self._note(f"{mode.name}: {why}")

    def _note(self, text: str) -> None:
        self.events.append((self._now_s, text))
