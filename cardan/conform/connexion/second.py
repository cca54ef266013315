"""The scapy layers as a second judge of 3Dconnexion's reports, where scapy is installed."""

from __future__ import annotations

from cardan.conform.connexion.seen import ConnexionSeen
from cardan.conform.requirements import Verdict, failed, not_applicable, not_seen, passed
from cardan.errors import ExtraMissingError
from cardan.protocols.hid import MalformedReport

COMPARED = 60
"""Reports that are read twice, from all over the timeline."""


def readings_differ(seen: ConnexionSeen) -> Verdict:
    """Whether the layers and the codec read the device's reports alike."""
    try:
        from cardan.dissect.connexion import ConnexionInput
    except ExtraMissingError as missing:
        return not_applicable(str(missing))
    found = [each for each in seen.reports if not isinstance(each.value, MalformedReport)]
    if not found:
        return not_seen("no reports came")
    chosen = found[:: max(1, len(found) // COMPARED)]
    for each in chosen:
        layer = ConnexionInput(each.raw)
        if layer.id != each.raw[0]:
            return failed("another id", [each.number])
        for name, value in each.value._asdict().items():
            read = getattr(layer, name, None)
            if read is None or (tuple(read) if isinstance(value, tuple) else read) != value:
                return failed(f"another {name}", [each.number])
    return passed(f"{len(chosen)} reports read twice")
