"""One readable line of an RTDE packet, in the units of the wire."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from cardan.dissect._scapy import Packet
from cardan.dissect.rtde import (
    LEVELS,
    NAMES,
    NO_RECIPE,
    RtdeAskInputs,
    RtdeAskOutputs,
    RtdeAskVersion,
    RtdeController,
    RtdeInputs,
    RtdeOutputs,
    RtdePaused,
    RtdeStarted,
    RtdeText,
    RtdeTextRequest,
    RtdeVersionReply,
    listed as parted,
)
from cardan.dissect.text import listed, number

UNITS = {
    "timestamp": "s",
    "_q": "rad",
    "_qd": "rad/s",
    "_qdd": "rad/s²",
    "_TCP_pose": "m, rad",
    "_TCP_speed": "m/s, rad/s",
    "_TCP_force": "N, N·m",
    "_current": "A",
    "_voltage": "V",
}
"""Of variables, by how their names end."""

SHOWN_CHARACTERS = 64
"""Of a variable's name in each data packet; those that there are, are shorter."""


class Recipe(NamedTuple):
    """The variables of data packets, as a request named them and its reply typed them."""

    names: tuple[str, ...]
    types: tuple[str, ...]
    frequency_hz: float | None
    """None: inputs."""

    @property
    def refused(self) -> Iterator[str]:
        """Names that it cannot have, with the controller's word for why."""
        for name, kind in zip(self.names, self.types, strict=False):
            if kind in ("NOT_FOUND", "IN_USE"):
                yield f"{name} {kind}"


def describe(layer: Packet) -> str:
    """Every value of a packet but data, which `describe_data` does."""
    return " | ".join((title(layer), *_body(layer)))


def title(layer: Packet) -> str:
    """Its type, by name."""
    return f"RTDE {NAMES[layer.kind]}"


def describe_data(layer: Packet, recipe: Recipe | None, values: Iterable[Any]) -> str:
    """A data packet; without its recipe there are bytes only."""
    parts = [f"{title(layer)} recipe {layer.recipe}"]
    if recipe is None:
        parts.append(f"{len(layer.values)} bytes")
    else:
        parts += map(_value, recipe.names, values)
    return " | ".join(parts)


def _value(name: str, value: Any) -> str:
    unit = next((unit for end, unit in UNITS.items() if name.endswith(end)), "")
    several = value if isinstance(value, tuple) else (value,)
    shown = " ".join(number(each) if isinstance(each, float) else str(each) for each in several)
    return f"{name[:SHOWN_CHARACTERS]} {shown} {unit}".rstrip()


def _body(layer: Packet) -> Iterator[str]:
    if isinstance(layer, RtdeAskVersion):
        yield f"asks for version {layer.version}"
    elif isinstance(layer, RtdeVersionReply | RtdeStarted | RtdePaused):
        yield "accepted" if layer.accepted else "NOT ACCEPTED"
    elif isinstance(layer, RtdeController):
        yield version(layer)
    elif isinstance(layer, RtdeAskOutputs):
        yield f"asks at {number(layer.frequency_hz)} Hz for {listed(parted(layer.variables))}"
    elif isinstance(layer, RtdeAskInputs):
        yield f"asks to write {listed(parted(layer.variables))}"
    elif isinstance(layer, RtdeOutputs | RtdeInputs):
        yield "no recipe" if layer.recipe == NO_RECIPE else f"recipe {layer.recipe}"
        yield listed(parted(layer.types))
    elif isinstance(layer, RtdeText | RtdeTextRequest):
        yield f"{LEVELS.get(layer.level, layer.level)} of {layer.source.decode()!r}"
        yield repr(layer.message.decode())
    else:
        yield "asks"


def version(layer: RtdeController) -> str:
    """The software's."""
    return f"{layer.major}.{layer.minor}.{layer.bugfix}.{layer.build_number}"
