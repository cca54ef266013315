"""Inputs, outputs and registers: addresses, values, result codes."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from cardan.errors import ScriptError
from cardan.protocols.simple_message.codec import WireFormat
from cardan.protocols.simple_message.codes import CommType, IoResult, MessageType, ReplyCode
from cardan.protocols.simple_message.messages import (
    MotionCtrl,
    ReadIo,
    ReadRegister,
    WriteIo,
    WriteRegister,
    request,
)
from cardan.sim_peers.motoros_controller.io_image import IoImage

WORDS = st.integers(0, 2**32 - 1)
READABLE = (10, 5127, 10010, 15127, 20010, 27010, 29567, 30010, 37010, 39567, 40010, 42567, 50010)
WRITABLE = (10010, 15127, 27010, 29567, 60010, 60647)


@pytest.fixture
def image():
    return IoImage(dict)


@pytest.mark.parametrize("address", READABLE)
def test_inputs_can_be_set_and_read(image, address):
    assert image.read_bit(address) == (0, IoResult.OK)
    image.set_input(address, True)
    assert image.read_bit(address) == (1, IoResult.OK)
    image.set_input(address, False)
    assert image.read_bit(address) == (0, IoResult.OK)


@pytest.mark.parametrize(
    "address", [0, 9, 18, 19, 5130, 10008, 15130, 26000, 80009, 87210, 1000001]
)
def test_other_addresses_are_refused(image, address):
    assert image.read_bit(address) == (0, IoResult.READ_ADDRESS_INVALID)
    assert image.write_bit(address, 1).result == IoResult.WRITE_ADDRESS_INVALID
    with pytest.raises(ScriptError, match=f"input {address}: there is no such bit"):
        image.set_input(address, True)


@pytest.mark.parametrize("address", WRITABLE)
def test_outputs_take_0_and_1(image, address):
    assert image.write_bit(address, 1).result == IoResult.OK
    assert image.read_bit(address).value == 1
    assert image.write_bit(address, 2).result == IoResult.WRITE_VALUE_INVALID
    assert image.read_bit(address).value == 1
    assert image.write_bit(address, 0).result == IoResult.OK
    assert image.read_bit(address).value == 0


@pytest.mark.parametrize("address", sorted(set(READABLE) - set(WRITABLE)))
def test_inputs_cannot_be_written(image, address):
    assert image.write_bit(address, 1).result == IoResult.WRITE_ADDRESS_INVALID
    assert image.read_bit(address).value == 0


def test_a_group_is_eight_bits_the_lowest_first(image):
    image.set_input(12, True)
    image.set_input(17, True)
    assert image.read_group(1) == (0b1000_0100, IoResult.OK)
    assert image.write_group(1001, 0b101).result == IoResult.OK
    assert [image.read_bit(10010 + bit).value for bit in range(8)] == [1, 0, 1, 0, 0, 0, 0, 0]
    assert image.write_group(1001, 256).result == IoResult.WRITE_VALUE_INVALID
    assert image.write_group(1, 1).result == IoResult.WRITE_ADDRESS_INVALID
    assert image.read_group(0) == (0, IoResult.READ_ADDRESS_INVALID)
    assert image.read_group(1001).value == 0b101


def test_registers_by_number_and_by_address(image):
    assert image.write_register(5, 65535).result == IoResult.OK
    assert image.read_register(5) == (65535, IoResult.OK)
    assert image.read_register(1_000_005) == (65535, IoResult.OK)
    assert image.write_register(559, 1).result == IoResult.OK
    assert image.write_register(560, 1).result == IoResult.WRITE_ADDRESS_INVALID
    assert image.write_register(5, 65536).result == IoResult.WRITE_VALUE_INVALID
    assert image.read_register(999) == (0, IoResult.OK)
    assert image.read_register(1000) == (0, IoResult.READ_ADDRESS_INVALID)
    assert image.read_register(5).value == 65535


def test_what_the_controller_drives_wins():
    signals = {11124: False}
    image = IoImage(lambda: signals)
    assert image.write_bit(11124, 1).result == IoResult.OK
    assert image.read_bit(11124).value == 0
    signals[11124] = True
    assert image.read_group(1112).value == 0b1_0000


@pytest.mark.parametrize(
    ("body", "asked", "answered"),
    [
        (ReadIo(10), MessageType.MOTO_READ_IO_BIT, MessageType.MOTO_READ_IO_BIT_REPLY),
        (WriteIo(10010, 1), MessageType.MOTO_WRITE_IO_BIT, MessageType.MOTO_WRITE_IO_BIT_REPLY),
        (ReadIo(1), MessageType.MOTO_READ_IO_GROUP, MessageType.MOTO_READ_IO_GROUP_REPLY),
        (
            WriteIo(1001, 1),
            MessageType.MOTO_WRITE_IO_GROUP,
            MessageType.MOTO_WRITE_IO_GROUP_REPLY,
        ),
        (ReadRegister(1), MessageType.MOTO_READ_MREGISTER, MessageType.MOTO_READ_MREGISTER),
        (WriteRegister(1, 1), MessageType.MOTO_WRITE_MREGISTER, MessageType.MOTO_WRITE_MREGISTER),
    ],
)
def test_replies_have_their_types_and_codes(image, body, asked, answered):
    found = image.answer(request(body, asked))
    assert found[:3] == (answered, CommType.SERVICE_REPLY, ReplyCode.SUCCESS)
    bad = image.answer(request(body._replace(**{body._fields[0]: 999_999}), asked))
    assert bad[:3] == (answered, CommType.SERVICE_REPLY, ReplyCode.FAILURE)
    assert bad.body.result in (IoResult.READ_ADDRESS_INVALID, IoResult.WRITE_ADDRESS_INVALID)


def test_other_messages_are_not_answered(image):
    assert image.answer(request(MotionCtrl(0, 0, 200101))) is None


@given(address=WORDS, value=WORDS)
def test_any_numbers_get_an_answer_that_can_be_sent(address, value):
    image, wire = IoImage(dict), WireFormat()
    for msg_type in (2003, 2005, 2007, 2009, 2012, 2013):
        body = {
            2003: ReadIo(address),
            2005: WriteIo(address, value),
            2007: ReadIo(address),
            2009: WriteIo(address, value),
            2012: ReadRegister(address),
            2013: WriteRegister(address, value),
        }[msg_type]
        found = image.answer(request(body, msg_type))
        assert wire.decode(wire.encode(found)) == found
        good = found.body.result == IoResult.OK
        assert found.reply_code == (ReplyCode.SUCCESS if good else ReplyCode.FAILURE)
