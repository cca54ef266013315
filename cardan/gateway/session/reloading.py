"""Another configuration for a session that runs: made ready beside its loop, taken between two of
its cycles.

The supervisor sends the configuration in pieces and has it prepared: the session answers with what
has changed and when each change can take effect, or with the reason why it refuses; nothing has
changed then. `apply` has it taken, each change at its moment; `drop` forgets it. A configuration
that is applied replaces what still waits of the one before.
"""

from __future__ import annotations

import enum
import json
import logging
import threading
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

from cardan.errors import CardanError, MotionLoopError
from cardan.gateway.session.changes import Change, Moment, Stages, staged
from cardan.gateway.session.config import SessionConfig, parse_config
from cardan.inbox import Inbox, InboxEmptyError
from cardan.shortage import shortage
from cardan.tables import as_table

PIECE: Final = b"config "
"""A packet of the supervisor that is a piece of a configuration begins so."""

ORDER: Final = b"reload "
"""One that says what to do with it; its number and an :class:`ReloadOrder` follow."""

ANSWER: Final = b'{"reload":'
"""A packet of the session that answers one begins so."""

PIECE_BYTES: Final = 4000
"""Length of a piece: a packet of the supervisor has at most 4 kB."""

LONGEST_BYTES: Final = 1 << 20
"""Longest configuration: a file has at most as much."""

LOOK_S: Final = 0.05
"""Pause between two looks whether what waits can be taken: nobody takes an arm over faster."""

LEAVES_WITHIN_S: Final = 1.0
"""Longest wait for the thread at the session's end: something may be being planned."""

_log = logging.getLogger(__name__)


class ReloadOrder(str, enum.Enum):
    """What to do with a configuration."""

    PREPARE = "prepare"
    APPLY = "apply"
    DROP = "drop"


def packets(
    number: int, order: ReloadOrder, config: SessionConfig | None = None
) -> Iterator[bytes]:
    """What the supervisor sends; with PREPARE a configuration."""
    if config is not None:
        data = json.dumps(as_table(config, from_file=False), separators=(",", ":")).encode()
        for start in range(0, len(data), PIECE_BYTES):
            yield PIECE + data[start : start + PIECE_BYTES]
    yield ORDER + f"{number} {order.value}".encode()


class Found(NamedTuple):
    """What a session has found of a configuration that it is to take."""

    number: int
    error: str = ""
    """Why it refuses; empty: it does not."""
    changes: tuple[tuple[str, Any, Any, Moment, bool], ...] = ()
    """Key, old value, new value, moment, and whether that has come."""
    taken_back: tuple[str, ...] = ()
    """Keys that waited and are as they were."""

    @classmethod
    def of(cls, packet: bytes) -> Found:
        """From a packet that begins with ANSWER."""
        table = json.loads(packet)
        changes = tuple(
            (key, old, new, Moment(moment), come)
            for key, old, new, moment, come in table["changes"]
        )
        return cls(table["reload"], table["error"], changes, tuple(table["taken_back"]))

    def packet(self) -> bytes:
        """As a packet."""
        table = {
            "reload": self.number,
            "error": self.error,
            "changes": self.changes,
            "taken_back": self.taken_back,
        }
        return json.dumps(table, separators=(",", ":")).encode()


class Step(NamedTuple):
    """What a session takes at one moment."""

    moment: Moment
    config: SessionConfig
    changes: tuple[Change, ...]

    @property
    def ends(self) -> str:
        """Why motions that were planned by the limits before end."""
        keys = [each.key for each in self.changes if each.key.startswith(("limits.", "arm."))]
        return f"{', '.join(keys)}: tightened by a reload, plan it anew" if keys else ""


Take = Callable[[Step], bool]
"""Takes a step, or finds that its moment has not come; waits for the loop."""


class Reloading:
    """Follows the supervisor's orders in a thread of its own, which begins with the first."""

    def __init__(
        self,
        config: SessionConfig,
        check: Callable[[SessionConfig], None],
        take: Take,
        has_come: Callable[[Moment], bool],
        tell: Callable[[bytes], None],
    ) -> None:
        """`check` raises ConfigurationError for what the session cannot take without a restart;
        `has_come` says whether it is the moment for a change; `tell` sends a packet to the
        supervisor."""
        self.config = config
        """What the session has by now."""
        self.busy = False
        """Whether there was an order yet."""
        self.waits: tuple[str, ...] = ()
        """The keys that have changed and wait for their moment, or for a restart."""
        self._check, self._take, self._has_come, self._tell = check, take, has_come, tell
        self._packets: Inbox[bytes | None] = Inbox()
        self._thread: threading.Thread | None = None
        self._pieces: list[bytes] = []
        self._prepared: tuple[int, SessionConfig] | None = None
        self._steps: list[Step] = []

    # -- for the loop ----------------------------------------------------------------------------

    def offer(self, packet: bytes) -> None:
        """Take a packet that begins with PIECE or ORDER. Does not block."""
        if not self.busy:
            self.busy = True
            self._thread = threading.Thread(target=self._work, name="cardan-reload", daemon=True)
            self._thread.start()
        self._packets.put(packet)

    def close(self) -> None:
        """End the thread: the loop has ended."""
        if self._thread is not None:
            self._packets.put(None)
            self._thread.join(LEAVES_WITHIN_S)

    # -- its thread ------------------------------------------------------------------------------

    def _work(self) -> None:
        while True:
            try:
                packet = self._packets.get(LOOK_S if self._steps else None)
            except InboxEmptyError:
                packet = b""
            if packet is None:
                return
            try:
                if packet.startswith(PIECE):
                    self._piece(packet.removeprefix(PIECE))
                elif packet.startswith(ORDER):
                    self._order(packet.removeprefix(ORDER))
                self._go_on()
            except MotionLoopError:
                return
            except Exception:
                # What moves the arm goes on as it was configured.
                self._steps = []
                _log.exception("the changed configuration cannot be taken")

    def _piece(self, data: bytes) -> None:
        if sum(map(len, self._pieces)) + len(data) <= LONGEST_BYTES:
            self._pieces.append(data)

    def _order(self, data: bytes) -> None:
        number, order = int(data.split()[0]), ReloadOrder(data.split()[1].decode())
        if order is ReloadOrder.PREPARE:
            pieces, self._pieces = self._pieces, []
            self._prepare(number, b"".join(pieces))
            return
        prepared, self._prepared = self._prepared, None
        if order is ReloadOrder.APPLY and prepared is not None and prepared[0] == number:
            # Compared anew: what waited of the one before may have been taken meanwhile.
            self._begin(staged(self.config, prepared[1], self._check))

    def _prepare(self, number: int, data: bytes) -> None:
        self._prepared = None
        try:
            config = parse_config(json.loads(data), from_file=False)
            self._check(config)
            stages = staged(self.config, config, self._check)
        except Exception as error:
            words = str(error) if isinstance(error, CardanError) else shortage(error)
            self._tell(Found(number, words or repr(error)).packet())
            return
        self._prepared = number, config
        changes = tuple(
            (each.key, each.old, each.new, each.moment, self._has_come(each.moment))
            for each in stages.changes
        )
        keys = {each.key for each in stages.changes}
        back = tuple(key for key in self.waits if key not in keys)
        self._tell(Found(number, "", changes, back).packet())

    def _begin(self, stages: Stages) -> None:
        self._steps, before = [], self.config
        for moment, config in stages.configs.items():
            if config != before:
                new = tuple(each for each in stages.changes if each.moment is moment)
                self._steps.append(Step(moment, config, new))
                before = config
        self.waits = tuple(each.key for each in stages.changes)

    def _go_on(self) -> None:
        while self._steps and self._take(step := self._steps[0]):
            del self._steps[0]
            self.config = step.config
            taken = {each.key for each in step.changes}
            self.waits = tuple(key for key in self.waits if key not in taken)
