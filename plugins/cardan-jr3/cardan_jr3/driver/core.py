"""Core of the JR3 driver: received frames to device state and requests; no I/O, time is an
argument.

The board is started by requests, one at a time, since an acknowledgment does not name its request:
ping, start, full scales; then, once the filter has settled and the force is steady, zero. A board
that reports a boot, or is silent for `RESTART_AFTER_S`, is started again from the ping.

A sensor sends continuously, so silence never means rest: after `STALE_AFTER_S` without a new sample
the axes are zero and there is no wrench. A sample is new if its counter has advanced: a board whose
sensor is unplugged repeats the last one forever. After opening, a silence, an overload or a zeroing
the axes stay zero (NEEDS_NEUTRAL) until the wrench was inside the dead bands for `REST_S`.

Zero is taken automatically once, when the sensor is opened. A board that boots later has lost its
zero, and the force of a hand still on it must not become the new zero: its samples count again
after `ask_zero`. A report of a boot may be lost, so a board that needs the start command again
counts as booted, unless it sends before that, with a counter that has advanced with time.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import ClassVar, NamedTuple

from cardan.drivers.core import DeviceCore
from cardan.errors import CommandError
from cardan.spatial import add, from_euler_zyx, rotate
from cardan.types import (
    NEUTRAL,
    NEVER_S,
    Axes,
    DeviceLink,
    Frame,
    Vector3,
    Wrench,
)
from cardan_jr3.driver.options import Jr3Options
from cardan_jr3.protocol import (
    COUNTER_MODULUS,
    FULL_SCALE_COUNTS,
    NODE_MASK,
    SAMPLE_PERIOD_S,
    Ack,
    Bootup,
    CanFrame,
    Forces,
    GetFsForces,
    GetFsMoments,
    GetState,
    HostMessage,
    Moments,
    Opcode,
    Six,
    StartAsync,
    StartSync,
    State,
    Stop,
    Sync,
    ZeroOffs,
    centihertz,
    decode_from_board,
    encode_from_host,
    samples_between,
)

Raw = tuple[int, int, int, int, int, int]
COMPONENTS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")

STALE_AFTER_S = 0.09
"""Time without a new sample after which no measurement is valid. The limit is 0.1 s; the difference
is for one cycle of the reader."""

REST_S = 0.1
"""Time for which the wrench must be inside the dead bands to count as rest: after zeroing, a board
sends one sample of zeros whatever it measures."""

ACK_TIMEOUT_S = 0.25
"""Time after which a request counts as lost; a board answers within 2 ms."""

TRIES = 3
"""Number of times a request is sent before the start-up begins again from the ping."""

RETRY_FIRST_S, RETRY_LAST_S = 0.25, 2.0
"""Pause before a request is sent again, doubled for each ping. A late acknowledgment then arrives
before the next request and is not mistaken for its answer."""

RESTART_AFTER_S = 1.0
"""Silence after which a board that should send is started again."""

SETTLE_S, SETTLE_TIME_CONSTANTS = 0.1, 5.0
"""Settling time of the board's filter after the start."""

STEADY_WINDOW_S = 0.25
"""Window in which the force must be steady before zero is taken."""

LOOK_AGAIN_S = 0.05
"""Time to the next check after one that found the force changing."""

CLOCK_TOLERANCE = 0.02
"""Share by which the board's clock may be slower than `SAMPLE_PERIOD_S`."""

RESTART_CHECK_S = 0.1
"""Time for which a board that answers again is observed before the start command: if it goes on
sending, it has not booted. More than two of the longest periods."""

_COUNTER_TURN_S = COUNTER_MODULUS * SAMPLE_PERIOD_S
"""Time after which the sample counter wraps."""

WIRING_ADVICE = "check the power of the sensor's board, its node id, bit rate and cables"
OPENED_REASON = "starting the sensor"
REST_REASON = "not seen at rest yet: take the hand off the sensor"
RESUMED_REASON = "the sensor fell silent: take the hand off it"
BOOTED_REASON = "the sensor's board came up"
ZERO_LOST_REASON = (
    "the sensor's board restarted, or may have, so zero is lost: take the hand off, then start "
    "the session again or zero()"
)
ZEROING_REASON = "taking zero: keep the hand off the sensor"


class _Step(NamedTuple):
    """Request of the start-up."""

    message: HostMessage
    name: str
    scales: bool = False
    """True if its acknowledgment has full scales."""


_PING = _Step(GetState(), "ping")
_ZERO = _Step(ZeroOffs(), "zero")


class _HeldSteady:
    """Detector of a steady wrench, component by component."""

    def __init__(self, limits: Six) -> None:
        self._limits = limits
        """Change of each component over the window that still counts as steady."""
        self._window: deque[tuple[float, Six]] = deque()
        self.overloaded = False

    def clear(self, overloaded: bool = False) -> None:
        """Forget all values. `overloaded`: report an overload until the next value."""
        self._window.clear()
        self.overloaded = overloaded

    def add(self, stamp_s: float, values: Six) -> None:
        """Process the wrench of a sample."""
        self.overloaded = False
        window = self._window
        window.append((stamp_s, values))
        # A sample from before the window's start is kept: it shows that the window is full.
        while len(window) > 2 and window[1][0] <= stamp_s - STEADY_WINDOW_S:
            window.popleft()

    @property
    def full(self) -> bool:
        """True if the samples cover the whole window."""
        window = self._window
        return bool(window) and window[-1][0] - window[0][0] >= STEADY_WINDOW_S

    def fastest(self) -> tuple[int, float]:
        """Return the component with the fastest change by its limit, and its rate over the window,
        per s."""
        columns = zip(*(values for _, values in self._window), strict=True)
        spans = [max(column) - min(column) for column in columns]
        worst = max(range(6), key=lambda index: spans[index] / self._limits[index])
        return worst, spans[worst] / STEADY_WINDOW_S

    def obstacle(self) -> str:
        """Return why zero must not be taken now; empty: it may."""
        if not self.full:
            return f"the force has not been watched for {STEADY_WINDOW_S:g} s yet"
        index, rate = self.fastest()
        if rate * STEADY_WINDOW_S <= self._limits[index]:
            return ""
        unit = "N/s" if index < 3 else "N·m/s"
        allowed = self._limits[index] / STEADY_WINDOW_S
        return f"{COMPONENTS[index]} changes by {rate:.1f} {unit}, more than {allowed:g}"


class Jr3Core(DeviceCore):
    """State of one sensor. Times are monotonic, s. `poll` returns the frames to send now,
    `next_due_s` the time of the next call; pass every received frame to `on_frame`.
    """

    _counters: ClassVar[Mapping[str, str]] = {
        "boots": "boots of the sensor's board",
        "timeouts": "requests without an answer",
        "refusals": "requests answered with an error",
        "unexpected_acks": "acknowledgments that were not expected",
        "lost_samples": "samples lost (by the counter)",
        "unpaired_samples": "forces without their moments, or moments without their forces",
        "repeated_samples": "samples that repeat the one before",
        "late_samples": f"samples older than {STALE_AFTER_S:g} s when they came",
        "overloads": "samples beyond full scale",
        "silences": f"silences of more than {STALE_AFTER_S:g} s",
        "foreign_frames": "frames that are not data frames with an eleven-bit identifier",
        "garbled_frames": "frames that the CAN interface could not read",
        "bus_errors": "error frames: check termination, bit rate and cable",
    }

    def __init__(self, options: Jr3Options) -> None:
        super().__init__()
        self._options = options
        self._answered = False
        self._not_before_s = NEVER_S
        self._retry_s = RETRY_FIRST_S
        self._started_s = NEVER_S
        self._has_run = False
        """True after the sensor ran since it was opened on request: zero is not taken automatically
        any more, since a hand may be on a sensor that just came back."""
        self._zero_lost = False
        self._continuous = False
        """True if the board was seen to continue since it was last started."""
        self._zeros = 0
        self._forces_n: tuple[int, int, int] | None = None
        """Full scales."""
        self._torques_nm: tuple[float, float, float] | None = None
        self._newest_counter: int | None = None
        self._newest_s = NEVER_S
        """Counter of the newest sample since opening on request, and its time."""
        self._counter_time_s = 0.0
        self._rest_since_s = math.inf
        self._measured: Six = NEUTRAL
        """N and N·m at the sensor's origin, along its axes, right-handed and filtered."""
        self._acting: Wrench | None = None
        """`_measured` at the TCP; None: not computed yet."""
        self._per_count: Six | None = None
        """Force and torque per count, N and N·m; None: the full scales are not known yet."""
        steady_n, steady_nm = options.steady_n_s, options.steady_nm_s
        self._steady = _HeldSteady(
            tuple(  # type: ignore[arg-type]
                rate * STEADY_WINDOW_S for rate in (*(steady_n,) * 3, *(steady_nm,) * 3)
            )
        )
        roll, pitch, yaw = map(math.radians, options.sensor_rpy_deg)
        self._turn = from_euler_zyx(roll, pitch, yaw)
        self._turned = any(options.sensor_rpy_deg)
        self._lever = Vector3(*options.sensor_xyz_m)
        self._levered = any(options.sensor_xyz_m)
        self._host_tau_s = (
            1.0 / (math.tau * options.host_cutoff_hz) if options.host_cutoff_hz else 0.0
        )
        self._halt()

    def _halt(self) -> None:
        """Discard pending requests and all measurements."""
        # Start-up.
        self._plan: tuple[_Step, ...] = ()
        self._done = self._tries = 0
        self._asked: _Step | None = None
        self._deadline_s = self._sync_s = math.inf
        self._sampling = False
        """True after the board has acknowledged the command to send."""
        self._running = False
        """True after the start-up, including zeroing if requested."""
        # Samples.
        self._sample_valid = False
        """True while the last sample is valid."""
        self._forces: Forces | None = None
        self._counter: int | None = None
        self._least_offset_s = math.inf
        self._stands_since_s = math.inf
        """Time since which the counter has not advanced."""
        self._filter_stamp_s = NEVER_S
        self._steady.clear()
        self._cached = None

    # -- events ------------------------------------------------------------

    def on_opened(self, now_s: float) -> None:
        """Discard what is known of the sensor: its bus was opened (again)."""
        self._answered = False
        self._retry_s = RETRY_FIRST_S
        self._bring_up(now_s)
        self._begin(OPENED_REASON, now_s)

    def on_closed(self, now_s: float) -> None:
        """Process the closing of the sensor on request."""
        super().on_closed(now_s)
        self._has_run = self._zero_lost = False
        self._newest_counter = None

    def on_frame(self, arbitration_id: int, data: bytes, now_s: float) -> None:
        """Process a data frame with an 11-bit identifier, received at `now_s`. Never raises."""
        if not self._open or arbitration_id & NODE_MASK != self._options.node_id:
            return
        value = decode_from_board(arbitration_id, data)
        if value is None:
            return
        if isinstance(value, Forces):
            if self._forces is not None:
                self._counts["unpaired_samples"] += 1
            self._forces = value
        elif isinstance(value, Moments):
            forces, self._forces = self._forces, None
            if forces is None or forces.counter != value.counter:
                self._counts["unpaired_samples"] += 1
            elif self._sampling:
                self._on_sample(forces, value, now_s)
            elif self._newest_counter is not None:
                self._on_unasked_sample(value.counter, self._newest_counter, now_s)
        elif isinstance(value, Ack):
            self._on_ack(value, now_s)
        elif isinstance(value, Bootup):
            self._on_bootup(now_s)
        else:
            self._malformed[f"{Opcode(value.opcode).name} frames {value.reason}"] += 1

    def on_unusable(self, kind: str) -> None:
        """Count a frame of another kind: "foreign_frames", "garbled_frames", "bus_errors"."""
        self._counts[kind] += 1

    # -- what to send --------------------------------------------------------------------------

    @property
    def next_due_s(self) -> float:
        """Return the time at which `poll` has work next; inf if only a frame can cause that."""
        if not self._open:
            return math.inf
        due_s = self._sync_s
        if self._asked is not None:
            return min(due_s, self._deadline_s)
        if self._done < len(self._plan):
            due_s = min(due_s, self._not_before_s)
        return min(due_s, self._silent_s + RESTART_AFTER_S)

    def poll(self, now_s: float) -> list[CanFrame]:
        """Return the frames to send at `now_s`, in this order."""
        if not self._open:
            return []
        frames: list[CanFrame] = []
        if self._asked is not None:
            if now_s >= self._deadline_s:
                self._on_no_answer(self._asked, now_s)
        elif now_s - self._silent_s >= RESTART_AFTER_S:
            self._invalidate_input(DeviceLink.STALE, self._silence(), now_s)
            self._bring_up(now_s)
        if self._asked is None and self._done < len(self._plan) and now_s >= self._not_before_s:
            step = self._plan[self._done]
            if step is not _ZERO or self._may_zero(now_s):
                if isinstance(step.message, (StartAsync, StartSync)):
                    # From here on a board that has booted sends again.
                    self._zero_lost |= self._has_run and not self._continuous
                self._asked = step
                self._deadline_s = now_s + ACK_TIMEOUT_S
                frames.append(encode_from_host(step.message, self._options.node_id))
        if now_s >= self._sync_s:
            # A late SYNC is skipped: its sample would only repeat the next one.
            period_s = self._options.period_s
            self._sync_s += (1 + int((now_s - self._sync_s) / period_s)) * period_s
            frames.append(_SYNC)
        return frames

    def final_command(self) -> list[CanFrame]:
        """Return the frames to send before an orderly close of the bus."""
        return [encode_from_host(Stop(), self._options.node_id)] if self._answered else []

    def ask_zero(self, now_s: float) -> int:
        """Request to take the present measurement as zero; done when `zeros` reaches the result.
        Raises CommandError, and requests nothing, while the force changes or nothing is measured.
        """
        self._watch(now_s)
        if not (self._running and self._sample_valid):
            raise CommandError(f"cannot take zero: {self._reason or 'the sensor is not running'}")
        if obstacle := self._steady.obstacle():
            raise CommandError(f"cannot take zero: {obstacle}; take the hand off the sensor")
        self._running = False
        self._plan, self._done = (_ZERO,), 0
        self._asked, self._not_before_s = None, now_s
        self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, ZEROING_REASON, now_s)
        return self._zeros + 1

    # -- what it says --------------------------------------------------------------------------

    @property
    def answered(self) -> bool:
        """True if the board has answered, or reported a boot, since the bus was opened."""
        return self._answered

    @property
    def watching(self) -> bool:
        """True if the force must be observed longer before zero can be requested."""
        return self._running and self._sample_valid and not self._steady.full

    @property
    def zeros(self) -> int:
        """Return the number of times that zero was taken."""
        return self._zeros

    def _figures(self, now_s: float) -> dict[str, float]:
        return {
            "sample_age_s": now_s - self._stamp_s,
            "malformed_frames": self._malformed.total(),
        }

    # -- start-up ----------------------------------------------------------------------------

    def _bring_up(self, now_s: float) -> None:
        """Begin with the ping, immediately."""
        options = self._options
        cutoff = centihertz(options.cutoff_hz)
        start: HostMessage
        if options.mode == "async":
            start = StartAsync(cutoff, round(options.period_s * 1e6))
        else:
            start = StartSync(cutoff)
        plan = [_PING, _Step(start, "start")]
        if options.force_full_scales_n is None:
            plan.append(_Step(GetFsForces(), "query of the forces' full scales", True))
        if options.torque_full_scales_nm is None:
            plan.append(_Step(GetFsMoments(), "query of the moments' full scales", True))
        if options.zero_on_open and not self._has_run:
            plan.append(_ZERO)
        self._halt()
        self._continuous = False
        self._plan = tuple(plan)
        self._not_before_s = now_s
        self._forces_n = options.force_full_scales_n
        self._torques_nm = options.torque_full_scales_nm
        self._set_per_count()

    def _fail(self, why: str, now_s: float) -> None:
        """Go back to the ping, after a pause."""
        pause_s = self._retry_s
        self._retry_s = min(2.0 * self._retry_s, RETRY_LAST_S)
        self._bring_up(now_s + pause_s)
        self._invalidate_input(DeviceLink.LOST, why, now_s)

    def _on_no_answer(self, step: _Step, now_s: float) -> None:
        self._counts["timeouts"] += 1
        self._tries += 1
        if step is not _PING and self._tries < TRIES:
            self._asked, self._deadline_s = None, math.inf
            self._not_before_s = now_s + RETRY_FIRST_S
        else:
            node_id = self._options.node_id
            self._fail(f"node {node_id} does not answer its {step.name}: {WIRING_ADVICE}", now_s)

    def _on_ack(self, ack: Ack, now_s: float) -> None:
        step = self._asked
        if step is None or (ack.full_scales is not None) is not step.scales:
            self._counts["unexpected_acks"] += 1
            return
        self._asked, self._deadline_s = None, math.inf
        self._answered = True
        self._tries = 0
        if ack.state != State.READY:
            self._counts["refusals"] += 1
            self._fail(
                "the board has not read the sensor's calibration: check the sensor's cable"
                if ack.state == State.NOT_INITIALIZED
                else f"the board answers its {step.name} with error {ack.state}",
                now_s,
            )
            return
        if step.scales and not self._take_scales(step, ack):
            self._counts["refusals"] += 1
            self._fail(f"the board gives full scales of {ack.full_scales}", now_s)
            return
        self._done += 1
        if step is _PING:
            self._retry_s = RETRY_FIRST_S
            if self._link is DeviceLink.LOST:
                self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, OPENED_REASON, now_s)
            if self._has_run and not (self._zero_lost or self._continuous):
                self._not_before_s = now_s + RESTART_CHECK_S
                if self._options.mode == "sync" and self._options.send_sync:
                    self._sync_s = now_s
        elif isinstance(step.message, (StartAsync, StartSync)):
            self._start(now_s)
        elif step is _ZERO:
            self._zeros += 1
            self._zero_lost = False
            self._steady.clear()
            self._filter_stamp_s = NEVER_S
        if self._done < len(self._plan):
            if self._plan[self._done] is _ZERO:
                self._not_before_s = self._started_s + self._settle_s()
        else:
            self._run(now_s)

    def _take_scales(self, step: _Step, ack: Ack) -> bool:
        given = ack.full_scales
        if given is None or not all(given):
            return False
        if isinstance(step.message, GetFsForces):
            self._forces_n = given
        else:
            x, y, z = given
            self._torques_nm = (0.1 * x, 0.1 * y, 0.1 * z)
        self._set_per_count()
        return True

    def _set_per_count(self) -> None:
        if self._forces_n is None or self._torques_nm is None:
            self._per_count = None
            return
        a, b, c, d, e, f = (
            scale / FULL_SCALE_COUNTS for scale in (*self._forces_n, *self._torques_nm)
        )
        self._per_count = (-a, b, c, -d, e, f) if self._options.left_handed else (a, b, c, d, e, f)

    def _start(self, now_s: float) -> None:
        self._sampling = True
        self._started_s = now_s
        if self._options.mode == "sync" and self._options.send_sync:
            self._sync_s = now_s

    def _run(self, now_s: float) -> None:
        self._running = True
        if self._link is DeviceLink.NEEDS_NEUTRAL:
            zeroed = self._plan[-1] is _ZERO or not self._has_run
            reason = REST_REASON if zeroed else RESUMED_REASON
            self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, reason, now_s)
        self._has_run = True

    def _settle_s(self) -> float:
        cutoff_hz = self._options.cutoff_hz
        slow_s = SETTLE_TIME_CONSTANTS / (math.tau * cutoff_hz) if cutoff_hz else 0.0
        return max(SETTLE_S, slow_s)

    def _may_zero(self, now_s: float) -> bool:
        """Check if zero may be taken now; if not, report why and schedule the next check."""
        obstacle = self._steady.obstacle()
        self._not_before_s = now_s + LOOK_AGAIN_S
        if self._sample_valid and not self._steady.overloaded:
            moves = obstacle and self._steady.full
            self._reason = f"{ZEROING_REASON} ({obstacle})" if moves else ZEROING_REASON
            self._cached = None
        return not obstacle

    def _on_bootup(self, now_s: float) -> None:
        self._counts["boots"] += 1
        self._answered = True
        self._zero_lost = self._has_run
        self._retry_s = RETRY_FIRST_S
        self._bring_up(now_s)
        self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, BOOTED_REASON, now_s)

    # -- samples -------------------------------------------------------------------------------

    def _on_sample(self, forces: Forces, moments: Moments, now_s: float) -> None:
        self._watch(now_s)
        stamp_s = self._stamp_of(forces.counter, now_s)
        if stamp_s is None:
            return
        self._heard = self._sample_valid = True
        self._stamp_s = stamp_s
        self._cached = None
        if self._link is DeviceLink.STALE:
            self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, RESUMED_REASON, now_s)
        per_count = self._per_count
        if per_count is None:
            return
        raw = (forces.x, forces.y, forces.z, moments.x, moments.y, moments.z)
        self._measure(raw, per_count, stamp_s)
        if max(raw) > FULL_SCALE_COUNTS or min(raw) < -FULL_SCALE_COUNTS:
            self._counts["overloads"] += 1
            self._steady.clear(overloaded=True)
            self._invalidate_input(DeviceLink.NEEDS_NEUTRAL, _overload(raw), now_s)
            return
        self._steady.add(stamp_s, self._measured)
        if not self._running or self._zero_lost or self._link is not DeviceLink.NEEDS_NEUTRAL:
            return
        if any(self._deflections()):
            self._rest_since_s = math.inf
        elif self._rest_since_s > stamp_s:
            self._rest_since_s = stamp_s
        elif stamp_s - self._rest_since_s >= REST_S:
            self._link, self._reason = DeviceLink.LIVE, ""

    def _on_unasked_sample(self, counter: int, before: int, now_s: float) -> None:
        """Check if a sample that came before the start command continues those before. The board of
        an unplugged sensor repeats the last sample: it has not booted, either."""
        passed_s = now_s - self._newest_s
        counted_s = samples_between(counter, before) * SAMPLE_PERIOD_S
        allowed_s = STALE_AFTER_S + CLOCK_TOLERANCE * passed_s
        off_s = math.remainder(counted_s - passed_s, _COUNTER_TURN_S)
        if counter != before and (abs(off_s) > allowed_s or allowed_s > 0.125 * _COUNTER_TURN_S):
            return
        self._newest_counter, self._newest_s = counter, now_s
        if self._continuous:
            return
        self._continuous = True
        if self._done == 1 and self._asked is None:
            self._not_before_s = min(self._not_before_s, now_s)

    def _watch(self, now_s: float) -> None:
        """Check for silence."""
        if self._sample_valid and now_s - self._stamp_s > STALE_AFTER_S:
            self._sample_valid = False
            self._steady.clear()
            self._fall_silent(self._silence(), now_s)

    def _stamp_of(self, counter: int, now_s: float) -> float | None:
        """Return the latest time at which a sample received at `now_s` can have been taken; None:
        unusable."""
        before = self._counter
        if before is None:
            steps = 0
        else:
            steps = samples_between(counter, before)
            if steps == 0:
                self._counts["repeated_samples"] += 1
                self._stands_since_s = min(self._stands_since_s, now_s)
                if now_s - self._stands_since_s > 0.5 * STALE_AFTER_S:
                    # The sensor is unplugged: once it is back, the counter lags behind for good.
                    self._least_offset_s = math.inf
                return None
            between = steps * SAMPLE_PERIOD_S
            self._counts["lost_samples"] += max(0, round(between / self._options.period_s) - 1)
            self._counter_time_s += between
            # Offset of the board's clock, from the sample with the least delay.
            self._least_offset_s += CLOCK_TOLERANCE * between
        self._counter = counter
        self._stands_since_s = math.inf
        offset_s = now_s - self._counter_time_s
        self._least_offset_s = min(self._least_offset_s, offset_s)
        late_s = offset_s - self._least_offset_s
        self._newest_counter, self._newest_s = counter, now_s - late_s
        if late_s > STALE_AFTER_S:
            self._counts["late_samples"] += 1
            return None
        return now_s - late_s

    def _measure(self, raw: Raw, per_count: Six, stamp_s: float) -> None:
        a, b, c, d, e, f = per_count
        values = (raw[0] * a, raw[1] * b, raw[2] * c, raw[3] * d, raw[4] * e, raw[5] * f)
        before_s, self._filter_stamp_s = self._filter_stamp_s, stamp_s
        if self._host_tau_s and before_s != NEVER_S:
            step_s = max(0.0, stamp_s - before_s)
            share = step_s / (step_s + self._host_tau_s)
            values = tuple(  # type: ignore[assignment]
                old + share * (new - old) for old, new in zip(self._measured, values, strict=True)
            )
        self._measured = values
        self._acting = None

    def _wrench(self) -> Wrench | None:
        known = self._running and self._sample_valid and not self._zero_lost
        return self._at_tcp() if known else None

    def _at_tcp(self) -> Wrench:
        if self._acting is not None:
            return self._acting
        fx, fy, fz, mx, my, mz = self._measured
        force, torque = Vector3(fx, fy, fz), Vector3(mx, my, mz)
        if self._turned:
            force, torque = rotate(self._turn, force), rotate(self._turn, torque)
        if self._levered:
            (x, y, z), (fx, fy, fz) = self._lever, force
            torque = add(torque, Vector3(y * fz - z * fy, z * fx - x * fz, x * fy - y * fx))
        self._acting = Wrench(force, torque, Frame.TOOL)
        return self._acting

    def _axes(self, now_s: float) -> Axes:
        return NEUTRAL if self._wrench() is None else self._deflections()

    def _deflections(self) -> Axes:
        options = self._options
        (fx, fy, fz), (mx, my, mz), _ = self._at_tcp()
        band, full = options.force_dead_band_n, options.force_full_n
        turn_band, turn_full = options.torque_dead_band_nm, options.torque_full_nm
        return Axes(
            _deflection(fx, band, full),
            _deflection(fy, band, full),
            _deflection(fz, band, full),
            _deflection(mx, turn_band, turn_full),
            _deflection(my, turn_band, turn_full),
            _deflection(mz, turn_band, turn_full),
        )

    # -- inside --------------------------------------------------------------------------------

    @property
    def _silent_s(self) -> float:
        """Return the time since which an expected sample is missing; inf: none is due."""
        return max(self._stamp_s, self._started_s) if self._sampling else math.inf

    def _silence(self) -> str:
        """Return why there are no new samples, as far as that is known."""
        if self._options.mode == "sync" and not self._options.send_sync and not self._heard:
            return "no samples: no master on the bus sends SYNC; start it, or set send_sync"
        return f"no new sample for {STALE_AFTER_S:g} s: {WIRING_ADVICE}"

    def _end(self, link: DeviceLink, reason: str, now_s: float) -> None:
        self._halt()
        super()._end(link, reason, now_s)

    def _invalidate_input(self, link: DeviceLink, reason: str, now_s: float) -> None:
        if link is DeviceLink.NEEDS_NEUTRAL and self._zero_lost:
            reason = ZERO_LOST_REASON
        super()._invalidate_input(link, reason, now_s)

    def _drop_input(self, now_s: float) -> None:
        self._rest_since_s = math.inf


_SYNC = encode_from_host(Sync(), 0)


def _deflection(value: float, band: float, full: float) -> float:
    """Return `value` beyond the dead band as a share of a full deflection, -1..1."""
    if value > band:
        return min(1.0, (value - band) / full)
    if value < -band:
        return max(-1.0, (value + band) / full)
    return 0.0


def _overload(raw: Raw) -> str:
    worst = max(range(6), key=lambda index: abs(raw[index]))
    percent = 100.0 * abs(raw[worst]) / FULL_SCALE_COUNTS
    return f"overloaded: {COMPONENTS[worst]} is at {percent:.0f} % of full scale; let go"
