"""Connects a Zenoh session again to peers whose connection to it broke.

Zenoh reconnects only to configured endpoints: the router. Two peers that met through the router
stay apart after their connection breaks; no log entry appears, and the router relays no messages
between them. A temporary third peer introduces them again. It does not help if a peer sends gossip
to routers only (scouting/gossip/target), as in rmw_zenoh's default configuration.
"""

from __future__ import annotations

import contextlib
import json
import logging
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from cardan.errors import ConfigurationError
from cardan.protocols.ros2.zenoh import LIVELINESS, NODE, Entity

LOOK_S = 0.2, 2.0
"""First and longest pause before the router is queried for a lost peer: by then it knows whether
the peer ended."""

MEET_S = 0.5
"""How long the third peer stays: they meet in 20 ms on loopback."""

ROUTER_TIMEOUT_S = 1.0
"""Longest wait for the router."""

THIRD = "cada9e3f"
"""Prefix of the ids of third peers, whose loss is ignored."""

_log = logging.getLogger(__name__)


class Reconnector:
    """Watches the connections of a session. It does nothing without a router: a peer retries its
    endpoint by itself, and a restarted router introduces its peers to each other."""

    def __init__(self, zenoh: Any, session: Any, config: Callable[[], Any]) -> None:
        """`config`: makes the configuration of another session on the same bus."""
        self._zenoh, self._session, self._config = zenoh, session, config
        self._lost: dict[str, float] = {}
        """Time of loss of each lost peer, by id."""
        self._reported: set[str] = set()
        self._pause_s = LOOK_S[0]
        self._changed = threading.Condition()
        self._thread: threading.Thread | None = None
        self._closed = False
        # Not indirect: no thread that waits for a rare event.
        handler = zenoh.handlers.Callback(self._hear, indirect=False)
        self._listener = session.info.declare_transport_events_listener(handler, history=False)

    def close(self) -> None:
        """Stop watching; call it before the session is closed. May be called twice."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            thread = self._thread
        with contextlib.suppress(self._zenoh.ZError):
            self._listener.undeclare()
        if thread is not None:
            thread.join()

    def _hear(self, event: Any) -> None:
        """Handle a connection that was opened or closed; runs in a thread of Zenoh."""
        transport = event.transport
        zid = str(transport.zid)
        if transport.whatami != self._zenoh.WhatAmI.PEER or zid.startswith(THIRD):
            return
        with self._changed:
            if event.kind == self._zenoh.SampleKind.PUT:
                self._found(zid)
            elif not self._closed:
                self._lost.setdefault(zid, time.monotonic())
                self._pause_s = LOOK_S[0]
                if self._thread is None:
                    self._thread = threading.Thread(target=self._run, daemon=True)
                    self._thread.start()
            self._changed.notify_all()

    def _found(self, zid: str) -> None:
        since_s = self._lost.pop(zid, None)
        self._reported.discard(zid)
        if since_s is not None:
            # Also if the peer reconnected before this side reported the loss: a session that
            # returns with the same id was there all the time.
            gap_s = time.monotonic() - since_s
            _log.warning("connected to Zenoh session %s again, after %.1f s", zid, gap_s)

    def _run(self) -> None:
        while self._waited():
            try:
                self._look()
            except (self._zenoh.ZError, ConfigurationError) as error:
                _log.info("the router could not be asked for lost peers: %s", error)

    def _waited(self) -> bool:
        """Wait; return False if nothing is left to do, which ends the thread."""
        with self._changed:
            pause_s = self._pause_s
            self._pause_s = min(2.0 * pause_s, LOOK_S[1])
            self._changed.wait_for(lambda: self._closed or not self._lost, pause_s)
        routers = self._session.info.routers_zid()  # Without the lock that _hear takes.
        with self._changed:
            if self._closed or not routers:
                self._forget(set(self._lost))
            if not self._lost:
                self._thread = None
                return False
            return True

    def _forget(self, gone: set[str]) -> None:
        for zid in gone:
            self._lost.pop(zid, None)
            self._reported.discard(zid)

    def _look(self) -> None:
        """Query the router for lost peers that are still there, and introduce this session to
        them."""
        with self._changed:
            lost = set(self._lost)
        with self._joined("client", None) as client:
            nodes = _nodes(client)
        if nodes is None:
            return  # It is unknown which peers have ended.
        with self._changed:
            self._forget(lost - nodes.keys())
            for zid in self._lost.keys() & lost - self._reported:
                self._reported.add(zid)
                _log.warning(
                    "the connection to Zenoh session %s (%s) is lost: no message passes between it "
                    "and this one; connects again",
                    zid,
                    nodes[zid],
                )
            if not self._lost:
                return
        with self._joined("peer", THIRD + secrets.token_hex(12)), self._changed:
            self._changed.wait_for(lambda: self._closed or not self._lost, MEET_S)

    @contextlib.contextmanager
    def _joined(self, mode: str, zid: str | None) -> Iterator[Any]:
        """Open another session on the same bus, to which no peer can connect."""
        config = self._config()
        endpoints = json.loads(config.get_json("connect/endpoints"))
        if isinstance(endpoints, dict):  # By mode; the other mode has this session's settings.
            endpoints = endpoints.get(json.loads(config.get_json("mode")), [])
        changes: dict[str, object] = {
            "id": zid,
            "mode": mode,
            "listen/endpoints": [],
            "connect/endpoints": endpoints,
            "connect/timeout_ms": round(1e3 * ROUTER_TIMEOUT_S),
            "connect/exit_on_failure": True,
        }
        for key, value in changes.items():
            config.insert_json5(key, json.dumps(value))
        session = self._zenoh.open(config)
        try:
            yield session
        finally:
            session.close()


def _nodes(client: Any) -> dict[str, str] | None:
    """Return the nodes of each Zenoh session from the router's tokens; None if they were not
    complete in time."""
    replies = client.liveliness().get(f"{LIVELINESS}/*/*/*/*/{NODE}/**", timeout=ROUTER_TIMEOUT_S)
    names: dict[str, set[str]] = {}
    for reply in replies:
        if reply.ok is None:
            return None
        each = Entity.parse(str(reply.ok.key_expr))
        if each is not None:
            names.setdefault(each.zid, set()).add(each.full_node)
    return {zid: ", ".join(sorted(nodes)) for zid, nodes in names.items()}
