"""Parts of a session beside its arm's controller: each runs after a command has been sent. All
methods are for the loop's thread. Times are monotonic, in s."""

from __future__ import annotations

import contextlib
import math
import socket
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

from cardan.common.histogram import LatencyHistogram
from cardan.common.plugins import reason
from cardan.drivers.base import OperatorDevice, RobotDriver
from cardan.drivers.foreign import RobotCalls, checked_lines, close_in_order, counted
from cardan.errors import CommandError, ConfigurationError
from cardan.gateway.arm.commanded_arm import TaskSpaceArm
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.loop import Cycle
from cardan.gateway.arm.loop_link import LoopLink
from cardan.gateway.arm.requests import MAX_REQUEST_BYTES
from cardan.gateway.arm.states import Inhibit
from cardan.gateway.arm.status import ArmStatus, Phase
from cardan.gateway.arm.vocab import Action
from cardan.gateway.force.rendering import ForceRenderer
from cardan.gateway.operator.feedback import ArmFeedback, OperatorFeedback
from cardan.gateway.operator.filters import registry as filter_registry
from cardan.gateway.operator.filters.base import TwistFilter
from cardan.gateway.session.assembly import check_buttons, check_mode, has_output
from cardan.gateway.session.config import SessionConfig
from cardan.gateway.session.device_sharing import GIVE, TAKE, DeviceLease
from cardan.gateway.session.driver_assembly import using_driver
from cardan.gateway.session.snapshot import (
    BOUNDS_S,
    ArmSnapshot,
    LoopSnapshot,
    RobotSnapshot,
    Snapshot,
    TrackingSnapshot,
)
from cardan.gateway.session.stop_and_requests import ChannelClient, RequestWorker
from cardan.gateway.session.supervisor_heartbeat import BEAT, SupervisorHeartbeat
from cardan.spatial import norm, subtract
from cardan.types import (
    IDENTITY_POSE,
    NEVER_S,
    ZERO3,
    DeviceFeedback,
    DeviceLink,
    Pose,
    RobotLink,
    RobotState,
)

if TYPE_CHECKING:  # Imports the messages of the network, which most sessions do without.
    from cardan.gateway.bus.neighbors import ArmNeighbors
    from cardan.gateway.session.network import SessionNetwork

REFUSAL_SHOWN_S: Final = 3.0
"""Time for which the refusal of a press of the enable button is shown."""

LISTEN_PERIOD_S: Final = 0.025
"""Period of reading the channel while the supervisor sends only beats: saves a system call in most
cycles. After its first request the channel is read in each cycle."""

PACKETS_AT_ONCE: Final = 16
"""Most packets read from the channel in one cycle: a flood of them costs no deadline."""

IN_MOTION: Final = (Phase.MOVING, Phase.BRAKING)


class Now(NamedTuple):
    """Input of a snapshot, beside the data of the parts."""

    cycle: Cycle
    status: ArmStatus
    time_s: float


@dataclass(frozen=True)
class Whole:
    """Session data shared by its parts."""

    config: SessionConfig
    robot: RobotDriver
    controller: ArmController
    lease: DeviceLease | None
    """Opens and closes the device, which other sessions may have."""
    link: LoopLink
    worker: RequestWorker
    network: SessionNetwork | None

    @cached_property
    def calls(self) -> RobotCalls:
        """Context around calls of the robot's driver."""
        return RobotCalls(self.robot)

    def tcp(self, state: RobotState) -> Pose | None:
        """Return the measured TCP: the robot's own pose, or the pose by the arm's model if that has
        a tool or the robot reports joints alone. None if the position of a lost robot is unknown.
        """
        commanded, arm = self.controller.commanded, self.config.arm
        # A verb may have changed the tool.
        same_tool = commanded.tool == IDENTITY_POSE and (arm is None or arm.has_no_tool)
        if isinstance(commanded, TaskSpaceArm) or (state.pose is not None and same_tool):
            return state.pose
        return commanded.reported(state) if state.link is RobotLink.LIVE else None


class Part:
    """Base of a part of a session; a part overrides only the hooks that it needs."""

    fault = ""
    """Reason why no source may move the arm now; empty while one may."""

    def __init__(self, whole: Whole) -> None:
        self.whole = whole
        self.cost = LatencyHistogram()
        """Times that `after` takes, in some of the cycles."""

    def open(self) -> None:
        """Prepare before the robot is opened. Raises DriverError or ConfigurationError."""

    def begin(self, now_s: float) -> None:
        """Prepare for the first cycle."""

    def after(self, cycle: Cycle, now_s: float) -> None:
        """Run once in each cycle, after its command has been sent."""

    def tell(self, snapshot: Snapshot, now: Now) -> None:
        """Fill in the part's own fields ten times a second, and add to the diagnosis."""

    def close(self) -> None:
        """Clean up after the robot was closed, or never opened. Never raises; idempotent."""


class Figures(Part):
    """Figures of the arm: its status, the latency of its answers, its following error."""

    def __init__(self, whole: Whole) -> None:
        super().__init__(whole)
        self._ticks, self._input_ages = LatencyHistogram(), LatencyHistogram()
        self._cycles = self._moving_cycles = 0
        self._square_sum_m2 = self._error_max_m = self._path_m = self._moving_s = 0.0
        self._error_m: float | None = None

    def after(self, cycle: Cycle, now_s: float) -> None:
        state, device, _, _ = cycle
        if not state.ready:
            return
        self._ticks.add(now_s - state.stamp_s)
        self._cycles += 1
        if device is not None and device.link is DeviceLink.LIVE:
            self._input_ages.add(now_s - device.stamp_s)
        controller = self.whole.controller
        if controller.phase not in IN_MOTION:
            return
        commanded = controller.commanded
        if not isinstance(commanded, TaskSpaceArm):
            # An arm's model may have a tool that the robot's own pose does not know of.
            error_m = controller.reference.ahead_m
        elif state.pose is not None:
            error_m = norm(subtract(commanded.pose.position, state.pose.position))
        else:
            return
        self._error_m = error_m
        self._square_sum_m2 += error_m * error_m
        self._moving_cycles += 1
        self._error_max_m = max(self._error_max_m, error_m)
        self._path_m += norm(commanded.twist.linear) * controller.advanced_s
        self._moving_s += state.period_s

    def tell(self, snapshot: Snapshot, now: Now) -> None:
        status, state, before = now.status, now.cycle.robot, snapshot.robot
        snapshot.arm = self._arm(status, state.stamp_s, snapshot.arm.reference)
        snapshot.tracking, snapshot.loop = self._tracking(status.phase), self._loop()
        metrics, errors = before.metrics, before.errors
        try:
            robot = self.whole.robot
            snapshot.diagnosis += checked_lines(robot.diagnosis())
            metrics, errors = counted(robot.metrics()), dict(robot.protocol_errors())
        except Exception as error:
            snapshot.diagnosis.append(f"the robot's driver failed: {reason(error)}")
        pose = self.whole.tcp(state) if state.pose is None else state.pose
        snapshot.robot = RobotSnapshot(
            state.link.value,
            state.hold_reason,
            state.joints,
            before.pose if pose is None else (*pose.position, *pose.orientation),
            state.utilization,
            metrics,
            errors,
        )

    def _arm(self, status: ArmStatus, now_s: float, reference: tuple[float, ...]) -> ArmSnapshot:
        """Fill in the arm's snapshot. `reference`: the previous one."""
        authority, controller, pose = status.authority, self.whole.controller, status.pose
        arm = status.arm
        return ArmSnapshot(
            phase=status.phase.value,
            message=status.message,
            trips=status.trips,
            authority=authority.owner,
            authority_s=now_s - authority.since_s if authority.owner else None,
            authority_refused=authority.refused,
            stops=controller.stops,
            stopped_by=controller.stopped_by,
            reference=reference if pose is None else (*pose.position, *pose.orientation),
            twist=(*status.twist.linear, *status.twist.angular),
            lead_used=status.lead_used,
            at_workspace_limit=status.at_workspace_limit,
            filters=status.filters,
            path_speed=None if arm is None else arm.path_speed,
            clearance_m=None if arm is None else arm.distance_m,
            nearest_pair=() if arm is None else arm.nearest_pair,
            limits=tuple(status.limits()),
            limits_in_words=() if arm is None else tuple(arm.in_words()),
        )

    def _tracking(self, phase: Phase) -> TrackingSnapshot:
        cycles = self._moving_cycles
        return TrackingSnapshot(
            self._path_m,
            self._moving_s,
            self._error_m if phase in IN_MOTION else None,
            math.sqrt(self._square_sum_m2 / cycles) if cycles else 0.0,
            self._error_max_m,
        )

    def _loop(self) -> LoopSnapshot:
        ticks, ages = self._ticks, self._input_ages
        return LoopSnapshot(
            self._cycles,
            ticks.percentile(50),
            ticks.percentile(99),
            ticks.max,
            ticks.sum,
            tuple(ticks.within(BOUNDS_S)),
            ages.count,
            ages.sum,
            tuple(ages.within(BOUNDS_S)),
        )


class Gripper(Part):
    """The gripper on an output of the robot, moved by buttons of the operator device and by
    verbs."""

    _closed = False

    def after(self, cycle: Cycle, now_s: float) -> None:
        operator = self.whole.controller.operator
        if operator is not None and operator.mapping.gripper_closed is not self._closed:
            self._move(operator.mapping.gripper_closed)

    def tell(self, snapshot: Snapshot, now: Now) -> None:
        snapshot.gripper_closed = self._closed

    def act(self, action: Action) -> None:
        """Carry out an action for a verb, from any thread."""
        if action is Action.STOP:
            raise CommandError("a gripper on an output of the robot cannot stop half way")
        closed = action is Action.CLOSE

        def move() -> None:
            self._move(closed)
            if (operator := self.whole.controller.operator) is not None:
                operator.mapping.gripper_closed = closed

        self.whole.link.do(move)

    def _move(self, closed: bool) -> None:
        options, robot = self.whole.config.gripper, self.whole.robot
        self._closed = closed
        value = options.closed_value if closed else options.open_value
        with self.whole.calls:
            if isinstance(options.output, str):
                robot.set_outputs(digital=value > 0)
            else:
                values = list(robot.output_values())
                values += [0.0] * (options.output + 1 - len(values))
                values[options.output] = value
                robot.set_outputs(values=values)


class Operator(Part):
    """The operator device: its lease, its buttons beside motion, and the filters."""

    def __init__(
        self, whole: Whole, device: OperatorDevice, lease: DeviceLease, begins_with_device: bool
    ) -> None:
        """`begins_with_device`: other sessions may have it at first."""
        super().__init__(whole)
        assert whole.controller.operator is not None
        self._input, self._device, self._lease = whole.controller.operator, device, lease
        self._begins_with_device = begins_with_device
        self._known_buttons: tuple[str, ...] = ()
        self._passes = 0
        self._refused, self._pressed_s = "", NEVER_S
        """Reason why the last press of the enable button was refused, and when."""
        self._opened: list[TwistFilter] = []

    def open(self) -> None:
        config, device, robot = self.whole.config, self._device, self.whole.robot
        gripper = config.gripper
        if self._begins_with_device:
            with using_driver(config.device, "device"):
                self._lease.begin()
        if gripper.buttons and not has_output(gripper, robot.capabilities):
            raise ConfigurationError(
                "gripper.output", f"the robot has no output {gripper.output!r}"
            )
        if config.mapping.enable and type(robot).enable is RobotDriver.enable:
            raise ConfigurationError(
                "mapping.enable", "this robot is enabled at its own controller; leave it out"
            )
        check_mode(config.mapping, device)
        check_buttons(config, device)
        for index, each in enumerate(self._input.filters):
            self._opened.append(each)
            with filter_registry.using(each.name, f"filters.{index}.filter"):
                each.open()

    def after(self, cycle: Cycle, now_s: float) -> None:
        device, events, mapping = cycle.device, cycle.events, self._input.mapping
        if not events or device is None:
            return
        if mapping.presses_enable(events, cycle.robot.stamp_s):
            self._refused, self._pressed_s = mapping.not_at_rest(device), now_s
            if not self._refused:
                with self.whole.calls:
                    self.whole.robot.enable()
        if mapping.passes_on(events):
            self._passes += 1

    def tell(self, snapshot: Snapshot, now: Now) -> None:
        s, device, state = snapshot, self._device, now.cycle.device
        held = self._lease.held
        metrics: dict[str, float] = {}
        errors = s.device.errors
        if held:
            try:
                self._look_at_buttons()
                s.diagnosis += checked_lines(device.diagnosis())
                errors = dict(device.protocol_errors())
                metrics = counted(device.metrics())
            except Exception as error:
                s.diagnosis.append(f"the device's driver failed: {reason(error)}")
        s.device = replace(s.device, held=held, passes=self._passes, metrics=metrics, errors=errors)
        if state is not None:
            s.device = replace(
                s.device,
                link=state.link.value,
                reason=state.reason,
                axes=state.axes,
                buttons=tuple(sorted(state.buttons)),
                battery=state.battery,
            )
        if self._lease.problem:
            s.diagnosis.insert(0, self._lease.problem)
        if self._refused and now.time_s - self._pressed_s < REFUSAL_SHOWN_S:
            enable = self._input.mapping.options.enable
            s.diagnosis.insert(
                0, f"{enable!r} enables nothing while {self._refused}: let go, then press it again"
            )
        for each in self._opened:
            try:
                s.diagnosis += checked_lines(each.diagnosis())
            except Exception as error:
                s.diagnosis.append(f"the filter {each.name} failed: {reason(error)}")

    def _look_at_buttons(self) -> None:
        """Report configured buttons that the open device does not have."""
        known = self._device.capabilities.buttons
        if known == self._known_buttons:
            return
        self._known_buttons, self._input.complaint = known, ""
        try:
            check_buttons(self.whole.config, self._device)
        except ConfigurationError as error:
            self._input.complaint = str(error)

    def close(self) -> None:
        while self._opened:
            close_in_order(self._opened.pop())
        self._lease.close()


class Feedback(Part):
    """Feedback on the operator device by its light and motor."""

    def __init__(self, whole: Whole, device: OperatorDevice, lease: DeviceLease) -> None:
        super().__init__(whole)
        self._device, self._lease = device, lease
        self._channels: Collection[str] = ()
        self._feedback = OperatorFeedback(whole.config.feedback, ())

    def open(self) -> None:
        """Set the feedback that the device can show: an open device may have more channels."""
        channels = self._device.capabilities.feedback
        if channels != self._channels:
            self._channels = channels
            self._feedback = OperatorFeedback(self.whole.config.feedback, channels)

    def after(self, cycle: Cycle, now_s: float) -> None:
        feedback = self._feedback
        if feedback.useful and feedback.due(now_s):
            arm_feedback = arm_feedback_of(self.whole.controller.status())
            if self.whole.network is not None:
                arm_feedback = arm_feedback._replace(asked=self.whole.network.rumble(now_s))
            self._send(feedback.update(arm_feedback, cycle.robot, now_s))

    def tell(self, snapshot: Snapshot, now: Now) -> None:
        if self._lease.held:
            with contextlib.suppress(Exception):  # The part of the operator reports it.
                self.open()

    def close(self) -> None:
        self._send(self._feedback.last())

    def _send(self, feedback: DeviceFeedback | None) -> None:
        """Send feedback; a failing light or motor does not stop the session, since the link itself
        is monitored."""
        if feedback is not None:
            with contextlib.suppress(Exception):
                self._device.feedback(feedback)


class Forces(Part):
    """The forces that a haptic device renders."""

    def __init__(self, whole: Whole, force: ForceRenderer) -> None:
        super().__init__(whole)
        self._force = force
        self._source = contextlib.ExitStack()

    def open(self) -> None:
        if self._force.measured is not None:
            self._source.enter_context(self._force.measured.source)
        self._force.start(self.whole.tcp)

    def after(self, cycle: Cycle, now_s: float) -> None:
        if cycle.device is None:
            return
        force, controller = self._force, self.whole.controller
        at_rest = controller.at_rest and not controller.following
        lost = force.cycle(cycle.robot, cycle.device, controller.device_map(), at_rest)
        if lost:
            controller.inhibit(lost, Inhibit.ONCE)
        elif force.watchdog.in_doubt:
            controller.inhibit("the force is in doubt", Inhibit.MOTION_IGNORED)

    def tell(self, snapshot: Snapshot, now: Now) -> None:
        said = set(snapshot.diagnosis)
        snapshot.diagnosis += [line for line in self._force.diagnosis() if line not in said]
        snapshot.force = self._force.report()
        if self._force.measured is not None:
            snapshot.contact = self._force.measured.report()

    def close(self) -> None:
        with self._source:
            self._force.stop()


class Requests(Part):
    """The requests of programs, beside the loop."""

    def after(self, cycle: Cycle, now_s: float) -> None:
        self.whole.worker.turn(now_s)
        if self.whole.worker.busy:
            self.whole.worker.run_due()

    def tell(self, snapshot: Snapshot, now: Now) -> None:
        snapshot.refusals = self.whole.worker.refusals()

    def close(self) -> None:
        self.whole.worker.close()


class Neighbors(Part):
    """Neighboring arms that move by themselves; while they are unknown no source moves the arm."""

    def __init__(self, whole: Whole, neighbors: ArmNeighbors) -> None:
        super().__init__(whole)
        self._neighbors = neighbors

    def begin(self, now_s: float) -> None:
        self.fault = self._neighbors.turn(now_s)

    def after(self, cycle: Cycle, now_s: float) -> None:
        self._neighbors.hear(now_s, time.time_ns())
        self.fault = self._neighbors.turn(now_s)

    def tell(self, snapshot: Snapshot, now: Now) -> None:
        snapshot.diagnosis += self._neighbors.diagnosis()


class BusPart(Part):
    """Part that connects the arm to the bus."""

    def __init__(self, whole: Whole, network: SessionNetwork, join: Callable[[], None]) -> None:
        """`join` opens the network."""
        super().__init__(whole)
        self._network, self.open = network, join  # type: ignore[method-assign]

    def after(self, cycle: Cycle, now_s: float) -> None:
        network, state = self._network, cycle.robot
        network.poll(now_s)
        if cycle.device is not None:
            network.show_device(cycle.device, now_s)
        if network.due(now_s):
            status, verbs = self.whole.controller.status(), self.whole.worker.verbs
            network.publish(state, self.whole.tcp(state), status, verbs, now_s, time.time_ns())
        network.publish_cycle(cycle, now_s)

    def tell(self, snapshot: Snapshot, now: Now) -> None:
        snapshot.diagnosis += self._network.diagnosis()
        self._network.tell(snapshot, now.time_s, time.time_ns())

    def close(self) -> None:
        self.whole.worker.close()  # The network answers requests under way.
        self._network.close()


class Supervisor(Part):
    """Connection to the process that started this one: its beats and requests; it gets the
    snapshots."""

    def __init__(self, whole: Whole, channel: socket.socket, gone: Callable[[str], None]) -> None:
        """`gone` is called with the reason once that process has ended."""
        super().__init__(whole)
        self._channel: socket.socket | None = channel
        self._client, self._gone = ChannelClient(channel), gone
        self._next_s = -math.inf

    def begin(self, now_s: float) -> None:
        silence_s = self.whole.controller.supervision.watchdogs.heartbeat_s
        self._heartbeat = SupervisorHeartbeat(silence_s, now_s)

    def after(self, cycle: Cycle, now_s: float) -> None:
        if now_s < self._next_s:
            return
        worker, channel, lease = self.whole.worker, self._channel, self.whole.lease
        if channel is not None and not worker.full:
            with contextlib.suppress(OSError):  # No packet waits; or tell() finds its end.
                for _ in range(PACKETS_AT_ONCE):
                    packet = channel.recv(MAX_REQUEST_BYTES + 1)
                    if packet == BEAT:
                        self._heartbeat.heard(now_s)
                    elif packet in (TAKE, GIVE):
                        if lease is not None:
                            lease.want(packet == TAKE)
                    elif packet:
                        worker.offer(self._client, packet, now_s)
                    else:
                        break
        self.fault = self._heartbeat.fault(now_s)
        self._next_s = now_s if worker.busy else now_s + LISTEN_PERIOD_S

    def tell(self, snapshot: Snapshot, now: Now) -> None:
        if self._channel is None:
            return
        try:
            self._channel.send(snapshot.to_bytes())
        except BlockingIOError:
            pass  # The reader is slow; a newer snapshot follows.
        except OSError:
            self._channel = None
            self._gone("the process that started this session is gone")


def arm_feedback_of(status: ArmStatus) -> ArmFeedback:
    """Return the feedback to the operator for `status`."""
    asked = status.target.linear != ZERO3 or status.target.angular != ZERO3
    held = status.arm is not None and bool(status.arm.in_words())
    return ArmFeedback(
        status.phase in (Phase.HOLDING, Phase.MOVING),
        status.trips,
        asked and (status.at_workspace_limit or held),
        status.lead_used,
    )
