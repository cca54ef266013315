"""Open resources at a fork: they stay the parent's, and the child gives them up."""

from __future__ import annotations

import contextlib
import os
from typing import Final, Protocol
from weakref import WeakSet

IN_CHILD: Final = (
    "it belongs to the parent process, from which this one was forked: open another one here"
)


class Inherited(Protocol):
    """A resource that must not be used in a forked child."""

    def after_fork(self) -> None:
        """Give it up in the child, without I/O: no other thread is left, and locks may be held for
        ever."""


_opened: WeakSet[Inherited] = WeakSet()


def give_up_in_children(opened: Inherited) -> None:
    """Call `after_fork` in each process forked from now on."""
    _opened.add(opened)


def _in_child() -> None:
    for each in tuple(_opened):
        with contextlib.suppress(Exception):
            each.after_fork()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_in_child)
