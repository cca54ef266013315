"""Hypothesis strategies for bytes that protobuf may or may not accept, structured like EGM."""

import struct

from hypothesis import strategies as st

TOP_TAGS = st.integers(1, 16)


def varint(number, padding=0):
    """Encode `number` in the fewest bytes plus `padding` more."""
    groups = []
    while True:
        groups.append(number & 0x7F)
        number >>= 7
        if not number:
            break
    groups += [0] * padding
    return bytes([group | 0x80 for group in groups[:-1]] + [groups[-1]])


def double(number):
    return struct.pack("<d", number)


def tagged(number, payload):
    """Encode a length-delimited field."""
    return varint(number << 3 | 2) + varint(len(payload)) + payload


varints = st.builds(
    varint,
    st.one_of(st.integers(0, 5), st.integers(0, 2**64 - 1), st.sampled_from((2**32, 2**63))),
    st.integers(0, 1) | st.integers(0, 10),
)
doubles = st.one_of(
    st.floats(-1e4, 1e4), st.floats(), st.sampled_from((0.0, -0.0, 1e308, 5e-324))
).map(double)


def _field(number, wire_type, payload):
    return varint(number << 3 | wire_type) + payload


def fields(children):
    number = st.integers(1, 5) | TOP_TAGS | st.integers(1, 2**29 - 1)
    return st.one_of(
        st.builds(_field, number, st.just(0), varints),
        st.builds(_field, number, st.just(1), doubles),
        st.builds(_field, number, st.just(5), st.binary(min_size=4, max_size=4)),
        st.builds(tagged, number, children),
        st.builds(tagged, number, st.lists(doubles, max_size=8).map(b"".join)),
        st.builds(tagged, number, st.binary(max_size=9)),
        st.builds(
            lambda n, inner: varint(n << 3 | 3) + inner + varint(n << 3 | 4), number, children
        ),
    )


messages = st.recursive(
    st.lists(fields(st.just(b"")), max_size=4).map(b"".join),
    lambda children: st.lists(fields(children), max_size=5).map(b"".join),
    max_leaves=12,
)
"""Well-formed protobuf with EGM's field numbers, and rarely EGM's types."""


@st.composite
def spoilt(draw, good):
    """Return `good` with bytes changed, cut off, inserted or repeated."""
    data = bytearray(draw(good))
    for _ in range(draw(st.integers(0, 3))):
        at = draw(st.integers(0, len(data)))
        action = draw(st.sampled_from(("change", "cut", "put in", "repeat")))
        if action == "change" and at < len(data):
            data[at] = draw(st.integers(0, 255))
        elif action == "cut":
            del data[at : at + draw(st.integers(1, 9))]
        elif action == "put in":
            data[at:at] = draw(st.binary(min_size=1, max_size=4))
        elif action == "repeat":
            data[at:at] = data[at : at + draw(st.integers(1, 60))]
    return bytes(data)
