"""Segments of TCP, and what a dissector of streams makes of them."""

from cardan_dissect.capture import CapturedPacket
from cardan_dissect.figures import Figures
from cardan_dissect.network import Segment
from cardan_dissect.reader import Note, describe, excerpt


def segments(parts, start, source, destination):
    """Each of `parts` in a segment of its own, one after the other from `start` on."""
    made = []
    for part in parts:
        made.append(Segment("TCP", source, destination, part, False, start % 2**32, 16))
        start += len(part)
    return made


def opened(kind):
    """A dissector of this class, with its usual numbers."""
    return kind({option.key: option.usual for option in kind.options})


def fed(dissector, listed, period_s):
    """Lines without their addresses, of segments that come in this period; and all that is said in
    the end of each direction."""
    lines, found, figures = [], [], {}
    for number, segment in enumerate(listed, 1):
        packet = CapturedPacket(number, round(number * period_s * 1e9), 1, "<", b"", 0)
        found += dissector.feed(packet, segment)
    for each in [*found, *dissector.finish()]:
        if isinstance(each, Note):
            lines.append(each.text)
            continue
        decoded = each.decoded
        if each.where not in figures:
            figures[each.where] = Figures(figures.get(each.other_way))
        figures[each.where].add(each)
        title = decoded.title or dissector.name
        fault = f"MALFORMED {title}: {decoded.fault} {excerpt(each.data)}"
        lines.append(fault if decoded.fault else describe(decoded))
    said = []
    for where, mine in figures.items():
        said += [f"{where}: {dissector.about(where)}", *mine]
    return lines, said
