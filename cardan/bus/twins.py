"""Detects other nodes of the same name: both would receive each command, thus only one accepts it.

The second node finds the liveliness token of the first and does not start. Of two that start at
once, or meet later, the later one takes no commands; because liveliness tokens of ROS 2 do not say
when a node started, Cardan's nodes have a second token with start time and place.
"""

from __future__ import annotations

import logging
import re
import socket
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from cardan.bus.node import LEASE_MS, BusNode, TokenWatch
from cardan.errors import ConfigurationError
from cardan.protocols.ros2.zenoh import Entity, mangled, node_pattern

CLAIM = "@cardan_lv"
"""First part of the tokens that hold the time of a node's claim to its name, and its computer."""

MEET_S = 0.3
"""How long a joining node looks for others before it appears: ten times as long as it takes to meet
nodes at the same router."""

GONE_S = 1.5e-3 * LEASE_MS
"""Longest wait for a token to vanish: within the lease for a lost computer, at once for a crashed
node."""

_LOOK_S = 0.02

_log = logging.getLogger(__name__)


class NameClaim(NamedTuple):
    """Claim of a node to its name since a time. The smaller of two is the elder's."""

    since_ns: int
    """Since the epoch, by its own clock."""
    zid: str
    host: str

    def key(self, domain: int, name: str) -> str:
        """Return the key expression of its token."""
        host = re.sub(r"[^\w.-]", "_", self.host) or "_"
        return f"{CLAIM}/{domain}/{mangled(name)}/{self.zid}/{self.since_ns}/{host}"

    @classmethod
    def parse(cls, key: str) -> NameClaim | None:
        """Parse a key expression; None if it is not a claim's."""
        parts = key.split("/")
        if len(parts) != 6 or parts[0] != CLAIM or not parts[4].isdecimal() or len(parts[4]) > 20:
            return None
        return cls(int(parts[4]), parts[3], parts[5])


class Twins:
    """Other nodes with the full name of `node`, which has joined."""

    def __init__(self, node: BusNode, key: str = "name") -> None:
        """`key`: key of the network's options that holds the node's name."""
        self._node, self._key = node, key
        domain = node.options.domain
        self._own = NameClaim(time.time_ns(), node.zid, socket.gethostname())
        self._nodes = node.watch_tokens(node_pattern(domain, node.namespace, node.name))
        self._claims = node.watch_tokens(f"{CLAIM}/{domain}/{mangled(node.full_name)}/**")
        self._zids: dict[str, str] = {}
        self._claimed: dict[str, NameClaim] = {}
        self._token: Any = None

    def begin(self) -> None:
        """Announce `node` once its name is free. Raises ConfigurationError."""
        self.wait()
        self.claim()
        self._node.open()

    def claim(self) -> None:
        """Announce since when this node has its name; before its own token appears."""
        self._token = self._node.declare_key_token(
            self._own.key(self._node.options.domain, self._node.full_name)
        )

    def wait(
        self,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Check for `MEET_S` that the name is free; if not, wait for `GONE_S` more, because its
        owner may have crashed. Raises ConfigurationError."""
        end_s = clock() + MEET_S
        while not self.others():
            if clock() >= end_s:
                return
            sleep(_LOOK_S)
        _log.warning("%s; waits up to %g s for it to go", self._words(), GONE_S)
        end_s = clock() + GONE_S
        while self.others():
            if clock() >= end_s:
                raise ConfigurationError(
                    f"network.{self._key}",
                    f"{self._words()}, and a command would go to both: give this one another name "
                    f'or namespace, such as {self._key} = "left_arm", or end the other one',
                )
            sleep(_LOOK_S)

    def others(self) -> dict[str, NameClaim | None]:
        """Return the present ones by the id of their Zenoh session; None: start unknown. Never
        blocks."""
        _take(self._nodes, self._zids, lambda key: getattr(Entity.parse(key), "zid", None))
        _take(self._claims, self._claimed, NameClaim.parse)
        claims = {each.zid: each for each in self._claimed.values()}
        return {zid: claims.get(zid) for zid in self._zids.values() if zid != self._node.zid}

    def state(self) -> tuple[str, bool]:
        """Return a message about them (empty: none), and whether this node accepts commands."""
        others = self.others()
        if not others:
            return "", True
        if any(each is None or each[:2] < self._own[:2] for each in others.values()):
            return (
                f"{self._words()}: this one accepts only stops from the network; end one "
                "of them, or give them different names",
                False,
            )
        return f"{self._words()}; it started later and accepts no commands", True

    def _words(self) -> str:
        hosts = {each.host for each in self.others().values() if each is not None}
        where = f" on {', '.join(sorted(hosts))}" if hosts else ""
        return f"another node{where} has the name {self._node.full_name}"


def _take(watch: TokenWatch, retained: dict[str, Any], read: Callable[[str], Any]) -> None:
    while (change := watch.poll()) is not None:
        key, there = change
        if not there:
            retained.pop(key, None)
        elif (found := read(key)) is not None:
            retained[key] = found
