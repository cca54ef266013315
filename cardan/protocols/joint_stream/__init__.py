"""The joint stream: states of a joint-controlled arm one way, joint commands the other.

Our own protocol, for the simulated arm; docs/simulated-peers.md describes it.
"""

from cardan.protocols.joint_stream.codec import (
    MAGIC as MAGIC,
    MAX_DATAGRAM_BYTES as MAX_DATAGRAM_BYTES,
    MAX_JOINTS as MAX_JOINTS,
    MAX_REASON_BYTES as MAX_REASON_BYTES,
    ArmCommand as ArmCommand,
    ArmState as ArmState,
    ControlMode as ControlMode,
    MalformedDatagram as MalformedDatagram,
    decode_command as decode_command,
    decode_state as decode_state,
    encode_command as encode_command,
    encode_state as encode_state,
    is_command as is_command,
    is_newer as is_newer,
)
