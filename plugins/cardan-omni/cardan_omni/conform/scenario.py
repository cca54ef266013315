"""Scenario of a haptic program: initializes a device, queries it, runs its scheduler, closes it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial

from cardan.conform.hands import HAND_S
from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Scenario, Script, Step, ask, mark, open_, send
from cardan.conform.timeline import Kind, WireEvent
from cardan_omni.conform.calls import END_CALLBACK, ERROR_STACK, FORCE, GREATEST_N, request
from cardan_omni.driver.library import RATE_HZ
from cardan_omni.protocol import INVALID_HANDLE, Capability, Error, Info, State, WaitCode

NOBODY = "cardan: there is no such device"
NO_ENUM = 0x2FFF
"""Code that is no parameter's."""
NO_HANDLE = 0x7FFFFF00
STRINGS = (Info.VERSION, Info.DEVICE_MODEL_TYPE, Info.DEVICE_VENDOR, Info.DEVICE_SERIAL_NUMBER)
DOUBLES = {
    Info.MAX_WORKSPACE_DIMENSIONS: 6,
    Info.USABLE_WORKSPACE_DIMENSIONS: 6,
    Info.NOMINAL_MAX_STIFFNESS: 1,
    Info.NOMINAL_MAX_FORCE: 1,
    Info.NOMINAL_MAX_CONTINUOUS_FORCE: 1,
}
"""Number of values of each parameter."""
SETTLE_S = 0.1
ANSWER_S = 0.02
"""Time for which a phase continues after its last request: answers in it belong to the phase."""
STILL_S = 0.6
"""Time after which a hand that moved the stylus somewhere is at rest."""
RAMP_S = 0.2
MOVES = 2.0
"""Share of a phase's length that is for motion by hand."""
WIRE = ""


class HdapiScenario(Scenario):
    """Level 0 only loads the library; force is zero up to level 1."""

    def __init__(self, level: Level, seconds: float) -> None:
        self._level, self._seconds = level, seconds
        self._hand_s = min(HAND_S, 4.0 * seconds)
        self._handle, self._scheduled = INVALID_HANDLE, 0
        self._buttons = self._inkwell = 0
        self._troubled = False

    def answer(self, event: WireEvent) -> Iterator[Step]:
        if event.kind is Kind.DATA:
            said = json.loads(event.data)
            if "tick" in said:
                (self._buttons,), (self._inkwell,) = said["buttons"], said["inkwell"]
                self._troubled = bool(said["errors"])
            elif said.get("call") == "hdInitDevice":
                self._handle = said["returns"]
            elif said.get("call") == "hdScheduleAsynchronous":
                self._scheduled = said["returns"]
        return iter(())

    def script(self) -> Script:
        yield open_(WIRE)
        yield mark("load")
        yield Pause(0.05)
        if self._level < Level.HOLD:
            return
        yield mark("without-device")
        yield send(request("hdGetError"))
        yield send(request("hdGetErrorString", Error.COMM_ERROR))
        yield send(request("hdInitDevice", NOBODY))
        yield mark("init")
        yield send(request("hdInitDevice", None))
        yield Pause(SETTLE_S)
        if self._handle == INVALID_HANDLE:
            return
        yield send(request("hdGetCurrentDevice"))
        yield mark("ask")
        yield from self._questions()
        yield mark("start")
        yield send(request("hdSetSchedulerRate", RATE_HZ))
        yield send(request("hdScheduleAsynchronous"))
        yield send(request("hdStartScheduler"))
        yield from self._served()
        if self._level >= Level.MOVE:
            yield from self._pushed()
        if self._level >= Level.BY_HAND:
            yield mark("unplug")
            self._troubled = False
            yield ask("unplug", "Pull the device's plug.")
            yield Pause(self._hand_s, lambda: self._troubled)
            yield Pause(SETTLE_S)
        yield mark("end-callback")
        yield send(request(END_CALLBACK))
        yield Pause(SETTLE_S)
        yield mark("ended")
        yield send(request("hdWaitForCompletion", self._scheduled, WaitCode.CHECK_STATUS))
        yield Pause(SETTLE_S)
        yield mark("let-go")
        yield send(request("hdStopScheduler"))
        yield send(request("hdDisableDevice", self._handle))
        yield send(request("hdBeginFrame", self._handle))
        yield Pause(ANSWER_S)

    def _questions(self) -> Script:
        for what in STRINGS:
            yield send(request("hdGetString", what))
        for what in (Info.INPUT_DOF, Info.OUTPUT_DOF):
            yield send(request("hdGetIntegerv", what, 1))
        for info, count in DOUBLES.items():
            yield send(request("hdGetDoublev", info, count))
        yield send(request("hdGetIntegerv", State.CURRENT_POSITION, 1))
        yield send(request("hdGetDoublev", NO_ENUM, 1))
        yield send(request("hdSetDoublev", State.CURRENT_FORCE, [0.0, 0.0, 0.0]))
        yield send(request("hdEndFrame", self._handle))
        yield send(request("hdBeginFrame", NO_HANDLE))
        yield send(request(ERROR_STACK, ["hdGetDoublev", NO_ENUM, 1], ["hdEndFrame", self._handle]))
        for call in ("hdEnable", "hdDisable"):
            yield send(request(call, Capability.FORCE_OUTPUT))
            yield send(request("hdIsEnabled", Capability.FORCE_OUTPUT))
        yield Pause(ANSWER_S)

    def _served(self) -> Script:
        yield ask("hold", "Hold the stylus still in the middle of its reach.")
        yield Pause(SETTLE_S)
        yield mark("hold")
        yield Pause(self._seconds)
        yield mark("asked")
        yield send(request("hdGetIntegerv", Info.UPDATE_RATE, 1))
        yield send(request("hdWaitForCompletion", self._scheduled, WaitCode.CHECK_STATUS))
        yield send(request("hdCheckCalibration"))
        yield Pause(ANSWER_S)
        yield mark("move")
        yield ask("move", "Move the stylus to and fro, 5 cm to each side, up and away.")
        yield Pause(MOVES * self._seconds)
        yield ask("hold", "Hold the stylus still in the middle of its reach.")
        yield Pause(SETTLE_S)
        for name, how, bits in (
            ("press", "Press the stylus' front button.", 1),
            ("release", "Release the button.", 0),
        ):
            yield mark(name)
            yield ask(name, how)
            yield Pause(self._hand_s, partial(self._has_buttons, bits))
            yield Pause(SETTLE_S)
        yield mark("dock")
        yield ask("dock", "Put the stylus into its inkwell.")
        yield Pause(self._hand_s, lambda: bool(self._inkwell))
        yield mark("undock")
        yield ask("hold", "Take the stylus out again, and hold it in the middle of its reach.")
        yield Pause(self._hand_s, lambda: not self._inkwell)
        yield Pause(STILL_S)

    def _has_buttons(self, bits: int) -> bool:
        return self._buttons == bits

    def _pushed(self) -> Script:
        yield mark("force")
        yield ask("hold", f"Hold the stylus: it is pushed upwards, by {GREATEST_N} N at most.")
        yield send(request("hdEnable", Capability.FORCE_OUTPUT))
        yield Pause(SETTLE_S)
        end_s = RAMP_S + self._seconds
        course = [[0.0, 0.0], [RAMP_S, GREATEST_N], [end_s, GREATEST_N], [end_s + RAMP_S, 0.0]]
        yield send(request(FORCE, course))
        yield Pause(end_s + RAMP_S + SETTLE_S)
        yield mark("force-over")
        yield send(request("hdDisable", Capability.FORCE_OUTPUT))
        yield Pause(SETTLE_S)
