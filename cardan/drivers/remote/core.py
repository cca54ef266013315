"""Interpreter of a shared device's messages, without any I/O and in the caller's time.

A state counts by its age, not by its arrival. Each claim has its local time of sending, and the
first state that echoes it gives the remote clock: a time between claim and echo, by the quickest
recent round trip. A state's age follows from its stamp; whatever the stamp, it is as old as the
newest claim that it echoes, less the transit time of a claim.

- No state that is young enough: STALE. The sharer has left, or another session has the device:
  LOST. Then deflections are zero, buttons released, and the device counts again from rest.
- States that are too old are dropped. Their edges are repeated with newer states until they are
  acknowledged; a press that is too old by then does not count until its release.
- Motion may wait for a bounded time, to be shown with its original timing (`playout_ms`). Button
  edges, rest, and the end of the link do not wait, and discard waiting motion.
- Of two computers that share under one name, the first one heard counts, while it sends.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import ClassVar

from cardan.common.clocks import SLACK_S, RemoteClock
from cardan.common.haptics import HapticCommand
from cardan.drivers.remote.options import RemoteOptions
from cardan.drivers.remote.playout import MotionSample, Playout
from cardan.drivers.remote.shared import (
    CLAIM_PERIOD_S,
    FORCE_PERIOD_S,
    STATE_TYPE,
    Claim,
    HapticFeedback,
    RemoteHapticCommand,
    Shared,
    SharedDecoder,
    UnusableError,
)
from cardan.drivers.ros2_nodes import BusCore
from cardan.protocols.ros2.cdr import MalformedCdr
from cardan.types import (
    NEUTRAL,
    NEVER_S,
    Axes,
    DeviceCapabilities,
    DeviceFeedback,
    DeviceLink,
    DeviceState,
    Inertia,
    Pose,
    Wrench,
)

MAX_ROUNDS = 1000
"""Number of remembered round trips, of half a minute."""

MAX_ECHOES = 64
"""Most claims, of two seconds, that an echo may still refer to: slower round trips tell nothing."""

MAX_SEQUENCES = 1000
"""States over which the loss ratio is computed: 4 to 20 s."""

UNKNOWN = DeviceCapabilities(gives_pose=True, buttons=(), feedback=frozenset(), battery=False)
"""Capabilities before the first state: all that a mapping may use."""

_LINKS = {DeviceLink.CLOSED: DeviceLink.LOST, DeviceLink.STALE: DeviceLink.LOST}
"""Remote link states that count as another one here: STALE means that no state is young enough."""

ANEW = "`cardan devices share` was restarted on the operator's computer"
LET_GO = "it was lost, or its states were too old: let go of the device once"


class RemoteCore(BusCore):
    """The state of a device on another computer."""

    message_type = STATE_TYPE

    _counters: ClassVar[Mapping[str, str]] = {
        "silences": "times that no state was recent enough",
        "late": "duplicate or late states, ignored",
        "old": "states that the network delayed too much, ignored",
        "back": "states whose stamp went back, ignored",
        "future": "states with a stamp in the future, ignored",
        "old_presses": "presses that were too old, ignored until released",
        "missed_edges": "edges of buttons that came too often to be reported",
        "others": "states of a second computer that shares under the same name, ignored: end one "
        "of the two",
    }

    def __init__(self, options: RemoteOptions, lessee: int, name: str) -> None:
        """Set `lessee`, a unique number other than 0, and `name`, its name for others."""
        super().__init__()
        self._options = options
        self._lessee, self._name = lessee, name
        self._decoder = SharedDecoder()
        self._run = 0
        self._asked: deque[float] = deque(maxlen=MAX_ECHOES)
        self._claimed_s = NEVER_S
        self._playout = Playout(1e-3 * options.playout_ms, options.max_age_s)
        self._forget_device()

    def _forget_device(self) -> None:
        """Discard the state of the remote clock and device."""
        self._clock = RemoteClock(MAX_ROUNDS)
        self._echoed_s = self._sent_s = self._newest_s = NEVER_S
        self._resets = 0
        """Resets of the remote clock at the last edges: earlier stamps are of another clock."""
        self._edge = 0
        self._down: frozenset[str] = frozenset()
        self._shared: DeviceState | None = None
        self._playout.clear()
        self._playout.forget()
        self.haptic_feedback: HapticFeedback | None = None
        """Haptic feedback at the newest state; None: unknown, or the device exerts no force."""
        self._sequences: deque[int] = deque(maxlen=MAX_SEQUENCES)
        """Sequence numbers of the newest states."""
        self.capabilities = UNKNOWN
        self.driver = ""
        self.leased = False
        """True if the device is leased to this session."""
        self.taken_by = ""
        """Another holder of the lease; empty if none is known."""

    # -- claims ----------------------------------------------------------------------------------

    def claim(
        self, now_s: float, feedback: DeviceFeedback, command: HapticCommand | None = None
    ) -> Claim | None:
        """Return the claim that is due now, if any, with `feedback` for the operator and the haptic
        `command`, if any."""
        engaged = command is not None and command.engaged
        if not self._open or now_s < self._claimed_s + (
            FORCE_PERIOD_S if engaged else CLAIM_PERIOD_S
        ):
            return None
        self._claimed_s = now_s
        self._asked.append(now_s)
        # The state that the arm follows now, not the newest: motion may wait for its playout.
        shown = self._playout.shown
        answers_s = NEVER_S if shown is None else shown.sent_s
        order = None if command is None else RemoteHapticCommand(command, answers_s)
        return Claim(
            self._lessee, self._name, now_s, True, self._edge, feedback, order, self._late_s(now_s)
        )

    def final_claim(self, now_s: float) -> Claim:
        """Return the claim that gives the device back."""
        return Claim(self._lessee, self._name, now_s, False, self._edge, DeviceFeedback())

    # -- reception -------------------------------------------------------------------------------

    @property
    def labels(self) -> tuple[str, ...]:
        return self.capabilities.buttons

    def on_opened(self, now_s: float) -> None:
        self._forget_sender(now_s)
        self._forget_device()
        self._begin("not seen at rest yet: let go of the device", now_s)

    def _on_other_sender(self) -> None:
        self._forget_device()

    def _on_data(self, data: bytes, now_s: float) -> None:
        try:
            shared = self._decoder.decode(data)
        except UnusableError as error:
            self._on_malformed(str(error))
            return
        if isinstance(shared, MalformedCdr):
            self._on_malformed("that are malformed")
            return
        if shared.run != self._run:
            self._run = shared.run
            self._forget_device()
            if self._link in (DeviceLink.LIVE, DeviceLink.NEEDS_NEUTRAL):
                self._invalidate_input(DeviceLink.LOST, ANEW, now_s)
        if shared.lessee != self._lessee:
            self._on_not_ours(shared, now_s)
            return
        if shared.sent_s < self._sent_s:
            self._counts["back"] += 1
            return
        if shared.asked_s > self._echoed_s:
            if shared.asked_s not in self._asked:
                if shared.asked_s < self._claimed_s:
                    self._counts["old"] += 1
                else:
                    self._on_malformed("that answer no request")
                return
            self._echoed_s = shared.asked_s
            resets = self._clock.resets
            self._clock.heard(shared.asked_s, shared.sent_s, now_s)
            if self._clock.resets != resets:
                self._playout.forget()
        round_s = self._clock.round_s
        sent_s = self._clock.here_s(shared.sent_s)
        if round_s is None or sent_s is None:
            return
        if sent_s > now_s + 0.5 * round_s + SLACK_S:
            self._counts["future"] += 1
            return
        self._sent_s = shared.sent_s
        if self._sequences and self._sequence <= self._sequences[-1]:
            self._sequences.clear()
        self._sequences.append(self._sequence)
        self._playout.heard(shared.sent_s, now_s)
        self.leased, self.taken_by = True, ""
        if shared.capabilities is not None:
            self.capabilities, self.driver = shared.capabilities, shared.driver
        self._newest_s = min(sent_s, now_s)
        if self._age_s(now_s) > self._options.max_age_s:
            self._counts["old"] += 1
            return
        self._take(shared, now_s)

    def _on_not_ours(self, shared: Shared, now_s: float) -> None:
        """Handle a state of a device that is not leased, or leased to another session."""
        self.taken_by = (shared.lessee_name or "another session") if shared.lessee else ""
        if self.leased:
            self.leased = False
            self._invalidate_input(DeviceLink.LOST, self.refusal or "its lease has ended", now_s)

    @property
    def refusal(self) -> str:
        """Reason why the lease is refused; empty if none is known."""
        if not self.taken_by:
            return ""
        return f"{self._options.device} is used by {self.taken_by}: end that session first"

    def _take(self, shared: Shared, now_s: float) -> None:
        """Process a state that is young enough."""
        state, before = shared.state, (self._link, self._edge, self._down, self._resets)
        there = _LINKS.get(state.link, state.link)
        if there is not DeviceLink.LIVE:
            reason = f"at the operator's computer: {state.reason}"
            if self._link is not there or self._reason != reason:
                self._invalidate_input(there, reason, now_s)
        elif not any(state.axes):
            self._link = DeviceLink.LIVE
        elif self._link is not DeviceLink.LIVE:
            self._resume(LET_GO, 0.0, now_s)
        self._heard = True
        self._last_s = self._newest_s
        self._take_edges(shared, now_s)
        self._shared, self.haptic_feedback = state, shared.haptic_feedback
        self._battery = state.battery
        stamp_s = self._clock.here_s(state.stamp_s)
        stamp_s = now_s if stamp_s is None else min(stamp_s, now_s)
        made_s = now_s - self._age_s(now_s)
        now = self._link, self._edge, self._down, self._resets
        at_once = now != before or self._link is not DeviceLink.LIVE
        motion = MotionSample(shared.sent_s, made_s, stamp_s, state.axes, state.pose)
        self._playout.take(motion, now_s, at_once=at_once)
        self._show()

    def _show(self) -> None:
        """Publish a newly played motion, or any other change."""
        if (shown := self._playout.shown) is not None:
            self._stamp_s = shown.stamp_s
        self._cached = None

    @property
    def due_s(self) -> float:
        """Time at which waiting motion is played next, s; inf: none waits."""
        return self._playout.due_s

    def play(self, now_s: float) -> bool:
        """Play the motion that is due; return True if the state has changed."""
        played = self._playout.advance(now_s)
        if played:
            self._show()
        return played

    def _take_edges(self, shared: Shared, now_s: float) -> None:
        for edge in shared.edges:
            if edge.number <= self._edge:
                continue
            if self._edge:
                self._counts["missed_edges"] += edge.number - self._edge - 1
            self._edge = edge.number
            if not edge.pressed:
                self._down -= {edge.button}
            else:
                self._down |= {edge.button}
                age_s = self._age_s(now_s) + shared.sent_s - edge.stamp_s
                if age_s > self._options.max_age_s or self._clock.resets != self._resets:
                    self._counts["old_presses"] += 1
                    self._buttons.mask([edge.button])
            self._buttons.set(sorted(self._down), now_s)
        self._resets = self._clock.resets
        # How long a button was pressed before the lease, or unseen, is unknown.
        self._buttons.mask(sorted(shared.state.buttons - self._down))
        self._down = shared.state.buttons
        self._buttons.set(sorted(self._down), now_s)

    # -- its age -------------------------------------------------------------------------------

    def _late_s(self, now_s: float) -> float:
        """Delay of the newest state beyond a quick one's, s, on the states' way alone, whatever
        delays the claims."""
        round_s = self._clock.round_s
        return 0.0 if round_s is None else max(0.0, now_s - self._newest_s - 0.5 * round_s)

    def _age_s(self, now_s: float) -> float:
        """Age of the newest state, s, at least what its round trip allows."""
        echoed_s = self._echoed_s + CLAIM_PERIOD_S + self._clock.quickest_s
        return now_s - min(self._newest_s, echoed_s)

    def _watch(self, now_s: float) -> None:
        self.play(now_s)
        longest_s = self._options.max_age_s
        if not self._open or self._link in (DeviceLink.STALE, DeviceLink.LOST):
            return
        # Before the first state the age counts from the opening.
        if now_s - self._last_s <= longest_s and not (
            self._shared is not None and self._age_s(now_s) > longest_s
        ):
            return
        round_s = self._clock.round_s
        trip = "" if round_s is None else f" (quickest round trip {1e3 * round_s:.0f} ms)"
        self._fall_silent(f"no state is younger than max_age_s, {longest_s:g} s{trip}", now_s)

    def _drop_input(self, now_s: float) -> None:
        self._shared = self.haptic_feedback = None
        self._playout.clear()

    def _axes(self, now_s: float) -> Axes:
        shown = self._playout.shown
        return NEUTRAL if shown is None else shown.axes

    def _pose(self) -> Pose | None:
        shown = self._playout.shown
        return None if shown is None else shown.pose

    def _wrench(self) -> Wrench | None:
        return None if self._shared is None else self._shared.wrench

    def _inertia(self, now_s: float) -> Inertia | None:
        return None if self._shared is None else self._shared.inertia

    def _figures(self, now_s: float) -> dict[str, float]:
        median_s, playout = self._clock.median_s, self._playout
        offset_s = self._clock.here_s(0.0)
        return {
            "age_s": self._age_s(now_s) if playout.shown is None else now_s - playout.shown.made_s,
            "delay_s": float("nan") if offset_s is None else playout.transit_s - offset_s,
            "jitter_s": playout.jitter_s,
            "loss": self._loss,
            "playout_s": playout.added_s,
            "round_trip_s": self._clock.round_s or float("nan"),
            "round_trip_median_s": float("nan") if median_s is None else median_s,
            "clock_resets": self._clock.resets,
        }

    @property
    def _loss(self) -> float:
        """Share of recent states that were lost, or came too late to be in order."""
        sequences = self._sequences
        if not sequences:
            return float("nan")
        return 1.0 - len(sequences) / (sequences[-1] - sequences[0] + 1)
