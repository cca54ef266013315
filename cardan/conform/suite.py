"""What a protocol's conformance is made of."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping
from typing import ClassVar, Generic, Literal, NamedTuple

from cardan.conform.requirements import Level, Requirement, V
from cardan.conform.runner import Exchange, Scenario
from cardan.conform.timeline import Event, Timeline
from cardan.conform.transports import TcpPorts, UdpPort, Wires, host_and_port
from cardan.sim_peers import registry
from cardan.sim_peers.base import FaultSwitch, parse_faults


class Transport(NamedTuple):
    """What a capture of it is written as."""

    kind: Literal["udp", "tcp", "can", "other"]
    """`other`: no packets of a network; the record has the bytes."""
    ports: Mapping[str, int] = {}
    """Of each channel: the port that is known for it, on the side that listens."""
    ours: frozenset[str] = frozenset()
    """Of `ports`: those that we listen at, where the other side is the client."""
    scenarios: frozenset[str] = frozenset()
    """Of `ports`: those of clients that are as only our scenario is; no other's is one of them."""


class Suite(Generic[V]):
    """The conformance of one side of one protocol: a declaration. It is never given bytes but by
    timelines."""

    name: ClassVar[str]
    """As ``cardan conform NAME`` has it."""
    judges: ClassVar[str]
    """The side that is judged: "the controller", "the driver"."""
    speaks: ClassVar[str]
    """The protocol, one line."""
    target: ClassVar[str]
    """What ``--target`` takes."""
    peer: ClassVar[str]
    """What is judged without a target: a simulated peer's name, a driver's, or an arm's."""
    levels: ClassVar[Level] = Level.BY_HAND
    """The highest level that has requirements."""
    harmless: ClassVar[Level] = Level.LISTEN
    """The highest level that needs nobody's consent, and the default at a target."""
    requirements: tuple[Requirement[V], ...]
    transport: ClassVar[Transport]
    dissector: ClassVar[str] = ""
    """Of a device without packets of a network: what finds its reports in a capture of USB or of
    Bluetooth, as cardan-dissect and its plug-ins name it; empty: nothing does."""
    fault_test_values: ClassVar[Mapping[str, float]] = {}
    """Values of fault switches with which a fault shows within the short time of a simulated run;
    of the others it is the switch's own."""
    tried_on: ClassVar[Mapping[str, Level]] = {}
    """Fault switches that only show on this level."""
    undetectable_faults: ClassVar[Mapping[str, str]] = {}
    """Fault switches that no requirement can catch, and why."""

    decoder: Callable[[Timeline], V]
    """Makes of a timeline what the judges look at."""
    asks: Callable[[Level, float], Scenario]
    """Makes the scenario that asks on every level up to one, each for about so many seconds."""
    rig: ClassVar[str]
    """``package.module:Class`` of what carries between a scenario and the simulated peer, which is
    made of an exchange, faults and a seed, and `run`. A target is judged without it."""
    seconds: ClassVar[float]
    """How long a level of a simulated run takes, s of virtual time."""
    own_faults: ClassVar[tuple[FaultSwitch, ...] | None] = None
    """The fault switches of what is judged without a target; None: the simulated peer's."""

    def decode(self, timeline: Timeline) -> V:
        """What the judges look at."""
        return self.decoder(timeline)

    def scenario(self, level: Level, seconds: float) -> Scenario:
        """Asks on every level up to `level`, each for about `seconds`."""
        return self.asks(level, seconds)

    def simulate(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        """Run `exchange` against the simulated peer with these faults, in virtual time."""
        module, _, name = self.rig.partition(":")
        getattr(importlib.import_module(module), name)(exchange, faults, seed).run()

    def wires(self, target: str) -> Wires:
        """The wires to `target`, ``HOST[:PORT]`` of the first of the transport's ports; nothing is
        opened yet. ConfigurationError says what it takes."""
        kind, known, ours, _ = self.transport
        first = next(iter(known.values()))
        host, port = host_and_port(target, "--target", first)
        home = host or "0.0.0.0"
        if kind == "udp":
            return UdpPort(home if ours else host, port, bool(ours))
        ports = {name: port + each - first for name, each in known.items()}
        return TcpPorts(host, ports, ours, home)

    def switches(self) -> tuple[FaultSwitch, ...]:
        """The fault switches of what is judged without a target."""
        if self.own_faults is not None:
            return self.own_faults
        return tuple(registry.load(self.peer).faults)

    def faults(self, words: Iterable[str]) -> dict[str, float]:
        """``NAME[=VALUE]`` as values by name. Raises ScriptError, which names those there are."""
        return parse_faults(words, self.switches())

    def only_asks(self, event: Event) -> bool:
        """Whether what we sent changes nothing in what is judged: level 0 sends nothing else."""
        return False

    def asks_it(self, frame: bytes) -> bool | None:
        """Of a frame of a bus, which does not say whose it is: whether it goes to what is judged,
        or comes from it; None: neither."""
        return None

    def redacted(self, event: Event) -> Event:
        """`event` without serial numbers and addresses in its bytes."""
        return event
