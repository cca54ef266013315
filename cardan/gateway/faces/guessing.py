"""Bounds how fast tokens can be guessed: so many wrong ones with the same beginning from an
address, then only one in a while. All times are monotonic, in seconds."""

from __future__ import annotations

import ipaddress
from collections import OrderedDict
from typing import NamedTuple

BURST = 20
"""Wrong tokens in a row with one beginning that an address may try: a person who mistypes."""

FORGOTTEN_S = 10.0
"""After so long one wrong token of an address is forgotten: 8640 guesses a day."""

BEGINNING_CHARACTERS = 8
"""Wrong tokens are counted by their beginning, so that they are in no other token's way. It is half
of the shortest token: who guesses has to guess the other half behind each beginning slowly."""

MOST_BEGINNINGS = 4096
"""Beginnings that are kept in mind; further ones take the place of that tried least lately."""


class _Tries(NamedTuple):
    level: float
    at_s: float


class FailedTokens:
    """The wrong tokens of each address, by their beginning. Of IPv6 the address is the network
    (/64), as who has one address of it has them all."""

    def __init__(
        self,
        burst: int = BURST,
        forgotten_s: float = FORGOTTEN_S,
        most_beginnings: int = MOST_BEGINNINGS,
    ) -> None:
        self._burst, self._forgotten_s, self._most = burst, forgotten_s, most_beginnings
        self._tries: OrderedDict[tuple[str, str], _Tries] = OrderedDict()

    def __len__(self) -> int:
        return len(self._tries)

    def wait_s(self, address: str, token: str, now_s: float) -> float:
        """How long until this address may try this token; 0: it may now."""
        level = self._level(_key(address, token), now_s)
        return max(0.0, (level + 1.0 - self._burst) * self._forgotten_s)

    def failed(self, address: str, token: str, now_s: float) -> None:
        """This token from this address was wrong."""
        key = _key(address, token)
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
