"""Two descriptions of simple message, both from the reference: the codec and the scapy layers."""

from __future__ import annotations

import pytest
from hypothesis import given, settings, strategies as st

from cardan.protocols.simple_message.codec import detect_wire, wire
from cardan.protocols.simple_message.codes import (
    InvalidSubcode,
    MessageType,
    MotionCommand,
    MotionResult,
    NotReadySubcode,
)
from cardan.protocols.simple_message.messages import (
    JointTrajPtFullEx,
    JointVelocityEx,
    MalformedMessage,
    Message,
    Raw,
    RtJointCommand,
    RtJointState,
    reply,
)
from cardan_dissect import simple_message as layers
from cardan_dissect.dissectors.streams import subcode_name
from tests.protocols.test_simple_message_codec import BODIES, TYPES, WIRES

NOT_ON_THE_WIRE = {"byte_order", "real_bytes", "prefix"}


def _numbers(value):
    if isinstance(value, (tuple, list)):
        for each in value:
            yield from _numbers(each)
    elif hasattr(value, "fields_desc"):
        yield from _layer_numbers(value)
    else:
        yield value


def _layer_numbers(layer):
    for field in layer.fields_desc:
        if field.name not in NOT_ON_THE_WIRE:
            yield from _numbers(layer.getfieldval(field.name))


COUNTED = {
    JointTrajPtFullEx: lambda b: (len(b.points), b.sequence, b.points),
    JointVelocityEx: lambda b: (len(b.commands), b.sequence, b.commands),
    RtJointState: lambda b: (b.message_id, b.mode, len(b.states), b.states),
    RtJointCommand: lambda b: (b.message_id, len(b.commands), b.commands),
}
"""Bodies whose number of groups is part of the message but not of the value."""


@pytest.mark.parametrize("wire", WIRES, ids=lambda w: f"{w.byte_order.name}-{w.real_bytes}")
@pytest.mark.parametrize(
    ("body", "msg_type"), [pair for pair in TYPES if pair[0] is not Raw], ids=str
)
@settings(max_examples=4)
@given(data=st.data())
def test_a_message_of_the_codec_is_the_same_to_the_layers(body, msg_type, wire, data):
    message = reply(data.draw(BODIES[body]), msg_type=msg_type)
    frame = wire.encode(message)
    layer = layers.SimpleMessage(frame)
    assert not isinstance(layer, layers.SimpleMessageBroken), layer
    assert layer.byte_order == wire.byte_order.value
    expected = COUNTED.get(body, tuple)(message.body)
    found = list(_layer_numbers(layer))
    assert found[:3] == [message.msg_type, message.comm_type, message.reply_code]
    if not isinstance(layer, layers.IoErrorReply):
        assert found[3:] == list(_numbers(expected))
    layer.clear_cache()
    assert bytes(layer) == frame


@given(st.binary(min_size=16, max_size=700))
def test_what_one_calls_malformed_is_no_message_to_the_other(data):
    frame = (len(data) - 4).to_bytes(4, "little") + data[4:]
    ours = wire().decode(frame)
    layer = layers.SimpleMessage(frame)
    broken = isinstance(layer, layers.SimpleMessageBroken)
    if isinstance(ours, MalformedMessage) and detect_wire(frame) is None:
        assert broken
    elif isinstance(ours, Message) and not isinstance(ours.body, Raw):
        assert not broken


def test_numbers_have_the_same_names():
    for ours, theirs in (
        (MessageType, layers.NAMES),
        (MotionCommand, layers.COMMANDS),
        (MotionResult, layers.RESULTS),
        (InvalidSubcode, layers.INVALID_SUBCODES),
        (NotReadySubcode, layers.NOT_READY_SUBCODES),
    ):
        assert {int(code) for code in ours} == set(theirs)
        for code in ours:
            short = theirs[code].split(" (")[0].removesuffix("_MODE")
            assert short in code.name, (code, theirs[code])


def test_a_subcode_is_named_by_its_result():
    assert subcode_name(MotionResult.NOT_READY, 5006) == "SERVO_OFF"
    assert subcode_name(MotionResult.INVALID, 3011) == "DATA_START_POS"
    assert subcode_name(MotionResult.FAILURE, 5006) == "SERVO_OFF"
    assert subcode_name(MotionResult.FAILURE, 3004) == "GROUPNO"
    assert subcode_name(MotionResult.INVALID, 42) == "42"
