"""Disengages teleoperation when a force that the operator presses against is lost. A hand that
presses on a force falls forward when the force vanishes, and a robot that continues to follow
presses on its surroundings with the hand's whole force. The session therefore disengages, and
motion needs a new clutch-in. A hand falls 10 mm in 50 ms, so the robot waits even before the force
counts as lost. Control logic only: time is an argument."""

from __future__ import annotations

from cardan.common.haptics import HapticState, OperatingState
from cardan.spatial import norm
from cardan.types import NEVER_S

FORCE_LOST_S = 0.15
"""Longest interruption of a force: a busy computer delays a loop for less."""

IN_DOUBT_S = 0.01
"""Interruption after which the robot waits until the force is back, or lost."""

SHARE_FORGIVEN = 0.25
"""Share of the time with force that offsets time without: a flickering force is lost, too."""

BEGINS_WITHIN_S = 1.0
"""Longest time from a clutch-in until force begins."""

SOURCE_LOST_S = 0.1
"""Time beyond `max_age_s`, the age limit of a measured force, after which the force is lost."""

LEAST_DERATING = 0.2
"""Share of the device's largest force below which the thermal limiter leaves too little to lean
on."""

DERATED, LET_OUT = 0.4, 0.8
"""The force is also lost if the limiter leaves less than the first share of the largest force and
less than the second of the commanded one is rendered. Without warm motors it leaves at least 0.88
N, so never less than 0.44 of the 2 N that `clamp_n` is by default; of 3.3 N it leaves 0.27."""

IN_A_FIXTURE_N = 0.1


class ForceWatchdog:
    """Watches the force of each engagement, from clutch-in to clutch-out."""

    def __init__(self, max_age_s: float) -> None:
        """`max_age_s`: age limit of a measured force."""
        self._source_lost_s = max_age_s + SOURCE_LOST_S
        self.rendered: bool
        """True if force was rendered in this engagement."""
        self.in_doubt: bool
        """True while the robot is to wait: force has not begun, or is interrupted."""
        self.heard: bool
        """True if the device's newest snapshot is of this engagement."""
        self.losses = 0
        """Count of the times that teleoperation was disengaged."""
        self.out_s = 0.0
        """Total time in which teleoperation went on after the loss of its force."""
        self.lost_reason = ""
        """Why force was lost the last time."""
        self.release()

    def engage(self, sequence: int, now_s: float) -> None:
        """Start at a clutch-in; the command `sequence` is the first that engages."""
        self.release()
        self._engaged, self._sequence = True, sequence
        self._begun_s = self._seen_s = now_s

    def release(self) -> None:
        """End at a clutch-out."""
        self._engaged = self.rendered = self.heard = self.in_doubt = False
        self._missing_s = self._derated_s = 0.0
        self._given_s = NEVER_S
        self._disengage_reason = ""

    def give(self, stamp_s: float) -> None:
        """Take note of a measured force of `stamp_s` sent to the device."""
        self._given_s = stamp_s

    def disengage_reason(
        self, state: HapticState, now_s: float, *, fixtures: bool, refusal: str, source: str
    ) -> str:
        """Return why teleoperation must be disengaged; empty if it need not. `state` is the
        device's newest snapshot; `refusal` says why it rejects commands, `source` why there is no
        measured force."""
        if not self._engaged:
            return ""
        dt_s, self._seen_s = now_s - self._seen_s, now_s
        # Before that the snapshot is older than the clutch-in.
        self.heard = state.command_sequence >= self._sequence
        if state.rendering and self.heard:
            self.rendered = True
            self._missing_s = max(0.0, self._missing_s - SHARE_FORGIVEN * dt_s)
        elif self.rendered:
            self._missing_s += dt_s
            self.out_s += dt_s
            self.lost_reason = state.reason or "the device gives none"
        self._derated_s = self._derated_s + dt_s if _derated(state) else 0.0
        missing = not self.rendered or (not state.rendering and self._missing_s > IN_DOUBT_S)
        self.in_doubt = missing or self._derated_s > IN_DOUBT_S
        if not self._disengage_reason:
            self._disengage_reason = self._why(state, now_s, fixtures, refusal, source)
            if self._disengage_reason:
                self.losses += 1
                self.lost_reason = self._disengage_reason
        return self._disengage_reason

    def _why(
        self,
        state: HapticState,
        now_s: float,
        fixtures: bool,
        refusal: str,
        source: str,
    ) -> str:
        why = refusal.removeprefix("no force: ") or state.reason or "the device gives none"
        off = state.state in (OperatingState.DISABLED, OperatingState.FAULT)
        if self.rendered and (off or self._missing_s > FORCE_LOST_S):
            return f"the force is lost: {why}"
        if not self.rendered:
            if now_s - self._begun_s <= BEGINS_WITHIN_S:
                return ""  # The cause may pass, and the robot waits.
            if off:
                return f"there is no force: {why}"
            asked_n = norm(state.force_commanded)
            if fixtures and asked_n > IN_A_FIXTURE_N and state.state is OperatingState.ENABLED:
                return (
                    f"the force cannot begin, since a fixture would push with {asked_n:.1f} N at "
                    "once: move out of the fixture, then clutch in"
                )
            return f"the force has not begun: {why}"
        left = state.thermal_derating
        if state.rendering and (left < LEAST_DERATING or self._derated_s > FORCE_LOST_S):
            return (
                f"the force is limited to {left:.0%} of the largest to spare the motors: let them "
                "cool down"
            )
        if self._given_s > NEVER_S and now_s - self._given_s > self._source_lost_s:
            return f"the measured force is lost: none for {now_s - self._given_s:.2f} s" + (
                f", {source}" if source else ""
            )
        return ""


def _derated(state: HapticState) -> bool:
    return (
        state.rendering
        and state.thermal_derating < DERATED
        and norm(state.force) < LET_OUT * norm(state.force_commanded)
    )
