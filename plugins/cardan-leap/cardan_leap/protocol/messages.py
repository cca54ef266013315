"""Messages between the Leap Motion tracking service and its clients: JSON text and values.

Every WebSocket text message is one JSON object. The service begins (its version), then sends
device events and frames; a client sends options and never gets an answer. Lengths are mm, speeds
mm/s, in the tracker's axes: x right along its long side, y up, z towards the operator.

Source: PROTOCOL.md and lib/ of the public client leapjs, and public recordings of the service.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

from cardan.types import Vector3

PORT = 6437
VERSIONS = (1, 2, 3, 4, 5, 6)
HEARTBEAT_VERSIONS = (2, 3)
HEARTBEAT_PERIOD_S = 0.1
FOCUS_SINCE = 4
"""First version with `focused` and `background`."""
DEVICE_EVENT_SINCE = 5
"""First version with `deviceEvent`; before, `deviceConnect` reports plugging and unplugging."""
HMD_SINCE = 6
SKELETON_SINCE = 6
"""First version whose hands have a side, grab, pinch and confidence."""
UNSUPPORTED_VERSION_CLOSE = 1001
"""WebSocket close code of a service that does not support the requested version."""
HANDS = ("left", "right")

_PATH = re.compile(r"/v([1-9][0-9]?)\.json\Z", re.ASCII)


class Version(NamedTuple):
    """The service's first message."""

    version: int
    """Protocol version in force; may be lower than requested."""
    service_version: str = ""


class DeviceEvent(NamedTuple):
    """Change of a tracker: plugged in, unplugged, or its delivery started or stopped."""

    id: str
    """Id of the tracker; empty before version 5."""
    type: str
    """Type of the tracker: peripheral, laptop or keyboard; empty before version 5."""
    attached: bool
    streaming: bool
    """False: it is connected but does not deliver."""


class Hand(NamedTuple):
    """Hand of a frame. None: the service gives no value."""

    id: int
    """Id; a new one after the hand was lost or classified again."""
    palm_position_mm: Vector3
    palm_normal: Vector3
    """Direction out of the palm, near unit length."""
    direction: Vector3
    """Direction from the palm to the fingers, near unit length."""
    type: str = ""
    """Side, left or right; empty: the service gives none."""
    grab_strength: float | None = None
    """Grab strength, 0 (open) to 1 (fist)."""
    pinch_strength: float | None = None
    """Pinch strength, 0 (open) to 1 (the thumb touches a finger)."""
    confidence: float | None = None
    """Confidence, 0 to 1: how well the hand's model fits the images."""
    time_visible_s: float | None = None


class TrackingFrame(NamedTuple):
    """Hands seen by the service at an instant. Without hands in view, empty frames go on."""

    id: int | None
    timestamp_us: int | None
    """Stamp by the service's clock, of an arbitrary epoch."""
    current_frame_rate_hz: float | None
    hands: tuple[Hand, ...]
    """Readable hands, in no particular order."""
    unreadable_hands: int = 0
    """Number of hands whose id, palm or direction is missing or not a number, or whose confidence
    is outside 0..1."""


class Ignored(NamedTuple):
    """Well-formed message that is not used here."""

    keys: tuple[str, ...]


class Malformed(NamedTuple):
    """Message that does not follow this protocol."""

    reason: str
    """Reason, one of a few fixed phrases suitable as keys of counters."""


ServiceMessage = Version | DeviceEvent | TrackingFrame | Ignored | Malformed


class ClientOptions(NamedTuple):
    """Options that a client requests; None: not requested."""

    focused: bool | None = None
    """Take (or release) the focus; taking it ends the frames for clients without `background`."""
    background: bool | None = None
    """Receive frames without the focus, too."""
    optimize_hmd: bool | None = None
    """Tell the service that the tracker is worn on the operator's forehead."""
    enable_gestures: bool | None = None
    heartbeat: bool | None = None
    unknown: tuple[str, ...] = ()
    """Number of keys outside this protocol, or with a value other than true or false."""


_OPTION_KEYS: Mapping[str, str] = {
    "background": "background",
    "optimizeHMD": "optimize_hmd",
    "enableGestures": "enable_gestures",
    "heartbeat": "heartbeat",
    "focused": "focused",
}
"""Option keys in the order in which the public client sends them."""

NOT_TEXT = "that are not UTF-8"
NOT_JSON = "that are not JSON"
NO_OBJECT = "that are not a JSON object"
BAD_VERSION = "with a version that is not a number"
BAD_EVENT = "with an event that cannot be read"
BAD_HANDS = "with hands that are not a list"


def path_of(version: int) -> str:
    """Return the path that a client opens to request `version`."""
    return f"/v{version}.json"


def version_of(path: str) -> int | None:
    """Return the version of a path; None: not a path of this protocol. ``/`` means 1."""
    if path == "/":
        return 1
    match = _PATH.match(path)
    return int(match.group(1)) if match else None


def decode_service(data: bytes | str) -> ServiceMessage:
    """Decode a message of the service. Never raises."""
    document = _document(data)
    if isinstance(document, Malformed):
        return document
    hands = document.get("hands")
    if hands is not None:
        return _frame(document, hands)
    if "event" in document:
        return _event(document["event"])
    if "version" in document:
        version = _integer(document["version"])
        if version is None:
            return Malformed(BAD_VERSION)
        return Version(version, _text(document.get("serviceVersion")))
    return Ignored(tuple(document))


def decode_options(data: bytes | str) -> ClientOptions | Malformed:
    """Decode a message of a client. Never raises."""
    document = _document(data)
    if isinstance(document, Malformed):
        return document
    known: dict[str, bool] = {}
    unknown: list[str] = []
    for key, value in document.items():
        if key in _OPTION_KEYS and isinstance(value, bool):
            known[_OPTION_KEYS[key]] = value
        else:
            unknown.append(key)
    return ClientOptions(unknown=tuple(unknown), **known)


def encode_version(version: Version) -> str:
    """Encode the service's first message."""
    document: dict[str, Any] = {"version": version.version}
    if version.service_version:
        document["serviceVersion"] = version.service_version
    return encode_json(document)


def encode_device_event(event: DeviceEvent, version: int) -> str:
    """Encode a device event in the format of `version`."""
    if version < DEVICE_EVENT_SINCE:
        return encode_json({"event": {"type": "deviceConnect", "state": event.streaming}})
    state = {
        "id": event.id,
        "type": event.type,
        "attached": event.attached,
        "streaming": event.streaming,
    }
    return encode_json({"event": {"type": "deviceEvent", "state": state}})


def encode_options(options: ClientOptions) -> tuple[str, ...]:
    """Return a message for each option that is set in `options`."""
    return tuple(
        encode_json({key: value})
        for key, name in _OPTION_KEYS.items()
        if (value := getattr(options, name)) is not None
    )


def encode_json(document: Mapping[str, Any]) -> str:
    """Encode `document` as the service does: keys sorted, no blanks. Raises ValueError for NaN."""
    return json.dumps(document, separators=(",", ":"), sort_keys=True, allow_nan=False)


# ---------------------------------------------------------------------------------------------


def _document(data: bytes | str) -> dict[str, Any] | Malformed:
    try:
        text = data.decode() if isinstance(data, bytes) else data
    except UnicodeDecodeError:
        return Malformed(NOT_TEXT)
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        return Malformed(NOT_JSON)
    return document if isinstance(document, dict) else Malformed(NO_OBJECT)


def _frame(document: Mapping[str, Any], hands: Any) -> TrackingFrame | Malformed:
    if not isinstance(hands, list):
        return Malformed(BAD_HANDS)
    read = [hand for entry in hands if (hand := _hand(entry)) is not None]
    return TrackingFrame(
        _integer(document.get("id")),
        _integer(document.get("timestamp")),
        _number(document.get("currentFrameRate")),
        tuple(read),
        len(hands) - len(read),
    )


def _hand(entry: Any) -> Hand | None:
    if not isinstance(entry, dict):
        return None
    identity = _integer(entry.get("id"))
    position = _vector(entry.get("palmPosition"))
    normal = _vector(entry.get("palmNormal"))
    direction = _vector(entry.get("direction"))
    confidence = _number(entry.get("confidence"))
    if identity is None or position is None or normal is None or direction is None:
        return None
    if "confidence" in entry and (confidence is None or not 0.0 <= confidence <= 1.0):
        return None
    kind = entry.get("type")
    return Hand(
        identity,
        position,
        normal,
        direction,
        kind if kind in HANDS else "",
        _number(entry.get("grabStrength")),
        _number(entry.get("pinchStrength")),
        confidence,
        _number(entry.get("timeVisible")),
    )


def _event(event: Any) -> ServiceMessage:
    if not isinstance(event, dict):
        return Malformed(BAD_EVENT)
    kind, state = event.get("type"), event.get("state")
    if kind == "deviceConnect":
        return (
            DeviceEvent("", "", state, state) if isinstance(state, bool) else Malformed(BAD_EVENT)
        )
    if kind != "deviceEvent":
        return Ignored(("event",))
    if not isinstance(state, dict):
        return Malformed(BAD_EVENT)
    attached, streaming = state.get("attached"), state.get("streaming")
    if not isinstance(attached, bool) or not isinstance(streaming, bool):
        return Malformed(BAD_EVENT)
    identity = state.get("id")
    if isinstance(identity, int) and not isinstance(identity, bool):
        identity = format(identity, "x")
    return DeviceEvent(_text(identity), _text(state.get("type")), attached, streaming)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _number(value: Any) -> float | None:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            return None
        return number if math.isfinite(number) else None
    return None


def _integer(value: Any) -> int | None:
    number = _number(value)
    if number is None:
        return None
    # An integer beyond 2^53 is kept as it was written.
    return value if isinstance(value, int) else int(number)


def _vector(value: Any) -> Vector3 | None:
    if not isinstance(value, list) or len(value) != 3:
        return None
    x, y, z = map(_number, value)
    return None if x is None or y is None or z is None else Vector3(x, y, z)
