"""Order of a RAPID program's instructions, and those that a restart executes again."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Literal

Instruction = Callable[[], None]
Part = Literal["move", "setup", "act", "stream", "motion"]


class RapidProgram:
    """Pending and executed instructions of a program.

    Instructions call `record` when they are executed; `restart` executes them again.
    """

    def __init__(self) -> None:
        self._pending: deque[Instruction] = deque()
        self._main: dict[Part, Instruction] = {}
        self._replaying = False

    @property
    def finished(self) -> bool:
        """True when no instruction is left to execute."""
        return not self._pending

    def append(self, instruction: Instruction) -> None:
        """Add an instruction to the end."""
        self._pending.append(instruction)

    def step(self) -> None:
        """Execute the next instruction."""
        self._pending.popleft()()

    def stop(self) -> None:
        """Drop the instructions that were not reached."""
        self._pending.clear()
        self._replaying = False

    def record(self, part: Part, instruction: Instruction) -> None:
        """Note an executed instruction for `restart`; each EGMSetupUC starts the program over."""
        if self._replaying:
            return
        if part == "setup":
            self._main = {key: step for key, step in self._main.items() if key == "move"}
        self._main[part] = instruction

    def forget(self, part: Part) -> None:
        """Remove the instruction recorded as `part` from `restart`."""
        self._main.pop(part, None)

    def restart(self, get_id: Instruction) -> None:
        """Queue the program from its first instruction to the last one reached so far."""
        main = self._main
        parts: tuple[Part, ...] = ("setup", "act", "stream", "motion")
        if "move" in main:
            self._pending.append(main["move"])
        self._pending.append(get_id)
        self._pending.extend(main[part] for part in parts if part in main)
        self._pending.append(self._replayed)
        self._replaying = True

    def _replayed(self) -> None:
        self._replaying = False
