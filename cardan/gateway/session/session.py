"""A session: one robot, its sources, one plain loop in one thread of a process of its own.

The robot is the clock: each of its control instants is answered directly by the loop, without a
queue. The process does nothing else, because any other busy thread would show in the loop's
latency; views and recorders live in other processes and get snapshots.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import gc
import json
import logging
import math
import socket
import sys
import time
from typing import Any

from cardan.common.logs import LogFormat, log_to_stderr
from cardan.common.output import dropping_text
from cardan.common.realtime import (
    ask_for_real_time,
    keep_processors_awake,
    share_interpreter_promptly,
)
from cardan.common.resource_errors import shortage
from cardan.common.signals import ignore_ending, take_ending
from cardan.drivers.base import OperatorDevice, RobotDriver
from cardan.drivers.foreign import RobotCalls, close_in_order
from cardan.errors import CardanError, ConfigurationError, DriverError
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.loop import ArmLoop, Cycle
from cardan.gateway.arm.loop_link import LoopLink
from cardan.gateway.arm.states import Inhibit
from cardan.gateway.force.rendering import ForceRenderer
from cardan.gateway.session.arm_assembly import make_neighbors
from cardan.gateway.session.assembly import make_controller, make_network, make_robot, make_verbs
from cardan.gateway.session.config import SessionConfig, parse_config
from cardan.gateway.session.device_sharing import DeviceLease
from cardan.gateway.session.driver_assembly import make_device, using_driver
from cardan.gateway.session.force_assembly import make_force
from cardan.gateway.session.parts import (
    BusPart,
    Feedback,
    Figures,
    Forces,
    Gripper,
    Neighbors,
    Now,
    Operator,
    Part,
    Requests,
    Supervisor,
    Whole,
)
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.stop_and_requests import RequestWorker

SNAPSHOT_PERIOD_S = 0.1
"""Period of snapshots: an operator reads no faster; at 250 Hz one tick in 25 bears the cost, after
its answer was sent."""

STOPPED_ON_REQUEST = "stopped on request"
"""Ending of a session on its supervisor's request, as after a Ctrl-C."""

BRAKE_TIMEOUT_S = 5.0
"""Longest wait of a stopping session for its robot to come to rest."""


class Session:
    """Loop of a session. Build it from a configuration with :func:`make_session`."""

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
        """`channel`: the supervisor's beats and requests; `force`: that of a haptic device;
        `has_device`: whether it begins with the device, which other sessions may share."""
        self.device, self.robot, self.controller = device, robot, controller
        self.snapshot = Snapshot()
        self._config, self._link = config, LoopLink()
        self._stop_reason = self._inhibited = ""
        worker = RequestWorker(
            self._link,
            lambda: make_verbs(config, robot, controller, gripper.act),
            controller.stop,
            time.monotonic,
        )
        lease = None if device is None else DeviceLease(device)
        network = make_network(config, robot, worker.offer, lambda: worker.full)
        neighbors = make_neighbors(config, robot, controller)
        whole = Whole(config, robot, controller, lease, self._link, worker, network)
        gripper = Gripper(whole)
        self._parts: list[Part] = [Figures(whole), gripper]
        if device is not None and lease is not None:
            self._parts.append(Operator(whole, device, lease, has_device))
            if force is not None:
                self._parts.append(Forces(whole, force))
            self._parts.append(Feedback(whole, device, lease))
        if neighbors is not None:
            self._parts.append(Neighbors(whole, neighbors))
        if channel is not None or network is not None:
            self._parts.append(Requests(whole))
        if network is not None:
            measured = None if force is None else force.measured
            source = None if measured is None else measured.source
            join = functools.partial(network.open, controller, robot, device, source, neighbors)
            self._parts.append(BusPart(whole, network, join))
        if channel is not None:
            self._parts.append(Supervisor(whole, channel, self.stop))

    def stop(self, reason: str) -> None:
        """Request the end: brake, hold, then leave. May be called from a signal handler."""
        self._stop_reason = self._stop_reason or reason

    def run(self, seconds: float = math.inf) -> Snapshot:
        """Run until stopped or until `seconds` are over; returns the last snapshot.

        Raises DriverError when the device, a filter or the robot cannot be opened, or the robot's
        driver fails.
        """
        with contextlib.ExitStack() as opened:
            for part in self._parts:
                opened.callback(part.close)
                part.open()
            # The loop makes no cycles of references worth collecting, and a collection in it
            # costs milliseconds. All this comes before the robot is opened, because its
            # datagrams do not wait.
            gc.collect()
            gc.disable()
            try:
                with using_driver(self._config.robot, "robot"):
                    self.robot.open()
                self._link.begin()
                self._loop(seconds)
            finally:
                close_in_order(self.robot)
                ending = self.snapshot.ending or "its robot is closed"
                self._link.end(f"the session has ended: {ending}")
                gc.enable()
        return self.snapshot

    def _loop(self, seconds: float) -> None:
        parts, controller, snapshot, monotonic = (
            self._parts,
            self.controller,
            self.snapshot,
            time.monotonic,
        )
        start_s = next_snapshot_s = monotonic()
        end_s, give_up_s = start_s + seconds, math.inf
        for part in parts:
            part.begin(start_s)
        self._heed_faults()
        cycle = None
        for cycle in ArmLoop(self.robot, controller, self.device).cycles():
            now_s = monotonic()
            # Everything from here on is bookkeeping: the answer has been sent.
            snapshot_is_due = now_s >= next_snapshot_s
            if snapshot_is_due:
                self._account(cycle, now_s)
            else:
                for part in parts:
                    part.after(cycle, now_s)
            self._heed_faults()
            if self._stop_reason or now_s >= end_s:
                if give_up_s == math.inf:
                    snapshot.ending = self._stop_reason or "the session's time limit is reached"
                    controller.inhibit(snapshot.ending, Inhibit.FOR_GOOD)
                    give_up_s = now_s + BRAKE_TIMEOUT_S
                if controller.at_rest or not cycle.robot.ready or now_s >= give_up_s:
                    break
            if snapshot_is_due:
                next_snapshot_s = now_s + SNAPSHOT_PERIOD_S
                self._publish(cycle, now_s - start_s)
        else:
            if cycle is None:
                raise RobotCalls(self.robot).failed("cycles() returned no state")
            snapshot.ending = snapshot.ending or "the robot's driver ended its cycles() by itself"
        snapshot.finished = True
        self._publish(cycle, monotonic() - start_s)

    def _heed_faults(self) -> None:
        """Inhibit all sources while a part reports a fault: the last part's reason counts, which is
        the supervisor's if there is one."""
        fault = ""
        for part in self._parts:
            fault = part.fault or fault
        if fault != self._inhibited:
            self._inhibited = fault
            self.controller.inhibit(fault, Inhibit.WHILE_SAID)

    def _account(self, cycle: Cycle, now_s: float) -> None:
        """Run the parts after a cycle, and measure the cost of each."""
        clock = time.perf_counter
        start_s = clock()
        for part in self._parts:
            part.after(cycle, now_s)
            end_s = clock()
            part.cost.add(end_s - start_s)
            start_s = end_s

    def _publish(self, cycle: Cycle, elapsed_s: float) -> None:
        snapshot = self.snapshot
        snapshot.elapsed_s, snapshot.diagnosis = elapsed_s, []
        snapshot.part_cost_s = {type(part).__name__.lower(): part.cost.mean for part in self._parts}
        now = Now(cycle, self.controller.status(), time.monotonic())
        for part in self._parts:
            part.tell(snapshot, now)


def make_session(
    config: SessionConfig, channel: socket.socket | None = None, has_device: bool = True
) -> Session:
    """Make a session as configured, nothing opened yet."""
    robot = make_robot(config)
    controller = make_controller(config, robot)
    device = None if config.device is None else make_device(config)
    force = None if device is None else make_force(config, device, robot)
    return Session(device, robot, controller, config, channel, force, has_device)


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
        keep_processors_awake(awake=True)
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
    # It has left its robot; a second signal (a login session: SIGTERM, SIGHUP) keeps its code.
    ignore_ending()
    sys.exit(EXIT_CODE)
