"""Shared parts of the targets."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from cardan.sim_peers.tcp_servers import TcpServers


def same(found: object, expected: object) -> None:
    """Assert that two values are the same; NaN is the same as NaN."""
    if repr(found) != repr(expected):
        raise AssertionError(f"{found!r:.300} is not {expected!r:.300}")


def pieces_of(data: bytes) -> list[bytes]:
    """`data` in pieces of 0 to 30 bytes, and some long ones: the same for the same data."""
    number = zlib.crc32(data)
    found, at = [], 0
    while at < len(data):
        number = (number * 1103515245 + 12345) & 0x7FFFFFFF
        size = number >> 8 & 31
        size = 4096 if size == 31 else size
        found.append(data[at : at + size])
        at += size
    return found


def text_of(data: bytes) -> str:
    """As a WebSocket or a file has it: UTF-8, of which nothing is refused before."""
    return data.decode("utf-8", "replace")


def joined_streams(
    feed: Callable[[], Callable[[bytes], Iterable[Any]]], data: bytes
) -> tuple[Any, ...]:
    """Return the items that a reader finds in a stream; assert the same for any split of it."""
    whole = tuple(feed()(data))
    take = feed()
    same(tuple(each for piece in pieces_of(data) for each in take(piece)), whole)
    return whole


def kinds(values: Sequence[Any]) -> tuple[str, ...]:
    """The types in a result, for telling outcomes apart."""
    return tuple([type(each).__name__ for each in values[:6]])


def near(found: Any, expected: Any) -> None:
    """Assert that two values are the same but for the rounding of their units."""
    if isinstance(expected, float) and isinstance(found, float):
        if not math.isclose(found, expected, rel_tol=1e-9, abs_tol=1e-12) and found == found:
            raise AssertionError(f"{found!r} is not {expected!r}")
    elif isinstance(expected, tuple) and type(found) is type(expected):
        if len(found) != len(expected):
            raise AssertionError(f"{found!r:.300} is not {expected!r:.300}")
        for one, other in zip(found, expected, strict=True):
            near(one, other)
    else:
        same(found, expected)


class Clients:
    """A client at each port of a simulated controller's servers, in virtual time."""

    def __init__(self, servers: TcpServers[Any, Any], step_s: float) -> None:
        self._servers, self._step_s = servers, step_s
        self.now_s = 1000.0
        self._numbers: dict[Any, int] = {}
        servers.advance(self.now_s)

    def feed(self, packets: Iterable[bytes]) -> None:
        """Each packet after a byte for its port; then all clients go."""
        servers, numbers = self._servers, self._numbers
        kinds = servers.kinds
        for data in packets:
            self.now_s += self._step_s
            kind = kinds[data[0] % len(kinds)] if data else kinds[0]
            number = numbers.get(kind) or servers.accepted(kind, self.now_s)
            if number is not None:
                numbers[kind] = number
                if servers.takes(number):
                    servers.data(number, data[1:], self.now_s)
            servers.advance(self.now_s)
            self.heard()
        for number in numbers.values():
            servers.eof(number, self.now_s)
        self.heard()

    def heard(self) -> bytes:
        """Return the bytes written since the last call; forget clients whose connections ended."""
        said = b"".join(data for _, data in self._servers.outgoing())
        ended = {*self._servers.closing(), *self._servers.aborting()}
        self._numbers = {kind: each for kind, each in self._numbers.items() if each not in ended}
        return said


def all_finite(value: object) -> None:
    """Assert that no number in a value is NaN or infinite."""
    if isinstance(value, float):
        assert math.isfinite(value), value
    elif isinstance(value, (tuple, list)):
        for each in value:
            all_finite(each)
    elif isinstance(value, dict):
        for each in value.values():
            all_finite(each)
