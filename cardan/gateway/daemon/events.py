"""Events of sessions: changes of authority over an arm, arming and stops, with their reasons.

Events are found by comparing the snapshots of a session. They are kept in a file, a JSON object a
line, which is rotated before it grows large.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from cardan.common.files import state_folder
from cardan.errors import ConfigurationError
from cardan.gateway.session.snapshot import Snapshot

FILE_BYTES: Final = 10_000_000
"""Size at which the event log is rotated: about 60,000 events."""

MAX_FILES: Final = 5
"""Number of older logs that are kept, as NAME.1 to NAME.5."""

_log = logging.getLogger(__name__)

_FIGURES = re.compile(r"[0-9][0-9.,]*")


class Event(NamedTuple):
    """Event of a session, a server or the daemon."""

    time_s: float
    """Time since the epoch, s."""
    name: str
    """Name of a session or a server, or ``daemon``."""
    event: str
    """Kind: ``authority``, ``arm``, ``robot``, ``device``, ``trip``, ``message``, or the fate of a
    process: ``started``, ``ended``, ``failed``, ``reload``; ``lost``: number of events that could
    not be written."""
    what: str
    why: str = ""

    def line(self) -> str:
        """Return the event as JSON."""
        return json.dumps(self._asdict(), separators=(",", ":"))


STOP_REASONS: Final = ("robot", "device", "trip", "none")
"""Faults that make an arm brake: the robot's link, the device's, another fault that disengaged its
source, or none: a normal stop."""


def _stop_reason(before: Snapshot, now: Snapshot) -> str:
    robot, device, trip, none = STOP_REASONS
    if now.robot.link != "live":
        return robot
    if now.device.held and now.device.link not in ("", "live"):
        return device
    return trip if now.arm.trips > before.arm.trips else none


class SessionWatch:
    """Finds the events of a session by its snapshots."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._before: Snapshot | None = None
        self._said = ""
        self.stops = dict.fromkeys(STOP_REASONS, 0)
        """Count of beginnings of braking, by fault."""
        self.refusals = 0
        """Count of refused requests for the authority."""

    def forget(self) -> None:
        """Forget the snapshot of a process that has ended."""
        self._before, self._said = None, ""

    def take(self, now: Snapshot, time_s: float) -> Iterator[Event]:
        """Yield the events since the previous snapshot."""
        before, self._before = self._before, now
        if before is None:
            before = Snapshot()
        arm, was = now.arm, before.arm
        why = arm.message or now.robot.hold_reason
        if arm.authority != was.authority:
            yield self._event(time_s, "authority", arm.authority or "nobody", why)
        if arm.authority_refused != was.authority_refused and arm.authority_refused:
            self.refusals += 1
            yield self._event(time_s, "authority refused", arm.authority_refused)
        if now.robot.link != before.robot.link:
            yield self._event(time_s, "robot", now.robot.link, now.robot.hold_reason)
        if now.device.link != before.device.link:
            yield self._event(time_s, "device", now.device.link, now.device.reason)
        if arm.trips > was.trips:
            yield self._event(time_s, "trip", f"{arm.trips - was.trips}", why)
        if arm.phase != was.phase:
            if arm.phase == "braking":
                self.stops[_stop_reason(before, now)] += 1
            yield self._event(time_s, "arm", arm.phase, why)
        words = _FIGURES.sub("", arm.message)  # Figures in a message change all the time.
        if words != self._said:
            self._said = words
            if words:
                yield self._event(time_s, "message", arm.message)

    def _event(self, time_s: float, event: str, what: str, why: str = "") -> Event:
        return Event(round(time_s, 3), self._name, event, what, why)


class EventLog:
    """Writes events to a file, each at once: a crash of the daemon loses none."""

    def __init__(self, path: Path, file_bytes: int = FILE_BYTES) -> None:
        """Raises ConfigurationError if the file cannot be written."""
        self.path = path
        self._most = file_bytes
        self.lost = 0
        """Count of events that could not be written: the disk is full, or the folder is gone."""
        self._unsaid = 0
        """Count of those that are not reported in the file yet."""
        self._why = ""
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._file = self._opened(path)
            # A daemon that ended on a full disk may have left half a line.
            self._torn = _is_torn(path)
        except OSError as error:
            raise ConfigurationError(
                "daemon.event_log",
                f"cannot write {path}: {error.strerror}; name a file in a folder that can be "
                'written, or "none"',
            ) from None

    @staticmethod
    def _opened(path: Path) -> int:
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC
        return os.open(path, flags, 0o600)

    def write(self, event: Event) -> None:
        """Write an event. Never raises: a failure is logged, and the file gets the number of
        missing events as soon as it can be written again."""
        data = event.line().encode() + b"\n"
        if self._unsaid:
            missing = Event(event.time_s, "daemon", "lost", f"{self._unsaid} events", self._why)
            data = missing.line().encode() + b"\n" + data
        if self._torn:
            data = b"\n" + data
        try:
            written = self._append(data)
        except OSError as error:
            self._lose(error.strerror or str(error))
            return
        self._torn = 0 < written < len(data) or (self._torn and not written)
        if written < len(data):
            self._lose("the disk is full")
        else:
            self._unsaid = 0

    def _append(self, data: bytes) -> int:
        found = os.fstat(self._file)
        if not found.st_nlink:  # The file was removed.
            fresh = self._opened(self.path)
            os.close(self._file)
            self._file = fresh
        elif found.st_size + len(data) > self._most:
            with contextlib.suppress(OSError):  # It grows on where it cannot be turned over.
                self._turn_over()
        return os.write(self._file, data)

    def _lose(self, why: str) -> None:
        if not self._unsaid:
            _log.error("%s cannot be written: %s; events are lost", self.path, why)
        self.lost += 1
        self._unsaid += 1
        self._why = why

    def _turn_over(self) -> None:
        # The new file is there before the old one is closed.
        new = self.path.with_name(f"{self.path.name}.new")
        fresh = self._opened(new)
        try:
            for number in range(MAX_FILES - 1, -1, -1):
                with contextlib.suppress(FileNotFoundError):
                    os.replace(self._numbered(number), self._numbered(number + 1))
            os.replace(new, self.path)
        except OSError:
            os.close(fresh)
            raise
        os.close(self._file)
        self._file = fresh

    def _numbered(self, number: int) -> Path:
        return _numbered(self.path, number)

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


def _numbered(path: Path, number: int) -> Path:
    """Return the log, and its older files."""
    return path if number == 0 else path.with_name(f"{path.name}.{number}")


def _is_torn(path: Path) -> bool:
    """Return whether the file ends within a line."""
    with path.open("rb") as file:
        end = file.seek(0, os.SEEK_END)
        file.seek(max(0, end - 1))
        return file.read(1) not in (b"", b"\n")


def default_event_log() -> Path:
    """Return the default path of the event log."""
    return state_folder() / "events.jsonl"
