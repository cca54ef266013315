"""Likely protocols of flows that no dissector read: the first packets of each are tried with the
port of either end as the option of every dissector in turn."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from cardan_dissect.capture import CapturedPacket
from cardan_dissect.network import TCP_ACK, TCP_SYN, Endpoint, Segment
from cardan_dissect.reader import CUT, Dissector, Message

MOST_FLOWS = 256
"""Most flows that are examined."""
FLOW_PACKETS, FLOW_BYTES = 24, 16_384
"""Most packets and bytes examined at the beginning of a flow."""
LEAST_MESSAGES = 2
"""Fewest messages: a single one may be readable by chance."""


class _FlowHints(NamedTuple):
    """The first packets of a flow."""

    packets: list[tuple[CapturedPacket, Segment]]
    sizes: list[int]


class Hints:
    """Flows of a capture that no dissector read."""

    def __init__(self) -> None:
        self._flows: dict[tuple[str, Endpoint, Endpoint], _FlowHints] = {}

    def add(self, packet: CapturedPacket, segment: Segment) -> None:
        """Add a packet that no dissector took."""
        if not segment.payload and segment.flags & (TCP_SYN | TCP_ACK) != TCP_SYN:
            return
        low, high = sorted((segment.source, segment.destination))
        key = segment.protocol, low, high
        seen = self._flows.get(key)
        if seen is None:
            if len(self._flows) >= MOST_FLOWS:
                return
            seen = self._flows[key] = _FlowHints([], [])
        if len(seen.sizes) < FLOW_PACKETS and sum(seen.sizes) < FLOW_BYTES:
            seen.packets.append((packet._replace(data=b""), segment))
            seen.sizes.append(len(segment.payload))

    def flows(self) -> Iterator[str]:
        """Yield all flows, in the order of their first packet."""
        for (protocol, *_), seen in self._flows.items():
            first = seen.packets[0][1]
            yield f"{protocol} {first.source} > {first.destination}"

    def lines(self, kinds: Iterable[type[Dissector]], option: str = "") -> Iterator[str]:
        """Yield advice for reading the flows: a line for each port that needs an option. `option`
        replaces the dissector's own, and is followed by the port."""
        kinds = [kind for kind in kinds if kind.recognized is not Dissector.recognized]
        more: dict[str, list[str]] = {}
        for (_, *ends), seen in self._flows.items():
            for kind in kinds:
                found = [each for end in ends if (each := _likeness(kind, seen, end, ends))]
                if not found:
                    continue
                sides = " or ".join(side for side, _ in found)
                numbers = " or ".join(
                    f"{option or f'--{kind.options[0].flag} '}{number}" for _, number in found
                )
                first = seen.packets[0][1]
                flow = f"{first.source} > {first.destination}"
                line = f"looks like {kind.name}, {sides}; read it with {numbers}"
                more.setdefault(numbers, []).append(f"{flow}: {line}")
        for line, *others in more.values():
            yield line + (f" ({len(others)} more of these flows)" if others else "")


def _likeness(
    kind: type[Dissector], seen: _FlowHints, end: Endpoint, ends: list[Endpoint]
) -> tuple[str, int] | None:
    """Return the dissector's description of the flow, read with the port of `end`, and that
    port."""
    option = kind.options[0]
    if end.port not in option.allowed:
        return None
    numbers = {each.key: frozenset[int]() for each in kind.options}
    trial = kind({**numbers, option.key: frozenset((end.port,))})
    found = [each for packet, segment in seen.packets for each in trial.feed(packet, segment)]
    found += trial.finish()
    messages = [each for each in found if isinstance(each, Message)]
    if len(messages) < len(found) or any(m.decoded.fault not in ("", CUT) for m in messages):
        return None
    whole = [each for each in messages if not each.decoded.fault]
    other = ends[0] if end == ends[1] else ends[1]
    side = trial.recognized(whole, end, other) if len(whole) >= LEAST_MESSAGES else ""
    return (side, end.port) if side else None
