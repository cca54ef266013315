"""Fuzz targets, and the criteria by which an input has found something."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from types import FrameType
from typing import Any

Packets = tuple[bytes, ...]
"""Inputs of a state machine, in order."""
Input = bytes | Packets


class Form(Enum):
    """Of a target's input: how it is damaged, and what its function gets."""

    BYTES = "bytes"
    TEXT = "text"
    """Bytes, damaged by words and lines too."""
    JSON = "json"
    """Bytes, damaged as a tree too."""
    PACKETS = "packets"
    """A tuple of bytes, damaged by order and number too."""
    JSON_PACKETS = "json packets"


@dataclass(frozen=True)
class Target:
    """A parser or a state machine."""

    name: str
    """Its module and the part of it: "egm.robot"."""
    form: Form
    run: Callable[[Any], object]
    """Raises AssertionError where a property does not hold; its result tells kinds of outcome
    apart, so that an input with a new one is kept for a while."""
    seeds: Callable[[], Iterable[Input]]
    """Good input, of which damaged input is made."""
    raises: tuple[type[Exception], ...] = ()
    """Exceptions that the function's documentation names."""
    words: tuple[bytes, ...] = ()
    """Pieces of the protocol that damage may put anywhere."""
    memory: int = 4 << 20
    """Most memory for an input, bytes, beyond what goes with its size."""
    longest: int = 16384
    """Bytes; longer input is cut: the transport has no more, or there is a limit before."""
    slow_s: float = 0.05
    """Longest CPU time of an input of no bytes."""
    slow_s_per_byte: float = 25e-6
    """Longest CPU time of each byte more."""

    def limit_s(self, given: Input) -> float:
        """Longest CPU time for an input."""
        return self.slow_s + self.slow_s_per_byte * size_of(given)


def size_of(given: Input) -> int:
    """Bytes of an input; a packet counts 16 more, so that empty ones are something."""
    return len(given) if isinstance(given, bytes) else sum(map(len, given)) + 16 * len(given)


class SlowError(Exception):
    """An input took longer than its size allows."""


class HangError(BaseException):
    """An input does not end. No parser's `except Exception` may take it."""


HANG_S = 5.0
"""CPU time after which an input is given up; the slowest takes a hundredth of it."""


class Watch:
    """Raises HangError in an input that takes HANG_S to twice that. One in a process at a time."""

    def __init__(self) -> None:
        self.count = 0
        """Inputs so far."""
        self._seen = -1

    def __enter__(self) -> Watch:
        self._before = signal.signal(signal.SIGPROF, self._look)
        signal.setitimer(signal.ITIMER_PROF, HANG_S, HANG_S)
        return self

    def __exit__(self, *error: object) -> None:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, self._before)

    def _look(self, _number: int, _frame: FrameType | None) -> None:
        if self._seen == self.count:
            self._seen = -1
            raise HangError(f"it does not end within {HANG_S:g} s")
        self._seen = self.count


def tried(target: Target, given: Input) -> object:
    """Run `target` on one input: the kind of its outcome. Raises what is a finding."""
    begin_s = time.perf_counter()
    try:
        result = target.run(given)
    except target.raises as error:
        result = error
    if time.perf_counter() - begin_s > target.limit_s(given):
        _check_time(target, given)
    return kind_of(result)


def _check_time(target: Target, given: Input) -> None:
    """Once more, by this process's time: the computer may just have been busy."""
    took_s = min(cpu_s(target, given) for _ in range(3))
    if took_s > target.limit_s(given):
        raise SlowError(f"{took_s:.3f} s for {size_of(given)} bytes")


def cpu_s(target: Target, given: Input) -> float:
    """CPU time of one input, s."""
    begin_s = time.process_time()
    with contextlib.suppress(target.raises):
        target.run(given)
    return time.process_time() - begin_s


_NO_DIGITS = {ord(digit): None for digit in "0123456789"}
_SHOWN = 48


def kind_of(result: object, deep: bool = True) -> object:
    """Return the value by which outcomes of one kind are equal."""
    if result is None or isinstance(result, (bool, Enum)):
        return result
    if isinstance(result, str):
        return result[:_SHOWN].translate(_NO_DIGITS)
    if isinstance(result, Exception):
        return type(result).__name__, str(result)[:_SHOWN].translate(_NO_DIGITS)
    if isinstance(result, (tuple, list)) and deep:
        if hasattr(result, "_fields"):
            return type(result).__name__, *[kind_of(each, False) for each in result]
        return len(result) > 0, *[kind_of(each, False) for each in result[:4]]
    return type(result).__name__


def packets_of(target: Target) -> bool:
    """Return True if its input is a tuple of packets."""
    return target.form in (Form.PACKETS, Form.JSON_PACKETS)


def joined(packets: Sequence[bytes]) -> bytes:
    """Packets as one piece of bytes, each after its length in two bytes."""
    return b"".join(len(each).to_bytes(2, "big") + each[:0xFFFF] for each in packets)


def split(data: bytes) -> Packets:
    """Packets of any bytes; the last one may be shorter than it says."""
    found, at = [], 0
    while at + 2 <= len(data) and len(found) < MOST_PACKETS:
        end = at + 2 + int.from_bytes(data[at : at + 2], "big")
        found.append(data[at + 2 : end])
        at = end
    return tuple(found)


MOST_PACKETS = 64
"""Of one input: enough for a session from its beginning to its end."""
