"""The joint stream: states of a joint-controlled arm one way, joint commands the other.

Our own protocol, for the simulated arm; docs/protocols/joint-stream.md describes it.
"""

from cardan.protocols.joint_stream.codec import (
    MAX_DATAGRAM_BYTES,
    MAX_JOINTS,
    MAX_REASON_BYTES,
    VERSION,
    ArmCommand,
    ArmState,
    ControlMode,
    Malformed,
    decode_command,
    decode_state,
    encode_command,
    encode_state,
    is_newer,
)

__all__ = [
    "MAX_DATAGRAM_BYTES",
    "MAX_JOINTS",
    "MAX_REASON_BYTES",
    "VERSION",
    "ArmCommand",
    "ArmState",
    "ControlMode",
    "Malformed",
    "decode_command",
    "decode_state",
    "encode_command",
    "encode_state",
    "is_newer",
]
