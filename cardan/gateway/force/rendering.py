"""Commands the haptic device in each cycle of the robot, and reads its snapshot.

Fixtures go to the device as geometry, together with the map from the hand's position to the TCP's,
so that its own loop evaluates them. A measured force (`input`) goes with its rate and its stamp.
Rendering starts with a clutch-in: before the first one the device is not enabled (`servo_on`). If a
force that the hand presses on is lost, teleoperation is disengaged (`watchdog`).
"""

from __future__ import annotations

import contextlib
from dataclasses import replace

from cardan.common.haptics import HapticCommand, MeasuredForce, WorldMap
from cardan.drivers.haptic import HapticDevice
from cardan.errors import DriverError
from cardan.gateway.force.crossfade import MapCrossfade
from cardan.gateway.force.figures import HapticFigures, StiffnessFigures
from cardan.gateway.force.fixtures import FixtureSet, world_point
from cardan.gateway.force.input import ForceInput, MeasuredTcp
from cardan.gateway.force.passive import FarPort
from cardan.gateway.force.servo_on import ForceEnabling
from cardan.gateway.force.snapshot import ForceSnapshot
from cardan.gateway.force.watchdog import ForceWatchdog
from cardan.types import NEVER_S, DeviceState, Pose, RobotState

LOOK_PERIOD_S = 0.01
"""Period of reading the device's snapshot for the figures while clutched out; while clutched in it
is read in every cycle."""

NO_MAP = WorldMap()


class ForceRenderer:
    """Force feedback of a session, one instance for each run."""

    def __init__(
        self,
        device: HapticDevice,
        fixtures: FixtureSet,
        measured: ForceInput | None = None,
        *,
        rendering: bool = True,
        max_age_s: float = 0.1,
        warnings: tuple[str, ...] = (),
    ) -> None:
        """Without `rendering` the device is never commanded: only its figures are kept.
        `max_age_s`: age limit of a measured force."""
        self.device = device
        self.fixtures = fixtures
        self.measured = measured
        self.figures = HapticFigures()
        self._stiffness = StiffnessFigures()
        self.watchdog = ForceWatchdog(max_age_s)
        self._enabling = ForceEnabling(device)
        self._crossfade = MapCrossfade()
        self._port = FarPort()
        self._rendering = rendering
        self._warnings = warnings
        self._tcp_of: MeasuredTcp = lambda state: state.pose
        self._tcp_state: RobotState | None = None
        self._tcp_pose: Pose | None = None
        """The last measured TCP and its state: its computation by an arm's model takes time."""
        self._started = False
        self._engaged = False
        self._sequence = 0
        self._look_s = NEVER_S
        self._rejection = ""
        """Reason why the device rejected the last command."""

    def start(self, tcp: MeasuredTcp) -> None:
        """Start with an open device before the first command; `tcp` gives the TCP of a state."""
        self._tcp_of = tcp
        self._sequence = self.device.haptics().command_sequence

    def stop(self) -> None:
        """Ramp all forces to zero. Never raises."""
        if not self._rendering:
            return
        with contextlib.suppress(DriverError):
            self.device.disable()

    def cycle(
        self,
        state: RobotState,
        device: DeviceState,
        world: WorldMap | None,
        at_rest: bool,
    ) -> str:
        """Render the force of this cycle of the robot.

        `world` is None while clutched out; `at_rest`: no commanded motion. Return why teleoperation
        must be disengaged; empty if it need not.
        """
        if self._rendering:
            self._render(state, device, world, at_rest)
        now_s = state.stamp_s
        if not self._engaged and now_s - self._look_s < LOOK_PERIOD_S:
            return ""
        self._look_s = now_s
        haptic = self.device.haptics()
        fixtures = self._engaged and bool(self.fixtures.fixtures)
        self.figures.add(haptic, fixtures, self._engaged)
        if self.measured is not None:
            touching = self._engaged and self.measured.contact.touching
            place = device.pose.position if touching and device.pose else None
            self._stiffness.add(place, haptic.force)
        if not self._engaged:
            return ""
        return self.watchdog.disengage_reason(
            haptic,
            now_s,
            fixtures=fixtures,
            refusal=self._enabling.refusal or self._rejection,
            source="" if self.measured is None else self.measured.reason,
        )

    def _tcp(self, state: RobotState) -> Pose | None:
        if state is not self._tcp_state:
            self._tcp_state, self._tcp_pose = state, self._tcp_of(state)
        return self._tcp_pose

    def _render(
        self,
        state: RobotState,
        device: DeviceState,
        world: WorldMap | None,
        at_rest: bool,
    ) -> None:
        pose = device.pose
        if not self._started and state.ready and (place := self._tcp(state)) is not None:
            self._started = True
            self.fixtures.place("start", place.position)
        if pose is None or world is None:
            world = None
            self._crossfade.release()
        else:
            world = self._crossfade.follow(world, pose.position, state.stamp_s)
        force: MeasuredForce | None = None
        if self.measured is not None:
            usable = self.measured.take(state, self._tcp, world, at_rest, self.watchdog.rendered)
            if usable and world is not None and pose is not None:
                force = self.measured.force(world, pose.position)
                absorbed_j = self._port.step(pose.position, force.force)
                force = force._replace(absorbed_j=absorbed_j)
        if force is None:
            self._port.rest()
        engaged = world is not None
        if engaged is not self._engaged:
            self._engaged = engaged
            if world is not None and pose is not None:
                self.fixtures.place("clutch-in", world_point(world, pose.position))
                self._enabling.engage(state.stamp_s)
                self.watchdog.engage(self._sequence + 1, state.stamp_s)
            else:
                self._enabling.release()
                self.watchdog.release()
                self._port.forget()
        elif engaged:
            self._enabling.retry(state.stamp_s)
        if force is not None:
            self.watchdog.give(force.stamp_s)
        self._sequence += 1
        command = HapticCommand(
            self._sequence, state.stamp_s, engaged, world or NO_MAP, self.fixtures.fixtures, force
        )
        try:
            self.device.render(command)
        except DriverError as error:
            self._rejection = f"the haptic device takes no command: {error}"
        else:
            self._rejection = ""

    def diagnosis(self) -> tuple[str, ...]:
        """Reasons why there is no force, or a poor one."""
        words = [each for each in (self._enabling.refusal, self._rejection) if each]
        newest = self.figures.newest
        if self.watchdog.heard and newest.reason:
            words.append(("force: " if newest.rendering else "no force: ") + newest.reason)
        if self.measured is not None:
            words += self.measured.diagnosis()
        return (*words, *self._warnings)

    def report(self) -> ForceSnapshot:
        """The figures of a snapshot."""
        watchdog, stiffness = self.watchdog, self._stiffness
        return replace(
            self.figures.report(),
            rendered_depth_m=stiffness.depth_m,
            rendered_stiffness_n_m=stiffness.stiffness_n_m,
            losses=watchdog.losses,
            out_s=watchdog.out_s,
            lost_reason=watchdog.lost_reason,
            measured_n=() if self.measured is None else self.measured.rendered_n,
        )
