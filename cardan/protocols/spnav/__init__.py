"""The protocol of spacenavd's socket, both versions, as a client speaks it; the server's side is in
the plug-in cardan-spnav-server."""

from cardan.protocols.spnav.codes import (
    DEFAULT_SOCKET as DEFAULT_SOCKET,
    DEVICE_TYPES as DEVICE_TYPES,
    MASK_V1 as MASK_V1,
    NEWEST_VERSION as NEWEST_VERSION,
    REQUEST_TAG as REQUEST_TAG,
    UNKNOWN_DEVICE as UNKNOWN_DEVICE,
    Code as Code,
    EventMask as EventMask,
    LedMode as LedMode,
)
from cardan.protocols.spnav.records import (
    FAILED as FAILED,
    MAX_BUTTONS as MAX_BUTTONS,
    OK as OK,
    RECORD_BYTES as RECORD_BYTES,
    STATUS as STATUS,
    Button as Button,
    ConfigChange as ConfigChange,
    Data as Data,
    DeviceChange as DeviceChange,
    Event as Event,
    MalformedRecord as MalformedRecord,
    MotionEvent as MotionEvent,
    RawAxis as RawAxis,
    RawButton as RawButton,
    ServerRecord as ServerRecord,
    ServerReply as ServerReply,
    decode_handshake as decode_handshake,
    decode_server_record as decode_server_record,
    encode_handshake as encode_handshake,
    encode_reply as encode_reply,
    encode_request as encode_request,
    encode_sensitivity as encode_sensitivity,
    to_robot_axes as to_robot_axes,
)
from cardan.protocols.spnav.streams import (
    Handshake as Handshake,
    ServerReader as ServerReader,
)
from cardan.protocols.spnav.strings import (
    CHUNK_BYTES as CHUNK_BYTES,
    encode_string as encode_string,
)
