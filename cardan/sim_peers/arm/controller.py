"""The controller of the simulated arm, sans I/O: datagrams in and out, in virtual time."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from typing import NamedTuple

from cardan.common.arm_libraries import np
from cardan.protocols.joint_stream.codec import (
    ArmCommand,
    ArmState,
    ControlMode,
    MalformedDatagram,
    decode_command,
    encode_state,
    is_newer,
)
from cardan.robots import load_arm
from cardan.sim_peers.arm.faults import JAM_AT_S, RESTART_SILENCE_S, SILENCE_EVERY_S
from cardan.sim_peers.arm.options import SimulatedArmOptions
from cardan.sim_peers.arm.plant import ArmPlant, DriveMode
from cardan.sim_peers.base import TimedActions
from cardan.sim_peers.link import FaultyLink

CLIENT_SILENT_S = 1.0
"""Silence of a client after which states are no longer sent to it, and another may connect."""

_CATCH_UP_S = 0.5
"""Longest unserved time that is made up for; a longer one is a pause of the whole process."""
_NOISE_SAMPLES = 509
_TOLERANCE = 1e-9
_MODES = {
    DriveMode.HOLD: ControlMode.HOLD,
    DriveMode.POSITION: ControlMode.POSITION,
    DriveMode.VELOCITY: ControlMode.VELOCITY,
    DriveMode.TORQUE: ControlMode.TORQUE,
}


class Counters(NamedTuple):
    """Counters of datagrams and commands."""

    sent: int
    taken: int
    """Commands that acted."""
    ignored: Mapping[str, int]
    """Ignored commands by reason."""
    timeouts: int
    """Number of times that commands stopped while the arm was not holding."""


class SimulatedArm:
    """A joint-controlled arm as seen over the joint stream.

    Call `cycle` once per period with increasing times and send the datagrams that it returns; pass
    received datagrams to `receive`. The same calls with the same options give the same datagrams. A
    command acts from the plant's step nearest to its reception.
    """

    def __init__(self, options: SimulatedArmOptions | None = None, session: int = 1) -> None:
        self.options = options = SimulatedArmOptions() if options is None else options
        self.arm = load_arm(options.robot)
        self.plant = ArmPlant(self.arm, options.plant)
        faults = options.faults
        self.plant.offset[:] = math.radians(faults.get("offset-deg", 0.0))
        self.plant.give_in()
        self.plant.slow = faults.get("slow", 1.0)
        noise_rad = math.radians(faults.get("noise-deg", 0.0))
        self._noise: list[list[float]] = (
            np.random.default_rng(options.seed)
            .normal(0.0, noise_rad, (_NOISE_SAMPLES, self.plant.joints))
            .tolist()
            if noise_rad
            else []
        )
        faulty = FaultyLink.wanted(faults)
        self._out: FaultyLink[bytes] | None = None
        self._in: FaultyLink[bytes] | None = None
        if faulty:
            self._out = FaultyLink(faults, options.seed + 2, True)
            self._in = FaultyLink(faults, options.seed + 3)
        self.session = session
        """Incremented when the controller restarts."""
        self.client: Hashable = None
        """Address that states are sent to; None: no client."""
        self._has_client = False
        self._heard_s = -math.inf
        self._sequence = 0
        self._newest: int | None = None
        self._command_s = -math.inf
        self._start_s: float | None = None
        self._behind_s = 0.0
        self._off_until_s: float | None = None
        self._stopped = ""
        self._stopped_s = 0.0
        self._refused = ""
        self._sent = self._taken = self._timeouts = 0
        self._bridged = (0, False)
        """Number of accepted commands one cycle ago, and whether one was missing by then."""
        self._ignored: Counter[str] = Counter()
        jam = ((JAM_AT_S, self._jam_joint),) if "jam" in faults else ()
        actions = {"estop": self.emergency_stop, "restart": self.restart}
        self._timed = TimedActions(faults, actions, *jam)
        self._silence_s = faults.get("silence", 0.0)
        lower, upper = np.array(self.arm.lower), np.array(self.arm.upper)
        speed = np.array(self.arm.velocity)
        self._limits = {
            ControlMode.POSITION: (lower, upper, "outside its range"),
            ControlMode.VELOCITY: (-speed, speed, "beyond its speed"),
        }

    # -- datagrams in and out -------------------------------------------------------------------

    def receive(self, data: bytes, now_s: float, source: Hashable = "in-process") -> None:
        """Handle a datagram that arrives from `source` at `now_s`.

        The first command makes `source` the client; other sources are ignored until the client has
        been silent for CLIENT_SILENT_S.
        """
        self._advance(now_s)
        if self._off_until_s is not None:
            return
        if self._has_client and source != self.client:
            if now_s - self._heard_s < CLIENT_SILENT_S:
                self._ignored["another client"] += 1
                return
            self._has_client = False
        if not self._has_client:
            command = decode_command(data)
            if isinstance(command, MalformedDatagram):
                self._ignored[command.reason] += 1
                return
            self.client, self._has_client, self._newest = source, True, None
        self._heard_s = now_s
        if self._in is None:
            self._take(data)
        else:
            self._in.push(now_s, data)

    def cycle(self, now_s: float) -> Sequence[bytes]:
        """Run a control cycle at `now_s`: move, supervise, measure. Return messages for
        `client`."""
        self._advance(now_s)
        if self._in is not None:
            for data in self._in.pop(now_s):
                self._take(data)
        if self._off_until_s is not None or self._start_s is None:
            return ()
        self._watch(now_s)
        self._extrapolate()
        if self._has_client and now_s - self._heard_s > CLIENT_SILENT_S:
            self._has_client = False
            self.client = None
        elapsed_s = now_s - self._start_s
        quiet = elapsed_s % SILENCE_EVERY_S > SILENCE_EVERY_S - self._silence_s
        if not self._has_client or quiet:
            return () if self._out is None else self._out.pop(now_s)
        self._sequence = self._sequence + 1 & 0xFFFFFFFF
        self._sent += 1
        data = encode_state(self.state())
        if self._out is None:
            return (data,)
        self._out.push(now_s, data)
        return self._out.pop(now_s)

    # -- diagnosis ------------------------------------------------------------------------------

    @property
    def hold_reason(self) -> str:
        """Reason why commands do not act, or why the last one was refused; empty when they act."""
        return self._stopped or self._refused

    @property
    def counters(self) -> Counters:
        """Counters of the datagrams so far."""
        return Counters(self._sent, self._taken, dict(self._ignored), self._timeouts)

    def state(self) -> ArmState:
        """The measured state now."""
        plant = self.plant
        positions = plant.positions
        if self._noise:
            noise = self._noise[self._sequence % _NOISE_SAMPLES]
            positions = tuple(q + e for q, e in zip(positions, noise, strict=True))
        pose, wrench = plant.pose, plant.wrench
        return ArmState(
            session=self.session,
            sequence=self._sequence,
            stamp_s=plant.time_s,
            mode=_MODES[plant.mode],
            acknowledged=self._newest or 0,
            period_s=self.options.period_s,
            positions=positions,
            velocities=plant.velocities,
            torques=plant.torques,
            pose=(*pose.position, *pose.orientation),
            wrench=(*wrench.force, *wrench.torque),
            reason=self.hold_reason,
        )

    def emergency_stop(self) -> None:
        """Brake and refuse commands until it is acknowledged."""
        self._stop("emergency stop")

    def acknowledge(self) -> None:
        """Clear a fault or an emergency stop, as an operator does."""
        self._stopped = ""
        self.plant.hold()

    def restart(self) -> None:
        """Power off and on: brakes, RESTART_SILENCE_S of silence, then a new session."""
        self.plant.give_in()
        self._off_until_s = self._time_s + RESTART_SILENCE_S
        self._has_client = False
        self.client = None
        self._stopped = self._refused = ""

    # -- inside ---------------------------------------------------------------------------------

    @property
    def _time_s(self) -> float:
        return self.plant.time_s + self._behind_s

    def _advance(self, now_s: float) -> None:
        """Advance the plant to `now_s`, with timed faults on the way."""
        if self._start_s is None:
            self._start_s = now_s
        until_s = now_s - self._start_s
        lost_s = until_s - self._time_s - _CATCH_UP_S
        if lost_s > 0.0:
            self._behind_s += lost_s
        plant = self.plant
        for due_s, action in self._timed.due(until_s):
            plant.advance(due_s - self._behind_s)
            action()
        plant.advance(until_s - self._behind_s)
        if self._off_until_s is not None and until_s >= self._off_until_s:
            self._off_until_s = None
            self.session = self.session + 1 & 0xFFFFFFFF
            self._sequence = 0
            self._newest = None

    def _jam_joint(self) -> None:
        self.plant.jammed = int(self.options.faults["jam"]) - 1

    def _extrapolate(self) -> None:
        """Continue at the commanded speeds where a command is missing."""
        period_s = self.options.period_s
        if self._taken == self._bridged[0]:
            # Only now is it certain that no command came in the period before.
            missing = 1 if self._bridged[1] else 2
            self.plant.go_on(missing * period_s)
        self._bridged = (self._taken, self._taken == self._bridged[0])

    def _watch(self, now_s: float) -> None:
        plant = self.plant
        if plant.mode is not DriveMode.HOLD and (
            now_s - self._command_s > self.options.command_timeout_s
        ):
            self._timeouts += 1
            plant.hold()
        error = plant.following_error
        if error > self.options.following_error_rad and not self._stopped:
            name = self.arm.joints[plant.worst_joint].name
            plant.give_in()
            self._stop(f"joint {name} did not follow: {error:.3g} from its reference")
        if self._stopped and self._time_s - self._stopped_s >= self.options.acknowledge_after_s:
            self.acknowledge()

    def _stop(self, reason: str) -> None:
        self._stopped, self._stopped_s = reason, self._time_s
        self.plant.hold()

    def _take(self, data: bytes) -> None:
        command = decode_command(data)
        if isinstance(command, MalformedDatagram):
            self._ignored[command.reason] += 1
            return
        if command.mode is ControlMode.HOLD and command.session == 0:
            # First contact: the sender counts from here.
            self._newest = None
        elif command.session != self.session:
            self._ignored["another session"] += 1
            return
        if self._newest is not None and not is_newer(command.sequence, self._newest):
            self._ignored["late or double"] += 1
            return
        self._newest = command.sequence
        if self._stopped:
            self._ignored[self._stopped] += 1
            return
        self._refused = self._refusal(command)
        if self._refused:
            self._ignored["refused"] += 1
            self.plant.hold()
            return
        assert self._start_s is not None
        self._command_s = self._start_s + self._time_s
        self._taken += 1
        self._obey(command)

    def _obey(self, command: ArmCommand) -> None:
        if command.mode is ControlMode.POSITION:
            self.plant.command_positions(command.values, command.feed_forward)
        elif command.mode is ControlMode.VELOCITY:
            self.plant.command_speeds(command.values)
        elif command.mode is ControlMode.TORQUE:
            self.plant.command_torques(command.values)
        else:
            self.plant.hold()

    def _refusal(self, command: ArmCommand) -> str:
        """Return why the controller refuses `command`; empty if it accepts it."""
        if command.mode is ControlMode.HOLD:
            return ""
        joints = self.plant.joints
        if len(command.values) != joints:
            return f"command for {len(command.values)} joints; the arm has {joints}"
        if command.mode is ControlMode.TORQUE:
            return "ideal drives have no torque mode" if self.plant.ideal else ""
        lower, upper, what = self._limits[command.mode]
        values = np.array(command.values)
        bad = (values < lower - _TOLERANCE) | (values > upper + _TOLERANCE)
        if bad.any():
            joint = int(np.argmax(bad))
            return (
                f"joint {self.arm.joints[joint].name} at {values[joint]:.4g} is {what}, "
                f"{lower[joint]:.4g} to {upper[joint]:.4g}"
            )
        return ""
