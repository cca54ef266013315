"""Runs a URScript program in the controller's own time: threads, waits, and actions of the arm.

Statements take no time. A thread runs until it calls a function that does, waits for another
thread, or ends; then the next one runs. The result of a frame is one `Action` of one thread, or
none. Threads only take turns when one of them waits: code between `enter_critical` and
`exit_critical` is never interrupted if it takes no time; otherwise others run, because existing
programs need it (the manual does not say).

Source: UR's script manual, threads and secondary programs. The share of a frame for computation is
not published.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from cardan.protocols.ur.script import Program
from cardan.sim_peers.ur_controller.compiler import Compiler
from cardan.sim_peers.ur_controller.language import (
    TOO_MUCH_BEHIND,
    TWO_THREADS,
    UNSET,
    Action,
    Function,
    HaltError,
    Joined,
    Pending,
    ProgramError,
    Running,
    Sleep,
    ThreadEndError,
)
from cardan.sim_peers.ur_controller.operators import Struct

MOST_STEPS: Final = 40_000
"""Steps of computing in one frame: operators, names and the like; a call of a function is 40."""
MOST_THREADS: Final = 100
MOST_BYTES: Final = 4 * 1024 * 1024
"""Size of all values that a program keeps."""
_MEASURED_EVERY: Final = 20
"""Frames."""


class Thread:
    """A thread of a program."""

    def __init__(self, handle: int, name: str) -> None:
        self.handle, self.name = handle, name
        self.running: Running | None = None
        """None: it has ended."""
        self.stack: list[list[Any]] = []
        """Variables of the functions on its stack."""
        self.line = 1
        self.acted = -1
        """Newest frame that it used up."""
        self.action: Action | None = None
        """Its action of the arm in the next frame."""
        self.wait: Joined | Pending | None = None
        self.until = 0.0
        """Frame in which it continues, or the wait ends."""
        self.value: Any = None
        """Value that it was waiting for."""


class Machine:
    """A run of a program."""

    def __init__(self, period_s: float, source: str = "") -> None:
        self.name = ""
        self.source = source
        """Text of the program."""
        self.secondary = False
        self.frame = 0
        self.ended = False
        self.steps = [0]
        """Steps left in this frame."""
        self.stack: list[list[Any]] = []
        """Stack of the running thread."""
        self.line = 1
        """Line of the running call."""
        self._period_s = period_s
        self._threads: list[Thread] = []
        self._started = 0
        self._running: Thread | None = None
        self._mover: Thread | None = None
        self._action: Action | None = None
        self._left_of: Callable[[Action], Action | None] = _nothing_left
        self.globals: list[Any] = []
        self.names: Mapping[str, int] = {}

    async def load(self, program: Program, functions: Mapping[str, Function]) -> None:
        """Compile a program in portions, before the first step. Raises ProgramError."""
        self.name, self.secondary = program.name, program.secondary
        self.names, frame, body = await Compiler(program, functions, self).compiled()
        self.start(self.name, frame, body)

    @property
    def main_line(self) -> int:
        """Line of the main program."""
        return self._threads[0].line if self._threads else 0

    @property
    def mover_line(self) -> int:
        """Line of the thread that moves the arm in this frame; 0: none."""
        return 0 if self._mover is None else self._mover.line

    @property
    def variables(self) -> dict[str, Any]:
        """Global variables that have a value."""
        return {name: self.globals[n] for name, n in self.names.items() if self.has(n)}

    def has(self, number: int) -> bool:
        """Return True if a global variable has a value."""
        return self.globals[number] is not UNSET

    def step(self, left_of: Callable[[Action], Action | None]) -> Action | None:
        """Run a frame; return the arm's action in it. `left_of` returns an action's rest after it.

        Raises ProgramError.
        """
        self.frame += 1
        self.steps[0] = MOST_STEPS
        self._left_of = left_of
        self._mover = self._action = None
        for each in self._threads:
            if each.action is not None:
                self._move(each, each.action)
        while not self.ended and self._turn():
            pass
        if self.frame % _MEASURED_EVERY == 0 and self._size() > MOST_BYTES:
            raise ProgramError(self.main_line, "the program keeps too many values")
        return None if self.ended else self._action

    def run_at_once(self) -> None:
        """Run the whole of a program that may take no time. Raises ProgramError."""
        self.step(_nothing_left)
        if not self.ended:
            raise ProgramError(self.main_line, TOO_MUCH_BEHIND)

    def close(self) -> None:
        """End all threads."""
        self.ended = True
        for each in self._threads:
            self._end(each)
        self._threads.clear()

    # -- threads ----------------------------------------------------------------------------------

    def start(self, name: str, frame: list[Any], body: Callable[[list[Any]], Any]) -> int:
        """Start a thread, which runs later in this frame; return its handle. Raises ValueError."""
        if self.secondary and self._started:
            raise ValueError("a secondary program has no threads")
        if len(self._threads) >= MOST_THREADS:
            raise ValueError(f"there are {MOST_THREADS} threads already")
        made = Thread(self._started, name)
        self._started += 1
        made.stack.append(frame)
        made.running = body(frame)
        self._threads.append(made)
        return made.handle

    def kill(self, handle: Any) -> None:
        """End a thread; handle 0 belongs to no thread."""
        for each in self._threads[1:]:
            if each.handle == handle:
                if each is self._running:
                    raise ThreadEndError
                self._end(each)

    def lives(self, handle: Any) -> bool:
        """Return True if a thread has not ended."""
        return any(e.handle == handle and e.running is not None for e in self._threads[1:])

    def _end(self, thread: Thread) -> None:
        if thread.running is not None and thread is not self._running:
            thread.running.close()
        thread.running = thread.action = thread.wait = None
        if self._mover is thread:
            self._mover = self._action = None

    def _turn(self) -> bool:
        """Run every thread that can continue; return False if there was none."""
        there_was = False
        for each in tuple(self._threads):
            if each.running is not None and each.acted < self.frame and self._ready(each):
                there_was = True
                self._resume(each)
                if self.ended:
                    return True
        if there_was:
            main, *others = self._threads
            self._threads = [main, *(each for each in others if each.running is not None)]
        return there_was

    def _ready(self, thread: Thread) -> bool:
        wait = thread.wait
        if wait is None:
            return self.frame >= thread.until
        if isinstance(wait, Joined):
            return not self.lives(wait.handle)
        thread.value = wait.poll()
        if thread.value is not None:
            return True
        if self.frame < thread.until:
            return False
        thread.value = wait.otherwise()
        return True

    def _resume(self, thread: Thread) -> None:
        running, value = thread.running, thread.value
        assert running is not None
        thread.wait = thread.value = None
        self._running, self.stack, self.line = thread, thread.stack, thread.line
        try:
            action = running.send(value)
        except (StopIteration, ThreadEndError):
            self._running = None
            self._end(thread)
            if thread is self._threads[0]:
                self.close()
            return
        except HaltError:
            self._running = None
            self.close()
            return
        except RecursionError:
            raise ProgramError(self.line, "too many levels") from None
        finally:
            self._running = None
        thread.line = self.line
        if isinstance(action, Joined):
            thread.wait = action
        elif self.secondary:
            raise ProgramError(self.line, TOO_MUCH_BEHIND)
        elif isinstance(action, Pending):
            thread.wait = action
            thread.until = self.frame + max(1.0, action.most_s / self._period_s - 1e-6)
        elif isinstance(action, Sleep):
            thread.acted = self.frame
            thread.until = self.frame + max(1.0, action.left_s / self._period_s - 1e-6)
        else:
            self._move(thread, action)

    def _move(self, thread: Thread, action: Action) -> None:
        if self._mover is not None:
            raise ProgramError(thread.line, TWO_THREADS)
        thread.acted = self.frame
        thread.action = self._left_of(action)
        thread.until = self.frame + 1
        self._mover, self._action = thread, action

    # -- memory -----------------------------------------------------------------------------------

    def _size(self) -> int:
        """Estimate the bytes of all values; counting stops above `MOST_BYTES`."""
        total = 0
        for values in self._retained():
            for each in values:
                total += _size(each)
                if total > MOST_BYTES:
                    return total
        return total

    def _retained(self) -> Iterator[list[Any]]:
        yield self.globals
        for each in self._threads:
            yield from each.stack


def _size(value: Any) -> int:
    if isinstance(value, str):
        return len(value)
    if isinstance(value, Struct):
        return 64 + sum(map(_size, value.values()))
    if isinstance(value, list):
        if value and isinstance(value[0], (list, str, tuple)):
            return 64 + sum(map(_size, value))
        return 64 + 32 * len(value)
    return 8


def _nothing_left(action: Action) -> None:
    """Return no rest, for an action in its only frame."""
