"""State of the buttons, merged from all reports about buttons."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from cardan.drivers.buttons import ButtonEdges
from cardan.protocols.connexion.devices import LONG_PRESS, PRO_BUTTONS, TWO_BUTTONS, V3DK, Model
from cardan.protocols.connexion.reports import ButtonBits, KeysDown, LongPress, LongPressBits

ButtonReport = ButtonBits | KeysDown | LongPress | LongPressBits

_V3DK_BITS: Mapping[int, str] = MappingProxyType({code - 1: V3DK[code] for code in V3DK})
_TWO_BUTTON_REPORT_BYTES = 3
_WHOLE = frozenset({ButtonBits, KeysDown})
"""Kinds of reports that name all pressed keys they know."""


class Buttons(ButtonEdges):
    """The buttons of one device of `model`.

    Of an unknown model (None) and of a receiver, what is paired shows in the length of report 3:
    three bytes are a two-button device's "left" and "right", more are the vendor's key numbers. A
    long press with its own meaning is one more button, held until its key is released. The last
    contents of each report are kept after `release_all`, because other reports do not show its
    buttons.
    """

    def __init__(self, model: Model | None) -> None:
        super().__init__()
        self.model = model
        self._heard: set[type[ButtonReport]] = set()
        """Kinds of reports received since the device was opened."""
        self._bits: list[str] = []
        self._keys: list[str] = []
        self._long_bits: list[str] = []
        self._long_keys: list[str] = []

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the buttons, lowest first; empty if the model is unknown."""
        if self.model is None:
            return ()
        own = self.model.buttons.values()
        return tuple(dict.fromkeys((*TWO_BUTTONS.values(), *own) if self.model.receiver else own))

    def on_opened(self) -> None:
        """Start after the device was opened (again): keys in its first reports may be pressed for
        long."""
        self._heard.clear()

    def on_report(self, value: ButtonReport, size: int, now_s: float) -> None:
        """Process a report of `size` bytes, with the complete state of its buttons.

        The size tells how to read the buttons of an unknown model, and is ignored otherwise.
        """
        if isinstance(value, ButtonBits):
            labels = self._labels_of(size)
            down = self._bits = [labels.get(bit) or f"button-{bit}" for bit in _bits_of(value.mask)]
            if not value.mask:
                self._long_bits = []
        elif isinstance(value, KeysDown):
            down = self._keys = [self._label(code) for code in value.codes]
            if not value.codes:
                self._long_keys = []
        elif isinstance(value, LongPress):
            down = self._long_keys = self._long_labels(value.codes)
        else:
            down = self._long_bits = self._long_labels([bit + 1 for bit in _bits_of(value.mask)])
        kind = type(value)
        if kind not in self._heard:
            # Which of several was pressed now is unknown. A long press is no new one.
            if len(down) > 1 and (kind in _WHOLE or not self._heard):
                self.mask(down)
            self._heard.add(kind)
        self.set((*self._bits, *self._keys, *self._long_bits, *self._long_keys), now_s)

    def _labels_of(self, size: int) -> Mapping[int, str]:
        """Labels by bit of a report 3 of `size` bytes."""
        if self.model is not None and not self.model.receiver:
            return self.model.buttons
        if size == _TWO_BUTTON_REPORT_BYTES:
            return TWO_BUTTONS
        return _V3DK_BITS if self.model is None else PRO_BUTTONS

    def _label(self, code: int) -> str:
        own = None if self.model is None else self.model.buttons.get(code - 1)
        return own or V3DK.get(code) or f"key-{code}"

    def _long_labels(self, codes: Sequence[int]) -> list[str]:
        return [self._label(LONG_PRESS.get(code, code)) for code in codes]


def _bits_of(mask: int) -> list[int]:
    return [bit for bit in range(mask.bit_length()) if mask >> bit & 1]
