"""Finds and loads libHD, the closed-source OpenHaptics library, and declares its functions' types.

It is loaded at run time and never shipped. Once loaded it stays until the process ends: it is known
not to survive being loaded twice.
"""

from __future__ import annotations

import contextlib
import ctypes
import locale
import os
import re
import struct
import threading
from collections.abc import Iterator, Mapping
from ctypes import (
    c_char_p,
    c_double,
    c_float,
    c_int,
    c_long,
    c_ubyte,
    c_uint,
    c_ulong,
    c_ushort,
    c_void_p as pointer,
)
from pathlib import Path
from typing import Any, NamedTuple

from cardan.errors import DeviceAccessError, DeviceNotFoundError, DriverError
from cardan_omni.protocol import INVALID_HANDLE, MAX_SCHEDULER_PRIORITY, Error, WaitCode

ENVIRONMENT = "CARDAN_LIBHD"
"""Environment variable with the library's path, if the option `library` is empty."""

NAMES = ("libHD.so.3.4", "libHD.so.3.0", "libHD.so")
"""Names tried with the system's loader, in this order, if no option names the library."""

RATE_HZ = 1000
"""Rate requested for the loop, Hz."""

PT_LOAD = 1
"""Type of an ELF segment that is mapped into memory (PT_LOAD)."""

MOST_ERRORS = 64
"""Most errors taken from the library's stack at once."""


class ErrorInfo(ctypes.Structure):
    """HDErrorInfo, which hdGetError returns by value."""

    _fields_ = (
        ("errorCode", c_uint),
        ("internalErrorCode", c_int),
        ("hHD", c_uint),
    )


_DOUBLES, _FLOATS = ctypes.POINTER(c_double), ctypes.POINTER(c_float)
_INTS, _LONGS, _BOOLEANS = ctypes.POINTER(c_int), ctypes.POINTER(c_long), ctypes.POINTER(c_ubyte)

SIGNATURES: Mapping[str, tuple[Any, tuple[Any, ...]]] = {
    "hdInitDevice": (c_uint, (c_char_p,)),
    "hdDisableDevice": (None, (c_uint,)),
    "hdMakeCurrentDevice": (None, (c_uint,)),
    "hdGetCurrentDevice": (c_uint, ()),
    "hdBeginFrame": (None, (c_uint,)),
    "hdEndFrame": (None, (c_uint,)),
    "hdGetBooleanv": (None, (c_uint, _BOOLEANS)),
    "hdGetIntegerv": (None, (c_uint, _INTS)),
    "hdGetFloatv": (None, (c_uint, _FLOATS)),
    "hdGetDoublev": (None, (c_uint, _DOUBLES)),
    "hdGetLongv": (None, (c_uint, _LONGS)),
    "hdSetBooleanv": (None, (c_uint, _BOOLEANS)),
    "hdSetIntegerv": (None, (c_uint, _INTS)),
    "hdSetFloatv": (None, (c_uint, _FLOATS)),
    "hdSetDoublev": (None, (c_uint, _DOUBLES)),
    "hdSetLongv": (None, (c_uint, _LONGS)),
    "hdGetString": (c_char_p, (c_uint,)),
    "hdEnable": (None, (c_uint,)),
    "hdDisable": (None, (c_uint,)),
    "hdIsEnabled": (c_ubyte, (c_uint,)),
    "hdGetError": (ErrorInfo, ()),
    "hdGetErrorString": (c_char_p, (c_uint,)),
    "hdCheckCalibration": (c_uint, ()),
    "hdUpdateCalibration": (None, (c_uint,)),
    "hdStartScheduler": (None, ()),
    "hdStopScheduler": (None, ()),
    "hdSetSchedulerRate": (None, (c_ulong,)),
    "hdScheduleAsynchronous": (c_ulong, (pointer, pointer, c_ushort)),
    "hdScheduleSynchronous": (None, (pointer, pointer, c_ushort)),
    "hdUnschedule": (None, (c_ulong,)),
    "hdWaitForCompletion": (c_ubyte, (c_ulong, c_uint)),
    "hdGetSchedulerTimeStamp": (c_double, ()),
}
"""Result and arguments of every function that any libHD 3 has."""

SOMETIMES: Mapping[str, tuple[Any, tuple[Any, ...]]] = {
    "hdDeploymentLicense": (c_ubyte, (c_char_p, c_char_p, c_char_p)),
    "hdCheckCalibrationStyle": (c_uint, ()),
    "hdUpdateCalibrationMessage": (None, (c_uint,)),
    "hdScaleGimbalAngles": (None, (c_double, c_double, c_double, _DOUBLES)),
}
"""Result and arguments of functions that only some libHD 3 have."""

_LICENSE = (
    "OpenHaptics has no valid license here: install the developer or academic edition's, and set "
    "OH_SDK_LICENSE_PATH where its release asks for that"
)
_SETUP = (
    "is it plugged in, powered, and set up (paired) in the vendor's setup tool for this user, and "
    "does GTDD_HOME name the folder that the tool wrote to? To try without hardware: "
    "`cardan sim omni -- PROGRAM`"
)

_WORDS: Mapping[int, str] = {
    Error.INVALID_ENUM: "a value this device does not have was asked for",
    Error.INVALID_VALUE: "a value was not allowed",
    Error.INVALID_OPERATION: "it cannot be done now",
    Error.INVALID_INPUT_TYPE: "a value was asked for as the wrong type",
    Error.BAD_HANDLE: "there is no such device",
    Error.WARM_MOTORS: "the motors are too warm",
    Error.EXCEEDED_MAX_FORCE: "the force was above the device's limit",
    Error.EXCEEDED_MAX_FORCE_IMPULSE: "the force rose faster than the device's limit",
    Error.EXCEEDED_MAX_VELOCITY: "the stylus was faster than the device's limit",
    Error.FORCE_ERROR: "two kinds of force were set at once",
    Error.DEVICE_FAULT: "the device reports a fault, or is not there",
    Error.DEVICE_ALREADY_INITIATED: "the device is already open in this program",
    Error.COMM_ERROR: "the device does not answer",
    Error.COMM_CONFIG_ERROR: "the device's connection is not configured",
    Error.TIMER_ERROR: "the library has no timer for its loop",
    Error.ILLEGAL_BEGIN: "a frame was begun twice",
    Error.ILLEGAL_END: "a frame was ended that was not begun",
    Error.FRAME_ERROR: "a value was set outside a frame",
    Error.INVALID_PRIORITY: "a priority is out of range",
    Error.SCHEDULER_FULL: "the library's loop takes no more callbacks",
    Error.INVALID_LICENSE: _LICENSE,
}


class HdError(NamedTuple):
    """Error of the library's stack."""

    code: int
    internal: int
    """Internal code of the library; few are documented."""
    device: int

    @property
    def words(self) -> str:
        """Meaning of the error, in words."""
        return error_words(self.code, self.internal)


def error_words(code: int, internal: int = 0) -> str:
    """Return the meaning of a library's error, with its codes."""
    text = _WORDS.get(code, "an error that HDAPI 3 does not name")
    number = f"0x{code:04x}" + (f", internal {internal}" if internal else "")
    if code == Error.COMM_ERROR and internal == -28:
        text += (
            " over Ethernet: give the port a link-local address (169.254.x.x), take firewalls "
            "away, and pair the device again in the vendor's setup tool"
        )
    return f"{text} ({number})"


class LibHD:
    """Loaded libHD. Its methods hold the lock of the current device where HDAPI uses one.

    Many devices share the one scheduler: it runs while any of them is scheduled.
    """

    def __init__(self, library: ctypes.CDLL, path: str) -> None:
        """Declare the functions. Raises DeviceAccessError when `library` lacks a function of
        HDAPI."""
        self.path = path
        self.functions: dict[str, int] = {}
        """Addresses by name, for compiled callers."""
        self._library = library
        self._lock = threading.RLock()
        """Lock for the current device, and for starting and stopping."""
        self._open: set[int] = set()
        self._serving: set[int] = set()
        missing = [name for name in SIGNATURES if not hasattr(library, name)]
        if missing:
            raise DeviceAccessError(f"{path} is not libHD: it has no {', '.join(missing[:3])}")
        for name, (result, arguments) in {**SIGNATURES, **SOMETIMES}.items():
            if not hasattr(library, name):
                continue
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
            self.functions[name] = ctypes.cast(function, pointer).value or 0

    def is_at(self, path: str) -> bool:
        """True if `path` names this loaded library."""
        try:
            same = ctypes.CDLL(path, mode=os.RTLD_NOLOAD | os.RTLD_LAZY)
        except OSError:
            return False
        return same._handle == self._library._handle

    # -- devices -------------------------------------------------------------------------------

    def init_device(self, name: str) -> int:
        """Open the device with that configuration name ("": the first). Returns its handle.

        Raises DeviceNotFoundError or DeviceAccessError.
        """
        with self._lock:
            # A device cannot join a running loop: the others pause briefly.
            running = bool(self._serving)
            if running:
                self._library.hdStopScheduler()
            try:
                self.errors()
                handle = int(self._library.hdInitDevice(name.encode() if name else None))
                errors = self.errors()
                serious = [error for error in errors if error.code != Error.WARM_MOTORS]
                if handle != INVALID_HANDLE and not serious:
                    self._open.add(handle)
                    return handle
                if handle != INVALID_HANDLE and handle not in self._open:
                    self._library.hdDisableDevice(handle)
            finally:
                if running:
                    self._library.hdStartScheduler()
        raise _init_failure(name, serious)

    def disable_device(self, handle: int) -> None:
        """Close a device."""
        with self._lock:
            if handle in self._open:
                self._open.discard(handle)
                self._library.hdDisableDevice(handle)
                self.errors()

    @contextlib.contextmanager
    def current(self, handle: int) -> Iterator[ctypes.CDLL]:
        """Make that device the library's current one within the block."""
        with self._lock:
            if len(self._open) > 1:
                self._library.hdMakeCurrentDevice(handle)
            yield self._library

    def string(self, handle: int, what: int) -> str:
        """Return a string parameter of the device; empty if it has none."""
        with self.current(handle) as library:
            return (library.hdGetString(what) or b"").decode("utf-8", "replace").strip()

    def integer(self, handle: int, what: int) -> int:
        """Return an integer parameter of the device; 0 if it has none."""
        value = c_int(0)
        with self.current(handle) as library:
            library.hdGetIntegerv(what, ctypes.byref(value))
        return value.value

    def doubles(self, handle: int, what: int, count: int) -> tuple[float, ...]:
        """Return numeric parameters of the device; zeros if it has none."""
        # Larger than any of HDAPI's arrays: a device with more axes writes more numbers.
        values = (c_double * max(16, count))()
        with self.current(handle) as library:
            library.hdGetDoublev(what, values)
        return tuple(values[:count])

    def set_integer(self, handle: int, what: int, value: int) -> None:
        """Set a whole number of the device."""
        with self.current(handle) as library:
            library.hdSetIntegerv(what, ctypes.byref(c_int(value)))

    def enable(self, handle: int, capability: int, on: bool) -> None:
        """Enable or disable one of the device's capabilities."""
        with self.current(handle) as library:
            (library.hdEnable if on else library.hdDisable)(capability)

    def update_calibration(self, handle: int, style: int) -> None:
        """Calibrate now."""
        with self.current(handle) as library:
            library.hdUpdateCalibration(style)

    # -- the loop ------------------------------------------------------------------------------

    def schedule(self, callback: int, user: int, handle: int) -> int:
        """Schedule the function at `callback` in every tick, before all others; start the loop.

        Returns the scheduler's handle. Raises DeviceAccessError if the loop refuses it.
        """
        with self._lock:
            if not self._serving:
                self._library.hdSetSchedulerRate(RATE_HZ)  # Not every device has a choice of rates.
            self.errors()
            scheduled = int(
                self._library.hdScheduleAsynchronous(callback, user, MAX_SCHEDULER_PRIORITY)
            )
            errors = self.errors()
            if not errors and not self._serving:
                self._library.hdStartScheduler()
                errors = [each for each in self.errors() if each.code != Error.WARM_MOTORS]
                if errors:
                    self._library.hdUnschedule(scheduled)
            if errors:
                raise DeviceAccessError(f"the force loop does not start: {errors[0].words}")
            self._serving.add(handle)
            return scheduled

    def scheduled(self, scheduled: int) -> bool:
        """Return True if the callback is still called."""
        return bool(self._library.hdWaitForCompletion(scheduled, WaitCode.CHECK_STATUS))

    def unschedule(self, scheduled: int, handle: int) -> None:
        """Unschedule the callback, with the loop stopped meanwhile: on return no call is in
        progress."""
        with self._lock:
            self._library.hdStopScheduler()
            self._library.hdUnschedule(scheduled)
            self._serving.discard(handle)
            if self._serving:
                self._library.hdStartScheduler()
            self.errors()

    def errors(self) -> list[HdError]:
        """Pop everything from the library's stack of errors, newest first."""
        found = []
        for _ in range(MOST_ERRORS):
            error = self._library.hdGetError()
            if error.errorCode == Error.SUCCESS:
                break
            found.append(HdError(error.errorCode, error.internalErrorCode, error.hHD))
        return found


def _init_failure(name: str, errors: list[HdError]) -> DriverError:
    device = f"the device {name!r}" if name else "the first device"
    error = errors[0] if errors else HdError(Error.DEVICE_FAULT, 0, INVALID_HANDLE)
    if error.code == Error.INVALID_LICENSE:
        return DeviceAccessError(error.words)
    if error.code == Error.DEVICE_ALREADY_INITIATED:
        return DeviceAccessError(f"{device} cannot be opened: {error.words}")
    words = [f"{device} cannot be opened: {error.words}", _SETUP]
    if hint := numbers_hint():
        words.append(hint)
    return DeviceNotFoundError("; ".join(words))


def numbers_hint() -> str:
    """Return the fault of the process's numeric locale, by which the library parses its files;
    empty: none."""
    point = locale.localeconv()["decimal_point"]
    if point == ".":
        return ""
    return f'LC_NUMERIC must be C, with "." in numbers: the library misreads its files by "{point}"'


# -- finding and loading -----------------------------------------------------------------------

ADVICE = (
    "install OpenHaptics and the device driver from the vendor (3D Systems), or name the library "
    f"with the option `library` or ${ENVIRONMENT}; to try without hardware: `cardan sim omni -- "
    "PROGRAM`, or the path that `cardan sim omni --library` prints"
)

_DEPENDENCIES = (
    ("libPHANToMIO", "it comes with the vendor's FireWire device driver (PHANTOM Device Drivers)"),
    ("libPhantomIOLib", "it comes with the vendor's Touch device driver"),
    ("libncurses.so.5", "Debian: apt-get install libncurses5"),
    ("libtinfo.so.5", "Debian: apt-get install libtinfo5"),
    ("libraw1394.so.8", "link it to the system's libraw1394.so.11"),
    ("libglut", "Debian: apt-get install freeglut3"),
)

_loading = threading.Lock()
_loaded: list[LibHD] = []
"""The library that this process has loaded, or None."""


def load(library: str = "") -> LibHD:
    """Load the library that the option `library`, $CARDAN_LIBHD or the system's loader names.

    Raises DeviceNotFoundError when there is none, DeviceAccessError when it cannot be loaded.
    """
    with _loading:
        named = library or os.environ.get(ENVIRONMENT, "")
        by = "the option `library`" if library else f"${ENVIRONMENT}"
        if "/" in named and not Path(named).is_file():
            raise DeviceNotFoundError(f"{by} names {named}, and there is no such file")
        if _loaded:
            only = _loaded[0]
            if named and not only.is_at(named):
                raise DeviceAccessError(
                    f"this program has loaded {only.path}, and {named} cannot be loaded beside it: "
                    "restart it"
                )
            return only
        path, loaded = _load_named(named, by) if named else _load_any()
        _loaded.append(LibHD(loaded, path))
        return _loaded[0]


def presence(library: str = "") -> tuple[str, str]:
    """Return libHD's path and the reason why it cannot be loaded, without loading it; "" for
    neither."""
    named = library or os.environ.get(ENVIRONMENT, "")
    if named and "/" in named:
        return (named, "") if Path(named).is_file() else (named, f"there is no file {named}")
    for name in (named,) if named else NAMES:
        if _known_to_loader(name):
            return name, ""
    return ("", f"there is no libHD: {ADVICE}")


def _load_named(named: str, by: str) -> tuple[str, ctypes.CDLL]:
    if "/" in named and _is_cut_off(Path(named)):
        raise DeviceAccessError(f"{named} is not whole: copy or install it again")
    try:
        return named, ctypes.CDLL(named, mode=ctypes.RTLD_GLOBAL)
    except OSError as error:
        if _is_missing(named, str(error)):
            raise DeviceNotFoundError(
                f"{by} names {named}, which the system's loader does not find: give its path"
            ) from None
        raise DeviceAccessError(_load_failure(named, str(error))) from None


def _is_cut_off(path: Path) -> bool:
    """Return True if a file ends before its segments do: the loader would map missing pages, and
    the process would crash."""
    with contextlib.suppress(OSError, struct.error), path.open("rb") as file:
        size, head = path.stat().st_size, file.read(64)
        if head[:4] != b"\x7fELF" or head[4:6] != b"\x02\x01":
            return False  # The loader's own message says what is wrong with those.
        (at,) = struct.unpack_from("<Q", head, 32)
        entry, count = struct.unpack_from("<2H", head, 54)
        file.seek(at)
        table = file.read(entry * count)
        for i in range(count):
            kind, _, start, _, _, length = struct.unpack_from("<2I4Q", table, i * entry)
            if kind == PT_LOAD and start + length > size:
                return True
        return False
    return True


def _load_any() -> tuple[str, ctypes.CDLL]:
    for name in NAMES:
        try:
            return name, ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)
        except OSError as error:
            if not _is_missing(name, str(error)):
                raise DeviceAccessError(_load_failure(name, str(error))) from None
    raise DeviceNotFoundError(
        f"there is no libHD, the vendor's library (looked for {', '.join(NAMES)}): {ADVICE}"
    )


def _is_missing(name: str, words: str) -> bool:
    return words.startswith(f"{name}: cannot open shared object file: No such file")


def _load_failure(path: str, words: str) -> str:
    """Return why a library that exists cannot be loaded."""
    if found := re.match(r"(?P<name>[^:\s]+): cannot open shared object file", words):
        missing = found["name"]
        for name, advice in _DEPENDENCIES:
            if name in missing:
                return f"{path} needs {missing}, which is not there: {advice}"
        return (
            f"{path} needs {missing}, which is not there: install it, or put its folder into "
            "LD_LIBRARY_PATH before the program starts"
        )
    if "wrong ELF class" in words or "invalid ELF header" in words or "file too short" in words:
        return f"{path} is not a library for this machine ({words})"
    if found := re.search(r"undefined symbol: (\S+)", words):
        return (
            f"{path} does not fit the device driver that is installed (it lacks {found[1]}): "
            "take both from the same release"
        )
    return f"{path} cannot be loaded: {words}"


def _known_to_loader(name: str) -> bool:
    """Return True if the loader would find the name; reads only its cache and LD_LIBRARY_PATH."""
    folders = [each for each in os.environ.get("LD_LIBRARY_PATH", "").split(":") if each]
    if any((Path(folder) / name).is_file() for folder in folders):
        return True
    with contextlib.suppress(OSError):
        return b"/" + name.encode() + b"\0" in Path("/etc/ld.so.cache").read_bytes()
    return False
