"""The Cartesian interface of a session in a process of its own.

The session's loop has its own interpreter: the user's program does not delay it.
"""

from __future__ import annotations

import threading
from pathlib import Path

from cardan.errors import (
    CardanError,
    ConfigurationError,
    DriverError,
    MotionLoopError,
)
from cardan.gateway.arm.authority import VERBS
from cardan.gateway.arm.remote_arm import RemotePacketArm
from cardan.gateway.arm.requests import Request, decode_answer
from cardan.gateway.session.arm_assembly import why_no_verbs
from cardan.gateway.session.assembly import load_config
from cardan.gateway.session.config import SessionConfig
from cardan.gateway.session.session import EXIT_CANNOT_OPEN, EXIT_CONFIGURATION
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor import Outcome, SessionProcess


class RemoteArm(RemotePacketArm):
    """A session as configured, in a process of its own that begins with `open`, and its verbs.

    ::

        with RemoteArm("verbs-ur5-simulated.toml") as arm:
            arm.movj([0.4, 0.1, 0.4, 3.14, 0.0, 0.0])
            arm.wait()

    While this process is stopped or gone, the arm brakes and holds, and verbs have to be asked for
    anew. An operator device in the configuration moves the arm beside the verbs, and takes it from
    them as [authority] says. A Motion is updated without being asked.
    """

    def __init__(self, config: SessionConfig | Path | str, *, source: str = VERBS) -> None:
        """`source`: name of this source, which gets the authority. Raises ConfigurationError."""
        self.config = config if isinstance(config, SessionConfig) else load_config(Path(config))
        if why := why_no_verbs(self.config):
            raise ConfigurationError("arm", why)
        super().__init__(source)
        self._process: SessionProcess | None = None
        self._reader: threading.Thread | None = None
        self._snapshot = Snapshot()
        self._outcome: Outcome | None = None

    @property
    def snapshot(self) -> Snapshot:
        """The newest snapshot of the session, a tenth of a second old at most while it runs."""
        return self._snapshot

    # -- open and close --------------------------------------------------------------------------

    def open(self) -> None:
        """Start the session; returns when the robot's first state is there.

        Raises ConfigurationError or DriverError if the session cannot open a part.
        """
        if self._process is not None:
            return
        self._snapshot, self._outcome = Snapshot(), None
        self._process = process = SessionProcess(self.config)
        self._begin()
        self._reader = threading.Thread(
            target=self._read, args=(process,), name="session", daemon=True
        )
        self._reader.start()
        try:
            self.status()
        except BaseException as error:
            self.close()
            outcome = self._outcome
            if not isinstance(error, MotionLoopError) or outcome is None or not outcome.exit_code:
                raise
            raise _why_it_ended(outcome) from None

    def close(self) -> None:
        """Brake to rest and end the session. Never raises; twice is fine."""
        process, reader = self._process, self._reader
        if process is None or reader is None:
            return
        process.stop()
        reader.join()
        self._process = self._reader = None
        self._close()

    def _read(self, process: SessionProcess) -> None:
        """Send beats, and handle the session's packets, until it ends."""
        why = ""
        try:
            self._outcome = outcome = process.follow(self._take)
            why = outcome.last.error or outcome.last.message
        finally:
            self._end(f"the session has ended: {why}" if why else "the session has ended")

    def _take(self, packet: bytes) -> Snapshot | None:
        answer = decode_answer(packet)
        if answer is None:
            self._snapshot = Snapshot.from_bytes(packet)
            return self._snapshot
        self._take_answer(answer)
        return None

    def _send(self, _request: Request, packet: bytes) -> None:
        process = self._process
        if process is not None:
            process.send(packet)


def _why_it_ended(outcome: Outcome) -> CardanError:
    """The error that the session's own process raised, as far as its end shows."""
    words = outcome.last.error
    if outcome.exit_code == EXIT_CONFIGURATION:
        key, _, rest = words.partition(": ")
        return ConfigurationError(key, rest) if " " not in key else ConfigurationError("", words)
    if outcome.exit_code == EXIT_CANNOT_OPEN:
        return DriverError(words)
    return MotionLoopError(words)
