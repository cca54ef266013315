"""Network interface of a session: publishes its arm on the bus, and takes commands from there."""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from cardan.bus.node import BusNode
from cardan.bus.twins import Twins
from cardan.drivers.base import OperatorDevice, RobotDriver
from cardan.drivers.haptic import HapticDevice
from cardan.drivers.ihaptic import IHapticDevice
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.loop import Cycle
from cardan.gateway.arm.status import ArmStatus, Phase
from cardan.gateway.bus.arm_server import ArmServer
from cardan.gateway.bus.arm_topics import (
    ERROR,
    LOG_INFO,
    LOG_WARN,
    OK,
    WARN,
    ArmNames,
    ArmTopics,
    DiagnosticStatus,
)
from cardan.gateway.bus.commands import (
    ACTIONS,
    SERVICES,
    TOPICS,
    Instant,
    joint_command,
    stat_command,
)
from cardan.gateway.bus.compatibility import NamesTopics, PublishedState, other_names, same_topics
from cardan.gateway.bus.device_topics import DeviceTopics
from cardan.gateway.bus.haptic_server import HapticServer
from cardan.gateway.bus.options import NetworkOptions
from cardan.gateway.bus.record_topics import RecordTopics
from cardan.gateway.bus.trajectories import follow_joint_trajectory
from cardan.gateway.force.network import NetworkSource
from cardan.gateway.force.sources import ForceSource
from cardan.gateway.session.snapshot import Snapshot
from cardan.types import DeviceLink, DeviceState, Pose, RobotLink, RobotState, Vector3

if TYPE_CHECKING:  # Imports Pinocchio, which sessions without an arm's model do without.
    from cardan.gateway.arm.verb_methods import ArmVerbs
    from cardan.gateway.bus.neighbors import ArmNeighbors

_log = logging.getLogger(__name__)

TWINS_PERIOD_S = 0.1
"""Period of checks for other nodes of its name."""

NO_FEEDBACK = (
    "this session takes no feedback from the network: its forces are those of its own [force] and "
    '[[fixtures]]; set source = "network" in [force]'
)


class SessionFeedback:
    """Feedback from the network as one source of the session's forces."""

    why_no_torques = (
        "a session renders forces, joint torques only where the device is served alone, by "
        "`cardan devices haptic`"
    )

    def __init__(self, haptic: IHapticDevice, source: NetworkSource | None) -> None:
        """`source`: None if the session has another, or none."""
        self._haptic = haptic
        self._feedback = None if source is None else source.feedback

    def give(self, publisher: int, sequence: int, asked: Vector3, now_s: float) -> str:
        """Take a force along the axes of the transformation. Return why not."""
        if self._feedback is None:
            return NO_FEEDBACK
        return self._feedback.give(publisher, sequence, self._haptic.to_hand(asked), now_s)

    def stop(self) -> str:
        """Render no force until the next feedback. Return why not."""
        if self._feedback is None:
            return NO_FEEDBACK
        self._feedback.stop()
        return ""


class SessionNetwork:
    """The network's side of a session. All methods are for the loop's thread."""

    def __init__(
        self,
        options: NetworkOptions,
        names: ArmNames,
        robot_description: str,
        tool: Pose,
        offer: Callable[[Any, Any, float], None],
        full: Callable[[], bool],
        tables: Mapping[str, Any],
        scene: str = "",
    ) -> None:
        """`offer` takes packets unless it is `full`, as in :class:`RequestWorker`; `tables`: the
        session's configuration; `scene`: that of the arm, as JSON."""
        self._scene = scene
        self._full = full
        self.options = options
        self._tables = tables
        self._names, self._description, self._tool = names, robot_description, tool
        self._offer = offer
        namespace = f"/{options.namespace}"
        self._node = BusNode(options, options.name, namespace)
        self._opened = contextlib.ExitStack()
        self._server: ArmServer | None = None
        self._device: DeviceTopics | None = None
        self._haptic: HapticServer | None = None
        self._twins_due_s = -math.inf
        self._twin: tuple[str, ...] = ()
        """Messages about other nodes of the same names."""
        self._logged = ""
        self._verbs: ArmVerbs | None = None

    def open(
        self,
        controller: ArmController,
        robot: RobotDriver,
        device: OperatorDevice | None,
        force: ForceSource | None = None,
        neighbors: ArmNeighbors | None = None,
    ) -> None:
        """Join the bus; `force`: the source of the session's measured force; `neighbors` subscribe
        there. Raises DriverError, ConfigurationError, or ExtraMissingError."""
        self._node.join()
        if neighbors is not None:
            neighbors.open(self._node)
        self._twins = Twins(self._node)
        self._twins.begin()
        if self.options.device and device is not None:
            self._device = DeviceTopics(
                self._node,
                device.capabilities.buttons,
                inertia=device.capabilities.gives_inertia,
            )
            if isinstance(device, HapticDevice):
                self._haptic = self._haptic_server(device, force)
        options = self.options
        others = other_names(options.other_names, self._names, options.servo, options.servo_scales)
        self._names_topics = NamesTopics(self._node, others)
        self._topics = ArmTopics(
            self._node,
            self._names,
            period_s=1.0 / options.rate_hz,
            robot_description=self._description,
            scene=self._scene,
            tool=self._tool,
            transforms=options.transforms,
            same=same_topics(others),
        )
        self._record_topics = RecordTopics(self._node, self._tables, controller, robot, device)
        self._opened.callback(self._record_topics.close)
        if options.commands:
            follow = follow_joint_trajectory(
                options.trajectory_controller,
                self._names.joints,
                options.distribution == "kilted and later",
            )
            self._server = ArmServer(
                self._node,
                self._offer,
                source=options.source,
                owner=lambda: controller.authority.owner,
                endless_without_watch=options.endless_without_watch,
                topics=(
                    *TOPICS,
                    joint_command(self._names.joints),
                    *(each for names in others for each in names.topics),
                ),
                services=(
                    *SERVICES,
                    stat_command(self._names.base),
                    *(each for names in others for each in names.services),
                ),
                actions=(*ACTIONS, follow),
                full=self._full,
            )

    def close(self) -> None:
        """Leave the bus. Never raises; idempotent."""
        self._opened.close()
        self._node.close()

    def _haptic_server(self, device: HapticDevice, force: ForceSource | None) -> HapticServer:
        options = self.options
        node = BusNode(options, options.haptic, f"/{options.namespace}", beside=self._node)
        node.join()
        self._haptic_twins = Twins(node, "haptic")
        self._haptic_twins.begin()
        haptic = IHapticDevice(device, "cartesian")
        source = force if isinstance(force, NetworkSource) else None
        feedback = SessionFeedback(haptic, source) if options.commands else None
        return HapticServer(node, device, haptic, feedback, period_s=0.0)

    def poll(self, now_s: float) -> None:
        """Pass on the commands that have arrived."""
        if now_s >= self._twins_due_s:
            self._twins_due_s = now_s + TWINS_PERIOD_S
            self._look_for_twins()
        if self._server is not None:
            self._server.poll(now_s)
        if self._haptic is not None:
            self._haptic.poll(now_s)

    def _look_for_twins(self) -> None:
        said, listens = self._twins.state()
        if self._server is not None:
            self._server.inhibited = "" if listens else said
        words = [said]
        if self._haptic is not None:
            said, listens = self._haptic_twins.state()
            self._haptic.inhibited = "" if listens else said
            words.append(said)
        twin = tuple(filter(None, words))
        if twin != self._twin:
            self._twin = twin
            _log.warning("%s", "; ".join(twin) or "no other node has this one's name any more")

    def publish_cycle(self, cycle: Cycle, now_s: float) -> None:
        """Publish a cycle for recorders."""
        self._record_topics.cycle(cycle, now_s)

    def diagnosis(self) -> tuple[str, ...]:
        """Faults and warnings."""
        said = list(self._twin)
        if dropped := self._record_topics.dropped:
            said.append(f"{dropped} raw packets were not published: too many at once")
        return tuple(said)

    def show_device(self, device: DeviceState, now_s: float) -> None:
        """Publish the operator device if it is due."""
        if self._device is not None:
            self._device.offer(device, now_s, time.time_ns())

    def rumble(self, now_s: float) -> float:
        """Return the rumble that the network requests of the device, 0..1."""
        return 0.0 if self._device is None else self._device.rumble(now_s)

    def due(self, now_s: float) -> bool:
        """Return whether the state is due for publication."""
        return self._topics.due(now_s)

    def publish(
        self,
        state: RobotState,
        pose: Pose | None,
        status: ArmStatus,
        verbs: ArmVerbs | None,
        now_s: float,
        now_ns: int,
    ) -> None:
        """Publish the state of one instant; `pose`: the measured TCP."""
        flags: dict[str, Any] = {"ready": state.ready, "moving": status.phase is Phase.MOVING}
        if verbs is not None:
            flags |= {"state": int(verbs.state), "stream": int(verbs.streams.kind)}
        self._topics.publish(state, pose, status, flags, now_s, now_ns)
        self._verbs = verbs
        self._names_topics.publish(PublishedState.of(state, status, verbs, now_s, now_ns), now_ns)
        if self._haptic is not None:
            self._haptic.publish(now_s, now_ns)
        if self._server is not None and self._server.running:
            stamp_ns = now_ns - int((now_s - state.stamp_s) * 1e9)
            desired = None if verbs is None else verbs.desired()
            now = Instant(stamp_ns, self._names.base, pose, state, desired)
            self._server.report(now, now_ns)

    def tell(self, snapshot: Snapshot, now_s: float, now_ns: int) -> None:
        """Publish a snapshot, the diagnostics of each part, and new messages."""
        self._topics.put_snapshot(snapshot.to_bytes().decode(), now_ns)
        parts = _parts(snapshot)
        if self._server is not None:
            parts.append(self._server.part())
        if self._haptic is not None:
            parts.append(self._haptic.part())
        self._topics.put_diagnostics(parts, now_s, now_ns)
        if self._server is not None and self._verbs is not None:
            self._server.parameters.observe(self._verbs.get_parameters(), now_ns)
        said = snapshot.arm.message or snapshot.arm.phase
        if said != self._logged:
            self._logged = said
            self._topics.log(LOG_WARN if snapshot.arm.message else LOG_INFO, said, now_ns)


def _parts(snapshot: Snapshot) -> list[DiagnosticStatus]:
    """Return the diagnostics of each part of a session."""
    s = snapshot
    lost = s.robot.link != RobotLink.LIVE.value
    robot = DiagnosticStatus(
        "robot",
        ERROR if lost else WARN if s.robot.hold_reason else OK,
        s.robot.hold_reason or f"link {s.robot.link}",
        values=s.robot.metrics,
    )
    session = DiagnosticStatus(
        "session",
        WARN if s.arm.message or s.diagnosis else OK,
        s.arm.message or (s.diagnosis[0] if s.diagnosis else s.arm.phase),
        values={
            "phase": s.arm.phase,
            "authority": s.arm.authority,
            "trips": s.arm.trips,
            "cycles": s.loop.cycles,
            "tick_p50_s": s.loop.tick_p50_s,
            "tick_p99_s": s.loop.tick_p99_s,
            **{f"diagnosis {number}": line for number, line in enumerate(s.diagnosis, 1)},
        },
    )
    parts = [session, robot]
    if s.device.link:
        live = s.device.link == DeviceLink.LIVE.value
        parts.append(
            DiagnosticStatus(
                "device",
                OK if live else WARN,
                s.device.reason or s.device.link,
                values=s.device.metrics,
            )
        )
    return parts
