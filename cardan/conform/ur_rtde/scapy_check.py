"""The scapy layers as a second judge of RTDE, where they are installed."""

from __future__ import annotations

from typing import Any

from cardan.conform.requirements import Verdict
from cardan.conform.second_reading import COMPARED, read_twice, second_description
from cardan.conform.ur_rtde.decoded import Heard, UrSeen
from cardan.protocols.ur.rtde import Data, SetupReply


def readings_differ(seen: UrSeen) -> Verdict:
    """Whether the layers and the codec read the controller's packets alike."""

    def differs(each: Heard) -> str:
        layers = second_description("rtde")
        layer = layers.RtdeReply(each.raw)
        return layers.malformed(layer) or _difference(seen, each, layer, layers)

    # The layers are of version 2; of what is no data there is little.
    heard = [each for each in seen.heard if each.channel not in seen.old]
    data = [each for each in heard if isinstance(each.reply, Data)]
    chosen = [each for each in heard if not isinstance(each.reply, Data)]
    chosen += data[:: max(1, len(data) // COMPARED)]
    return read_twice(chosen, differs, "packets", compared=max(1, len(chosen)))


def _difference(seen: UrSeen, heard: Heard, layer: object, layers: Any) -> str:
    """What a layer says otherwise; empty: nothing."""
    reply = heard.reply
    if isinstance(reply, SetupReply):
        read = getattr(layer, "recipe", None), layers.listed(getattr(layer, "types", b""))
        return "" if read == (reply.recipe, reply.types) else f"another recipe: {read}"
    if isinstance(reply, Data):
        recipe = seen.recipes.get(heard.number)
        if recipe is None:
            return ""
        values = layers.values_of(recipe.types, getattr(layer, "values", b""))
        same = recipe.unpack(reply.values)
        return "" if same is not None and values == [*same.values()] else "other values"
    for name, value in reply._asdict().items():
        found = getattr(layer, _SAME.get(name, name), value)
        found = found.decode() if isinstance(found, bytes) else found
        if found != value:
            return f"another {name}"
    return ""


_SAME = {"text": "message", "build": "build_number"}
"""Fields of the codec, and the layers' names for them."""
