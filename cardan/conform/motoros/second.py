"""The scapy layers as a second judge of simple message, where scapy is installed."""

from __future__ import annotations

from cardan.conform.motoros.seen import MotorosSeen
from cardan.conform.requirements import Verdict, failed, not_applicable, not_seen, passed
from cardan.errors import ExtraMissingError

COMPARED = 60
"""Messages that are read twice, from all over the timeline: scapy takes a millisecond for one."""


def readings_differ(seen: MotorosSeen) -> Verdict:
    """Whether the layers and the codec read the controller's messages alike."""
    try:
        from cardan.dissect.simple_message import SimpleMessage, malformed
    except ExtraMissingError as missing:
        return not_applicable(str(missing))
    if not seen.heard:
        return not_seen("nothing came")
    chosen = seen.heard[:: max(1, len(seen.heard) // COMPARED)]
    for each in chosen:
        layer = SimpleMessage(each.raw)
        wrong = malformed(layer)
        if wrong is not None:
            return failed(f"the layers refuse it: {wrong}", [each.number])
        message = each.message
        head = (layer.msg_type, layer.comm_type, layer.reply_code)
        if head != (message.msg_type, message.comm_type, message.reply_code):
            return failed("another header", [each.number])
        for name, other in _SAME.items():
            value = getattr(message.body, name, None)
            if value is not None and hasattr(layer, other):
                read = getattr(layer, other)
                if (tuple(read) if isinstance(value, tuple) else read) != value:
                    return failed(f"another {name}", [each.number])
    return passed(f"{len(chosen)} messages read twice")


_SAME = {
    "group": "group",
    "sequence": "sequence",
    "command": "command_code",
    "result": "result",
    "subcode": "subcode",
    "valid_fields": "valid_fields",
    "pos": "positions",
    "mode": "mode",
    "motion_possible": "motion_possible",
}
"""Fields of the codec, and the layers' names for them."""
