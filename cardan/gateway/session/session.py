"""A session: one robot, its sources, one plain loop in one thread of a process of its own.

The robot is the clock: each of its control instants is answered from the loop's own turn, with
no queue between. The process holds nothing else, because any other busy thread would show in the
loop's latency; views and recorders live in other processes and get snapshots.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import logging
import math
import socket
import sys
import time
from collections.abc import Collection
from typing import TYPE_CHECKING, Any

from cardan.common.histogram import LatencyHistogram
from cardan.common.logs import LogFormat, log_to_stderr
from cardan.common.output import dropping_text
from cardan.common.plugins import reason
from cardan.common.realtime import ask_for_real_time, share_interpreter_promptly
from cardan.common.resource_errors import shortage
from cardan.common.signals import ignore_ending, take_ending
from cardan.drivers.base import OperatorDevice, RobotDriver
from cardan.drivers.foreign import RobotCalls, close_in_order, counted, told
from cardan.errors import (
    CardanError,
    CommandError,
    ConfigurationError,
    DriverError,
)
from cardan.gateway.arm.body import FreeBody
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.link import LoopLink
from cardan.gateway.arm.loop import ArmLoop
from cardan.gateway.arm.requests import MAX_REQUEST_BYTES
from cardan.gateway.arm.states import Inhibit
from cardan.gateway.arm.status import ArmStatus, Phase
from cardan.gateway.arm.vocab import Action
from cardan.gateway.force.rendering import ForceRenderer
from cardan.gateway.operator.feedback import Felt, HandFeedback
from cardan.gateway.operator.filters import registry as filter_registry
from cardan.gateway.operator.filters.base import TwistFilter
from cardan.gateway.session.assembly import (
    check_buttons,
    check_mode,
    has_output,
    make_controller,
    make_device,
    make_force,
    make_neighbours,
    make_network,
    make_robot,
    make_verbs,
    using_driver,
)
from cardan.gateway.session.config import SessionConfig, parse_config
from cardan.gateway.session.device_sharing import GIVE, TAKE, DeviceLease
from cardan.gateway.session.heartbeat import BEAT, Heartbeat
from cardan.gateway.session.request_worker import ChannelClient, RequestWorker
from cardan.gateway.session.snapshot import BOUNDS_S, Snapshot
from cardan.spatial import norm, subtract
from cardan.types import (
    IDENTITY_POSE,
    ZERO3,
    DeviceFeedback,
    DeviceLink,
    DeviceState,
    Pose,
    RobotState,
)

if TYPE_CHECKING:  # Imports the messages of the network, which most sessions do without.
    from cardan.gateway.bus.neighbours import ArmNeighbours
    from cardan.gateway.session.network import SessionNetwork

SNAPSHOT_PERIOD_S = 0.1
"""A person reads no faster; at 250 Hz one tick in 25 bears the cost, after its answer was sent."""

LISTEN_PERIOD_S = 0.025
"""Period of reading the channel while the supervisor only beats: a system call, saved in most
cycles. After its first request the channel is read in each cycle."""

PACKETS_AT_ONCE = 16
"""Most packets read from the channel in one cycle: a flood of them costs no deadline."""

STOPPED_ON_REQUEST = "stopped on request"
"""The ending of a session whose supervisor asked for it, as after a Ctrl-C."""

BRAKE_TIMEOUT_S = 5.0
"""Longest wait of a stopping session for its robot to come to rest."""


_IN_MOTION = (Phase.MOVING, Phase.BRAKING)


class Session:
    """The loop. Build it from a configuration with :func:`make_session`."""

    def __init__(
        self,
        device: OperatorDevice | None,
        robot: RobotDriver,
        controller: ArmController,
        config: SessionConfig,
        channel: socket.socket | None = None,
        force: ForceRenderer | None = None,
        has_device: bool = True,
    ) -> None:
        """`channel`: the supervisor's beats and requests; `force`: what a haptic device renders;
        `has_device`: whether it begins with the device, which other sessions may have."""
        self.device = device
        self._has_device = has_device
        self._known_buttons: tuple[str, ...] = ()
        self._lease: DeviceLease | None = None
        self.robot, self._calls = robot, RobotCalls(robot)
        self.controller = controller
        self.snapshot = Snapshot()
        self._config = config
        self._gripper_closed = False
        self._link = LoopLink()
        self._requests: RequestWorker | None = None
        self._network: SessionNetwork | None = None
        if channel is not None:
            self._supervisor = ChannelClient(channel)
        if channel is not None or config.network is not None:
            self._requests = RequestWorker(
                self._link,
                lambda: make_verbs(self._config, robot, controller, self._act),
                controller.stop,
                time.monotonic,
            )
            worker = self._requests
            self._network = make_network(config, robot, worker.offer, lambda: worker.full)
        self._neighbours = make_neighbours(config, robot, controller)
        self._supervisor_fault = ""
        self._channel = channel
        self._force = force
        self._ticks = LatencyHistogram()
        self._input_ages = LatencyHistogram()
        self._square_sum_m2 = 0.0
        self._moving_cycles = 0
        self._error_m: float | None = None
        self._feedback = HandFeedback(config.feedback, ())
        self._channels: Collection[str] = ()
        self._stop_reason = ""

    def stop(self, reason: str) -> None:
        """Ask for the end: brake, hold, then leave. May be called from a signal handler."""
        self._stop_reason = self._stop_reason or reason

    def run(self, seconds: float = math.inf) -> Snapshot:
        """Run until stopped or until `seconds` are over; returns the last snapshot.

        Raises DriverError when the device, a filter or the robot cannot be opened, or the robot's
        driver fails.
        """
        with contextlib.ExitStack() as opened:
            device, controller, config = self.device, self.controller, self._config
            if device is not None:
                self._lease = DeviceLease(device)
                opened.callback(self._lease.close)
                if self._has_device:
                    with using_driver(config.device, "device"):
                        self._lease.begin()
                self._check(config, device)
                self._fit_feedback(device)
            for index, each in enumerate(self._filters):
                opened.callback(close_in_order, each)
                with filter_registry.using(each.name, f"filters.{index}.filter"):
                    each.open()
            if self._force is not None:
                opened.callback(self._force.stop)
                if self._force.measured is not None:
                    opened.enter_context(self._force.measured.source)
                self._force.start(self._tcp)
            if self._network is not None:
                opened.callback(self._network.close)
                measured = None if self._force is None else self._force.measured
                source = None if measured is None else measured.source
                self._network.open(controller, self.robot, device, source, self._neighbours)
            # The loop makes no cycles of references worth collecting, and a collection in it
            # costs milliseconds. All this comes before the robot is opened, because its
            # datagrams do not wait.
            gc.collect()
            gc.freeze()
            gc.disable()
            try:
                with using_driver(config.robot, "robot"):
                    self.robot.open()
                self._link.begin()
                self._loop(seconds)
            finally:
                close_in_order(self.robot)
                self._end_requests()
                gc.enable()
                gc.unfreeze()
                self._send_feedback(self._feedback.last())
        return self.snapshot

    def _fit_feedback(self, device: OperatorDevice) -> None:
        """Give the operator what the device can show: an open one may be able to do more."""
        channels = device.capabilities.feedback
        if channels != self._channels:
            self._channels = channels
            self._feedback = HandFeedback(self._config.feedback, channels)

    def _look_at_buttons(self, device: OperatorDevice) -> None:
        """Have the operator told of configured buttons that the device, open by now, has not."""
        known = device.capabilities.buttons
        if known == self._known_buttons or self.controller.hand is None:
            return
        self._known_buttons, self.controller.hand.complaint = known, ""
        try:
            check_buttons(self._config, device)
        except ConfigurationError as error:
            self.controller.hand.complaint = str(error)

    def _end_requests(self) -> None:
        self._link.end("the session has ended: " + (self.snapshot.ending or "its robot is closed"))
        if self._requests is not None:
            self._requests.close()

    def _check(self, config: SessionConfig, device: OperatorDevice) -> None:
        options, gripper = config.mapping, config.gripper
        buttons = gripper.buttons
        if buttons and not has_output(gripper, self.robot.capabilities):
            raise ConfigurationError(
                "gripper.output", f"the robot has no output {gripper.output!r}"
            )
        if options.enable and type(self.robot).enable is RobotDriver.enable:
            raise ConfigurationError(
                "mapping.enable", "this robot is enabled at its own controller; leave it out"
            )
        check_mode(options, device)
        check_buttons(config, device)

    @property
    def _filters(self) -> tuple[TwistFilter, ...]:
        return () if self.controller.hand is None else self.controller.hand.filters

    def _loop(self, seconds: float) -> None:
        robot, controller = self.robot, self.controller
        operator = controller.hand
        force = self._force
        monotonic, tick_cost = time.monotonic, self._ticks.add
        input_age, live = self._input_ages.add, DeviceLink.LIVE
        requests, network = self._requests, self._network
        neighbours = self._neighbours
        start_s = monotonic()
        if neighbours is not None:
            self._heed(neighbours, start_s)
        heartbeat = None
        if self._channel is not None:
            heartbeat = Heartbeat(controller.supervision.watchdogs.heartbeat_s, start_s)
        end_s = start_s + seconds
        next_snapshot_s = next_listen_s = start_s
        give_up_s = math.inf
        snapshot = self.snapshot
        state: RobotState | None = None
        for cycle in ArmLoop(robot, controller, self.device).cycles():
            state, hand, events, _ = cycle
            now_s = monotonic()
            # Everything from here on is bookkeeping: the answer has left.
            if state.ready:
                tick_cost(now_s - state.stamp_s)
                snapshot.cycles += 1
                if hand is not None and hand.link is live:
                    input_age(now_s - hand.stamp_s)
                if controller.phase in _IN_MOTION:
                    self._update_figures(state)
            if requests is not None:
                requests.turn(now_s)
            if requests is not None and requests.busy:
                requests.attend()
            if operator is not None and hand is not None:
                mapping = operator.mapping
                if mapping.gripper_closed is not self._gripper_closed:
                    self._move_gripper(mapping.gripper_closed)
                if events and mapping.asks_to_enable(hand, events, state.stamp_s):
                    with self._calls:
                        robot.enable()
                if events and mapping.passes_on(events):
                    snapshot.device_passes += 1
                if force is not None:
                    at_rest = controller.at_rest and not controller.following
                    disengage_reason = force.cycle(state, hand, controller.hand_map(), at_rest)
                    if disengage_reason:
                        controller.inhibit(disengage_reason, Inhibit.ONCE)
                    elif force.guard.in_doubt:
                        controller.inhibit("the force is in doubt", Inhibit.MOTION_IGNORED)
                hand_feedback = self._feedback
                if hand_feedback.useful and hand_feedback.due(now_s):
                    felt = felt_of(controller.status())
                    if network is not None:
                        felt = felt._replace(asked=network.rumble(now_s))
                    self._send_feedback(hand_feedback.update(felt, state, now_s))
            if heartbeat is not None and now_s >= next_listen_s:
                self._listen(heartbeat, now_s)
                asked = requests is not None and requests.busy
                next_listen_s = now_s if asked else now_s + LISTEN_PERIOD_S
            if neighbours is not None:
                neighbours.hear(now_s, time.time_ns())
                self._heed(neighbours, now_s)
            if network is not None:
                network.poll(now_s)
                if hand is not None:
                    network.show_device(hand, now_s)
                if network.due(now_s):
                    verbs = None if requests is None else requests.verbs
                    status = controller.status()
                    now_ns = time.time_ns()
                    network.publish(state, self._tcp(state), status, verbs, now_s, now_ns)
                network.tap(cycle, now_s)
            if self._stop_reason or now_s >= end_s:
                if give_up_s == math.inf:
                    snapshot.ending = self._stop_reason or "the session's time is over"
                    controller.inhibit(snapshot.ending, Inhibit.FOR_GOOD)
                    give_up_s = now_s + BRAKE_TIMEOUT_S
                if controller.at_rest or not state.ready or now_s >= give_up_s:
                    break
            if now_s >= next_snapshot_s:
                next_snapshot_s = now_s + SNAPSHOT_PERIOD_S
                self._publish(state, hand, now_s - start_s)
        else:
            if state is None:
                raise self._calls.failed("cycles() gave no state")
            snapshot.ending = snapshot.ending or "the robot's driver ended its cycles() by itself"
        if state is not None:
            snapshot.finished = True
            self._publish(state, cycle.device, monotonic() - start_s)

    def _listen(self, heartbeat: Heartbeat, now_s: float) -> None:
        """Take the supervisor's beats and requests; without beats no source moves the arm."""
        channel, requests = self._channel, self._requests
        if channel is not None and requests is not None and not requests.full:
            try:
                for _ in range(PACKETS_AT_ONCE):
                    packet = channel.recv(MAX_REQUEST_BYTES + 1)
                    if packet == BEAT:
                        heartbeat.heard(now_s)
                    elif packet in (TAKE, GIVE):
                        if self._lease is not None:
                            self._lease.want(packet == TAKE)
                    elif packet:
                        requests.offer(self._supervisor, packet, now_s)
                    else:
                        break
            except BlockingIOError:
                pass
            except OSError:
                pass  # _tell() finds out the same and ends the session.
        self._supervisor_fault = heartbeat.fault(now_s)
        if self._neighbours is None:
            self.controller.inhibit(self._supervisor_fault, Inhibit.WHILE_SAID)

    def _heed(self, neighbours: ArmNeighbours, now_s: float) -> None:
        """Place the neighbours; without them no source moves the arm either."""
        fault = neighbours.turn(now_s)
        self.controller.inhibit(self._supervisor_fault or fault, Inhibit.WHILE_SAID)

    def _tcp(self, state: RobotState) -> Pose | None:
        """The measured TCP: the robot's own pose, or by the arm's model where that has a tool, or
        the robot reports joints alone."""
        body, arm = self.controller.body, self._config.arm
        # A verb may have changed the tool.
        same_tool = body.tool == IDENTITY_POSE and (arm is None or arm.has_no_tool)
        if isinstance(body, FreeBody) or (state.pose is not None and same_tool):
            return state.pose
        return body.reported(state) if state.ready else None

    def _update_figures(self, state: RobotState) -> None:
        """Keep the figures of the summary: path, and following error."""
        controller = self.controller
        reference, body = controller.reference, controller.body
        if not isinstance(body, FreeBody):
            # An arm's model may have a tool that the robot's own pose does not know of.
            error_m = reference.ahead_m
        elif state.pose is not None:
            error_m = norm(subtract(body.pose.position, state.pose.position))
        else:
            return
        self._error_m = error_m
        self._square_sum_m2 += error_m * error_m
        self._moving_cycles += 1
        snapshot = self.snapshot
        snapshot.error_max_m = max(snapshot.error_max_m, error_m)
        snapshot.path_m += norm(body.twist.linear) * controller.advanced_s
        snapshot.moving_s += state.period_s

    def _act(self, action: Action) -> None:
        """Act on the gripper for a verb, from any thread."""
        if action is Action.STOP:
            raise CommandError("a gripper on an output of the robot cannot stop half way")
        closed = action is Action.CLOSE

        def act() -> None:
            self._move_gripper(closed)
            if self.controller.hand is not None:
                self.controller.hand.mapping.gripper_closed = closed

        self._link.do(act)

    def _move_gripper(self, closed: bool) -> None:
        table = self._config.gripper
        self._gripper_closed = closed
        value = table.closed_value if closed else table.open_value
        with self._calls:
            if isinstance(table.output, str):
                self.robot.set_outputs(digital=value > 0)
            else:
                values = list(self.robot.output_values())
                values += [0.0] * (table.output + 1 - len(values))
                values[table.output] = value
                self.robot.set_outputs(values=values)

    def _send_feedback(self, feedback: DeviceFeedback | None) -> None:
        """Send feedback to the device. A light or motor that fails is no reason to stop: the link
        itself is watched elsewhere."""
        if feedback is not None and self.device is not None:
            with contextlib.suppress(Exception):
                self.device.feedback(feedback)

    def _publish(self, state: RobotState, hand: DeviceState | None, elapsed_s: float) -> None:
        status = self.controller.status()
        s = self.snapshot
        s.elapsed_s = elapsed_s
        s.phase, s.message, s.trips = status.phase.value, status.message, status.trips
        if hand is not None:
            s.device_link, s.device_reason = hand.link.value, hand.reason
            s.axes, s.buttons, s.battery = list(hand.axes), sorted(hand.buttons), hand.battery
        authority = status.authority
        s.authority, s.authority_refused = authority.owner, authority.refused
        s.stops, s.stopped_by = self.controller.stops, self.controller.stopped_by
        s.authority_s = state.stamp_s - authority.since_s if authority.owner else None
        s.robot_link, s.hold_reason = state.link.value, state.hold_reason
        s.sequence, s.joints_rad = state.sequence, list(state.joints)
        pose = state.pose
        if pose is None:
            pose = self._tcp(state)
        if pose is not None:
            s.pose = [*pose.position, *pose.orientation]
        if status.pose is not None:
            s.reference = [*status.pose.position, *status.pose.orientation]
        s.twist = [*status.twist.linear, *status.twist.angular]
        s.leash_used, s.at_workspace_limit = status.leash_used, status.at_workspace_limit
        s.gripper_closed, s.utilization = self._gripper_closed, state.utilization
        if status.arm is not None:
            s.path_speed, s.singular_value = (
                status.arm.path_speed,
                status.arm.smallest_singular_value,
            )
            s.clearance_m, s.nearest_pair = status.arm.distance_m, list(status.arm.nearest_pair)
            s.arm_limits = status.arm.in_words()
        s.limits = status.limits()
        s.error_m = self._error_m if status.phase in _IN_MOTION else None
        if self._moving_cycles:
            s.error_rms_m = math.sqrt(self._square_sum_m2 / self._moving_cycles)
        s.tick_p50_s, s.tick_p99_s = self._ticks.percentile(50), self._ticks.percentile(99)
        s.tick_max_s, s.tick_sum_s = self._ticks.max, self._ticks.sum
        s.tick_within = self._ticks.within(BOUNDS_S)
        s.inputs, s.input_age_sum_s = self._input_ages.count, self._input_ages.sum
        s.input_age_within = self._input_ages.within(BOUNDS_S)
        if self._requests is not None:
            s.refusals = self._requests.refusals()
        s.filters = list(status.filters)
        try:
            s.diagnosis = told(self.robot.diagnosis())
            s.metrics = counted(self.robot.metrics())
            s.robot_errors = dict(self.robot.protocol_errors())
        except Exception as error:
            s.diagnosis = [f"the robot's driver failed: {reason(error)}"]
        if self.device is not None and self._lease is not None:
            s.device_held = self._lease.held
            if s.device_held:
                try:
                    self._fit_feedback(self.device)
                    self._look_at_buttons(self.device)
                    s.diagnosis += told(self.device.diagnosis())
                    s.device_errors = dict(self.device.protocol_errors())
                except Exception as error:
                    s.diagnosis.append(f"the device's driver failed: {reason(error)}")
            if self._lease.problem:
                s.diagnosis.insert(0, self._lease.problem)
        for each in self._filters:
            try:
                s.diagnosis += told(each.diagnosis())
            except Exception as error:
                s.diagnosis.append(f"the filter {each.name} failed: {reason(error)}")
        if self._force is not None:
            said = set(s.diagnosis)
            s.diagnosis += [line for line in self._force.diagnosis() if line not in said]
            for name, value in self._force.report().items():
                setattr(s, name, value)
        if self._neighbours is not None:
            s.diagnosis += self._neighbours.diagnosis()
        if self._network is not None:
            s.diagnosis += self._network.diagnosis()
            self._network.tell(s, time.monotonic(), time.time_ns())
        self._tell(s)

    def _tell(self, snapshot: Snapshot) -> None:
        if self._channel is None:
            return
        try:
            self._channel.send(snapshot.to_bytes())
        except BlockingIOError:
            pass  # The reader is slow; a newer snapshot follows.
        except OSError:
            self._channel = None
            self.stop("the process that started this session is gone")


def make_session(
    config: SessionConfig, channel: socket.socket | None = None, has_device: bool = True
) -> Session:
    """A session as configured, nothing opened yet."""
    robot = make_robot(config)
    controller = make_controller(config, robot)
    device = None if config.device is None else make_device(config)
    force = None if device is None else make_force(config, device, robot)
    return Session(device, robot, controller, config, channel, force, has_device)


def felt_of(status: ArmStatus) -> Felt:
    """The feedback to the operator for `status`."""
    asked = status.target.linear != ZERO3 or status.target.angular != ZERO3
    held = status.arm is not None and bool(status.arm.in_words())
    return Felt(
        status.phase in (Phase.HOLDING, Phase.MOVING),
        status.trips,
        asked and (status.at_workspace_limit or held),
        status.leash_used,
    )


# ---------------------------------------------------------------------------------------------
# The session's own process: python -m cardan.gateway.session.session

EXIT_OK = 0
EXIT_INTERNAL = 1
EXIT_CONFIGURATION = 2
EXIT_CANNOT_OPEN = 3


def main(arguments: list[str] | None = None) -> int:
    """Run the session whose configuration comes as JSON on standard input."""
    parser = argparse.ArgumentParser(prog="cardan-session")
    parser.add_argument("--channel-fd", type=int, required=True)
    parser.add_argument("--seconds", type=float, default=math.inf)
    parser.add_argument("--log-level", type=int, default=logging.WARNING)
    parser.add_argument("--log-format", type=LogFormat, default=LogFormat.TEXT)
    parser.add_argument("--without-device", action="store_true")
    options = parser.parse_args(arguments)
    sys.stdout, sys.stderr = dropping_text(1), dropping_text(2)
    log_to_stderr(options.log_level, options.log_format)
    channel = socket.socket(fileno=options.channel_fd)
    channel.setblocking(False)
    table: dict[str, Any] = json.load(sys.stdin)
    last = Snapshot(finished=True)
    code = EXIT_INTERNAL
    try:
        config = parse_config(table, from_file=False)
        session = make_session(config, channel, not options.without_device)

        take_ending(lambda _signal: session.stop(STOPPED_ON_REQUEST))
        last = session.snapshot
        last.scheduling = ask_for_real_time()
        share_interpreter_promptly()
        session.run(options.seconds)
        code = EXIT_OK
    except ConfigurationError as error:
        code, last.error = EXIT_CONFIGURATION, str(error)
    except DriverError as error:
        code, last.error = EXIT_CANNOT_OPEN, str(error)
    except CardanError as error:
        last.error = str(error)
    except Exception as error:
        last.error = shortage(error)
        if not last.error:
            raise
    if last.error:
        last.finished = True
        channel.setblocking(True)
        channel.send(last.to_bytes())
    return code


if __name__ == "__main__":
    EXIT_CODE = main()
    # It has left its robot; who asked it twice (a login session: SIGTERM, SIGHUP) gets its code.
    ignore_ending()
    sys.exit(EXIT_CODE)
