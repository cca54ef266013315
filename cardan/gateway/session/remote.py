"""The Cartesian interface of a session in a separate process. The session's loop has its own
interpreter: the user's program does not delay it."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

from cardan.errors import (
    CardanError,
    ConfigurationError,
    DriverError,
    MotionLoopError,
)
from cardan.gateway.arm.remote_arm import RemoteArm
from cardan.gateway.arm.status import VERBS
from cardan.gateway.session.arm_assembly import why_no_verbs
from cardan.gateway.session.assembly import load_config
from cardan.gateway.session.config import SessionConfig
from cardan.gateway.session.session import EXIT_CANNOT_OPEN, EXIT_CONFIGURATION
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor import SessionExit, SessionProcess


def session_arm(
    config: SessionConfig | Path | str,
    *,
    source: str = VERBS,
    show: Callable[[Snapshot], None] = lambda _snapshot: None,
) -> RemoteArm:
    """Make the arm of a configured session, whose process begins with `open`.

    ::

        with session_arm("verbs-ur5-simulated.toml") as arm:
            arm.movj([0.4, 0.1, 0.4, 3.14, 0.0, 0.0])
            arm.wait()

    When this process is stopped or ends, the arm brakes and holds, and motions must be requested
    again. An operator device in the configuration moves the arm beside the verbs, with precedence
    as in [authority]. `close` brakes to rest and ends the session.

    `source`: name of this client as a source, which gets the authority. `show` gets each snapshot
    of the session, ten a second, in a separate thread; an exception in it ends the session. Raises
    ConfigurationError; `open` raises it, or DriverError, if the session cannot open a device, robot
    or network.
    """
    chosen = config if isinstance(config, SessionConfig) else load_config(Path(config))
    if why := why_no_verbs(chosen):
        raise ConfigurationError("arm", why)
    return RemoteArm(partial(_connect, chosen, show), source)


def _connect(
    config: SessionConfig, show: Callable[[Snapshot], None], arm: RemoteArm
) -> Callable[[], None]:
    """Start the session; return, when the robot's first state is there, the function that ends
    it."""
    process = SessionProcess(config)
    outcomes: list[SessionExit] = []

    def take(packet: bytes) -> Snapshot | None:
        if arm.take(packet):
            return None
        snapshot = Snapshot.from_bytes(packet)
        show(snapshot)
        return snapshot

    def read() -> None:
        """Send beats, and handle the session's packets, until it ends."""
        why = ""
        try:
            outcome = process.follow(take)
            outcomes.append(outcome)
            why = outcome.last.error or outcome.last.arm.message
        finally:
            arm.end(f"the session has ended: {why}" if why else "the session has ended")

    arm.begin(lambda _request, packet: process.send(packet))
    reader = threading.Thread(target=read, name="session", daemon=True)
    reader.start()
    try:
        with contextlib.ExitStack() as undone:
            undone.callback(reader.join)
            undone.callback(process.stop)
            arm.status()
            return undone.pop_all().close
    except MotionLoopError:
        if not outcomes or not outcomes[0].exit_code:
            raise
        raise _why_it_ended(outcomes[0]) from None


def _why_it_ended(outcome: SessionExit) -> CardanError:
    """Return the error that the session's process raised, as far as its end shows it."""
    words = outcome.last.error
    if outcome.exit_code == EXIT_CONFIGURATION:
        key, _, rest = words.partition(": ")
        return ConfigurationError(key, rest) if " " not in key else ConfigurationError("", words)
    if outcome.exit_code == EXIT_CANNOT_OPEN:
        return DriverError(words)
    return MotionLoopError(words)
