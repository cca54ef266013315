"""Shared types of programs, the functions they call and the machine that runs them."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping
from typing import Any, Final, NamedTuple, Protocol

CALL_STEPS: Final = 40
"""Cost of a function call in steps; an operator is one step."""
POSE_STEPS: Final = 200
"""Steps of a function that works with poses, or with the arm's motion."""
KINEMATICS_STEPS: Final = 600
"""Steps of a function of the arm's kinematics."""
MASS_STEPS: Final = 2400
"""Steps of the arm's mass matrix."""
ELEMENT_STEPS: Final = 4
"""Steps of an operator for each element of its lists."""
PRODUCT_STEPS: Final = 10
"""Steps of a product of matrices for each product of two elements."""
DEEPEST_CALLS: Final = 50

TOO_MUCH_TIME: Final = (
    "The program used too much time without instructing the robot what to do. Consider using a "
    "Wait or sync() to split long program sequences that do not move the robot."
)
"""Text of the controller, as reported by users."""
TOO_MUCH_BEHIND: Final = "Runtime is too much behind"
"""Error of a secondary program that takes time."""
TWO_THREADS: Final = "Another thread is already controlling the robot"


class ProgramError(Exception):
    """Error that ends the program."""

    def __init__(self, line: int, reason: str) -> None:
        super().__init__(f"line {line}: {reason}")
        self.line, self.reason = line, reason


class HaltError(Exception):
    """End of the program with all of its threads."""


class ThreadEndError(Exception):
    """End of a thread by itself."""


class Sleep(NamedTuple):
    """Wait for a time."""

    left_s: float


class Pending(NamedTuple):
    """Wait until a value is available, while the arm continues."""

    poll: Callable[[], Any]
    """Returns the value; None if it is not available yet."""
    most_s: float = math.inf
    otherwise: Callable[[], Any] = lambda: None
    """Returns the value after a timeout, in the next frame at the earliest."""


class Joined(NamedTuple):
    """Wait until a thread has ended."""

    handle: int


Action = tuple[Any, ...]
"""NamedTuple of a motion, or one of the above."""
Running = Generator[Action, Any, Any]


class Function(NamedTuple):
    """A function of the controller."""

    parameters: tuple[str, ...]
    defaults: Mapping[str, Any]
    do: Callable[..., Any]
    """Returns a value; raises ValueError with the reason of a failure."""
    takes_time: bool = False
    """`do` may return an `Action`; the program continues after it."""
    steps: int = CALL_STEPS
    """Cost of a call in steps."""


def costing(steps: int, functions: Mapping[str, Function]) -> Mapping[str, Function]:
    """Return these functions, each with this cost in steps."""
    return {name: each._replace(steps=steps) for name, each in functions.items()}


class _Unset:
    def __repr__(self) -> str:
        return "no value"


UNSET: Final = _Unset()
"""Content of a variable before it gets a value."""


class Runtime(Protocol):
    """Interface of the machine that runs a program."""

    steps: list[int]
    """Steps left in this frame."""
    stack: list[list[Any]]
    """Variables of the functions on the running thread's stack."""
    line: int
    """Line of the call that takes time."""
    globals: list[Any]

    def start(self, name: str, frame: list[Any], body: Callable[[list[Any]], Any]) -> int:
        """Start a thread; return its handle. Raises ValueError."""
        ...

    def kill(self, handle: Any) -> None:
        """End a thread, if there is one with this handle."""
        ...

    def lives(self, handle: Any) -> bool:
        """Return True if a thread has not ended."""
        ...
