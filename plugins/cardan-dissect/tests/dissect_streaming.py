"""TCP segments, and the output of a stream dissector for them."""

from cardan_dissect.capture import CapturedPacket
from cardan_dissect.figures import Figures
from cardan_dissect.network import Segment
from cardan_dissect.reader import Note, describe, excerpt


def segments(parts, start, source, destination):
    """Return consecutive segments with the given parts, from sequence number `start` on."""
    made = []
    for part in parts:
        made.append(Segment("TCP", source, destination, part, False, start % 2**32, 16))
        start += len(part)
    return made


def opened(kind):
    """Return a dissector of this class with the default port numbers."""
    return kind({option.key: option.usual for option in kind.options})


def fed(dissector, listed, period_s):
    """Return the lines without addresses for segments that arrive at this period, and the final
    figures of each direction."""
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
