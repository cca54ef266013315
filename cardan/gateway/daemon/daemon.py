"""The daemon: starts sessions and servers from files, keeps them running, and serves its socket.

A single thread makes all decisions; the threads that follow processes report to its inbox.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from cardan import __version__
from cardan.common.inbox import Inbox, InboxEmptyError
from cardan.common.logs import fields
from cardan.common.resource_errors import shortage
from cardan.common.sockets import make_runtime_folder, runtime_path
from cardan.errors import CardanError, ConfigurationError
from cardan.gateway.arm.backlog import STREAMED_S
from cardan.gateway.arm.requests import LATE_S, PacketError, decode_request
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.arm.verb_table import ENDLESS, NEW_MOTION, SEQUENCED
from cardan.gateway.daemon.changes import (
    REMOVED,
    UNTIL_FREE,
    UNTIL_START,
    Change,
    in_words,
    of_servers,
    of_session,
)
from cardan.gateway.daemon.config import DaemonConfig, ServerEntry, SessionEntry, sharers
from cardan.gateway.daemon.control import CLIENT_SILENCE_S, Ask, ControlError, Response
from cardan.gateway.daemon.device_sharing import Order, SessionState, SharedDevice
from cardan.gateway.daemon.events import Event, EventLog, default_event_log
from cardan.gateway.daemon.processes import (
    ENDS_WITHIN_S,
    RunningSession,
)
from cardan.gateway.daemon.restart_policy import Ended, Unit, UnitState
from cardan.gateway.daemon.server import ControlConnection, ControlServer
from cardan.gateway.daemon.services import DaemonService, LogLine, ServerService, SessionService
from cardan.gateway.daemon.systemd_watchdog import Notifier
from cardan.gateway.servers.tokens import Role
from cardan.gateway.session.device_sharing import GIVE, TAKE
from cardan.types import NEVER_S

POLL_S: Final = 0.1
"""Period of checks of its processes."""

MAX_LINES: Final = 2000
MAX_CHARACTERS: Final = 2_000_000
"""Most lines of output kept for later requests, and their total characters: one answer has them
all."""

LINES_WAITING: Final = 5000
"""Most lines that wait for the daemon; beyond, lines are dropped, and counted."""

CALLS_A_TURN: Final = 500
"""Most reports of processes handled in one turn."""

GOING_ON: Final = 16
"""Most continuing requests of one connection: `watch`, `log -f` and `events -f`."""

MAX_EVENTS: Final = 1000
"""Events kept for later requests; the event log has more."""

WATCH_PERIODS_S: Final = (0.1, 60.0)

_UNDER_WAY = ("waiting", "running")
"""Outcomes of motions that have not ended."""

_BAD = frozenset({UnitState.WAITING.value, UnitState.FAILED.value, "trip", "reload refused"})
"""Events that may need an administrator."""

_log = logging.getLogger(__name__)


class _Route(NamedTuple):
    """A client that sent a session a request."""

    connection: ControlConnection
    ask: int
    request: Any
    endless: bool
    note: Mapping[str, Any] = MappingProxyType({})
    """Report of the motion's beginning."""
    since_s: float = NEVER_S
    """Time of that report, with which the client's beats begin."""

    @property
    def silent_s(self) -> float:
        """Time for which nothing has come from the client of the motion."""
        return min(self.connection.silent_s, self.connection.empty_s - self.since_s)


ReloadOutcome = Sequence[Change] | CardanError
"""Outcome of a reload: its changes, or why nothing was changed."""


class Daemon:
    """Runs the services of a configuration until it is requested to end."""

    def __init__(self, config: DaemonConfig, read: Callable[[], DaemonConfig]) -> None:
        """`read` reads the files again, in a separate thread, where it must not delay the daemon's
        other threads: sessions without beats stop their arms. Raises ConfigurationError."""
        self.config = config
        self._read = read
        self._services: dict[str, DaemonService] = {}
        self._events: Inbox[Callable[[], None]] = Inbox()
        self._lines: deque[LogLine] = deque()
        self._characters = 0
        """Total length of these lines."""
        self._lines_dropped = 0
        self._server: ControlServer | None = None
        self._ending = False
        self._reload_asked = False
        self._reading = False
        """True while the files are being read for a reload."""
        self._watchers: dict[tuple[int, int], _Watcher] = {}
        self._followers: dict[tuple[int, int], tuple[ControlConnection, Ask]] = {}
        self._notifier = Notifier()
        self._recent: deque[Event] = deque(maxlen=MAX_EVENTS)
        self._event_log: EventLog | None = None
        self._ids = itertools.count(1)
        self._routes: dict[tuple[str, int], _Route] = {}
        """Clients that wait for the answer to a request, by session and the daemon's own number."""
        self._motions: dict[tuple[str, int], _Route] = {}
        """Clients to be notified of a motion, by session and the motion's id."""
        self._shared: dict[str, SharedDevice] = {}
        """The devices that several sessions share, by name."""
        self._routed: frozenset[tuple[str, int]] = frozenset()
        """Addresses at which servers of this daemon are to be the router; replaced, as threads of
        sessions read it."""
        for name, session in config.sessions.items():
            self._add(SessionService(name, session, config.daemon.start_limit), session.start)
        for name, server in config.servers.items():
            self._add(ServerService(name, server, config.daemon.start_limit), server.start)
        self._share()

    def _add(self, service: DaemonService, start: bool) -> None:
        self._services[service.name] = service
        if isinstance(service, SessionService):
            name = service.name
            service.answered = lambda packet: self._answered(name, packet)
            service.gone = lambda reason: self._session_gone(name, reason)
            service.has_device = lambda: self._holder(name) in ("", name)
            service.lent = lambda: self._lent(name)
            service.router_promised = lambda address: address in self._routed
        if start:
            service.unit.start(time.monotonic())

    def _share(self) -> None:
        """Find the sessions that share devices, by present configurations; a holder keeps its
        device."""
        before, self._shared = self._shared, {}
        entries = {}
        for name in (*self.config.sessions, *self._services):
            service = self._services[name]
            wanted = service.process or name in self.config.sessions
            if isinstance(service, SessionService) and wanted:
                entries[name] = service.entry
        for device, names in sharers(entries).items():
            shared = before.get(device)
            if shared is None:
                shared = SharedDevice(device, names)
                seen = {name: self._seen(name) for name in names}
                have = (name for name in names if seen[name].running and seen[name].held)
                shared.holder = next(have, shared.holder)
            shared.serve(names)
            self._shared[device] = shared

    def _holder(self, name: str) -> str:
        """Return the session that holds the device of this one; empty: it is not shared."""
        found = (each.holder for each in self._shared.values() if name in each.sessions)
        return next(found, "")

    def _lent(self, name: str) -> str:
        """Return where the device of a session is that has not opened it."""
        holder = self._holder(name)
        return f"its device serves {holder}" if holder != name else "its device is being opened"

    # -- from other threads, and signal handlers -------------------------------------------------

    def end(self) -> None:
        """Request its end: sessions brake, hold and leave. Safe in a signal handler."""
        self._ending = True
        if self._server is not None:
            self._server.wake()

    def ask_reload(self) -> None:
        """Request a reload of its files. Safe in a signal handler."""
        self._reload_asked = True
        if self._server is not None:
            self._server.wake()

    def _post(self, call: Callable[[], None]) -> None:
        self._events.put(call)
        if self._server is not None:
            self._server.wake()

    def _say(self, line: LogLine) -> None:
        if len(self._events) >= LINES_WAITING:
            self._lines_dropped += 1
            return
        self._post(lambda: self._keep_line(line))

    # -- the loop --------------------------------------------------------------------------------

    def run(self, ready: Callable[[str], None], seconds: float | None = None) -> None:
        """Serve until `end`, or until `seconds` are over. `ready` gets the path of its socket.

        Raises AddressError if another daemon has the socket.
        """
        options = self.config.daemon
        if not options.socket:
            make_runtime_folder()
        path = options.socket or runtime_path("cardan.sock")
        self._server = server = ControlServer(
            path, options.group, self._handle, Role[options.group_role.upper()]
        )
        until_s = None if seconds is None else time.monotonic() + seconds
        try:
            if options.event_log != "none":
                file = Path(options.event_log) if options.event_log else default_event_log()
                self._event_log = EventLog(file)
            ready(server.path)
            self._notifier.ready()
            while not self._ending and (until_s is None or time.monotonic() < until_s):
                self._turn(server)
            self._leave(server)
        finally:
            for service in self._services.values():
                if service.process is not None:
                    service.process.stop()
            for service in self._services.values():
                if (process := service.process) is not None:
                    process.join(ENDS_WITHIN_S)
            server.close()
            if self._event_log is not None:
                self._event_log.close()

    def _turn(self, server: ControlServer) -> None:
        now_s = time.monotonic()
        if self._reload_asked and not self._reading:
            self._reload_asked = False
            self._notifier.reloading()
            self.reload(lambda _outcome: self._notifier.ready())
        if self._notifier.watched:
            self._notifier.status(self._summary())
            if self._all_answer(now_s):
                self._notifier.alive(now_s)
        self._look_after(now_s)
        self._find_events()
        self._pass_devices()
        self._tell_watchers(now_s)
        server.poll(0.0 if len(self._events) else POLL_S)
        with contextlib.suppress(InboxEmptyError):
            for _ in range(CALLS_A_TURN):
                call = self._events.get(0.0)
                try:
                    call()
                except Exception:  # A fault of one process; the others go on.
                    _log.exception("a report of a process failed: internal error of the daemon")
        self._end_of_left()

    def _summary(self) -> str:
        states = [service.unit.state.value for service in self._services.values()]
        return ", ".join(f"{states.count(state)} {state}" for state in dict.fromkeys(states))

    def _all_answer(self, now_s: float) -> bool:
        """Return whether every session that has begun has reported recently."""
        running = (service.process for service in self._services.values())
        return all(
            now_s <= process.due_s for process in running if isinstance(process, RunningSession)
        )

    def _find_events(self) -> None:
        for service in self._services.values():
            self._find_events_of(service, time.time())

    def _find_events_of(self, service: DaemonService, time_s: float) -> None:
        unit = service.unit
        if isinstance(service, SessionService) and service.last is not None:
            for event in service.watch.take(service.last, time_s):
                self._happened(event)
            service.watch.forget()
            service.last = None
        if unit.state is not service.shown_state:
            service.shown_state = unit.state
            self._happened(Event(time_s, service.name, unit.state.value, service.kind, unit.reason))
        if isinstance(service, SessionService) and service.process is not None:
            for event in service.watch.take(service.snapshot, time_s):
                self._happened(event)

    def _happened(self, event: Event) -> None:
        self._recent.append(event)
        _log.log(
            logging.WARNING if event.event in _BAD else logging.INFO,
            "%s: %s %s%s",
            *(event.name, event.event, event.what, f": {event.why}" if event.why else ""),
            extra=fields(name=event.name, event=event.event, what=event.what, why=event.why),
        )
        if self._event_log is not None:
            self._event_log.write(event)
        for connection, ask in self._followers.values():
            if ask.do == "events" and ask.name in ("", event.name):
                connection.tell(Response(ask.id, "event", event._asdict()))

    def _look_after(self, now_s: float) -> None:
        servers = (each for each in self._services.values() if isinstance(each, ServerService))
        self._routed = frozenset().union(*(s.entry.routed for s in servers if s.unit.wanted))
        for service in list(self._services.values()):
            unit = service.unit
            if isinstance(service, SessionService) and service.changes_wait and not service.engaged:
                self._renew(service, now_s)
            if unit.is_ending and service.process is not None:
                service.process.stop()
            elif unit.due(now_s):
                if service.shown_state is UnitState.RUNNING:
                    # It has ended by itself, and this daemon has not reported that yet.
                    self._find_events_of(service, time.time())
                self._begin(service, now_s)

    def _renew(self, service: SessionService, now_s: float) -> None:
        """Apply changes to a session whose arm is free."""
        if service.unit.state is UnitState.RUNNING:
            if REMOVED in service.changes_wait:
                _remove(service)
            else:
                service.unit.restart(now_s, "its configuration has changed")

    def _begin(self, service: DaemonService, now_s: float) -> None:
        service.unit.begun(now_s)
        if isinstance(service, ServerService) and self._server is not None:
            service.socket = os.path.abspath(self._server.path)
        try:
            service.begin(self._post, self._say)
        except OSError as error:
            words = shortage(error) or f"cannot be started: {error}"
            service.unit.ended(Ended.DIED, words, now_s)

    def _pass_devices(self) -> None:
        for shared in self._shared.values():
            for name, order in shared.poll(self._seen):
                service = self._services[name]
                if isinstance(service.process, RunningSession):
                    with contextlib.suppress(OSError):
                        service.process.send(TAKE if order is Order.TAKE else GIVE)

    def _seen(self, name: str) -> SessionState:
        service = self._services[name]
        assert isinstance(service, SessionService)
        s = service.snapshot
        return SessionState(
            service.unit.wanted,
            service.process is not None,
            s.device.held,
            s.arm.phase,
            s.device.passes,
        )

    def _leave(self, server: ControlServer) -> None:
        """Shut down all processes; requests are answered meanwhile."""
        self._notifier.stopping()
        now_s = time.monotonic()
        give_up_s = now_s + ENDS_WITHIN_S
        for service in self._services.values():
            service.unit.stop(now_s, "the daemon ends")
        while (
            any(each.process for each in self._services.values()) and time.monotonic() < give_up_s
        ):
            self._turn(server)

    # -- requests --------------------------------------------------------------------------------

    def _handle(self, ask: Ask, connection: ControlConnection) -> None:
        try:
            found = getattr(self, f"_do_{ask.do}")(ask, connection)
        except CardanError as error:
            connection.tell(Response(ask.id, "error", str(error)))
            return
        except Exception:
            # A single request must not end all sessions.
            _log.exception("a request, %s, failed: internal error of the daemon", ask.do)
            connection.tell(
                Response(ask.id, "error", f"{ask.do}: an internal error: see the daemon's log")
            )
            return
        if found is not None:
            connection.tell(Response(ask.id, "result", found))

    def _named(self, ask: Ask) -> list[DaemonService]:
        if not ask.name:
            raise ControlError(f"{ask.do}: give a name: {self._names()}", ask.id)
        if ask.name not in self._services:
            raise ControlError(f"there is no {ask.name!r:.70}; {self._names()}", ask.id)
        return [self._services[ask.name]]

    def _names(self) -> str:
        return f"there are: {', '.join(self._services)}"

    def _session(self, ask: Ask) -> SessionService:
        service = self._named(ask)[0]
        if not isinstance(service, SessionService):
            raise ControlError(f"{ask.name} is a server, which has no arm", ask.id)
        return service

    def _rows(self, name: str = "") -> list[dict[str, Any]]:
        now_s = time.monotonic()
        return [each.shown(now_s) for each in self._services.values() if name in ("", each.name)]

    def _do_version(self, _ask: Ask, _connection: ControlConnection) -> Any:
        return __version__

    def _do_units(self, ask: Ask, _connection: ControlConnection) -> Any:
        if ask.name:
            self._named(ask)
        return self._rows(ask.name)

    def _do_snapshot(self, ask: Ask, _connection: ControlConnection) -> Any:
        return json.loads(self._session(ask).snapshot.to_bytes())

    def _do_figures(self, _ask: Ask, _connection: ControlConnection) -> Any:
        now_s = time.monotonic()
        units = [service.figures(now_s) for service in self._services.values()]
        return {"version": __version__, "units": units}

    def _do_start(self, ask: Ask, _connection: ControlConnection) -> Any:
        return self._order(ask, Unit.start)

    def _do_stop(self, ask: Ask, _connection: ControlConnection) -> Any:
        return self._order(ask, Unit.stop)

    def _do_restart(self, ask: Ask, _connection: ControlConnection) -> Any:
        return self._order(ask, Unit.restart)

    def _order(self, ask: Ask, order: Callable[[Unit, float], None]) -> Any:
        for service in self._named(ask):
            order(service.unit, time.monotonic())
        self._look_after(time.monotonic())
        return self._rows(ask.name)

    def _do_devices(self, _ask: Ask, _connection: ControlConnection) -> Any:
        return [
            {"name": each.name, "sessions": list(each.sessions), "holder": each.holder}
            for each in self._shared.values()
        ]

    def _do_switch(self, ask: Ask, _connection: ControlConnection) -> Any:
        shared = self._shared.get(ask.name)
        if shared is None:
            known = ", ".join(self._shared) or "none"
            raise ControlError(
                f"{ask.name!r:.70} is not a device that sessions share; these are: {known}",
                ask.id,
            )
        to = ask.value or shared.after(
            shared.next or shared.holder, lambda name: self._seen(name).wanted
        )
        if not to:
            raise ControlError(f"no other session that shares {ask.name} runs", ask.id)
        if to not in shared.sessions:
            raise ControlError(
                f"{ask.name} goes to {', '.join(shared.sessions)}, not to {to!r:.70}", ask.id
            )
        if not self._seen(to).wanted:
            state = self._services[to].unit.state.value
            raise ControlError(f"{to} is {state}: `cardan daemon start {to}` first", ask.id)
        shared.pass_to(to)
        return {"name": shared.name, "from": shared.holder, "to": to}

    def _do_reload(self, ask: Ask, connection: ControlConnection) -> Any:
        if ask.value not in (None, True, False):
            raise ControlError(
                "reload: its value says whether it only checks: true or false", ask.id
            )

        def over(outcome: ReloadOutcome) -> None:
            if isinstance(outcome, CardanError):
                connection.tell(Response(ask.id, "error", str(outcome)))
            else:
                connection.tell(Response(ask.id, "result", [each._asdict() for each in outcome]))

        self.reload(over, check_only=ask.value is True)
        return None

    def _do_watch(self, ask: Ask, connection: ControlConnection) -> Any:
        period_s = 1.0 if ask.value is None else ask.value
        low, high = WATCH_PERIODS_S
        if isinstance(period_s, bool) or not isinstance(period_s, (int, float)):
            raise ControlError(f"watch: {period_s!r:.40} is not a period in seconds", ask.id)
        if not low <= period_s <= high:
            raise ControlError(
                f"watch: {period_s!r:.40} s is not allowed; from {low:g} to {high:g}", ask.id
            )
        if ask.name:
            self._named(ask)
        self._goes_on(ask, connection)
        self._watchers[id(connection), ask.id] = _Watcher(connection, ask, float(period_s))

    def _goes_on(self, ask: Ask, connection: ControlConnection) -> None:
        """Raise ControlError if too many requests of this connection continue already."""
        ids = [number for of, number in (*self._watchers, *self._followers) if of == id(connection)]
        if len(ids) >= GOING_ON or ask.id in ids:
            why = f"a request of id {ask.id}" if ask.id in ids else f"{GOING_ON} requests"
            raise ControlError(f"{ask.do}: this connection has {why} already", ask.id)
        if not ids:
            connection.gone.append(lambda: self._forget(id(connection)))

    def _forget(self, connection: int) -> None:
        for table in (self._watchers, self._followers):
            for key in [each for each in table if each[0] == connection]:
                del table[key]

    def _tell_watchers(self, now_s: float) -> None:
        for watcher in self._watchers.values():
            if now_s >= watcher.due_s:
                watcher.due_s = now_s + watcher.period_s
                rows = self._rows(watcher.ask.name)
                watcher.connection.tell(Response(watcher.ask.id, "event", rows))

    def _do_beat(self, _ask: Ask, _connection: ControlConnection) -> None:
        """Do nothing: the connection has recorded its time."""

    def _do_log(self, ask: Ask, connection: ControlConnection) -> Any:
        if ask.name:
            self._named(ask)
        retained = [list(line) for line in self._lines if ask.name in ("", line.name)]
        return self._followed(ask, connection, retained)

    def _do_events(self, ask: Ask, connection: ControlConnection) -> Any:
        if ask.name and ask.name != "daemon":
            self._named(ask)
        retained = [each._asdict() for each in self._recent if ask.name in ("", each.name)]
        return self._followed(ask, connection, retained)

    def _followed(self, ask: Ask, connection: ControlConnection, retained: Sequence[Any]) -> Any:
        """Return the retained items as the answer; or send them one by one, followed by new
        ones."""
        if ask.value not in (None, True, False):
            why = "its value must be true or false (follow or not)"
            raise ControlError(f"{ask.do}: {why}", ask.id)
        if not ask.value:
            return retained
        self._goes_on(ask, connection)
        connection.tell(*(Response(ask.id, "event", each) for each in retained))
        self._followers[id(connection), ask.id] = connection, ask
        return None

    def _keep_line(self, line: LogLine) -> None:
        if dropped := self._lines_dropped:
            self._lines_dropped = 0
            _log.warning("%d lines of processes were left out: they came too fast", dropped)
        self._lines.append(line)
        self._characters += len(line.text)
        while len(self._lines) > MAX_LINES or self._characters > MAX_CHARACTERS:
            self._characters -= len(self._lines.popleft().text)
        level = getattr(logging, line.level.upper())
        _log.log(level, "%s| %s", line.name, line.text, extra=fields(name=line.name, event="said"))
        for connection, ask in self._followers.values():
            if ask.do == "log" and ask.name in ("", line.name):
                connection.tell(Response(ask.id, "event", list(line)))

    # -- verbs -----------------------------------------------------------------------------------

    def _do_ask(self, ask: Ask, connection: ControlConnection) -> Any:
        service = self._session(ask)
        request, process = ask.value, service.process
        if not isinstance(request, dict):
            raise ControlError("ask: its value is a request of a verb, an object", ask.id)
        if not isinstance(process, RunningSession):
            why = f": {service.unit.reason}" if service.unit.reason else ""
            raise ControlError(f"{service.name} is {service.unit.state.value}{why}", ask.id)
        if not process.snapshot.arm.phase:
            raise ControlError(f"{service.name} is starting", ask.id)
        late_s, verb = time.monotonic() - connection.since_s, request.get("verb")
        if late_s > LATE_S and verb in NEW_MOTION | SEQUENCED:
            raise ControlError(
                f"the daemon stalled for {late_s:.1f} s when this came; ask again", ask.id
            )
        if late_s > STREAMED_S and verb in SEQUENCED:
            raise ControlError(
                f"{verb}: it may have waited for {late_s:.2f} s; commands older than "
                f"{STREAMED_S:g} s are not executed: send less often",
                ask.id,
            )
        number = next(self._ids)
        try:
            filled = request | {"id": number, "since": connection.since_s}
            packet = json.dumps(filled, separators=(",", ":")).encode()
            endless = decode_request(packet).verb in ENDLESS
        except RecursionError:
            raise ControlError("ask: its value is too deep", ask.id) from None
        except PacketError as error:
            if error.request is None:  # The session could not say whose it is.
                raise ControlError(f"ask: {error}", ask.id) from None
            endless = False
        self._routes[service.name, number] = _Route(connection, ask.id, request.get("id"), endless)
        try:
            process.send(packet)
        except OSError as error:
            del self._routes[service.name, number]
            blocked = isinstance(error, BlockingIOError)
            words = "it does not read them; it hangs" if blocked else error.strerror
            raise ControlError(f"{service.name} takes no requests: {words}", ask.id) from None

    def _answered(self, name: str, packet: bytes) -> None:
        """Handle a session's answer, or its report of a motion."""
        table = json.loads(packet)
        if "motion" in table:
            note = table["motion"]
            route = self._motions.get((name, note["id"]))
            if route is not None:
                if note["outcome"] not in _UNDER_WAY:
                    del self._motions[name, note["id"]]
                route.connection.tell(Response(route.ask, "event", table))
            return
        route = self._routes.pop((name, table["reply"] or 0), None)
        if route is None:
            return
        result = table.get("result")
        if isinstance(result, dict) and result.get("outcome") in _UNDER_WAY and "ends" in result:
            begun = route._replace(note=result, since_s=time.monotonic())
            self._motions[name, result["id"]] = begun
        route.connection.tell(Response(route.ask, "result", table | {"reply": route.request}))

    def _session_gone(self, name: str, reason: str) -> None:
        """Refuse unanswered requests to a session whose process has ended. The next one's motions
        have the same ids."""
        why = f"{name} has ended{reason and f': {reason}'}"
        for key in [each for each in self._routes if each[0] == name]:
            route = self._routes.pop(key)
            route.connection.tell(Response(route.ask, "error", why))
        for key in [each for each in self._motions if each[0] == name]:
            route = self._motions.pop(key)
            note = {**route.note, "outcome": Outcome.ABORTED.value, "reason": why}
            route.connection.tell(Response(route.ask, "event", {"motion": note}))
        service = self._services[name]
        assert isinstance(service, SessionService)
        if REMOVED in service.changes_wait:
            _remove(service)
        service.entry, service.changes_wait = self.config.sessions.get(name, service.entry), ()
        self._share()

    def _end_of_left(self) -> None:
        """End the motions without end of clients that are suspended, or have disconnected."""
        for key, route in list(self._motions.items()):
            is_open, silent_s = route.connection.open, route.silent_s
            if is_open and not (route.endless and silent_s > CLIENT_SILENCE_S):
                continue
            if route.endless and not self._stop_arm(key[0]):
                continue  # It reads no requests now: again in the next turn.
            if not is_open:
                del self._motions[key]
                continue
            self._motions[key] = route._replace(endless=False)
            what = f"{route.note.get('verb')} of {route.note.get('source')} is stopped"
            why = f"nothing came from its program for {silent_s:.1f} s: it is suspended"
            self._happened(Event(time.time(), key[0], "message", what, why))

    def _stop_arm(self, name: str) -> bool:
        """Return False if the session takes no request."""
        service = self._services.get(name)
        process = None if service is None else service.process
        if isinstance(process, RunningSession):
            request = {"id": next(self._ids), "source": "daemon", "verb": "stop"}
            try:
                process.send(json.dumps(request).encode())
            except BlockingIOError:
                return False
            except OSError:  # It has ended, and its arm rests.
                return True
        return True

    # -- reload ----------------------------------------------------------------------------------

    def reload(self, over: Callable[[ReloadOutcome], None], check_only: bool = False) -> None:
        """Read the files again, check all of them, and apply all changes, or none; or only check.
        `over` gets the changes, or why nothing was changed. Raises ControlError if a reload is
        under way.
        """
        if self._reading:
            raise ControlError("a reload is under way; try again when it has finished")
        self._reading = True

        def read() -> None:
            config: DaemonConfig | CardanError
            try:
                config = self._read()
            except CardanError as error:
                config = error
            except Exception as error:  # The client waits for an answer.
                config = ConfigurationError("", shortage(error) or repr(error))
            self._post(lambda: over(self._take_config(config, check_only)))

        threading.Thread(target=read, name="cardan-reading", daemon=True).start()

    def _take_config(self, config: DaemonConfig | CardanError, check_only: bool) -> ReloadOutcome:
        """Handle a configuration that was read and checked."""
        self._reading = False
        try:
            if isinstance(config, CardanError):
                raise config
            self._check_kinds(config)
        except CardanError as error:
            if not check_only:
                what = "nothing was changed"
                self._happened(Event(time.time(), "daemon", "reload refused", what, str(error)))
            return error
        changes = [*of_servers(self.config.servers, config.servers), *self._changes(config)]
        if not check_only:
            self._happened(Event(time.time(), "daemon", "reload", in_words(changes)))
            self._apply(config, changes, time.monotonic())
        return changes

    def _check_kinds(self, config: DaemonConfig) -> None:
        """Raise ConfigurationError for changes that no reload can make."""
        if config.daemon != self.config.daemon:
            raise ConfigurationError(
                "daemon", "its own options are read at its start: restart the daemon for them"
            )
        for entries, kind in ((config.sessions, SessionService), (config.servers, ServerService)):
            for name in entries:
                service = self._services.get(name)
                process = None if service is None else service.process
                if process is not None and not isinstance(service, kind):
                    raise ConfigurationError(
                        name, "was a session and is a server now, or the other way round: rename it"
                    )

    def _changes(self, config: DaemonConfig) -> Iterator[Change]:
        """Yield changes of sessions; running sessions are compared by their present
        configuration."""
        for name in self.config.sessions.keys() - config.sessions.keys():
            service = self._services[name]
            assert isinstance(service, SessionService)
            yield Change(name, "", REMOVED, waits=UNTIL_FREE if service.engaged else "")
        for name, entry in config.sessions.items():
            session = self._services.get(name)
            if not isinstance(session, SessionService) or (
                name not in self.config.sessions and not session.changes_wait
            ):
                yield Change(name, "", "added")
                continue
            waits = UNTIL_FREE if session.engaged else "" if session.process else UNTIL_START
            yield from of_session(
                name, session.entry.config, entry.config, waits, session.changes_wait
            )

    def _apply(self, config: DaemonConfig, changes: Sequence[Change], now_s: float) -> None:
        before, self.config = self.config, config
        for name in before.servers.keys() - config.servers.keys() - config.sessions.keys():
            _remove(self._services[name])
        for name in before.sessions.keys() - config.sessions.keys():
            service = self._services[name]
            assert isinstance(service, SessionService)
            if service.process is None:
                _remove(service)
            else:
                service.changes_wait = (REMOVED,)
        for name, session in config.sessions.items():
            keys = [each.key for each in changes if (each.name, each.what) == (name, "changed")]
            self._take_session(name, session, keys, name not in before.sessions, now_s)
        for name, server in config.servers.items():
            self._take_server(name, server, name not in before.servers, now_s)
        self._share()

    def _take_session(
        self, name: str, entry: SessionEntry, keys: Sequence[str], is_new: bool, now_s: float
    ) -> None:
        service = self._services.get(name)
        if not isinstance(service, SessionService):
            self._add(SessionService(name, entry, self.config.daemon.start_limit), entry.start)
            return
        service.changes_wait = () if service.process is None else tuple(keys)
        if not service.changes_wait:
            service.entry = entry
        if keys and service.unit.state is UnitState.FAILED:
            service.unit.start(now_s)  # The cause of its failure may be fixed.
        if is_new and entry.start:
            service.unit.start(now_s)  # It was in the files before.

    def _take_server(self, name: str, entry: ServerEntry, is_new: bool, now_s: float) -> None:
        service = self._services.get(name)
        if not isinstance(service, ServerService):
            self._add(ServerService(name, entry, self.config.daemon.start_limit), entry.start)
        elif is_new:
            service.entry = entry
            if entry.start:
                service.unit.start(now_s)
        elif service.entry != entry:
            service.entry = entry
            if service.unit.state is UnitState.RUNNING:
                service.unit.restart(now_s, "its options have changed")


def _remove(service: DaemonService) -> None:
    service.unit.stop(time.monotonic(), "it is not in the files any more")


class _Watcher:
    """A client that gets all rows periodically."""

    def __init__(self, connection: ControlConnection, ask: Ask, period_s: float) -> None:
        self.connection, self.ask, self.period_s = connection, ask, period_s
        self.due_s = NEVER_S
