"""Rate limit for failed token attempts, per address: a burst of wrong tokens with the same
beginning, then a low rate; and a coarser limit for all wrong ones. All times are monotonic, in
seconds."""

from __future__ import annotations

import ipaddress
from collections import OrderedDict
from collections.abc import Collection
from typing import NamedTuple

BURST = 20
"""Wrong tokens in a row with one beginning that an address may try: allows for typing errors."""

FORGOTTEN_S = 10.0
"""Time after which one wrong token of an address is forgotten: 8640 guesses a day."""

BEGINNING_CHARACTERS = 8
"""Characters by which wrong tokens are counted, so that they do not block other tokens. It is half
of the shortest token: the other half can only be guessed slowly behind each beginning."""

MOST_BEGINNINGS = 4096
"""Most beginnings that are remembered; a new one replaces the longest unused."""


ADDRESS_BURST = 200
"""Wrong tokens in a row, of any beginning, that an address may try: beyond, all get the answer of a
blocked one. The right token is accepted nevertheless."""

ADDRESS_FORGOTTEN_S = 1.0
"""Time after which one of them is forgotten."""


class _Tries(NamedTuple):
    level: float
    at_s: float


class FailedTokens:
    """The wrong tokens of each address, by their beginning. An IPv6 address counts as its network
    (/64), because a client with one address of it has them all."""

    def __init__(
        self,
        burst: int = BURST,
        forgotten_s: float = FORGOTTEN_S,
        most_beginnings: int = MOST_BEGINNINGS,
        right: Collection[str] = (),
    ) -> None:
        """`right`: beginnings of right tokens, which are kept separately: wrong ones cannot
        displace them."""
        self._right = right
        self._known = _Levels(burst, forgotten_s, most_beginnings)
        self._others = _Levels(burst, forgotten_s, most_beginnings)
        self._addresses = _Levels(ADDRESS_BURST, ADDRESS_FORGOTTEN_S, most_beginnings)

    def __len__(self) -> int:
        return len(self._known) + len(self._others)

    def wait_s(self, address: str, token: str, now_s: float) -> float:
        """Return the time until this address may try a token with its beginning; 0: now."""
        key = _key(address, token)
        return self._of(key).wait_s(key, now_s)

    def wrong_wait_s(self, address: str, now_s: float) -> float:
        """Return the time until this address may try a wrong token; 0: now."""
        return self._addresses.wait_s((_network(address), ""), now_s)

    def failed(self, address: str, token: str, now_s: float) -> None:
        """Record a wrong token of this address."""
        key = _key(address, token)
        counts = self.wrong_wait_s(address, now_s) == 0.0
        if counts or key[1] in self._right:
            self._of(key).add(key, now_s)
        if counts:
            self._addresses.add((key[0], ""), now_s)

    def _of(self, key: tuple[str, str]) -> _Levels:
        return self._known if key[1] in self._right else self._others


class _Levels:
    """Counts of wrong tokens by key."""

    def __init__(self, burst: int, forgotten_s: float, most: int) -> None:
        self._burst, self._forgotten_s, self._most = burst, forgotten_s, most
        self._tries: OrderedDict[tuple[str, str], _Tries] = OrderedDict()

    def __len__(self) -> int:
        return len(self._tries)

    def wait_s(self, key: tuple[str, str], now_s: float) -> float:
        return max(0.0, (self._level(key, now_s) + 1.0 - self._burst) * self._forgotten_s)

    def add(self, key: tuple[str, str], now_s: float) -> None:
        self._tries[key] = _Tries(self._level(key, now_s) + 1.0, now_s)
        self._tries.move_to_end(key)
        while len(self._tries) > self._most:
            self._tries.popitem(last=False)

    def _level(self, key: tuple[str, str], now_s: float) -> float:
        tries = self._tries.get(key)
        if tries is None:
            return 0.0
        return max(0.0, tries.level - (now_s - tries.at_s) / self._forgotten_s)


def _key(address: str, token: str) -> tuple[str, str]:
    return _network(address), token[:BEGINNING_CHARACTERS]


def _network(address: str) -> str:
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return ""
    if isinstance(found, ipaddress.IPv4Address):
        return str(found)
    if found.ipv4_mapped is not None:
        return str(found.ipv4_mapped)
    return str(ipaddress.ip_network((int(found), 64), strict=False))
