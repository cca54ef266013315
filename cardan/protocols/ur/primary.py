"""The primary interface, TCP port 30001: programs in, states and messages out.

A program is sent as text. The controller sends packages: size (int32, inclusive), type (uint8) and
content, big-endian: messages (type 20) and robot states (type 16), whose modes are here and the
rest in `robot_state`. The secondary interface, TCP port 30002, has of the messages only the
version.

Source: UR's client interface tables (public).
"""

from __future__ import annotations

import enum
import struct
from typing import Final, NamedTuple

from cardan.protocols.ur.framing import StreamReader
from cardan.protocols.ur.states import RobotMode, SafetyMode

PRIMARY_PORT: Final = 30001
SECONDARY_PORT: Final = 30002
READ_ONLY: Final = 10
"""Offset of the ports of the read-only interfaces."""
LARGEST: Final = 1 << 20
"""Longest package of a controller, bytes."""

_HEADER = struct.Struct(">iB")
_MESSAGE = struct.Struct(">QbB")
_VERSION = struct.Struct(">BBii")
_PLACE = struct.Struct(">ii")
_COMM = struct.Struct(">iiiII")
_SAFETY = struct.Struct(">iiBII")
_POPUP = struct.Struct(">II???B")
_LABEL = struct.Struct(">i")
_REQUEST = struct.Struct(">II")
_MODE = struct.Struct(">iBQ7?BBddd")
_RESERVED = bytes(1)
"""Reserved byte after the modes, from 3.5 on."""

ROBOT_STATE: Final = 16
ROBOT_MESSAGE: Final = 20
_ROBOT_MODE_DATA = 0


class MessageKind(enum.IntEnum):
    """The kind of a robot message."""

    TEXT = 0
    LABEL = 1
    POPUP = 2
    VERSION = 3
    SAFETY_MODE = 5
    ERROR_CODE = 6
    KEY = 7
    REQUEST_VALUE = 9
    RUNTIME_EXCEPTION = 10


class ReportLevel(enum.IntEnum):
    """Severity of an error code."""

    DEBUG = 0
    INFO = 1
    WARNING = 2
    VIOLATION = 3
    FAULT = 4


class RobotMessage(NamedTuple):
    """A message of the controller."""

    kind: int
    text: str
    line: int = 0
    """Line of a runtime exception in the program, counted from 1."""
    title: str = ""
    """Title of a key message or popup."""
    code: int = 0
    """Code of an error or safety mode message, number of a label or popup."""


class PrimaryPackage(NamedTuple):
    """Type and content."""

    kind: int
    content: bytes


def package(kind: int, content: bytes) -> bytes:
    """Encode a package."""
    return _HEADER.pack(_HEADER.size + len(content), kind) + content


class PackageReader(StreamReader):
    """Splitter of a TCP stream into packages."""

    def take(self) -> PrimaryPackage | None:
        """Return the next package; None if it is incomplete."""
        pending = self._pending
        if self.failure or len(pending) < _HEADER.size:
            return None
        size, kind = _HEADER.unpack_from(pending)
        if not _HEADER.size <= size <= LARGEST:
            self.failure = f"a package of {size} bytes: not a primary interface"
            return None
        if len(pending) < size:
            return None
        content = bytes(pending[_HEADER.size : size])
        del pending[:size]
        return PrimaryPackage(kind, content)


_CODED = {
    MessageKind.LABEL: _LABEL,
    MessageKind.SAFETY_MODE: _SAFETY,
    MessageKind.ERROR_CODE: _COMM,
    MessageKind.REQUEST_VALUE: _REQUEST,
}
"""Formats of messages that begin with their code."""


def read_message(found: PrimaryPackage) -> RobotMessage | None:
    """Decode the message in a package; None for another or a truncated package."""
    if found.kind != ROBOT_MESSAGE or len(found.content) < _MESSAGE.size:
        return None
    _, _, kind = _MESSAGE.unpack_from(found.content)
    rest = found.content[_MESSAGE.size :]
    if kind == MessageKind.RUNTIME_EXCEPTION and len(rest) >= _PLACE.size:
        line, _ = _PLACE.unpack_from(rest)
        return RobotMessage(kind, _text(rest[_PLACE.size :]), line)
    if kind == MessageKind.KEY and len(rest) > _PLACE.size:
        size = rest[_PLACE.size]
        titled = rest[_PLACE.size + 1 :]
        return RobotMessage(kind, _text(titled[size:]), title=_text(titled[:size]))
    if kind == MessageKind.VERSION and rest:
        return RobotMessage(kind, _text(rest[1 : 1 + rest[0]]))
    if kind == MessageKind.POPUP and len(rest) >= _POPUP.size:
        number, _, _, _, _, size = _POPUP.unpack_from(rest)
        titled = rest[_POPUP.size :]
        return RobotMessage(kind, _text(titled[size:]), 0, _text(titled[:size]), number)
    for each, form in _CODED.items():
        if kind == each and len(rest) >= form.size:
            return RobotMessage(kind, _text(rest[form.size :]), code=form.unpack_from(rest)[0])
    return RobotMessage(kind, _text(rest) if kind == MessageKind.TEXT else "")


def _text(data: bytes) -> str:
    return data.rstrip(b"\0").decode("utf-8", "replace")


def _message(time_s: float, kind: MessageKind, content: bytes) -> bytes:
    # Source -2: the controller.
    return package(ROBOT_MESSAGE, _MESSAGE.pack(round(1e6 * time_s), -2, kind) + content)


def version_message(
    time_s: float, version: tuple[int, int, int, int], built: str = "01-01-2022, 00:00:00"
) -> bytes:
    """Encode the first message of a controller; `time_s` is since power-on."""
    name = b"URControl"
    numbers = _VERSION.pack(version[0], version[1], version[2], version[3])
    content = bytes([len(name)]) + name + numbers + built.encode()
    return _message(time_s, MessageKind.VERSION, content)


def text_message(time_s: float, text: str) -> bytes:
    """Encode the text of a program's `textmsg`."""
    return _message(time_s, MessageKind.TEXT, text.encode())


def key_message(time_s: float, title: str, text: str) -> bytes:
    """Encode a key message, such as PROGRAM_XXX_STARTED with the program's name."""
    titled = title.encode()[:255]
    content = _PLACE.pack(0, 0) + bytes([len(titled)]) + titled + text.encode()
    return _message(time_s, MessageKind.KEY, content)


def exception_message(time_s: float, line: int, text: str, column: int = 1) -> bytes:
    """Encode the reason why a program ended or did not start; line and column from 1."""
    content = _PLACE.pack(line, column) + text.encode()
    return _message(time_s, MessageKind.RUNTIME_EXCEPTION, content)


def label_message(time_s: float, number: int, text: str) -> bytes:
    """Encode the current label of a program, `$ number "text"`."""
    return _message(time_s, MessageKind.LABEL, _LABEL.pack(number) + text.encode())


def popup_message(
    time_s: float,
    number: int,
    title: str,
    text: str,
    warning: bool = False,
    error: bool = False,
    blocking: bool = False,
) -> bytes:
    """Encode a popup of the pendant."""
    titled = title.encode()[:255]
    head = _POPUP.pack(number, 0, warning, error, blocking, len(titled))
    return _message(time_s, MessageKind.POPUP, head + titled + text.encode())


def safety_message(time_s: float, mode: SafetyMode) -> bytes:
    """Encode a change of the safety mode."""
    return _message(time_s, MessageKind.SAFETY_MODE, _SAFETY.pack(0, 0, mode, 0, 0))


def error_message(
    time_s: float, code: int, argument: int, level: ReportLevel, text: str = ""
) -> bytes:
    """Encode an error: C`code`A`argument` of UR's list."""
    content = _COMM.pack(code, argument, level, 0, 0) + text.encode()
    return _message(time_s, MessageKind.ERROR_CODE, content)


class ModeData(NamedTuple):
    """Modes in the robot state."""

    power_on: bool
    emergency_stopped: bool
    protective_stopped: bool
    program_running: bool
    program_paused: bool
    robot_mode: RobotMode
    speed_fraction: float
    speed_scaling: float = 1.0


def state_package(
    time_s: float, data: ModeData, parts: bytes = b"", before_3_5: bool = False
) -> bytes:
    """Encode a robot state: the modes, then `parts`, its other sub-packages."""
    reserved = b"" if before_3_5 else _RESERVED
    content = _MODE.pack(
        _MODE.size + len(reserved),
        _ROBOT_MODE_DATA,
        round(1e6 * time_s),
        True,
        True,
        data.power_on,
        data.emergency_stopped,
        data.protective_stopped,
        data.program_running,
        data.program_paused,
        max(int(data.robot_mode), 0),
        0,
        data.speed_fraction,
        data.speed_scaling,
        1.0,
    )
    return package(ROBOT_STATE, content + reserved + parts)


def read_mode(found: PrimaryPackage) -> ModeData | None:
    """Decode the modes in a robot state; None if they are not its first part."""
    if found.kind != ROBOT_STATE or len(found.content) < _MODE.size:
        return None
    values = _MODE.unpack_from(found.content)
    if values[1] != _ROBOT_MODE_DATA or values[10] not in RobotMode._value2member_map_:
        return None
    power_on, emergency, protective, running, paused = values[5:10]
    mode = RobotMode(values[10])
    return ModeData(power_on, emergency, protective, running, paused, mode, values[12], values[13])
