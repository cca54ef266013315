"""What the haptic device is told in each cycle of the robot, and what it tells back.

Fixtures go to the device as geometry, together with the map from the hand's place to the TCP's, so
that its own loop evaluates them. A measured force goes with its rate and its stamp. The operator
takes hold of both by clutching in: before the first time the device is not even enabled. Should the
force vanish that the hand leans on, teleoperation is disengaged (`guard`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

from cardan.drivers.haptic import HapticDevice
from cardan.errors import CommandError, DriverError
from cardan.gateway.force.conditioning import Conditioner
from cardan.gateway.force.figures import ContactFigures, FeltFigures
from cardan.gateway.force.fixtures import FixtureSet, turned_back, world_point
from cardan.gateway.force.glide import MapGlide
from cardan.gateway.force.guard import ForceGuard
from cardan.gateway.force.service import RemoteSource
from cardan.gateway.force.sources import ForceSource
from cardan.haptics import HapticCommand, MeasuredForce, OperatingState, WorldMap
from cardan.histogram import LatencyHistogram
from cardan.spatial import norm, scale
from cardan.types import NEVER_S, DeviceState, Pose, RobotState

LOOK_PERIOD_S = 0.01
"""How often the device's own snapshot is looked at while the hand is not followed, for the figures;
while it is, in every cycle."""

ENABLE_PERIOD_S = 0.05
"""How often a device that was not ready at the clutch-in is asked to let force out."""

FADE_IN_S = 0.5
"""A measured force grows within so long once the device lets force out, and so does one that comes
while the hand is engaged (a sensor that is back, a force node that connects). Before that it is
zero: a device begins with a small force only, and a tool that presses already would not be felt."""

NO_MAP = WorldMap()


class ForceRenderer:
    """The force's share of a session. One for each run."""

    def __init__(
        self,
        device: HapticDevice,
        fixtures: FixtureSet,
        source: ForceSource | None,
        conditioner: Conditioner,
        *,
        rendering: bool = True,
        max_age_s: float = 0.1,
        stiffness_n_m: float = 0.0,
        contact_target_n: float | None = None,
        warnings: tuple[str, ...] = (),
    ) -> None:
        """Without `rendering` the device is never commanded: only its figures are kept."""
        self.device = device
        self.fixtures = fixtures
        self.source = source
        self.conditioner = conditioner
        self.contact = ContactFigures()
        self.felt = FeltFigures()
        self.guard = ForceGuard(max_age_s)
        self._remote = source if isinstance(source, RemoteSource) else None
        self._needs_tcp = source is not None and source.needs_tcp
        self._rendering = rendering
        self._max_age_s = max_age_s
        self._stiffness_n_m = stiffness_n_m
        self._contact_target_n = contact_target_n
        self._warnings = warnings
        self._tcp_of: Callable[[RobotState], Pose | None] = lambda state: state.pose
        self._tcp_state: RobotState | None = None
        self._tcp_pose: Pose | None = None
        """The measured TCP, and the state that it is of: an arm's model takes its time."""
        self._started = False
        self._engaged = False
        self._sequence = 0
        self._read_s = NEVER_S
        self._sound = False
        """Whether the source's newest reading gave a force."""
        self._stale = False
        self._share = 0.0
        """How much of the measured force is let through."""
        self._look_s = NEVER_S
        self._refusal = ""
        """Why the device lets no force out, in words."""
        self._refused = False
        """Whether it is to be asked again: what stands in the way may pass."""
        self._tried_s = NEVER_S
        self._faults = 0
        """How many the device had told of when it was asked."""
        self._rejection = ""
        """Why it did not take the last command, in words."""
        self._glide = MapGlide()

    def start(self, tcp: Callable[[RobotState], Pose | None]) -> None:
        """The device is open, and nothing was commanded yet; `tcp` gives a state's measured TCP."""
        self._tcp_of = tcp
        self._sequence = self.device.haptics().command_sequence

    def stop(self) -> None:
        """Nothing is felt any more, by ramp. Never raises."""
        if not self._rendering:
            return
        with contextlib.suppress(DriverError):
            self.device.disable()

    def cycle(
        self,
        state: RobotState,
        hand: DeviceState,
        world: WorldMap | None,
        at_rest: bool,
    ) -> str:
        """Render what this cycle of the robot brings.

        `world` is None while clutched out; `at_rest`: nothing is commanded to move. Returns why
        teleoperation must be disengaged, in words; empty while it need not.
        """
        if self._rendering:
            self._render(state, hand, world, at_rest)
        now_s = state.stamp_s
        if not self._engaged and now_s - self._look_s < LOOK_PERIOD_S:
            return ""
        self._look_s = now_s
        told = self.device.haptics()
        fixtures = self._engaged and bool(self.fixtures.fixtures)
        self.felt.add(told, fixtures, self._engaged)
        if not self._engaged:
            return ""
        source = "" if self.source is None else self.source.reason or self.conditioner.reason
        return self.guard.disengage_reason(
            told, now_s, fixtures=fixtures, refusal=self._refusal or self._rejection, source=source
        )

    def _tcp(self, state: RobotState) -> Pose | None:
        if state is not self._tcp_state:
            self._tcp_state, self._tcp_pose = state, self._tcp_of(state)
        return self._tcp_pose

    def _render(
        self,
        state: RobotState,
        hand: DeviceState,
        world: WorldMap | None,
        at_rest: bool,
    ) -> None:
        pose = hand.pose
        if not self._started and state.ready and (place := self._tcp(state)) is not None:
            self._started = True
            self.fixtures.place("start", place.position)
        if pose is None or world is None:
            world = None
            self._glide.release()
        else:
            world = self._glide.follow(world, pose.position, state.stamp_s)
        measured = None
        if self.source is not None:
            known = self._tcp(state) if self._needs_tcp else None
            if self._remote is not None:
                self._remote.publish(state, known, world, state.stamp_s)
            sound = self._take(self.source, state, known, at_rest and world is None)
            if sound and self.guard.rendered:
                self._share = min(1.0, self._share + state.period_s / FADE_IN_S)
            else:
                self._share = 0.0
            if sound and world is not None and pose is not None:
                filtered, share = self.conditioner.filtered, self._share
                measured = MeasuredForce(
                    scale(turned_back(world.rotation, filtered.value), share),
                    filtered.stamp_s,
                    scale(turned_back(world.rotation, self.conditioner.rate), share),
                    pose.position,
                    self._stiffness_n_m * share,
                )
        engaged = world is not None
        if engaged is not self._engaged:
            self._engaged = engaged
            if world is not None and pose is not None:
                self.fixtures.place("clutch-in", world_point(world, pose.position))
                self._enable(state.stamp_s)
                self.guard.engage(self._sequence + 1, state.stamp_s)
            else:
                self._refused = False
                self.guard.release()
        elif engaged:
            self._enable_again(state.stamp_s)
        if measured is not None:
            self.guard.give(measured.stamp_s)
        self._sequence += 1
        try:
            self.device.render(
                HapticCommand(
                    self._sequence,
                    state.stamp_s,
                    engaged,
                    world if world is not None else NO_MAP,
                    self.fixtures.fixtures,
                    measured,
                )
            )
        except DriverError as error:
            self._rejection = f"the haptic device takes no command: {error}"
        else:
            self._rejection = ""

    def _take(
        self,
        source: ForceSource,
        state: RobotState,
        known: Pose | None,
        at_rest: bool,
    ) -> bool:
        """Take the source's newest reading; False while there is no force to be felt."""
        conditioner, contact = self.conditioner, self.contact
        reading = source.read(state, known)
        if reading is None:
            self._sound = self._stale = False
            contact.lift()
            return False
        if reading.stamp_s > self._read_s:
            self._read_s = reading.stamp_s
            self._sound = conditioner.add(reading, at_rest, self._tcp(state))
            if self._sound and not source.shaped:
                place = self._tcp(state)
                contact.add(
                    conditioner.contact,
                    reading.stamp_s,
                    None if place is None else place.position,
                )
        self._stale = state.stamp_s - self._read_s > self._max_age_s
        if self._stale:
            contact.lift()
        return self._sound and not self._stale

    def _enable(self, now_s: float) -> None:
        """The operator took hold: let force out, after a latched fault too."""
        self._refusal, self._refused = "", False
        told = self.device.haptics()
        if told.state not in (OperatingState.DISABLED, OperatingState.FAULT):
            return
        self._faults, self._tried_s = told.faults, now_s
        try:
            self.device.enable()
        except CommandError as error:
            self._refusal, self._refused = f"no force: {error}", True
        except DriverError as error:
            self._refusal = f"no force: {error}"

    def _enable_again(self, now_s: float) -> None:
        """What refused the clutch-in may have passed. A fault of after it needs another one."""
        if self._refused and now_s - self._tried_s >= ENABLE_PERIOD_S:
            if self.device.haptics().faults == self._faults:
                self._enable(now_s)
            else:
                self._refused = False

    def diagnosis(self) -> tuple[str, ...]:
        """What stands in the way of a force, or of a good one."""
        words = [each for each in (self._refusal, self._rejection) if each]
        if self.guard.heard and (reason := self.felt.newest.reason):
            words.append(
                f"force: {reason}" if self.felt.newest.rendering else f"no force: {reason}"
            )
        if self.source is not None:
            words += self.source.diagnosis()
            if self.conditioner.reason and not self.source.reason:
                words.append(f"no measured force: {self.conditioner.reason}")
            if self._stale:
                words.append(
                    f"no measured force: the last one is older than {self._max_age_s * 1e3:g} ms"
                )
        return (*words, *self._warnings)

    def report(self) -> dict[str, Any]:
        """The figures of a snapshot, by the names that they have there."""
        felt, contact, state = self.felt, self.contact, self.felt.newest
        measured = self.source is not None and self._sound and not self._stale
        found: dict[str, Any] = {
            "haptic_state": state.state.value,
            "haptic_reason": state.reason,
            "force_n": norm(state.force),
            "force_commanded_n": norm(state.force_commanded),
            "force_peak_n": felt.peak_n,
            "force_losses": self.guard.losses,
            "force_out_s": self.guard.out_s,
            "force_lost_reason": self.guard.lost_reason,
            "energy_j": state.energy_j,
            "energy_given_j": state.delivered_j,
            "energy_given_peak_j": felt.given_peak_j,
            "passivity_damping_n_s_m": state.passivity_damping_n_s_m,
            "force_age_s": state.force_age_s,
            "fixture_age_p50_s": _percentile(felt.fixture_age, 50),
            "fixture_age_p99_s": _percentile(felt.fixture_age, 99),
            "measured_age_p50_s": _percentile(felt.measured_age, 50),
            "measured_age_p99_s": _percentile(felt.measured_age, 99),
            "measured_force_n": list(self.conditioner.filtered.value) if measured else None,
        }
        if self.source is not None and not self.source.shaped:
            found |= {
                "contact_force_n": contact.force_n,
                "contact_s": contact.time_s,
                "contact_path_m": contact.path_m,
                "contact_force_mean_n": contact.mean_n,
                "contact_target_n": self._contact_target_n,
                "contact_force_rms_error_n": contact.rms_error_n(self._contact_target_n),
            }
        return found


def _percentile(ages: LatencyHistogram, percent: float) -> float | None:
    return ages.percentile(percent) if ages.count else None
