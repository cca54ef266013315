"""Scenario that is a MotoROS client's controller: several firmwares in turn, with disturbances."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from cardan.conform.controllers import COME
from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Scenario, Script, Step, ask, close, mark, open_, send
from cardan.conform.timeline import Kind, WireEvent
from cardan.protocols.simple_message.codes import ActiveMode
from cardan.sim_peers.motoros_controller import (
    MotorosController,
    MotorosControllerOptions,
    MotorosServers,
)
from cardan.sim_peers.motoros_controller.faults import FAULT_ALARM
from cardan.sim_peers.motoros_controller.servers import PORT_KINDS, PortKind

ROBOT = "gp8"
"""The arm of the controllers."""
SERVO_ON_S = 0.2
STREAMS_WITHIN_S = 0.3
"""A client streams if its newest command is no older than this, or a trajectory plays."""
GREETED_S = 0.3
TRIES = 3
STOPPED_S = 0.5
SILENT_S = 0.6
ANSWERED_WITHIN_S = 5.0
"""Time for which a request stays unanswered, unless its client times out sooner."""
LATE_MS = 60.0
BUSY = 5
WRONG_REPLIES_S = 0.8
JUNK = b"HTTP/1.1 400 Bad Request\r\n\r\n"
LEFT_S = 4.0


def port_of(channel: str) -> str:
    """Return the port of a channel: "motion" of "motion 3", the third connection to any port."""
    return channel.partition(" ")[0]


class Halt(NamedTuple):
    """Stop of motion at the controller, and its release."""

    begin: Callable[[MotorosController, float], None]
    end: Callable[[MotorosController, float], None]


STOPS = {
    "estop": Halt(MotorosController.emergency_stop, MotorosController.release_emergency_stop),
    "alarm": Halt(lambda it, now_s: it.alarm(FAULT_ALARM, now_s), MotorosController.reset_alarm),
    "teach": Halt(
        lambda it, now_s: it.mode("teach", now_s), lambda it, now_s: it.mode("play", now_s)
    ),
    "hold": Halt(lambda it, now_s: it.hold(True, now_s), lambda it, now_s: it.hold(False, now_s)),
    "servo-off": Halt(
        lambda it, now_s: it.servo(False, now_s), lambda it, now_s: it.servo(True, now_s)
    ),
    # START_TRAJ_MODE itself releases the stop.
    "pfl": Halt(MotorosController.collaborative_stop, lambda _it, _now_s: None),
}


class Firmware(NamedTuple):
    """A controller, and the disturbances it goes through."""

    name: str
    velocity_mode: bool
    big_endian: bool
    befalls: tuple[str, ...]


FIRMWARE = (
    Firmware(
        "velocity",
        True,
        False,
        ("pieces", "estop", "teach", "servo-off", "silence", "unanswered", "stale", "cut", "junk"),
    ),
    Firmware("fs100", False, True, ()),
    Firmware(
        "stock",
        False,
        False,
        (
            "pieces",
            "busy",
            "refused-start",
            "estop",
            "hold",
            "alarm",
            "pfl",
            "late",
            "silence",
            "unanswered",
            "stale",
            "cut",
        ),
    ),
)
"""The velocity mode is an extension of MotoROS; controllers without it serve any client."""


class MotorosControllerScenario(Scenario):
    """The simulated controllers, run by a script. No real arm moves.

    An open port listens; each client that connects is a channel of its own, with a number after
    the port's name.
    """

    def __init__(self, level: Level, seconds: float) -> None:
        self._level = level
        self._seconds = seconds
        self._controller = MotorosController()
        self._servers = MotorosServers(self._controller, self._controller.options)
        self._numbers: dict[str, int] = {}
        """Connection numbers of the servers, by the channels of clients."""
        self._came_s = 0.0
        """Connection time of the newest client of the motion port."""
        self._mute = False
        """True while the state port is silent."""

    # -- received data ----------------------------------------------------------------------------

    def answer(self, event: WireEvent) -> Iterator[Step]:
        channel, now_s, servers = event.channel, self.now_s, self._servers
        kind: PortKind | None = next((k for k in PORT_KINDS if k == port_of(channel)), None)
        if kind is None or channel == kind:
            return
        if event.kind is Kind.OPENED:
            number = servers.accepted(kind, now_s)
            if number is None:
                yield close(channel)
            else:
                self._numbers[channel] = number
                if kind == "motion":
                    self._came_s = now_s
        elif channel in self._numbers:
            if event.kind is Kind.DATA:
                servers.data(self._numbers[channel], event.data, now_s)
            elif event.kind is Kind.CLOSED:
                servers.eof(self._numbers.pop(channel), now_s)
        yield from self._written()

    def _written(self) -> Iterator[Step]:
        """Yield the servers' writes and closes."""
        servers = self._servers
        channels = {number: channel for channel, number in self._numbers.items()}
        for number, data in servers.outgoing():
            channel = channels.get(number)
            if channel is not None and not (self._mute and port_of(channel) == "state"):
                yield send(data, channel)
        for number in (*servers.closing(), *servers.aborting()):
            channel = channels.get(number)
            if channel is not None:
                del self._numbers[channel]
                yield close(channel)

    def _connected(self, port: str = "motion") -> bool:
        return any(port_of(each) == port for each in self._numbers)

    def _streams(self) -> bool:
        """True if commands of the client act."""
        controller = self._controller
        if controller.active_mode is ActiveMode.NONE or not self._connected():
            return False
        age_s = controller.newest_command_age_s
        is_its_own = age_s < self.now_s - self._came_s
        return is_its_own and (age_s < STREAMS_WITHIN_S or controller.moving_data)

    # -- the script -------------------------------------------------------------------------------

    def script(self) -> Script:
        if self._level < Level.HOLD:
            return
        for port in PORT_KINDS:
            yield open_(port)
        for firmware in FIRMWARE:
            yield from self._power_up(firmware)
            if not self._connected():
                return
            yield from self._in_use(firmware)
            last = firmware is FIRMWARE[-1]
            if self._level >= Level.BY_HAND and (firmware.velocity_mode or last):
                yield from self._ended(firmware, last)

    def _power_up(self, firmware: Firmware) -> Script:
        """Replace the controller by the next one."""
        for channel in tuple(self._numbers):
            yield close(channel)
        self._numbers.clear()
        options = MotorosControllerOptions(
            robot=ROBOT,
            velocity_mode=firmware.velocity_mode,
            big_endian=firmware.big_endian,
            servo_on_s=SERVO_ON_S,
            plant="ideal" if firmware.velocity_mode else "paper",
        )
        self._controller = MotorosController(options)
        self._servers = MotorosServers(self._controller, options)
        yield mark(f"{firmware.name} connect")
        yield from self._serve(COME * self._seconds + 1.0, self._connected)
        yield from self._serve(GREETED_S)

    def _in_use(self, firmware: Firmware) -> Script:
        name = firmware.name
        yield mark(f"{name} refused")
        self._controller.hold(True, self.now_s)
        yield from self._enable()
        yield from self._serve(STOPPED_S)
        self._controller.hold(False, self.now_s)
        yield from self._serve(0.1)
        for what in ("run", *firmware.befalls):
            yield mark(f"{name} before-{what}")
            if what != "refused-start":
                yield from self._run()
                if not self._streams():
                    return
            yield mark(f"{name} {what}")
            yield from self._befall(what, f"{name} {what}")

    def _run(self) -> Script:
        """Wait until the client is connected and moves the arm, if it does."""
        for _ in range(TRIES):
            yield from self._serve(COME * self._seconds, self._connected)
            if not self._streams():
                yield from self._serve(GREETED_S)
            if not self._streams():
                yield from self._enable()
                yield from self._serve(COME * self._seconds, self._streams)
            yield from self._serve(0.5 * self._seconds)
            if self._streams():
                return

    def _enable(self) -> Script:
        yield ask("enable", "Have the driver start motion, and move slowly.")

    def _befall(self, what: str, phase: str) -> Script:
        controller = self._controller
        if what == "run":
            yield from self._serve(self._seconds)
        elif what in STOPS:
            STOPS[what].begin(controller, self.now_s)
            yield from self._serve(STOPPED_S)
            yield mark(f"{phase} over")
            STOPS[what].end(controller, self.now_s)
            yield from self._serve(STOPPED_S)
        elif what == "pieces":
            for fault in ("split", "merge"):
                yield from self._behaves({fault: 1.0}, self._seconds)
        elif what == "busy":
            controller.busy_answers = BUSY
            yield from self._serve(self._seconds)
            controller.busy_answers = 0
        elif what == "refused-start":
            yield from self._refused_start()
        elif what == "late":
            yield from self._behaves({"late": LATE_MS}, self._seconds)
        elif what == "silence":
            self._mute = True
            yield from self._serve(SILENT_S)
            self._mute = False
        elif what == "unanswered":
            left_s = ANSWERED_WITHIN_S + 0.5
            yield from self._behaves({"drop-reply": 1.0}, left_s, lambda: not self._connected())
            yield from self._hang_up("motion")
        elif what == "stale":
            yield from self._behaves({"stale-reply": 1.0}, WRONG_REPLIES_S)
        else:
            if what == "cut":
                yield from self._hang_up("motion")
            else:
                for channel in self._numbers:
                    if port_of(channel) == "state":
                        yield send(JUNK, channel)
                yield from self._serve(STOPPED_S)
                yield mark(f"{phase} over")
            yield from self._serve(COME * self._seconds, lambda: self._connected("state"))
            yield from self._serve(COME * self._seconds, self._connected)
            yield from self._serve(STOPPED_S)

    def _behaves(
        self, faults: dict[str, float], seconds: float, until: Callable[[], bool] | None = None
    ) -> Script:
        """Serve with these faults for `seconds`, or until `until`."""
        self._servers.behave(faults)
        yield from self._serve(seconds, until)
        self._servers.behave({})

    def _refused_start(self) -> Script:
        """Refuse a first point as for a sagging arm: the client starts motion again."""
        yield from self._hang_up("motion")
        yield from self._serve(COME * self._seconds, self._connected)
        yield from self._serve(GREETED_S)
        self._controller.refused_starts = 1
        yield from self._run()
        self._controller.refused_starts = 0

    def _hang_up(self, port: str) -> Script:
        """Close the connections of a port."""
        for channel in tuple(self._numbers):
            if port_of(channel) == port:
                self._servers.lost(self._numbers[channel], self.now_s, "hung up")
        yield from self._written()

    def _ended(self, firmware: Firmware, last: bool) -> Script:
        yield mark(f"{firmware.name} before-end")
        yield from self._run()
        if not self._streams():
            return
        yield mark(f"{firmware.name} end")
        yield ask("end", "End the driver's program while the arm moves.")
        left_s = max(LEFT_S, self._seconds)
        yield from self._serve(left_s, lambda: not self._numbers)
        if not last:
            yield mark(f"{firmware.name} begin")
            yield ask("begin", "Start the driver's program again.")

    def _serve(self, seconds: float, until: Callable[[], bool] | None = None) -> Script:
        """Serve for `seconds`, or until `until`."""
        end_s = self.now_s + seconds
        while until is None or not until():
            self._servers.advance(self.now_s)
            yield from self._written()
            if self.now_s >= end_s:
                return
            next_s = min(max(self._servers.next_s, self.now_s + 1e-4), end_s)
            yield Pause(next_s - self.now_s)
