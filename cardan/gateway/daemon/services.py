"""Services of the daemon: its sessions and servers, each with its known state.

Only the daemon's thread uses them; reports of processes are passed on to it.
"""

from __future__ import annotations

import json
import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from cardan.common.logs import level_of
from cardan.common.text_sanitizer import printable
from cardan.gateway.daemon.config import ServerEntry, SessionEntry
from cardan.gateway.daemon.events import SessionWatch
from cardan.gateway.daemon.processes import Process, RunningServer, RunningSession
from cardan.gateway.daemon.restart_policy import Ended, Unit, UnitState
from cardan.gateway.daemon.usage import ProcessorUse
from cardan.gateway.session.snapshot import Snapshot
from cardan.types import NEVER_S

ENGAGED: Final = frozenset({"holding", "moving", "braking", "recovering"})
"""Phases of an arm that is moved by a source, or may be at once."""


class LogLine(NamedTuple):
    """A line that a process has written."""

    time_s: float
    """Time since the epoch, s."""
    name: str
    text: str
    level: str
    """Level of the log: ``debug``, ``info``, ``warning``, ``error`` or ``critical``."""

    @classmethod
    def of(cls, name: str, text: str) -> LogLine:
        """Make a line that `name` has written now."""
        level, text = level_of(text)
        return cls(time.time(), name, printable(text), logging.getLevelName(level).lower())


Post = Callable[[Callable[[], None]], None]
"""Schedules a call in the daemon's thread."""

Say = Callable[[LogLine], None]


class DaemonService(ABC):
    """A session or a server: its known state, and its process while it runs."""

    kind = ""

    def __init__(self, name: str, start_limit: int) -> None:
        self.unit = Unit(name, start_limit)
        self.process: Process | None = None
        self.use = ProcessorUse()
        self.shown_state = UnitState.STOPPED
        """The last state in the event log."""

    @property
    def name(self) -> str:
        return self.unit.name

    @abstractmethod
    def begin(self, post: Post, say: Say) -> None:
        """Start its process. Raises OSError."""

    @abstractmethod
    def figures(self, now_s: float) -> dict[str, Any]:
        """Return its row, and all of its figures."""

    def shown(self, now_s: float) -> dict[str, Any]:
        """Return its row."""
        unit, process = self.unit, self.process
        return {
            "name": unit.name,
            "kind": self.kind,
            "state": unit.state.value,
            "reason": unit.reason,
            "since_s": 0.0 if unit.since_s == NEVER_S else round(now_s - unit.since_s, 1),
            "restarts": unit.restarts,
            "pid": None if process is None else process.pid,
            "cpu": None if process is None else self.use.share(process.pid, now_s),
        }


def why_nothing_moves(s: Snapshot, lent: str) -> str:
    """Return why nothing moves; `lent`: where its device is while another session has it. A fault
    of the robot has precedence, because programs can move the arm without the device."""
    if s.device.held:
        return s.arm.message or s.robot.hold_reason or s.device.reason
    return s.robot.hold_reason or lent


class SessionService(DaemonService):
    """Service that runs a session."""

    kind = "session"

    def __init__(self, name: str, entry: SessionEntry, start_limit: int) -> None:
        super().__init__(name, start_limit)
        self.entry = entry
        """Configuration with which its process runs, or will."""
        self.watch = SessionWatch(name)
        self.last: Snapshot | None = None
        """Last snapshot of a process that has ended, until its events were found."""
        self.changes_wait: tuple[str, ...] = ()
        """Keys of its configuration that take effect as soon as its arm is free: the session is
        restarted then, or ends if it was removed."""
        self.answered: Callable[[bytes], None] = lambda _packet: None
        self.gone: Callable[[str], None] = lambda _reason: None
        """Called when its process has ended."""
        self.has_device: Callable[[], bool] = lambda: True
        """Returns whether it begins with its device, which other sessions may have."""
        self.lent: Callable[[], str] = lambda: ""
        """Returns the place of its device, as text."""
        self.router_promised: Callable[[tuple[str, int]], bool] = lambda _address: False
        """Returns whether a server of the daemon is to be the router there; for any thread."""

    @property
    def snapshot(self) -> Snapshot:
        process = self.process
        return process.snapshot if isinstance(process, RunningSession) else Snapshot()

    @property
    def engaged(self) -> bool:
        """True if a source moves its arm, or has the authority to."""
        s = self.snapshot
        moves = s.arm.phase in ENGAGED and s.arm.phase != "holding"
        return self.process is not None and (moves or s.arm.authority != "")

    def begin(self, post: Post, say: Say) -> None:
        def over(how: Ended, reason: str) -> None:
            post(lambda: _ended(self, how, reason))

        self.process = RunningSession(
            self.entry.config,
            lambda text: say(LogLine.of(self.name, text)),
            over,
            lambda packet: post(lambda: self.answered(packet)),
            self.has_device(),
            self.router_promised,
        )

    def figures(self, now_s: float) -> dict[str, Any]:
        return self.shown(now_s) | {
            "snapshot": None if self.process is None else json.loads(self.snapshot.to_bytes()),
            "stops": self.watch.stops,
            "refusals": self.watch.refusals,
        }

    def shown(self, now_s: float) -> dict[str, Any]:
        s = self.snapshot
        config = self.entry.config
        return super().shown(now_s) | {
            "device": config.device.driver if config.device else "",
            "robot": config.robot.driver,
            "phase": s.arm.phase,
            "device_link": s.device.link,
            "robot_link": s.robot.link,
            "device_held": s.device.held,
            "device_metrics": s.device.metrics,
            "authority": s.arm.authority,
            "authority_s": s.arm.authority_s,
            "why": why_nothing_moves(s, self.lent()),
            "trips": s.arm.trips,
            "cycles": s.loop.cycles,
            "tick_p99_s": s.loop.tick_p99_s,
            "changes_wait": list(self.changes_wait),
        }


class ServerService(DaemonService):
    """Service that runs a server."""

    kind = "server"

    def __init__(self, name: str, entry: ServerEntry, start_limit: int) -> None:
        super().__init__(name, start_limit)
        self.entry = entry
        self.socket = ""
        """The daemon's socket, for servers that query it."""

    def begin(self, post: Post, say: Say) -> None:
        def over(how: Ended, reason: str) -> None:
            post(lambda: _ended(self, how, reason))

        self.process = RunningServer(
            (self.entry.server, *self.entry.words),
            lambda text: say(LogLine.of(self.name, text)),
            over,
            self.socket,
        )

    def figures(self, now_s: float) -> dict[str, Any]:
        process = self.process
        return self.shown(now_s) | {
            "figures": process.figures if isinstance(process, RunningServer) else {}
        }

    def shown(self, now_s: float) -> dict[str, Any]:
        process = self.process
        endpoint = process.endpoint if isinstance(process, RunningServer) else ""
        return super().shown(now_s) | {"server": self.entry.server, "endpoint": endpoint}


def _ended(service: DaemonService, how: Ended, reason: str) -> None:
    if isinstance(service, SessionService):
        service.last = service.snapshot
    service.process = None
    reason = printable(reason)
    service.unit.ended(how, reason, time.monotonic())
    if isinstance(service, SessionService):
        service.gone(reason)
