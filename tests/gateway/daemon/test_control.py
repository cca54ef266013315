"""The daemon's control protocol."""

import contextlib

import pytest
from hypothesis import given, strategies as st

from cardan.gateway.daemon.control import (
    MAX_LINE_BYTES,
    Ask,
    ControlError,
    LineReader,
    Response,
    decode_ask,
    decode_response,
    encode_ask,
    encode_response,
)


@pytest.mark.parametrize(
    "ask", [Ask(1, "units"), Ask(0, "start", "gofa"), Ask(2**53, "watch", "", 0.5)]
)
def test_requests_come_back(ask):
    line = encode_ask(ask)
    assert line.endswith(b"}\n")
    assert decode_ask(line) == ask


@pytest.mark.parametrize("kind", ["result", "error", "event"])
def test_answers_come_back(kind):
    response = Response(7, kind, [{"name": "gofa"}])
    assert decode_response(encode_response(response)) == response


@pytest.mark.parametrize(
    ("line", "words", "request_id"),
    [
        (b"", "not JSON", None),
        (b"[]", "not an object", None),
        (b'{"do":"units"}', "not a whole number", None),
        (b'{"id":true,"do":"units"}', "not a whole number", None),
        (b'{"id":-1,"do":"units"}', "not a whole number", None),
        (b'{"id":3,"do":"fly"}', "there is no 'fly'; allowed: units", 3),
        (b'{"id":3,"do":["units"]}', "there is no", 3),
        (b'{"id":3,"do":"stop","name":1}', "is not text", 3),
        (b'{"id":3,"do":"stop","nmae":"x"}', "there is no key 'nmae'", 3),
        (b"[" * 100_000, "not JSON", None),
    ],
)
def test_what_is_no_request(line, words, request_id):
    with pytest.raises(ControlError, match=None) as error:
        decode_ask(line)
    assert words in str(error.value)
    assert error.value.request == request_id


@pytest.mark.parametrize("levels", [31, 40, 300, 900])
def test_what_nests_too_deep_is_refused_before_it_is_shown_or_passed_on(levels):
    line = b'{"id":3,"do":"stop","name":' + b"[" * levels + b"]" * levels + b"}"
    with pytest.raises(ControlError) as error:
        decode_ask(line)
    assert ("within each other" in str(error.value)) == (levels > 31)


@given(st.binary(max_size=200))
def test_no_bytes_raise_anything_else(data):
    for decode in (decode_ask, decode_response):
        with contextlib.suppress(ControlError):
            decode(data)


@given(st.lists(st.binary(max_size=40).filter(lambda each: b"\n" not in each)), st.data())
def test_lines_come_whole_however_they_are_cut(lines, data):
    reader, found = LineReader(), []
    stream = b"".join(line + b"\n" for line in lines)
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        found += reader.take(stream[:size])
        stream = stream[size:]
    assert found == [line for line in lines if line.strip()]


def test_a_line_without_an_end_is_refused():
    reader = LineReader()
    assert reader.take(b"x" * MAX_LINE_BYTES) == []
    with pytest.raises(ControlError, match="at most"):
        reader.take(b"x")
