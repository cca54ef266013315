"""A simulated JR3 sensor with uc3m's mbed board, without I/O and in virtual time."""

from __future__ import annotations

import heapq
import math
import random
from collections import deque
from collections.abc import Callable, Mapping, Sequence

from cardan.sim_peers.base import check_faults, strikes
from cardan_jr3.peer.faults import FAULTS, POWER_OFF_S, TIMED_FAULTS
from cardan_jr3.protocol import (
    COUNTER_MODULUS,
    NODE_MASK,
    SAMPLE_PERIOD_S,
    Ack,
    BoardMessage,
    Bootup,
    CanFrame,
    Forces,
    FullScales,
    GetFsForces,
    GetFsMoments,
    GripperPwm,
    HostMessage,
    Moments,
    Opcode,
    Reset,
    SetFilter,
    Six,
    StartAsync,
    StartSync,
    State,
    Stop,
    Sync,
    ZeroOffs,
    decode_from_host,
    encode_from_board,
    to_counts,
)

NO_WRENCH: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

QUEUE_MESSAGES = 32
"""Most commands queued for the board's main loop; further ones are lost."""
LOOP_S = (0.001, 0.002)
"""Sleep of the main loop: 1 ms, which the board's system makes 1 to 2 ms."""
EEPROM_S = 0.3
"""Time for reading the sensor's calibration."""
BIT_RATE = 1_000_000
"""Bit rate of the bus, bit/s."""
WAITING_FRAMES = 32
"""Most frames queued while the bus is busy; further ones are lost."""


def frame_s(size: int) -> float:
    """Return the time that an 11-bit frame of `size` bytes occupies the bus at `BIT_RATE`: 47 bits
    of overhead with the pause after it, and the largest number of stuff bits. Source: ISO 11898-1.
    """
    return (47 + 8 * size + (33 + 8 * size) // 4) / BIT_RATE


SHORTEST_PERIOD_S = 2.0 * frame_s(8)
"""Shortest period of samples: a pair of frames occupies the bus for this time, even if a host
requests a shorter period."""


class SimulatedJr3:
    """Board with its sensor: its inputs are a wrench and frames, its output the frames of the real
    board.

    Power is switched on at time 0; times are s from then and move in `reports` only. Settings hold
    from the time of the last `reports` or `skip_to` on. The main loop takes commands every 1 to 2
    ms; a thread of its own sends samples in async mode. SYNC is a flag: two within one cycle of the
    loop give one answer. `offset` is an unzeroed sensor's reading without load (N, N·m).
    """

    def __init__(
        self,
        node_id: int,
        scales: FullScales,
        *,
        boot_s: float = 2.0,
        offset: Six = NO_WRENCH,
        noise_n: float = 0.0,
        noise_nm: float = 0.0,
        faults: Mapping[str, float] | None = None,
        seed: int = 0,
    ) -> None:
        self._faults = faults = dict(faults or {})
        check_faults(faults, FAULTS)
        self.node_id = node_id
        self.scales = scales
        self.wrench = NO_WRENCH
        """Wrench that acts on the sensor: N, N·m."""
        self.plugged = True
        """True: the node stays on its bus."""
        self.powered = True
        self.sensor_plugged = not faults.get("no-sensor")
        self.hung = False
        """True while the board neither sends nor receives, until power is cycled."""
        self.gripper_percent = 0.0
        self.ignored = 0
        """Number of frames for this node that the board does not know."""
        self.dropped = 0
        """Number of commands that found the queue full."""
        self.unsent = 0
        """Number of frames lost because the bus was too busy."""
        self.starts = 0
        """Number of times that acquisition was started."""
        self.on_first_start: Callable[[float], None] = lambda now_s: None
        """Callback with the time when acquisition is started for the first time."""
        self._boot_s = boot_s
        self._bias = offset
        self._noise = (noise_n,) * 3 + (noise_nm,) * 3
        self._drift_n_s = faults.get("drift", 0.0)
        self._random = random.Random(seed)
        self._now_s = 0.0
        self._under_way: list[tuple[float, int, CanFrame]] = []
        self._bus_free_s = 0.0
        self._sent = 0
        self._acks = 0
        self._pairs = 0
        self._timed: list[tuple[float, str]] = []
        self._after_start = sorted((faults[name], name) for name in TIMED_FAULTS if name in faults)
        self._power_back_s = math.inf
        self._power_up()

    # -- the world -----------------------------------------------------------------------------

    def set_wrench(self, wrench: Sequence[float]) -> None:
        """Load the sensor with six finite numbers: N, N·m."""
        if len(wrench) != 6 or not all(map(math.isfinite, wrench)):
            raise ValueError(f"a wrench is six finite numbers, not {wrench!r}")
        fx, fy, fz, mx, my, mz = wrench
        self.wrench = (fx, fy, fz, mx, my, mz)

    def power_off(self) -> None:
        """Cut the power: the board's settings are lost."""
        self.powered = False
        self._commands.clear()
        self._turn_s = self._boot_due_s = self._send_s = math.inf
        self._under_way.clear()

    def power_on(self) -> None:
        """Switch the power on (again)."""
        if not self.powered:
            self.powered = True
            self.hung = False
            self._power_up()

    def unplug_sensor(self) -> None:
        """Unplug the sensor: the board continues to send the last sample with its counter."""
        self._sample(self._now_s)
        self.sensor_plugged = False

    def plug_sensor(self) -> None:
        """Plug the sensor in again; samples continue. A board that never got ready needs a power
        cycle."""
        self._sample(self._now_s)
        self.sensor_plugged = not self._faults.get("no-sensor")

    def hang(self) -> None:
        """Hang the board: it neither sends nor receives until `recover`."""
        self.hung = True

    def recover(self) -> None:
        """Recover from a hang: the board continues."""
        self.hung = False

    # -- the bus -------------------------------------------------------------------------------

    def receive(self, arbitration_id: int, data: bytes, now_s: float) -> None:
        """Process a frame of another node on the bus at `now_s`."""
        mine = arbitration_id & NODE_MASK == self.node_id
        if not self.powered or self.hung or not (mine or arbitration_id == Opcode.SYNC):
            return
        message = decode_from_host(arbitration_id, data)
        if message is None:
            self.ignored += 1
            return
        if len(self._commands) == QUEUE_MESSAGES:
            self.dropped += 1
            return
        self._commands.append(message)
        if self._turn_s == math.inf:
            # The loop has been running; its phase matters only now.
            length_s = self._random.uniform(*LOOP_S)
            self._turn_s = max(now_s, self._blocked_until_s) + self._random.uniform(0.0, length_s)

    @property
    def next_due_s(self) -> float:
        """Return the time at which `reports` has work next; inf if nothing is planned."""
        return min(self._event_s, self._arrival_s)

    def reports(self, now_s: float) -> list[CanFrame]:
        """Return the frames that the board has sent by `now_s`, in order."""
        arrived: list[CanFrame] = []
        while (event_s := self._event_s) <= now_s:
            self._now_s = max(self._now_s, event_s)
            self._carry(self._now_s, arrived)
            self._act(self._now_s)
        self._now_s = max(self._now_s, now_s)
        self._sample(self._now_s)
        self._carry(now_s, arrived)
        return arrived

    def skip_to(self, now_s: float) -> None:
        """Skip the samples of the time before `now_s`, with an unchanged load."""
        self._sample(now_s)
        if self._send_s < now_s:
            self._send_s += math.ceil((now_s - self._send_s) / self._period_s) * self._period_s

    # -- inside: the board ---------------------------------------------------------------------

    def _power_up(self) -> None:
        self._commands: deque[HostMessage] = deque()
        self._sync = False
        self._ready = False
        self._acquiring = False
        self._period_s = math.inf
        self._send_s = math.inf
        self._turn_s = math.inf
        self._blocked_until_s = self._now_s
        self._boot_due_s = self._now_s + self._boot_s if self.sensor_plugged else math.inf
        self._alpha = 1.0
        self._offset = NO_WRENCH
        self._zeros_next = False
        self._reset_data()

    def _reset_data(self) -> None:
        self._counter = int(self._faults.get("counter", 0.0))
        self._filtered = NO_WRENCH
        self._sampled_s = self._now_s

    @property
    def _event_s(self) -> float:
        timed_s = self._timed[0][0] if self._timed else math.inf
        return min(timed_s, self._power_back_s, self._boot_due_s, self._send_s, self._turn_s)

    def _act(self, now_s: float) -> None:
        """Execute the first event that is due at `now_s`."""
        if self._timed and self._timed[0][0] <= now_s:
            self._have_fault(self._timed.pop(0)[1])
        elif self._power_back_s <= now_s:
            self._power_back_s = math.inf
            self.power_on()
        elif self._boot_due_s <= now_s:
            self._boot_due_s = math.inf
            self._ready = True
            self._emit(Bootup(), now_s)
        elif self._send_s <= now_s:
            self._send_s += self._period_s
            self._send_pair(now_s)
        else:
            self._turn(now_s)

    def _have_fault(self, name: str) -> None:
        if name == "sensor-unplug":
            self.unplug_sensor()
        elif name == "power-cycle":
            self.power_off()
            self._power_back_s = self._now_s + POWER_OFF_S
        elif name == "silence":
            self.hang()
        else:
            self._obey(Stop(), self._now_s)

    def _turn(self, now_s: float) -> None:
        """Run one cycle of the main loop: all queued commands, then one answer to SYNC."""
        self._turn_s = math.inf
        while self._commands:
            self._obey(self._commands.popleft(), now_s)
            if self._blocked_until_s > now_s:
                self._turn_s = self._blocked_until_s
                return
        if self._sync:
            self._sync = False
            self._send_pair(now_s)

    def _obey(self, message: HostMessage, now_s: float) -> None:
        if isinstance(message, Sync):
            self._sync = self._acquiring
            return
        if isinstance(message, GripperPwm):
            if math.isfinite(message.percent):
                self.gripper_percent = min(100.0, max(-100.0, message.percent))
            return
        scales = None
        if isinstance(message, (GetFsForces, GetFsMoments)):
            forces = isinstance(message, GetFsForces)
            scales = self.scales.forces_n if forces else self.scales.moments_dnm
            if not self._ready:  # whatever is in the board's memory
                a, b, c = (self._random.randrange(COUNTER_MODULUS) for _ in range(3))
                scales = (a, b, c)
        elif isinstance(message, Reset):
            self._ready = self._ready and self.sensor_plugged
            self._blocked_until_s = now_s + EEPROM_S if self.sensor_plugged else math.inf
            if not self.sensor_plugged:
                return
        elif self._ready:
            self._change(message, now_s)
        state = State.READY if self._ready else State.NOT_INITIALIZED
        self._acknowledge(int(self._faults.get("error-ack", state)), scales, now_s)

    def _change(self, message: HostMessage, now_s: float) -> None:
        """Apply a command on a board that is ready."""
        if isinstance(message, (StartSync, StartAsync)):
            self._start(message, now_s)
        elif isinstance(message, Stop):
            self._acquiring = False
            self._send_s = math.inf
            self._reset_data()
        elif isinstance(message, ZeroOffs):
            self._sample(now_s)
            self._offset = self._filtered
            self._zeros_next = True
        elif isinstance(message, SetFilter):
            self._sample(now_s)
            self._set_filter(message.cutoff_centihz)

    def _start(self, message: StartSync | StartAsync, now_s: float) -> None:
        self._sample(now_s)
        self._set_filter(message.cutoff_centihz)
        if not self._acquiring:
            self._sampled_s = now_s
        self._acquiring = True
        if isinstance(message, StartAsync):
            self._period_s = max(SHORTEST_PERIOD_S, message.period_us * 1e-6)
            self._send_s = now_s + self._period_s
        else:
            self._send_s = math.inf
        if not self.starts:
            self.on_first_start(now_s)
            self._timed = [(now_s + after_s, name) for after_s, name in self._after_start]
        self.starts += 1

    def _set_filter(self, cutoff_centihz: int) -> None:
        if cutoff_centihz:
            time_constant_s = 100.0 / (math.tau * cutoff_centihz)
            self._alpha = SAMPLE_PERIOD_S / (SAMPLE_PERIOD_S + time_constant_s)
        else:
            self._alpha = 1.0

    # -- inside: the sensor --------------------------------------------------------------------

    def _sample(self, now_s: float) -> None:
        """Take the samples due until `now_s`, all under the present load."""
        if not self._acquiring:
            return
        count = int((now_s - self._sampled_s) / SAMPLE_PERIOD_S)
        if count <= 0:
            return
        self._sampled_s += count * SAMPLE_PERIOD_S
        if not self.sensor_plugged:
            return
        self._counter = (self._counter + count) % COUNTER_MODULUS
        retained = (1.0 - self._alpha) ** count
        # White noise of every sample, after `count` steps of the filter.
        passed = self._alpha * math.sqrt((1.0 - retained**2) / (1.0 - (1.0 - self._alpha) ** 2))
        wander = self._drift_n_s * now_s
        a, b, c, d, e, f = (
            (load + bias + (wander if index < 3 else 0.0)) * (1.0 - retained)
            + old * retained
            + (self._random.gauss(0.0, noise * passed) if noise else 0.0)
            for index, (load, bias, old, noise) in enumerate(
                zip(self.wrench, self._bias, self._filtered, self._noise, strict=True)
            )
        )
        self._filtered = (a, b, c, d, e, f)

    def _send_pair(self, now_s: float) -> None:
        self._sample(now_s)
        self._pairs += 1
        counts = (0,) * 6
        if not self._zeros_next:
            a, b, c, d, e, f = (
                value - zero for value, zero in zip(self._filtered, self._offset, strict=True)
            )
            counts = to_counts((a, b, c, d, e, f), self.scales)
        self._zeros_next = False
        forces = Forces(*counts[:3], self._counter)
        counter = self._counter
        if self._strikes("wrong-counter", self._pairs):
            counter = (counter + 1) % COUNTER_MODULUS
        moments = Moments(*counts[3:], counter)
        if self._strikes("unknown-frame", self._pairs):
            junk = self._random.randbytes(self._random.randrange(9))
            self._push(CanFrame(Opcode.BOOTUP + self.node_id, b"\0" + junk[:7]), now_s)
        if self._strikes("short-frame", self._pairs):
            whole = encode_from_board(forces, self.node_id)
            self._push(whole._replace(data=whole.data[: self._random.randrange(8)]), now_s)
        else:
            self._emit(forces, now_s)
        if not self._strikes("lost-moments", self._pairs):
            self._emit(moments, now_s)
        if self._strikes("duplicate", self._pairs):
            self._emit(forces, now_s)
            self._emit(moments, now_s)

    # -- inside: the wire ----------------------------------------------------------------------

    def _acknowledge(self, state: int, scales: tuple[int, int, int] | None, now_s: float) -> None:
        self._acks += 1
        if not self._strikes("lost-ack", self._acks):
            sent_s = max(now_s, self._blocked_until_s) + 1e-3 * self._faults.get("late-ack", 0.0)
            self._emit(Ack(state, scales), sent_s)

    def _emit(self, message: BoardMessage, sent_s: float) -> None:
        self._push(encode_from_board(message, self.node_id), sent_s)

    def _push(self, frame: CanFrame, sent_s: float) -> None:
        if self.hung or self._random.random() < self._faults.get("lost", 0.0):
            return
        if len(self._under_way) >= WAITING_FRAMES:
            self.unsent += 1
            return
        self._sent += 1
        heapq.heappush(self._under_way, (sent_s, self._sent, frame))

    @property
    def _arrival_s(self) -> float:
        """Return the time at which the next frame has passed the bus; inf: there is none."""
        if not self._under_way:
            return math.inf
        sent_s, _, frame = self._under_way[0]
        return max(sent_s, self._bus_free_s) + frame_s(len(frame.data))

    def _carry(self, now_s: float, arrived: list[CanFrame]) -> None:
        """Add the frames that have passed the bus by `now_s` to `arrived`."""
        while (arrival_s := self._arrival_s) <= now_s:
            self._bus_free_s = arrival_s
            arrived.append(heapq.heappop(self._under_way)[2])

    def _strikes(self, fault: str, count: int) -> bool:
        return strikes(self._faults, fault, count)
