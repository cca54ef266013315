"""The simulated controller of the rail: its rules without I/O, its peer, and its command."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from cardan.common import bounds
from cardan.common.options import check_options
from cardan.protocols.joint_stream.codec import is_newer
from cardan.robots import load_arm
from cardan.sim_peers.base import FaultSwitch, TimedActions, check_faults
from cardan.sim_peers.command import PeerCommand, option
from cardan.sim_peers.datagrams import ListeningPeer
from cardan.sim_peers.link import LINK_FAULTS

from cardan_rail.protocol import (
    BRAKES_AFTER_S,
    PERIOD_S,
    Condition,
    RailState,
    decode_command,
    encode_state,
)

FAULTS = (
    *LINK_FAULTS,
    FaultSwitch.share("garbage", "share of states with a datagram of junk before it", 0.1),
    FaultSwitch.at("estop", "emergency stop"),
    FaultSwitch.at("restart", "the controller restarts"),
    FaultSwitch.at("mute", "half a second without a state"),
    FaultSwitch.flag("nan", "positions are not numbers in every tenth state"),
)

OFF_S = 1.0
"""Duration of a restart."""
MUTE_S = 0.5
CLIENT_SILENT_S = 1.0
"""Silence of a client after which another one may take its place."""

TOO_FAST = 1.5
"""Limit of the commanded speed, as a multiple of the axis' speed. It exceeds 1 because a command
may have to make up for the previous cycle if datagrams are late."""


class RailController:
    """The controller's rules. Call `cycle` once for each period, from time 0 on."""

    def __init__(self, faults: Mapping[str, float] | None = None, session: int = 1) -> None:
        faults = {} if faults is None else faults
        arm = load_arm("cardan_rail:rail.toml")
        self._limits = arm.limits
        self.positions = list(arm.home)
        """Axis positions, m."""
        self.speeds = [0.0] * len(arm.home)
        self.condition = Condition.FOLLOWING
        self.session = session
        self.time_s = 0.0
        self.client: Hashable = None
        """Address whose commands are obeyed and to which the states are sent."""
        self._heard_s = -CLIENT_SILENT_S
        self._sequence = 0
        self._taken: int | None = None
        self._target: tuple[float, ...] | None = None
        self._commanded_s = 0.0
        self._silent_until_s = 0.0
        self._nan = bool(faults.get("nan", 0.0))
        acts = {"estop": self.emergency_stop, "restart": self.restart, "mute": self.mute}
        self._timed = TimedActions(faults, acts)

    def emergency_stop(self) -> None:
        self.condition = Condition.EMERGENCY_STOP

    def restart(self) -> None:
        """Close the brakes at once, and stay silent for a while."""
        self.speeds = [0.0] * len(self.speeds)
        self._begin()
        self._silent_until_s = self.time_s + OFF_S

    def _begin(self) -> None:
        """Begin a new session: earlier commands no longer act."""
        self.condition = Condition.FOLLOWING
        self.session, self._sequence = self.session + 1 & 0xFFFFFFFF, 0
        self._target = self._taken = None

    def mute(self) -> None:
        self._silent_until_s = self.time_s + MUTE_S

    def receive(self, data: bytes, source: Hashable) -> None:
        """Process a datagram from `source`."""
        command = decode_command(data)
        if isinstance(command, str):
            return
        if source != self.client and self.time_s - self._heard_s < CLIENT_SILENT_S:
            return
        self.client, self._heard_s = source, self.time_s
        if command.positions is None:
            self._target = None
            if self.condition is Condition.FOLLOWING and any(self.speeds):
                self.condition = Condition.BRAKING
        elif command.session == self.session and (
            self._taken is None or is_newer(command.sequence, self._taken)
        ):
            self._taken, self._target = command.sequence, command.positions

    def cycle(self) -> bytes | None:
        """Run one cycle: move, and return the state to send to `client`; None: send nothing."""
        self.time_s += PERIOD_S
        for _, act in self._timed.due(self.time_s):
            act()
        target, self._target = self._target, None
        if target is not None:
            self._commanded_s = self.time_s
        if self.condition is Condition.FOLLOWING:
            if target is not None:
                self._follow(target)
            elif self.time_s - self._commanded_s > BRAKES_AFTER_S and any(self.speeds):
                self.condition = Condition.BRAKING
        if self.condition is not Condition.FOLLOWING:
            self._brake()
        self._move()
        self._sequence = self._sequence + 1 & 0xFFFFFFFF
        if self.client is None or self.time_s < self._silent_until_s:
            return None
        x, y, z = self.positions
        if self._nan and self._sequence % 10 == 0:
            x = float("nan")
        return encode_state(RailState(self.session, self._sequence, self.condition, (x, y, z)))

    def _follow(self, target: tuple[float, ...]) -> None:
        wanted = [(q - p) / PERIOD_S for q, p in zip(target, self.positions, strict=True)]
        limits = zip(wanted, self._limits.velocity, strict=True)
        if any(abs(v) > TOO_FAST * most for v, most in limits):
            self.condition = Condition.TOO_FAST
        else:
            self.speeds = wanted

    def _brake(self) -> None:
        for axis, most in enumerate(self._limits.acceleration):
            step = most * PERIOD_S
            self.speeds[axis] -= max(-step, min(step, self.speeds[axis]))
        if self.condition is Condition.BRAKING and not any(self.speeds):
            self._begin()

    def _move(self) -> None:
        lower, upper, _, _ = self._limits
        for axis, speed in enumerate(self.speeds):
            place = self.positions[axis] + speed * PERIOD_S
            self.positions[axis] = max(lower[axis], min(upper[axis], place))


@dataclass(frozen=True, kw_only=True)
class RailPeerOptions:
    """Address of the controller, and its faults."""

    host: Annotated[str, bounds.LISTEN_HOST] = option(
        "127.0.0.1",
        "Address at which it takes commands; port 0: any.",
        name="listen",
        metavar="HOST:PORT",
        port_field="port",
    )
    port: Annotated[int, bounds.ANY_PORT] = 7400
    """UDP port of the controller."""
    faults: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0

    def __post_init__(self) -> None:
        check_options(self)
        check_faults(self.faults, FAULTS)


class RailPeer(ListeningPeer):
    """Serves a `RailController`."""

    def __init__(self, options: RailPeerOptions) -> None:
        super().__init__(options.host, options.port, PERIOD_S, options.faults, options.seed)
        self.core = RailController(options.faults)

    def _receive(self, data: bytes, source: Any, now_s: float) -> None:
        self.core.receive(data, source)
        self._client = self.core.client

    def _cycle(self, now_s: float, scheduled_s: float) -> None:
        state = self.core.cycle()
        if state is not None:
            self._send(state, now_s)


class RailCommand(PeerCommand[RailPeerOptions]):
    """The controller of a gantry of three linear axes."""

    Options, Peer = RailPeerOptions, RailPeer
    page, speaks = "https://rail.example/cardan", "axis positions, UDP, 125 Hz"
    epilog = "Prints READY and the address it listens on once it serves."
    faults = FAULTS
