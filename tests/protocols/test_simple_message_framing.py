"""Messages from a TCP stream split anywhere, and a real controller's stream."""

from __future__ import annotations

import itertools
from collections import Counter

import pytest
from hypothesis import given, strategies as st

from cardan.protocols.simple_message import codec
from cardan.protocols.simple_message.codec import detect_wire
from cardan.protocols.simple_message.codes import (
    IO_PORT,
    MOTION_PORT,
    STATE_PORT,
    MessageType,
    MotionCommand,
)
from cardan.protocols.simple_message.framing import (
    LONGEST_PREFIX_OF_MOTOROS,
    ByteOrder,
    FrameReader,
    detect_byte_order,
)
from cardan.protocols.simple_message.messages import (
    ZEROS,
    Empty,
    JointFeedback,
    MotionCtrl,
    RobotStatus,
    request,
    topic,
)
from tests import captures

PORTS = {MOTION_PORT, STATE_PORT, IO_PORT}


def _stream(order: ByteOrder) -> tuple[list[bytes], bytes]:
    wire = codec.wire(order)
    frames = [
        wire.encode(message)
        for message in (
            topic(RobotStatus(1, 0, 0, 0, 0, 2, 1)),
            request(Empty(), MessageType.PING),
            topic(JointFeedback(0, 2, 0.0, *[ZEROS] * 3)),
            request(MotionCtrl(0, 1, MotionCommand.STOP_MOTION)),
        )
    ]
    return frames, b"".join(frames)


def _all(reader: FrameReader) -> list[bytes]:
    found = []
    while (frame := reader.take()) is not None:
        found.append(frame)
    return found


@pytest.mark.parametrize("order", ByteOrder)
@given(cuts=st.lists(st.integers(0, 268), max_size=12))
def test_segments_may_be_split_and_merged(order, cuts):
    frames, stream = _stream(order)
    reader = FrameReader()
    found = []
    edges = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    for first, last in itertools.pairwise(edges):
        reader.feed(stream[first:last])
        found += _all(reader)
    assert found == frames
    assert reader.byte_order is order
    assert reader.pending_bytes == 0
    assert not reader.failure


@given(st.lists(st.binary(max_size=300), max_size=5))
def test_arbitrary_bytes_end_in_a_failure_at_worst(pieces):
    reader = FrameReader(longest_prefix=LONGEST_PREFIX_OF_MOTOROS)
    for piece in pieces:
        reader.feed(piece)
        for frame in _all(reader):
            assert 16 <= len(frame) <= 4 + LONGEST_PREFIX_OF_MOTOROS
    if reader.failure:
        reader.feed(b"more")
        assert reader.take() is None
        assert reader.pending_bytes == 0


def test_a_prefix_that_no_message_has_is_named():
    reader = FrameReader(ByteOrder.LITTLE, LONGEST_PREFIX_OF_MOTOROS)
    reader.feed((1021).to_bytes(4, "little"))
    assert reader.take() is None
    assert "1021" in reader.failure
    assert "12 to 1020" in reader.failure


@pytest.mark.parametrize(("prefix", "good"), [(11, False), (12, True), (1020, True)])
def test_the_shortest_and_the_longest_prefix(prefix, good):
    reader = FrameReader(ByteOrder.LITTLE, LONGEST_PREFIX_OF_MOTOROS)
    reader.feed(prefix.to_bytes(4, "little") + bytes(prefix))
    assert (reader.take() is not None) is good
    assert bool(reader.failure) is not good


def test_byte_order_is_that_in_which_the_length_is_plausible():
    assert detect_byte_order((12).to_bytes(4, "little")) is ByteOrder.LITTLE
    assert detect_byte_order((12).to_bytes(4, "big")) is ByteOrder.BIG
    assert detect_byte_order((0xFFFF).to_bytes(4, "little")) is ByteOrder.LITTLE
    assert detect_byte_order(b"GET ") is None
    assert detect_byte_order(bytes(4)) is None


def test_the_whole_capture_decodes_and_encodes_to_the_same_bytes():
    streams: dict[object, tuple[FrameReader, bytearray, list[bytes]]] = {}
    for _, segment in captures.tcp_segments(captures.MOTOMAN):
        if not {segment.source.port, segment.destination.port} & PORTS:
            continue
        key = (segment.source, segment.destination)
        reader, raw, frames = streams.setdefault(key, (FrameReader(), bytearray(), []))
        raw += segment.payload
        reader.feed(segment.payload)
        frames += _all(reader)
    types: Counter[str] = Counter()
    for reader, raw, frames in streams.values():
        assert reader.byte_order is ByteOrder.BIG
        assert not reader.failure
        assert reader.pending_bytes == 0
        assert b"".join(frames) == raw
        for frame in frames:
            wire = detect_wire(frame)
            assert wire is codec.wire(ByteOrder.BIG)
            message = wire.decode(frame)
            assert wire.encode(message) == frame
            types[type(message.body).__name__] += 1
    assert types == {
        "JointFeedback": 22,
        "RobotStatus": 22,
        "JointTrajPtFull": 58,
        "MotionCtrl": 2,
        "MotionReply": 60,
    }
