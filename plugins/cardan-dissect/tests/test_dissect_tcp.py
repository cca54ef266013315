"""Reassembly of TCP streams from captures with missing, repeated, cut and reordered segments."""

import itertools

import pytest
from hypothesis import given, strategies as st

from cardan_dissect.network import TCP_FIN, TCP_RST, TCP_SYN, Endpoint, Segment
from cardan_dissect.tcp import FARTHEST_BACK, HELD_BYTES, HELD_NS, Begin, Bytes, End, Gap, TcpStream

pytestmark = pytest.mark.matrix

ENDS = Endpoint("10.0.0.1", 1), Endpoint("10.0.0.2", 2)


def segment(sequence, payload=b"", flags=16):
    return Segment("TCP", *ENDS, payload, False, sequence % 2**32, flags)


def read(stream, *segments, period_ns=1):
    return [e for n, s in enumerate(segments) for e in stream.feed(s, n * period_ns)]


def text(events):
    return b"".join(event.data for event in events if isinstance(event, Bytes))


def test_a_connection_from_its_beginning_to_its_end():
    stream = TcpStream()
    events = read(
        stream, segment(99, flags=TCP_SYN), segment(100, b"ab"), segment(102, b"c", TCP_FIN)
    )
    assert events == [End(), Begin(), Bytes(b"ab", 1), Bytes(b"c", 2), End()]
    assert (stream.segments, stream.retransmitted, stream.reordered, stream.gaps) == (2, 0, 0, 0)


def test_the_same_syn_again_begins_nothing():
    syn = segment(99, flags=TCP_SYN)
    assert read(TcpStream(), syn, syn) == [End(), Begin()]


@given(
    st.binary(min_size=1, max_size=60),
    st.sampled_from((5, 2**32 - 20)),
    st.data(),
)
def test_any_order_with_overlaps_gives_the_same_bytes(payload, start, data):
    cuts = sorted(data.draw(st.sets(st.integers(0, len(payload)), max_size=6)) | {0, len(payload)})
    pieces = [
        segment(start + a, payload[a : b + data.draw(st.integers(0, 3))])
        for a, b in itertools.pairwise(cuts)
    ]
    stream, first = TcpStream(), segment(start - 1, flags=TCP_SYN)
    assert text(read(stream, first, *data.draw(st.permutations(pieces)))) == payload
    assert list(stream.flush()) == []


def test_bytes_after_a_filled_hole_could_be_read_when_it_was_filled():
    stream = TcpStream()
    events = read(stream, segment(0, b"a"), segment(2, b"c"), segment(1, b"b"), period_ns=10)
    assert events == [Bytes(b"a", 0), Bytes(b"b", 20), Bytes(b"c", 20)]
    assert stream.reordered == 1


def test_bytes_after_a_hole_of_the_capture_could_be_read_as_they_came():
    stream = TcpStream()
    late = segment(50, b"later")
    events = read(stream, segment(0, b"a"), segment(3, b"d"), late, period_ns=HELD_NS + 1)
    assert events == [Bytes(b"a", 0), Gap(2), Bytes(b"d", HELD_NS + 1)]
    assert list(stream.flush()) == [Gap(46), Bytes(b"later", 2 * (HELD_NS + 1))]
    assert (stream.gaps, stream.lost_bytes) == (2, 48)


def test_much_that_is_held_makes_a_hole_the_captures():
    events = read(TcpStream(), segment(0, b"a"), segment(2, bytes(HELD_BYTES + 1)))
    assert events[1:] == [Gap(1), Bytes(bytes(HELD_BYTES + 1), 1)]


def test_a_reset_and_a_far_sequence_number_end_the_connection():
    stream = TcpStream()
    events = read(stream, segment(10, b"a"), segment(11, b"b", TCP_RST), segment(500, b"c"))
    assert events == [Bytes(b"a", 0), Bytes(b"b", 1), End(), Bytes(b"c", 2)]
    assert read(stream, segment(500 - FARTHEST_BACK - 1, b"d")) == [End(), Bytes(b"d", 0)]
