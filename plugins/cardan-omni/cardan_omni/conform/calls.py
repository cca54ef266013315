"""Calls of an HDAPI library's functions by requests, and their recorded answers.

A request is a JSON list, a function's name and its arguments; an answer is an object with both, the
results, and the errors that were on the library's stack then. A tick of the scheduler is recorded
as an object, too, with a frame's values. Requests, answers and ticks together replace the network
traffic that other protocols have.
"""

from __future__ import annotations

import ctypes
import json
import math
from bisect import bisect_right
from collections import deque
from collections.abc import Callable
from typing import Any

from cardan_omni.driver.library import MOST_ERRORS, SIGNATURES, ErrorInfo, LibHD
from cardan_omni.protocol import (
    DEFAULT_SCHEDULER_PRIORITY,
    INVALID_HANDLE,
    CallbackCode,
    Error,
    Info,
    State,
)

GREATEST_N = 0.2
"""Largest force ever set, N: the first force that the driver sets, which does not startle the
operator and is less than the friction of the mechanism."""
FORCE, END_CALLBACK, ERROR_STACK = "force", "end-callback", "error-stack"
"""Requests that are not functions of the library: a force profile as pairs of time (s) and upward
force (N) that the callback sets; a callback that ends itself; and two errors at once, to see in
which order they are returned."""
MOST_TICKS = 20_000
"""Most ticks kept unread."""

_VALUES: dict[str, Any] = {
    "hdGetBooleanv": ctypes.c_ubyte,
    "hdGetIntegerv": ctypes.c_int,
    "hdGetFloatv": ctypes.c_float,
    "hdGetDoublev": ctypes.c_double,
    "hdGetLongv": ctypes.c_long,
    "hdSetBooleanv": ctypes.c_ubyte,
    "hdSetIntegerv": ctypes.c_int,
    "hdSetFloatv": ctypes.c_float,
    "hdSetDoublev": ctypes.c_double,
    "hdSetLongv": ctypes.c_long,
}
_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p)
_ROOM = 16
"""Size of value buffers: more than any parameter needs."""


def request(call: str, *arguments: object) -> bytes:
    """Encode a request as bytes."""
    return json.dumps([call, *arguments]).encode()


class HdCalls:
    """Program that uses a library. `clock` gives the time of ticks, s; `ticked` is called after
    each, in the scheduler's thread."""

    def __init__(
        self,
        library: LibHD,
        clock: Callable[[], float],
        ticked: Callable[[], None] = lambda: None,
    ) -> None:
        self._functions: dict[str, Any] = {
            name: ctypes.CFUNCTYPE(result, *arguments)(library.functions[name])
            for name, (result, arguments) in SIGNATURES.items()
        }
        self._clock, self._ticked = clock, ticked
        self._callback = _CALLBACK(self._tick)
        self._ticks: deque[dict[str, Any]] = deque(maxlen=MOST_TICKS)
        self._course: tuple[tuple[float, float], ...] = ()
        self._course_s = 0.0
        self._ending = self._started = False
        self._handle = INVALID_HANDLE
        self._scheduled = 0

    @property
    def began(self) -> bytes:
        """Facts known without a call: the available functions."""
        return json.dumps({"functions": sorted(self._functions)}).encode()

    def ticks(self) -> list[bytes]:
        """Return the ticks since the last call."""
        found = []
        while self._ticks:
            found.append(json.dumps(self._ticks.popleft()).encode())
        return found

    def do(self, words: bytes) -> bytes:
        """Execute a request and return its answer."""
        call, *arguments = json.loads(words)
        answer: dict[str, Any] = {"call": call, "arguments": arguments}
        if call == FORCE:
            self._course_s = self._clock()
            self._course = tuple((s, _bounded(n)) for s, n in arguments[0])
        elif call == END_CALLBACK:
            self._ending = True
        elif call == ERROR_STACK:
            for each in arguments:
                self._call(*each)
        elif call == "hdGetError":
            answer["errors"] = [_error(self._functions[call]())]
            return json.dumps(answer).encode()
        else:
            answer["returns"], answer["values"] = self._call(call, *arguments)
        answer["errors"] = self._errors()
        return json.dumps(answer).encode()

    def end(self) -> None:
        """Clear the force, stop the scheduler and close the device, whatever was requested
        before."""
        self._course = ()
        if self._started:
            self._call("hdStopScheduler")
        if self._scheduled:
            self._call("hdUnschedule", self._scheduled)
        if self._handle != INVALID_HANDLE:
            self._call("hdDisableDevice", self._handle)
        self._errors()

    def _call(self, call: str, *arguments: Any) -> tuple[Any, list[float]]:
        """Return the function's result and its output values."""
        function = self._functions[call]
        if call in _VALUES:
            given = arguments[1] if call.startswith("hdSet") else ()
            values = (_VALUES[call] * _ROOM)(*given)
            function(arguments[0], values)
            count = 0 if call.startswith("hdSet") else arguments[1]
            return None, [_plain(each) for each in values[:count]]
        if call == "hdScheduleAsynchronous":
            self._ending = False
            self._scheduled = function(self._callback, None, DEFAULT_SCHEDULER_PRIORITY)
            return self._scheduled, []
        said = function(*(a.encode() if isinstance(a, str) else a for a in arguments))
        if call == "hdInitDevice" and said != INVALID_HANDLE:
            self._handle = said
        elif call == "hdDisableDevice" and arguments[0] == self._handle:
            self._handle = INVALID_HANDLE
        elif call == "hdUnschedule":
            self._scheduled = 0
        elif call in ("hdStartScheduler", "hdStopScheduler"):
            self._started = call == "hdStartScheduler"
        return said.decode("utf-8", "replace") if isinstance(said, bytes) else said, []

    def _errors(self) -> list[list[int]]:
        """Return all errors of the stack, newest first."""
        found = []
        for _ in range(MOST_ERRORS):
            error = _error(self._functions["hdGetError"]())
            if error[0] == Error.SUCCESS:
                break
            found.append(error)
        return found

    # -- in the scheduler ----------------------------------------------------------------------

    def _tick(self, _user: object) -> int:
        if self._ending:
            return CallbackCode.DONE
        functions, handle = self._functions, self._handle
        functions["hdBeginFrame"](handle)
        tick: dict[str, Any] = {"tick": self._clock()}
        for name, call, what, count in _READ:
            values = (_VALUES[call] * _ROOM)()
            functions[call](what, values)
            tick[name] = [_plain(each) for each in values[:count]]
        force_n = self._force(tick["tick"])
        functions["hdSetDoublev"](State.CURRENT_FORCE, (ctypes.c_double * 3)(0.0, force_n, 0.0))
        functions["hdEndFrame"](handle)
        tick["set"] = force_n
        tick["errors"] = self._errors()
        self._ticks.append(tick)
        self._ticked()
        return CallbackCode.CONTINUE

    def _force(self, now_s: float) -> float:
        """Force of the course, linear between its points, N; zero beyond it."""
        course, since_s = self._course, now_s - self._course_s
        at = bisect_right(course, since_s, key=lambda point: point[0])
        if not 0 < at < len(course):
            return 0.0
        (a_s, a_n), (b_s, b_n) = course[at - 1 : at + 1]
        return _bounded(a_n + (b_n - a_n) * (since_s - a_s) / (b_s - a_s))


_READ = (
    ("buttons", "hdGetIntegerv", State.CURRENT_BUTTONS, 1),
    ("inkwell", "hdGetBooleanv", State.CURRENT_INKWELL_SWITCH, 1),
    ("encoders", "hdGetLongv", State.CURRENT_ENCODER_VALUES, 6),
    ("position", "hdGetDoublev", State.CURRENT_POSITION, 3),
    ("velocity", "hdGetDoublev", State.CURRENT_VELOCITY, 3),
    ("transform", "hdGetDoublev", State.CURRENT_TRANSFORM, 16),
    ("joints", "hdGetDoublev", State.CURRENT_JOINT_ANGLES, 3),
    ("temperature", "hdGetDoublev", Info.MOTOR_TEMPERATURE, 3),
    ("force", "hdGetDoublev", State.CURRENT_FORCE, 3),
    ("last", "hdGetDoublev", State.LAST_FORCE, 3),
)
"""Values that a frame reads: name, function, parameter, count of numbers."""


def _bounded(force_n: float) -> float:
    return max(-GREATEST_N, min(GREATEST_N, force_n)) if math.isfinite(force_n) else 0.0


def _error(info: ErrorInfo) -> list[int]:
    return [info.errorCode, info.internalErrorCode, info.hHD]


def _plain(value: float) -> float:
    """Return the value for JSON; 1e300 replaces a value that is not finite."""
    return value if not isinstance(value, float) or math.isfinite(value) else 1e300
