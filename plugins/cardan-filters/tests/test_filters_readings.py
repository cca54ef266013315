"""Sensor datagrams: exact values for good ones, a reason for all others, never an exception."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan_filters.readings import (
    MAX_DATAGRAM_BYTES,
    Centroid,
    Malformed,
    decode_centroid,
    decode_proximity,
)

words = st.lists(st.integers(0, 0xFFE), min_size=16, max_size=16)
boards = st.fixed_dictionaries({name: st.tuples(words, words, words) for name in "IJK"})


def skin_text(axes_by_board, order="IJK", end="\r\n"):
    """The text as the AMOR skin sends it."""
    lines = []
    for board in order:
        lines.append(board)
        for axis, values in zip("XYZ", axes_by_board[board], strict=True):
            lines.append(axis + "".join(f"{value:03X}" for value in values))
    return end.join(lines).encode()


def flat(value):
    return {board: ([value] * 16,) * 3 for board in "IJK"}


@given(boards, st.permutations("IJK"), st.sampled_from(["\r\n", "\n", "\r", " "]))
def test_skin_values_are_the_means_of_three_axes_in_the_order_of_the_boards(axes, order, end):
    values = decode_proximity(skin_text(axes, order, end))
    means = [sum(column) / 3 for board in "IJK" for column in zip(*axes[board], strict=True)]
    assert values == pytest.approx(means)


def test_skin_worked_reading():
    axes = flat(0x010)
    axes["J"] = ([0x384, *[0] * 15], [0x384, *[0] * 15], [0x384, *[0] * 15])
    text = skin_text(axes)
    assert text.startswith(b"I\r\nX010010010")
    values = decode_proximity(text)
    assert (len(values), values[0], values[16], values[17], values[47]) == (48, 16, 900, 0, 16)


def test_fff_counts_as_zero():
    axes = flat(0x300)
    axes["I"] = ([0xFFF] * 16, [0x300] * 16, [0x300] * 16)
    assert decode_proximity(skin_text(axes))[0] == 0x300 * 2 / 3


def test_a_skin_that_sees_nothing_is_not_free_space():
    assert "FFF" in decode_proximity(skin_text(flat(0xFFF))).reason


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t[:-1], "board K"),
        (lambda t: t + b"0", "board K"),
        (lambda t: t.replace(b"J", b"I"), "the expected one of the boards"),
        (lambda t: t.replace(b"J", b"L"), "the expected one of the boards"),
        (lambda t: t.replace(b"Y", b"X", 1), "not Y and"),
        (lambda t: t.replace(b"X010", b"X0_0", 1), "hexadecimal"),
        (lambda t: t.replace(b"X010", b"X+10", 1), "hexadecimal"),
        (lambda t: t + b" I", "13 lines"),
        (lambda t: t.split(b"K")[0], "8 lines"),
    ],
)
def test_skin_faults_are_named(change, words):
    found = decode_proximity(change(skin_text(flat(0x010))))
    assert isinstance(found, Malformed)
    assert words in found.reason


@pytest.mark.parametrize(
    ("data", "values"),
    [
        (b"250", (250.0,)),
        (b"1 2.5,3e2\n", (1.0, 2.5, 300.0)),
        (b"0, 0 ,.5", (0.0, 0.0, 0.5)),
        (b" ".join([b"7"] * 256), (7.0,) * 256),
    ],
)
def test_plain_numbers(data, values):
    assert decode_proximity(data) == values


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "0 numbers"),
        (b" ".join([b"7"] * 257), "257 numbers"),
        (b"1" * (MAX_DATAGRAM_BYTES + 1), "longer than"),
        (b"12 nan", "'nan' is not a number"),
        (b"inf", "not a number"),
        (b"1e999", "not a number"),
        (b"1_0", "not a number"),
        ("٣".encode(), "not a number"),
        (b"5 -1", "-1 is negative"),
        (b"\x00" * 40, "..."),
    ],
)
def test_plain_faults_are_named(data, words):
    found = decode_proximity(data)
    assert isinstance(found, Malformed)
    assert words in found.reason
    assert len(found.reason) < 100


@pytest.mark.parametrize(
    ("data", "expected"),
    [(b"0.4 -0.3", (0.4, -0.3)), (b"0 0\n", (0, 0)), (b"1 -1", (1, -1)), (b"+.5 5e-1", (0.5, 0.5))],
)
def test_centroids(data, expected):
    assert decode_centroid(data) == Centroid(*expected)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "0 words"),
        (b"0.1", "1 words"),
        (b"0.1 0.2 0.3", "3 words"),
        (b"0.1 1.01", "1.01 is outside"),
        (b"a b", "'a' is not a number"),
        (b"nan 0", "not a number"),
        (b" " * (MAX_DATAGRAM_BYTES + 1), "longer than"),
    ],
)
def test_centroid_faults_are_named(data, words):
    found = decode_centroid(data)
    assert isinstance(found, Malformed)
    assert words in found.reason


noise = st.binary(max_size=200) | st.text("IJKXYZ0F. ,-+e\n", max_size=600).map(str.encode)


@given(noise)
def test_any_bytes_are_a_reading_or_a_reason(data):
    values = decode_proximity(data)
    if not isinstance(values, Malformed):
        assert values
        assert all(math.isfinite(value) and value >= 0 for value in values)
    centroid = decode_centroid(data)
    if not isinstance(centroid, Malformed):
        assert all(-1 <= value <= 1 for value in centroid)


@given(boards, st.integers(0, 460), st.binary(min_size=1, max_size=3))
def test_a_damaged_skin_text_is_a_reading_or_a_reason(axes, at, damage):
    text = skin_text(axes)
    values = decode_proximity(text[:at] + damage + text[at + len(damage) :])
    assert isinstance(values, Malformed) or all(0 <= v <= 0xFFE for v in values)
