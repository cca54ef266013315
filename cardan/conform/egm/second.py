"""The scapy layers as a second judge of EGM, where scapy is installed."""

from __future__ import annotations

import math

from cardan.conform.egm.seen import EgmSeen
from cardan.conform.requirements import Verdict, failed, not_applicable, not_seen, passed
from cardan.errors import ExtraMissingError

COMPARED = 40
"""Datagrams that are read twice, from all over the timeline: scapy takes a millisecond for one."""


def readings_differ(seen: EgmSeen) -> Verdict:
    """Whether the layers and the codec read the controller's datagrams alike."""
    try:
        from cardan.dissect.egm import EgmRobot, malformed
    except ExtraMissingError as missing:
        return not_applicable(str(missing))
    if not seen.robots:
        return not_seen("no datagrams of the controller")
    chosen = seen.robots[:: max(1, len(seen.robots) // COMPARED)]
    for each in chosen:
        layer = EgmRobot(seen.raw[each.number])
        wrong = malformed(layer)
        if wrong is not None:
            return failed(f"the layers refuse it: {wrong}", [each.number])
        header = each.message.header
        if header is not None and (layer.header.seqno, layer.header.tm) != header[:2]:
            return failed("another seqno or tm", [each.number])
        joints = [math.radians(q) for q in layer.feedBack.joints.joints]
        if each.joints and not all(
            math.isclose(a, b, abs_tol=1e-12) for a, b in zip(joints, each.joints, strict=True)
        ):
            return failed("other joints", [each.number])
    return passed(f"{len(chosen)} datagrams read twice")
