"""A measured force for the hand: reading, conditioning, age limit, fade-in."""

from __future__ import annotations

from collections.abc import Callable

from cardan.common.haptics import MeasuredForce, WorldMap
from cardan.gateway.force.conditioning import Conditioner
from cardan.gateway.force.figures import ContactFigures
from cardan.gateway.force.fixtures import turned_back
from cardan.gateway.force.snapshot import ContactSnapshot
from cardan.gateway.force.sources import ForceSource
from cardan.spatial import scale
from cardan.types import NEVER_S, Pose, RobotState, Vector3

FADE_IN_S = 0.5
"""Duration of the fade-in of a measured force once the device renders force, or when the force
returns during an engagement (a sensor, a force node). Before that it is zero: a device begins with
a small force only, so that of a tool in contact would not be rendered."""

MeasuredTcp = Callable[[RobotState], Pose | None]
"""Returns the measured TCP of a state, base frame; None if it is not known."""


class ForceInput:
    """Source of measured forces in a session with a haptic device."""

    def __init__(
        self,
        source: ForceSource,
        conditioner: Conditioner,
        *,
        max_age_s: float = 0.1,
        stiffness_n_m: float = 0.0,
        contact_target_n: float | None = None,
    ) -> None:
        """A force older than `max_age_s` is not rendered. `stiffness_n_m`: its growth with the
        hand's motion until the next one. `contact_target_n`: the intended contact force."""
        self.source = source
        self.conditioner = conditioner
        self.contact = ContactFigures()
        self._max_age_s = max_age_s
        self._stiffness_n_m = stiffness_n_m
        self._contact_target_n = contact_target_n
        self._read_s = NEVER_S
        self._valid = False
        """True if the source's newest reading gave a force."""
        self._stale = False
        self._share = 0.0
        """Share of the force that is faded in."""

    @property
    def reason(self) -> str:
        """Why there is no force; empty when there is one."""
        return self.source.reason or self.conditioner.reason

    def take(
        self,
        state: RobotState,
        tcp: MeasuredTcp,
        world: WorldMap | None,
        at_rest: bool,
        rendered: bool,
    ) -> bool:
        """Take the readings of this robot cycle; return False while there is no force to render.
        `world` is None while clutched out; `at_rest`: no commanded motion; `rendered`: the device
        renders force."""
        known = tcp(state) if self.source.needs_tcp else None
        self.source.publish(state, known, world, state.stamp_s)
        usable = self._take(state, known, tcp, at_rest and world is None)
        fading = usable and rendered
        self._share = min(1.0, self._share + state.period_s / FADE_IN_S) if fading else 0.0
        return usable

    def force(self, world: WorldMap, hand: Vector3) -> MeasuredForce:
        """The present force, with the hand at `hand`."""
        filtered, share = self.conditioner.filtered, self._share
        return MeasuredForce(
            scale(turned_back(world.rotation, filtered.value), share),
            filtered.stamp_s,
            scale(turned_back(world.rotation, self.conditioner.rate), share),
            hand,
            self._stiffness_n_m * share,
        )

    def _take(self, state: RobotState, known: Pose | None, tcp: MeasuredTcp, at_rest: bool) -> bool:
        source, conditioner, contact = self.source, self.conditioner, self.contact
        reading = source.read(state, known)
        if reading is None:
            self._valid = self._stale = False
            contact.lift()
            return False
        if reading.stamp_s > self._read_s:
            self._read_s = reading.stamp_s
            place = tcp(state)
            self._valid = conditioner.add(reading, at_rest, place)
            if self._valid and not source.shaped:
                position = None if place is None else place.position
                contact.add(conditioner.contact, reading.stamp_s, position)
        self._stale = state.stamp_s - self._read_s > self._max_age_s
        if self._stale:
            contact.lift()
        return self._valid and not self._stale

    def diagnosis(self) -> tuple[str, ...]:
        """Reasons why there is no force."""
        words = list(self.source.diagnosis())
        if self.conditioner.reason and not self.source.reason:
            words.append(f"no measured force: {self.conditioner.reason}")
        if self._stale:
            words.append(
                f"no measured force: the last one is older than {self._max_age_s * 1e3:g} ms"
            )
        return tuple(words)

    @property
    def rendered_n(self) -> tuple[float, ...]:
        """The measured force as it would be rendered, N, base axes; empty without one."""
        return self.conditioner.filtered.value if self._valid and not self._stale else ()

    def report(self) -> ContactSnapshot:
        """The figures of a snapshot."""
        if self.source.shaped:
            return ContactSnapshot()
        return self.contact.report(self._contact_target_n)
