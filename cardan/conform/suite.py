"""Base class of the conformance suites of protocols."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping
from typing import ClassVar, Generic, Literal, NamedTuple

from cardan.conform.requirements import Level, Requirement, V
from cardan.conform.runner import Exchange, Scenario
from cardan.conform.timeline import WireEvent, WireTimeline
from cardan.conform.transports import TcpPorts, UdpPort, Wires, host_and_port
from cardan.sim_peers import registry
from cardan.sim_peers.base import FaultSwitch, parse_faults


class SuiteTransport(NamedTuple):
    """Packet format in which the traffic is written to a capture."""

    kind: Literal["udp", "tcp", "can", "other"]
    """`other`: no packets of a network; the record has the bytes."""
    ports: Mapping[str, int] = {}
    """Well-known port of each channel, on the listening side."""
    ours: frozenset[str] = frozenset()
    """Channels of `ports` on which we listen, with the other side as the client."""
    scenarios: frozenset[str] = frozenset()
    """Channels of `ports` whose clients only our scenario has: no captured client is one."""


class Suite(Generic[V]):
    """Declaration of the conformance of a side of a protocol. Bytes reach it only in timelines."""

    name: ClassVar[str]
    """NAME in ``cardan conform NAME``."""
    judges: ClassVar[str]
    """The tested side: "the controller", "the driver"."""
    speaks: ClassVar[str]
    """The protocol, one line."""
    target: ClassVar[str]
    """Values that ``--target`` takes."""
    peer: ClassVar[str]
    """Name of the simulated peer, driver or arm that is tested without a target."""
    levels: ClassVar[Level] = Level.BY_HAND
    """The highest level that has requirements."""
    harmless: ClassVar[Level] = Level.LISTEN
    """The highest level that needs no consent, and the default at a target."""
    requirements: tuple[Requirement[V], ...]
    transport: ClassVar[SuiteTransport]
    dissector: ClassVar[str] = ""
    """For a device without network packets: the dissector of its reports in a USB or Bluetooth
    capture, by its name in cardan-dissect and its plug-ins; empty: none."""
    fault_test_values: ClassVar[Mapping[str, float]] = {}
    """Values of fault switches with which a fault shows within the short time of a simulated run;
    the other switches use their default."""
    tried_on: ClassVar[Mapping[str, Level]] = {}
    """Fault switches that only show on this level."""
    undetectable_faults: ClassVar[Mapping[str, str]] = {}
    """Fault switches that no requirement can catch, and why."""

    decode: Callable[[WireTimeline], V]
    """Makes a timeline's decoded traffic, which the requirements are checked on."""
    scenario: Callable[[Level, float], Scenario]
    """Makes the scenario of every level up to the given one, each for about the given time, s."""
    simulation: ClassVar[str]
    """``package.module:Class`` of the connection between a scenario and the simulated peer, made
    from an exchange, faults and a seed, with `run`. A target is tested without it."""
    seconds: ClassVar[float]
    """Duration of a level of a simulated run, s of virtual time."""
    own_faults: ClassVar[tuple[FaultSwitch, ...] | None] = None
    """Fault switches of the side tested without a target; None: the simulated peer's."""

    def simulate(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        """Run `exchange` against the simulated peer with these faults, in virtual time."""
        module, _, name = self.simulation.partition(":")
        getattr(importlib.import_module(module), name)(exchange, faults, seed).run()

    def wires(self, target: str) -> Wires:
        """Return the wires to `target`, ``HOST[:PORT]`` of the first of the transport's ports,
        not opened yet. Raises ConfigurationError, which names valid targets."""
        kind, known, ours, _ = self.transport
        first = next(iter(known.values()))
        host, port = host_and_port(target, "--target", first)
        home = host or "0.0.0.0"
        if kind == "udp":
            return UdpPort(home if ours else host, port, bool(ours))
        ports = {name: port + each - first for name, each in known.items()}
        return TcpPorts(host, ports, ours, home)

    def switches(self) -> tuple[FaultSwitch, ...]:
        """Return the fault switches of the side tested without a target."""
        if self.own_faults is not None:
            return self.own_faults
        return tuple(registry.load(self.peer).faults)

    def faults(self, words: Iterable[str]) -> dict[str, float]:
        """Return ``NAME[=VALUE]`` as values by name. Raises ScriptError, which names known ones."""
        return parse_faults(words, self.switches())

    def only_asks(self, event: WireEvent) -> bool:
        """True if our data change nothing on the tested side: level 0 sends nothing else."""
        return False

    def asks_it(self, frame: bytes) -> bool | None:
        """True if a bus frame, which names no sender, goes to the tested side, False if it comes
        from there; None: neither."""
        return None

    def redacted(self, event: WireEvent) -> WireEvent:
        """Return `event` without serial numbers and addresses in its bytes."""
        return event
