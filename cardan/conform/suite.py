"""What a protocol's conformance is made of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, ClassVar, Generic, Literal, NamedTuple

from cardan.conform.conduct import Conduct, Pilot
from cardan.conform.requirements import Level, Requirement, V
from cardan.conform.timeline import Event, Timeline
from cardan.sim_peers import registry
from cardan.sim_peers.base import FaultSwitch, parse_faults

if TYPE_CHECKING:
    from cardan.conform.wires import Wires


class Transport(NamedTuple):
    """What a capture of it is written as."""

    kind: Literal["udp", "tcp", "can", "other"]
    """`other`: no packets of a network; the record has the bytes."""
    ports: Mapping[str, int] = {}
    """Of each channel: the port that is known for it, on the side that listens."""
    ours: frozenset[str] = frozenset()
    """Of `ports`: those that we listen at, where the other side is the client."""


class Suite(ABC, Generic[V]):
    """The conformance of one side of one protocol. It is never given bytes but by timelines."""

    name: ClassVar[str]
    """As ``cardan conform NAME`` has it."""
    judges: ClassVar[str]
    """Who is judged: "the controller", "the driver"."""
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
    tried_with: ClassVar[Mapping[str, float]] = {}
    """Values of fault switches with which a fault shows within the short time of a simulated run;
    of the others it is the switch's own."""
    tried_on: ClassVar[Mapping[str, Level]] = {}
    """Fault switches that only show on this level."""
    off_the_wire: ClassVar[Mapping[str, str]] = {}
    """Fault switches that no requirement can catch, and why."""

    @abstractmethod
    def see(self, timeline: Timeline) -> V:
        """What the judges look at."""

    @abstractmethod
    def pilot(self, level: Level, seconds: float) -> Pilot:
        """Asks on every level up to `level`, each for about `seconds`."""

    seconds: ClassVar[float]
    """How long a level of a simulated run takes, s of virtual time."""

    @abstractmethod
    def simulate(self, conduct: Conduct, faults: Mapping[str, float], seed: int) -> None:
        """Run `conduct` against the simulated peer with these faults, in virtual time."""

    @abstractmethod
    def wires(self, target: str) -> Wires:
        """The wires to `target`; nothing is opened yet. ConfigurationError says what it takes."""

    def switches(self) -> tuple[FaultSwitch, ...]:
        """The fault switches of the simulated peer."""
        return tuple(registry.load(self.peer).faults)

    def faults(self, words: Iterable[str]) -> dict[str, float]:
        """``NAME[=VALUE]`` as values by name. Raises ScriptError, which names those there are."""
        return parse_faults(words, self.switches())

    def only_asks(self, event: Event) -> bool:
        """Whether what we sent changes nothing in what is judged: level 0 sends nothing else."""
        return False

    def redacted(self, event: Event) -> Event:
        """`event` without serial numbers and addresses in its bytes."""
        return event
