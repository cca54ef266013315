"""Bounds how fast tokens can be guessed: so many wrong ones from an address, then only one in a
while. All times are monotonic, in seconds."""

from __future__ import annotations

import ipaddress
from collections import OrderedDict
from typing import NamedTuple

BURST = 20
"""Wrong tokens in a row that an address may try: a person who mistypes, a page that reconnects."""

FORGOTTEN_S = 10.0
"""After so long one wrong token of an address is forgotten: 8640 guesses a day."""

MOST_ADDRESSES = 4096
"""Addresses that are kept in mind; beyond, the one is forgotten that has tried least lately."""


class _Tries(NamedTuple):
    level: float
    at_s: float


class FailedTokens:
    """The wrong tokens of each address. Of IPv6 it is the network (/64), as who has one address of
    it has them all."""

    def __init__(
        self,
        burst: int = BURST,
        forgotten_s: float = FORGOTTEN_S,
        most_addresses: int = MOST_ADDRESSES,
    ) -> None:
        self._burst, self._forgotten_s, self._most = burst, forgotten_s, most_addresses
        self._tries: OrderedDict[str, _Tries] = OrderedDict()

    def __len__(self) -> int:
        return len(self._tries)

    def wait_s(self, address: str, now_s: float) -> float:
        """How long until this address may try a token; 0: it may now."""
        level = self._level(_network(address), now_s)
        return max(0.0, (level + 1.0 - self._burst) * self._forgotten_s)

    def failed(self, address: str, now_s: float) -> None:
        """A token from this address was wrong."""
        key = _network(address)
        self._tries[key] = _Tries(self._level(key, now_s) + 1.0, now_s)
        self._tries.move_to_end(key)
        while len(self._tries) > self._most:
            self._tries.popitem(last=False)

    def _level(self, key: str, now_s: float) -> float:
        tries = self._tries.get(key)
        if tries is None:
            return 0.0
        return max(0.0, tries.level - (now_s - tries.at_s) / self._forgotten_s)


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
