"""The scapy layers as a second judge of RTDE, where scapy is installed."""

from __future__ import annotations

from cardan.conform.requirements import Verdict, failed, not_applicable, not_seen, passed
from cardan.conform.ur_rtde.seen import OLD, Heard, UrSeen
from cardan.errors import ExtraMissingError
from cardan.protocols.ur.rtde import Data, SetupReply

COMPARED = 60
"""Data packets that are read twice, from all over the timeline; of the others there are few."""


def readings_differ(seen: UrSeen) -> Verdict:
    """Whether the layers and the codec read the controller's packets alike."""
    try:
        from cardan.dissect.rtde import RtdeReply, malformed
    except ExtraMissingError as missing:
        return not_applicable(str(missing))
    # The layers are of version 2.
    heard = [each for each in seen.heard if each.channel != OLD]
    if not heard:
        return not_seen("nothing came")
    data = [each for each in heard if isinstance(each.reply, Data)]
    chosen = [each for each in heard if not isinstance(each.reply, Data)]
    chosen += data[:: max(1, len(data) // COMPARED)]
    for each in chosen:
        layer = RtdeReply(each.raw)
        wrong = malformed(layer)
        if wrong is None:
            wrong = _difference(seen, each, layer)
        if wrong:
            return failed(wrong, [each.number])
    return passed(f"{len(chosen)} packets read twice")


def _difference(seen: UrSeen, heard: Heard, layer: object) -> str:
    """What a layer says otherwise; empty: nothing."""
    from cardan.dissect.rtde import listed, values_of

    reply = heard.reply
    if isinstance(reply, SetupReply):
        read = getattr(layer, "recipe", None), listed(getattr(layer, "types", b""))
        return "" if read == (reply.recipe, reply.types) else f"another recipe: {read}"
    if isinstance(reply, Data):
        recipe = seen.recipes.get(heard.number)
        if recipe is None:
            return ""
        values = values_of(recipe.types, getattr(layer, "values", b""))
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
