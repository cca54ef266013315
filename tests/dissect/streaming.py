"""Segments of TCP, and what a reader of streams makes of them."""

from cardan.dissect.capture import CapturedPacket
from cardan.dissect.network import Segment


def segments(parts, start, source, destination):
    """Each of `parts` in a segment of its own, one after the other from `start` on."""
    made = []
    for part in parts:
        made.append(Segment("TCP", source, destination, part, False, start % 2**32, 16))
        start += len(part)
    return made


def fed(reader, listed, period_s):
    """Lines without their addresses, of segments that come in this period."""
    lines = []
    for number, segment in enumerate(listed, 1):
        packet = CapturedPacket(number, round(number * period_s * 1e9), 1, "<", b"", 0)
        lines += [text for _, text in reader.feed(packet, segment)]
    lines += [text for _, text in reader.finish()]
    return [line.split(" ", 3)[3] for line in lines]
