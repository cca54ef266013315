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
"""Phases of an arm that a source moves, or may move at once."""


class LogLine(NamedTuple):
    """A line that a process has written."""

    time_s: float
    """Since the epoch."""
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
"""Has something done in the daemon's thread."""

Say = Callable[[LogLine], None]


class DaemonService(ABC):
    """A session or a server: its known state, and its process while it runs."""

    kind = ""

    def __init__(self, name: str, start_limit: int) -> None:
        self.unit = Unit(name, start_limit)
        self.process: Process | None = None
        self.use = ProcessorUse()
        self.shown_state = UnitState.STOPPED
        """The state that the event log knows of."""

    @property
    def name(self) -> str:
        return self.unit.name

    @abstractmethod
    def begin(self, post: Post, say: Say) -> None:
        """Start its process. Raises OSError."""

    @abstractmethod
    def figures(self, now_s: float) -> dict[str, Any]:
        """Its row, and all figures that there are of it."""

    def shown(self, now_s: float) -> dict[str, Any]:
        """Its row."""
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
    of the robot comes before that, because programs can move the arm without the device."""
    if s.device.held:
        return s.arm.message or s.robot.hold_reason or s.device.reason
    return s.robot.hold_reason or lent


class SessionService(DaemonService):
    """A session."""

    kind = "session"

    def __init__(self, name: str, entry: SessionEntry, start_limit: int) -> None:
        super().__init__(name, start_limit)
        self.entry = entry
        """Configuration with which its process runs, or will."""
        self.watch = SessionWatch(name)
        self.last: Snapshot | None = None
        """Last snapshot of a process that has ended, while no events were found of it yet."""
        self.changes_wait: tuple[str, ...] = ()
        """Keys of its configuration that take effect as soon as its arm is free: it begins anew
        then, or ends if it was removed."""
        self.answered: Callable[[bytes], None] = lambda _packet: None
        self.gone: Callable[[str], None] = lambda _reason: None
        """Called when its process has ended."""
        self.has_device: Callable[[], bool] = lambda: True
        """Whether it begins with its device, which other sessions may have."""
        self.lent: Callable[[], str] = lambda: ""
        """Place of its device, in words."""

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
    """A server."""

    kind = "server"

    def __init__(self, name: str, entry: ServerEntry, start_limit: int) -> None:
        super().__init__(name, start_limit)
        self.entry = entry
        self.socket = ""
        """The daemon's, for servers that ask it."""

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
