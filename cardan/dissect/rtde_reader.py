"""RTDE in a capture: TCP streams put together, a line per packet, figures per connection."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from typing import Any, NamedTuple

from cardan.dissect import tcp
from cardan.dissect._scapy import Packet
from cardan.dissect.capture import Direction
from cardan.dissect.network import Endpoint
from cardan.dissect.ports import RTDE_PORTS
from cardan.dissect.rtde import (
    HEADER_BYTES,
    NAMES,
    NO_RECIPE,
    OUTPUTS_TYPE,
    RtdeAskInputs,
    RtdeAskOutputs,
    RtdeController,
    RtdeInputData,
    RtdeInputs,
    RtdeOutputData,
    RtdeOutputs,
    RtdeReply,
    RtdeRequest,
    RtdeText,
    RtdeTextRequest,
    begins_packet,
    listed as parted,
    malformed,
    packet_bytes,
    values_of,
)
from cardan.dissect.rtde_text import Recipe, describe, describe_data, version
from cardan.dissect.statistics import Intervals, Latencies, milliseconds, tallies
from cardan.dissect.streams import Framer, Measured, StreamFlow, StreamReader
from cardan.dissect.text import listed, number

PENDING = 256
"""Requests remembered until they are answered."""
LARGEST_TIME_S = 1e9
"""No controller was on for so long."""
LONGEST_STEP_MS = 1000
"""Steps of the controller's clock that are longer count as one."""
_WRONG_VALUES = "values that are not of their recipe's types"


class _Framer(Framer):
    """Cuts by the size."""

    def __init__(self) -> None:
        super().__init__(HEADER_BYTES)

    def begins(self, data: bytes) -> bool:
        return begins_packet(data)

    def measure(self, data: bytearray) -> Measured:
        size = packet_bytes(data)
        return Measured(size, "" if size is not None else "a size below 3")


class _Asked(NamedTuple):
    """A request that waits for its reply."""

    layer: Packet
    time_ns: int


class _Series:
    """The data packets of one recipe."""

    def __init__(self) -> None:
        self.period = Intervals()
        self._last_s: float | None = None
        self._steps: Counter[int] = Counter()

    def add(self, time_ns: int, timestamp_s: Any) -> None:
        """One more, with the controller's time where it tells it."""
        self.period.add(time_ns)
        if not isinstance(timestamp_s, float) or not abs(timestamp_s) < LARGEST_TIME_S:
            return
        if self._last_s is not None:
            step_ms = min(round(1e3 * (timestamp_s - self._last_s)), LONGEST_STEP_MS)
            self._steps[max(step_ms, 0)] += 1
        self._last_s = timestamp_s

    @property
    def left_out(self) -> int | None:
        """How many the controller left out, by the usual step of its clock; None: it is unknown."""
        if not self._steps:
            return None
        usual = max(self._steps.most_common(1)[0][0], 1)
        return sum((max(round(step / usual), 1) - 1) * n for step, n in self._steps.items())


class _Flow(StreamFlow):
    """The RTDE port of a controller and one client."""

    title = "RTDE"

    def __init__(self, controller: Endpoint, client: Endpoint) -> None:
        super().__init__(controller, client, _Framer)
        self._recipes: dict[tuple[Direction, int], Recipe] = {}
        self._pending: deque[_Asked] = deque(maxlen=PENDING)
        self._software = ""
        self._shown: dict[str, None] = {}
        self._series: dict[tuple[Direction, int], _Series] = {}
        self._latencies: dict[str, Latencies] = {}
        self._refused: Counter[str] = Counter()
        self._texts: Counter[str] = Counter()
        self._unanswered = 0

    def noted(self, event: tcp.Event, direction: Direction) -> None:
        if isinstance(event, tcp.Begin) and direction is Direction.TO_DEVICE:
            # Recipes are a connection's own.
            self._unanswered += len(self._pending)
            self._pending.clear()
            self._recipes.clear()

    def take(self, data: bytes, direction: Direction, time_ns: int) -> tuple[str, str]:
        from_controller = direction is Direction.FROM_DEVICE
        layer = RtdeReply(data) if from_controller else RtdeRequest(data)
        reason = malformed(layer)
        said: list[str] = []
        text = ""
        if reason is None and isinstance(layer, RtdeOutputData | RtdeInputData):
            text, reason = self._data(layer, direction, time_ns, said)
        if reason is not None:
            return self.broken(data, reason, direction), reason
        if not text:
            text = describe(layer)
            said += self._replied(layer, time_ns) if from_controller else self._ask(layer, time_ns)
        sender = self.senders[direction]
        sender.types[NAMES[layer.kind]] += 1
        sender.remarks.update(said)
        return " | ".join((text, *(words.upper() for words in said))), ""

    def _data(
        self, layer: Packet, direction: Direction, time_ns: int, said: list[str]
    ) -> tuple[str, str | None]:
        """The line of a data packet, or why it is malformed."""
        key = direction, layer.recipe
        recipe = self._recipes.get(key)
        values: list[Any] = []
        if recipe is None:
            said.append("recipe not in the capture")
        else:
            read = values_of(recipe.types, layer.values)
            if read is None:
                return "", _WRONG_VALUES
            values = read
        names = () if recipe is None else recipe.names
        told = dict(zip(names, values, strict=True))
        self._series.setdefault(key, _Series()).add(time_ns, told.get("timestamp"))
        return describe_data(layer, recipe, values), None

    def _ask(self, layer: Packet, time_ns: int) -> Iterator[str]:
        if isinstance(layer, RtdeTextRequest):
            return
        if len(self._pending) == PENDING:
            self._pending.popleft()
            self._unanswered += 1
        self._pending.append(_Asked(layer, time_ns))
        yield from ()

    def _replied(self, layer: Packet, time_ns: int) -> Iterator[str]:
        if isinstance(layer, RtdeText):
            self._texts[layer.message.decode()] += 1
            return
        place = next((n for n, a in enumerate(self._pending) if a.layer.kind == layer.kind), None)
        if isinstance(layer, RtdeController):
            self._software = version(layer)
        if place is None:
            yield "answers no request"
            return
        asked = self._pending[place]
        del self._pending[place]
        self._latencies.setdefault(NAMES[layer.kind], Latencies()).add(time_ns - asked.time_ns)
        if isinstance(layer, RtdeOutputs | RtdeInputs):
            yield from self._set_up(asked.layer, layer)

    def _set_up(self, asked: Packet, reply: Packet) -> Iterator[str]:
        if not isinstance(asked, RtdeAskOutputs | RtdeAskInputs):
            return
        outputs = reply.kind == OUTPUTS_TYPE
        frequency_hz = asked.frequency_hz if outputs else None
        recipe = Recipe(parted(asked.variables), parted(reply.types), frequency_hz)
        refused = list(recipe.refused)
        self._refused.update(refused)
        if refused:
            yield f"{len(refused)} of {len(recipe.names)} variables refused"
        if len(recipe.names) != len(recipe.types):
            yield f"{len(recipe.types)} types for {len(recipe.names)} variables"
        elif reply.recipe != NO_RECIPE and not refused:
            way = Direction.FROM_DEVICE if outputs else Direction.TO_DEVICE
            self._recipes[way, reply.recipe] = recipe
            what = (
                f"output recipe {reply.recipe} at {number(frequency_hz)} Hz"
                if (frequency_hz is not None)
                else f"input recipe {reply.recipe}"
            )
            self._shown[f"  {what}: {listed(recipe.names)}"] = None

    def summary(self) -> Iterator[str]:
        software = f", software {self._software}" if self._software else ""
        yield f"RTDE flow controller {self.device} - client {self.client}{software}"
        for name, sender in zip(("controller", "client"), self.senders.values(), strict=True):
            yield from sender.summary(name)
        yield from self._shown
        for (direction, recipe), series in self._series.items():
            way = "output" if direction is Direction.FROM_DEVICE else "input"
            left_out = "" if series.left_out is None else f", left out {series.left_out}"
            yield f"  {way} data of recipe {recipe}: {series.period}{left_out}"
        for what, latencies in self._latencies.items():
            figures = zip(("min", "median", "max"), (0.0, 0.5, 1.0), strict=True)
            shown = " ".join(
                f"{name} {milliseconds(latencies.quantile_ns(q))}" for name, q in figures
            )
            yield f"  {what} to its reply x{len(latencies)}: {shown} ms"
        unanswered = self._unanswered + len(self._pending)
        if unanswered:
            yield f"  requests without a reply {unanswered}"
        yield from tallies("  ", ("refused", self._refused), ("texts", self._texts))


class RtdeReader(StreamReader[_Flow]):
    """TCP streams to and from the RTDE ports of controllers."""

    def __init__(self, rtde_ports: frozenset[int] = frozenset(RTDE_PORTS)) -> None:
        super().__init__(rtde_ports)

    def open(self, device: Endpoint, client: Endpoint) -> _Flow:
        return _Flow(device, client)
