"""Options of the driver of serial devices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cardan.common import bounds
from cardan.common.options import require_each, suggestion
from cardan.drivers.spacemouse.options import MouseOptions
from cardan_serial_mice.protocol import SERIAL_MODELS

_KEYS = tuple(model.key for model in SERIAL_MODELS)


@dataclass(frozen=True, kw_only=True)
class SpaceMouseSerialOptions(MouseOptions):
    """Options of :class:`SpaceMouseSerial`. Raises OptionError for a value that is not allowed."""

    path: Annotated[str, bounds.MEETING] = "/dev/ttyUSB0"
    """Path of the serial port."""
    model: str = ""
    """Key of the device's model ("spaceball-4000"). Empty: any that answers."""

    def __post_init__(self) -> None:
        super().__post_init__()
        near = suggestion(self.model, _KEYS)
        good = not self.model or self.model in _KEYS
        require_each(
            self,
            ("path", self.path, "the path of the serial port"),
            ("model", good, f"empty or one of {', '.join(_KEYS)}{near}"),
        )
