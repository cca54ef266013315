"""Start of motion: remote control, power, brakes, the program."""

from __future__ import annotations

from collections import deque
from typing import Final

from cardan.drivers.ur_rtde.options import UrRtdeOptions
from cardan.drivers.ur_rtde.status_text import STARTABLE, mode_words, safety_words
from cardan.protocols.ur import dashboard
from cardan.protocols.ur.states import MOVES_IN, RobotMode, RuntimeState

_MODE_FOR: Final = {
    RobotMode.POWER_OFF: dashboard.POWER_ON,
    RobotMode.IDLE: dashboard.BRAKE_RELEASE,
}


class Starting:
    """A start of motion. `failure` is the reason of its end, `wish` what it waits for."""

    def __init__(self, options: UrRtdeOptions, token: int, now_s: float) -> None:
        self.token = token
        self.failure = ""
        self.wish = "waiting for the dashboard server"
        self.deadline_s = now_s + options.start_timeout_s
        self.uploads = False
        """True when the program is to be sent."""
        self.uploaded = False
        self.model = ""
        """Model of the arm as the controller reports it; empty if unknown."""
        self._options = options
        self._began_s = now_s
        self._remote: bool | None = None
        self._done: set[str] = set()
        self._asked: deque[str] = deque()

    def asks(self, mode: int, safety: int, runtime: int, now_s: float) -> str:
        """Return the next request to the connected dashboard server; empty if none is due."""
        if self._look(mode, safety, runtime, now_s) or self._asked:
            return ""
        request = ""
        if self._remote is None:
            request = dashboard.REMOTE_CONTROL
        elif dashboard.ROBOT_MODEL not in self._done:
            request = dashboard.ROBOT_MODEL
        elif mode in _MODE_FOR:
            request = _MODE_FOR[RobotMode(mode)]
            self.wish = mode_words(mode)
            if request in self._done:
                return ""
        elif runtime != RuntimeState.STOPPED and not self.uploaded:
            self.wish = "another program runs at the controller"
        elif mode == RobotMode.RUNNING:
            self.wish = "the program is being started"
            self.uploads = not self.uploaded
        else:
            self.wish = mode_words(mode)
        if request:
            self._done.add(request)
            self._asked.append(request)
        return request

    def _look(self, mode: int, safety: int, runtime: int, now_s: float) -> str:
        if safety not in MOVES_IN:
            self.failure = safety_words(safety)
        elif mode not in STARTABLE:
            self.failure = mode_words(mode)
        elif (
            not self.uploaded
            and runtime != RuntimeState.STOPPED
            and now_s - self._began_s > self._options.request_timeout_s
        ):
            self.failure = "another program runs at the controller: stop it there, and enable again"
        elif now_s >= self.deadline_s:
            self.failure = f"not started within {self._options.start_timeout_s:g} s: {self.wish}"
        return self.failure

    def replied(self, line: str) -> None:
        """Process an answer or greeting of the dashboard server."""
        if line.startswith(dashboard.GREETING) or not self._asked:
            return
        request = self._asked.popleft()
        if request == dashboard.REMOTE_CONTROL:
            # A CB3 has no remote control, and does not understand the question.
            self._remote = line.strip().lower() != "false"
            if not self._remote:
                self.failure = (
                    "the robot is in local control: choose remote control at the pendant's top "
                    "right, and enable again"
                )
        elif request == dashboard.ROBOT_MODEL:
            self.model = line
        elif refused := dashboard.refusal(request, line):
            self.failure = f"`{request}` was refused: {refused}"

    def report_failure(self, text: str) -> None:
        """Record the primary interface's reason why a program does not run."""
        if self.uploaded and not self.failure:
            self.failure = f"the program was not started: {text}"
