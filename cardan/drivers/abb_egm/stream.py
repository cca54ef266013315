"""Thread that answers the controller for an application slower than its cycle."""

from __future__ import annotations

import threading
import time
from contextlib import closing

from cardan.drivers.abb_egm.session import EgmSession
from cardan.drivers.robot_core import LoopMixin
from cardan.errors import DriverError
from cardan.types import HoldCommand, RobotCommand, RobotState

_JOIN_S = 2.0
"""Timeout longer than a wake-up and a braking ramp."""


class EgmStream:
    """Exchange of the newest state and the newest command; a thread answers every datagram at once.

    A command acts until the next one, until it is older than the option `command_timeout_s`, or
    until the controller begins a new session; then the robot brakes within its limits.
    """

    def __init__(self, driver: LoopMixin[EgmSession]) -> None:
        self._driver = driver
        self._timeout_s = driver.options.late_after_s
        self._thread: threading.Thread | None = None
        self._stopping = False
        self._failure: BaseException | None = None
        self._state: RobotState | None = None
        # Assigned at once: the thread sees either a whole new command or the previous one.
        self._newest: tuple[RobotCommand, float, int] = (HoldCommand(), 0.0, -1)

    def __enter__(self) -> EgmStream:
        self._stopping = False
        self._thread = threading.Thread(target=self._answer, name="EGM", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stopping = True
        if self._thread is not None:
            self._thread.join(_JOIN_S)

    def state(self) -> RobotState:
        """Newest state; its stamp tells its age.

        Never blocks. Raises DriverError if the thread has failed.
        """
        self._raise_failure()
        state = self._state
        if state is None:
            session = self._driver.session
            now_s = time.monotonic()
            state = session.state or session.tick(now_s)
            assert state is not None
        return state

    def command(self, command: RobotCommand) -> None:
        """Answer every further datagram with `command`.

        Never blocks. Raises CommandError if the robot cannot take it (the previous one stays in
        force), and DriverError if the thread has failed.
        """
        self._raise_failure()
        session = self._driver.session
        session.check(command)
        self._newest = (command, time.monotonic(), session.sessions)

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise DriverError(f"the EGM thread has ended: {self._failure}") from self._failure

    def _answer(self) -> None:
        hold = HoldCommand()
        send = self._driver.send
        try:
            with closing(self._driver.cycles()) as cycles:
                for state in cycles:
                    self._state = state
                    if self._stopping:
                        break
                    command, stamp_s, session = self._newest
                    fresh = state.stamp_s - stamp_s <= self._timeout_s
                    send(command if fresh and session == state.session else hold)
        except BaseException as error:
            self._failure = error
