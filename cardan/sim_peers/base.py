"""Shared parts of every simulated peer: fault switches, motion scripts, and the serving loop.

A peer's behavior is a sans-I/O core that takes time as an argument, for tests in virtual time; a
thin shell serves it over the real transport. Peers never import drivers.
"""

from __future__ import annotations

import contextlib
import gc
import math
import operator
import shlex
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Generic, NamedTuple, TypeVar

from cardan.common.files import read_text
from cardan.common.options import suggestion
from cardan.common.realtime import ask_for_real_time
from cardan.common.signals import on_ending
from cardan.errors import ConfigurationError, ScriptError


class FaultSwitch(NamedTuple):
    """A fault that a peer can be given: ``--fault NAME`` or ``--fault NAME=VALUE``."""

    name: str
    help: str
    """Effect of the fault and the unit of its value, in one line."""
    default: float = 1.0
    """The value of a bare ``--fault NAME``."""
    lowest: float = 0.0
    highest: float = 1e9
    after: str = ""
    """Fault that this one ends, which must be given with an earlier time."""

    @classmethod
    def at(cls, name: str, what: str, default_s: float = 5.0) -> FaultSwitch:
        """Make the switch of a fault that happens at a time, s."""
        return cls(name, f"{what} at this time, s", default_s)

    @classmethod
    def share(cls, name: str, what: str, default: float = 0.05) -> FaultSwitch:
        """Make the switch of a fault that happens to a share of something."""
        return cls(name, f"{what} (0..1)", default, 0.0, 1.0)

    @classmethod
    def flag(cls, name: str, what: str) -> FaultSwitch:
        """Make the switch of a fault that is on or off."""
        return cls(name, f"{what} (1: yes)", 1.0, 0.0, 1.0)


def check_faults(faults: Mapping[str, float], switches: Iterable[FaultSwitch]) -> None:
    """Raise ScriptError for a fault that is not among `switches`, a value out of range, or the end
    of a fault that is not given."""
    known = {switch.name: switch for switch in switches}
    for name, value in faults.items():
        if name not in known:
            words = f"there is no fault {name!r}; there are: {', '.join(sorted(known))}"
            raise ScriptError(words + suggestion(name, known))
        lowest, highest, first = known[name].lowest, known[name].highest, known[name].after
        if not lowest <= value <= highest:
            raise ScriptError(f"fault {name}: {value:g} is not in {lowest:g} to {highest:g}")
        if first and value <= faults.get(first, math.inf):
            raise ScriptError(f"fault {name}: needs the fault {first}, at an earlier time")


def check_jam(faults: Mapping[str, float], joints: int) -> None:
    """Raise ConfigurationError if the fault "jam" names none of an arm's joints."""
    if "jam" in faults and faults["jam"] not in range(1, joints + 1):
        raise ConfigurationError(
            "faults", f"jam: {faults['jam']:g} is not a joint; allowed: 1 to {joints}"
        )


def parse_faults(words: Iterable[str], switches: Iterable[FaultSwitch]) -> dict[str, float]:
    """Parse ``NAME[=VALUE]`` words into values by name. ScriptError lists the known faults."""
    switches = tuple(switches)
    defaults = {switch.name: switch.default for switch in switches}
    faults: dict[str, float] = {}
    for word in words:
        name, equals, text = word.partition("=")
        try:
            faults[name] = float(text) if equals else defaults.get(name, 0.0)
        except ValueError:
            raise ScriptError(f"fault {name}: {text!r} is not a number") from None
    check_faults(faults, switches)
    return faults


def strikes(faults: Mapping[str, float], name: str, count: int) -> bool:
    """Return True if a fault of every VALUE-th item acts on the `count`-th."""
    return name in faults and count % int(faults[name]) == 0


ActionT = TypeVar("ActionT", bound=Callable[..., object])


class TimedActions(Generic[ActionT]):
    """Actions that are each done once at their time: timed faults and others."""

    def __init__(
        self,
        faults: Mapping[str, float],
        actions: Mapping[str, ActionT],
        *others: tuple[float, ActionT],
        start_s: float = 0.0,
    ) -> None:
        """`actions` by the names of faults; `others` with times. Times count from `start_s`."""
        timed = [*((faults[name], do) for name, do in actions.items() if name in faults), *others]
        timed.sort(key=operator.itemgetter(0))
        self._left = deque((start_s + time_s, action) for time_s, action in timed)

    @property
    def next_s(self) -> float:
        """Time of the next action; infinite when none is left."""
        return self._left[0][0] if self._left else math.inf

    def due(self, until_s: float) -> Iterator[tuple[float, ActionT]]:
        """Yield the actions due by `until_s`, each once with its time, in order."""
        while self._left and self._left[0][0] <= until_s:
            yield self._left.popleft()


class ScriptStep(NamedTuple):
    """Line of a script: at `time_s` after the start, do `verb` with `args`."""

    time_s: float
    verb: str
    args: tuple[str, ...]


def parse_script(text: str, verbs: Mapping[str, str]) -> tuple[ScriptStep, ...]:
    """Parse a script, a step per line: ``SECONDS VERB [ARGUMENT ...]``; ``#`` starts a comment.

    `verbs` maps each verb to its usage, which a ScriptError quotes. Times must not go back.
    """
    steps: list[ScriptStep] = []
    for number, line in enumerate(text.splitlines(), 1):
        try:
            words = shlex.split(line, comments=True)
        except ValueError as error:
            raise ScriptError(f"line {number}: {error}") from None
        if not words:
            continue
        try:
            time_s = float(words[0])
        except ValueError:
            time_s = math.nan
        if not 0.0 <= time_s < math.inf:
            raise ScriptError(f"line {number}: {words[0]!r} is not a time in seconds")
        if len(words) < 2 or words[1] not in verbs:
            raise ScriptError(
                f"line {number}: after the time comes one of: " + "; ".join(verbs.values())
            )
        if steps and time_s < steps[-1].time_s:
            raise ScriptError(f"line {number}: time {time_s} s is before the line above")
        steps.append(ScriptStep(time_s, words[1], tuple(words[2:])))
    return tuple(steps)


def load_script(
    name_or_file: str, built_in: Mapping[str, str], verbs: Mapping[str, str]
) -> tuple[ScriptStep, ...]:
    """Load a built-in script by name, or one from a file."""
    if name_or_file in built_in:
        return parse_script(built_in[name_or_file], verbs)
    try:
        text = read_text(name_or_file)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise ScriptError(
            f"script {name_or_file!r} is neither a file that can be read ({why}) nor one of: "
            f"{', '.join(sorted(built_in))}"
        ) from None
    return parse_script(text, verbs)


SERVE_SLICE_S = 0.1
"""Longest step of a served peer, which delays the reaction to an interrupt."""

THREAD_SLICE_S = 0.02
"""Longest wait at the end of a ``with`` block for the thread that serves a peer."""

_P = TypeVar("_P", bound="SimulatedPeer")


class SimulatedPeer(ABC):
    """Peer that can be served. Shells implement these four members.

    `serve` is the loop of a separate program; ``with peer:`` serves it in a thread.
    """

    @property
    @abstractmethod
    def endpoint(self) -> str:
        """Address that clients connect to; printed after READY."""

    @abstractmethod
    def open(self) -> None:
        """Bind or create the transport. Raises a CardanError that says what to do."""

    @abstractmethod
    def step(self, until_s: float) -> None:
        """Serve until the monotonic time `until_s`, or return earlier (peers poll in here)."""

    @abstractmethod
    def close(self) -> None:
        """Release the transport; remove files that open() created. Never raises."""

    def __enter__(self: _P) -> _P:
        """Open it, and serve in a thread until the end of the ``with`` block."""
        with contextlib.ExitStack() as stack:
            self.open()
            stack.callback(self.close)
            stopping = threading.Event()

            def step() -> None:
                while not stopping.is_set():
                    self.step(time.monotonic() + THREAD_SLICE_S)

            thread = threading.Thread(target=step, name=f"cardan-{type(self).__name__}")
            thread.start()
            stack.callback(thread.join)
            stack.callback(stopping.set)
            self._leaving = stack.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._leaving.close()


def serve(peer: SimulatedPeer, seconds: float | None = None) -> None:
    """Run `peer` until `seconds` are over or a signal would end it; print READY once it serves."""
    stopping = False
    # Unfreezing would also unfreeze objects of the calling program.
    freezes = not gc.get_freeze_count()

    def stop(_signal: int) -> None:
        nonlocal stopping
        stopping = True

    with on_ending(stop):
        try:
            peer.open()
            # Hardware keeps its period under any load of this machine.
            ask_for_real_time()
            # A garbage collection of permanent objects takes tens of milliseconds.
            gc.collect()
            if freezes:
                gc.freeze()
            print(f"READY {peer.endpoint}", flush=True)
            end_s = float("inf") if seconds is None else time.monotonic() + seconds
            while not stopping and (now_s := time.monotonic()) < end_s:
                peer.step(min(end_s, now_s + SERVE_SLICE_S))
        finally:
            if freezes:
                gc.unfreeze()
            with contextlib.suppress(OSError):
                sys.stdout.flush()
            peer.close()
