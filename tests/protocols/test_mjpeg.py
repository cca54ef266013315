"""MJPEG streams are parsed from pieces of any size."""

from __future__ import annotations

import pytest

from cardan.protocols.mjpeg import (
    MAX_HEAD_BYTES,
    MAX_PICTURE_BYTES,
    MjpegError,
    PictureParser,
    boundary_of,
)

ONE = b"\xff\xd8one\xff\xd9 within \xff\xd9"
TWO = b"\xff\xd8two\r\n\xff\xd9"


def part(picture, head=b"Content-Type: image/jpeg\r\nContent-Length: %d\r\n"):
    filled = head % len(picture) if b"%d" in head else head
    return b"--frame\r\n" + filled + b"\r\n" + picture + b"\r\n"


@pytest.mark.parametrize("size", [1, 2, 7, 10_000])
@pytest.mark.parametrize(
    "head",
    [
        b"Content-Type: image/jpeg\r\nContent-Length: %d\r\n",
        b"content-length:%d\r\n",
        b"Content-Type: image/jpeg\r\n",
    ],
)
def test_pictures_come_whole(size, head):
    stream = b"preface" + part(ONE, head) + part(TWO, head) + part(b"no picture", head) + b"--frame"
    parser, found = PictureParser("frame"), []
    for at in range(0, len(stream), size):
        found += parser.feed(stream[at : at + size])
    assert found == [ONE, TWO]


def test_lines_may_end_as_they_like():
    stream = b"--frame\nContent-Length: 5\n\n\xff\xd8abc\n--frame\n"
    assert PictureParser("frame").feed(stream) == [b"\xff\xd8abc"]


def test_what_is_too_long_is_no_picture():
    with pytest.raises(MjpegError, match="head"):
        PictureParser("frame").feed(b"--frame\r\n" + b"x" * (MAX_HEAD_BYTES + 1))
    with pytest.raises(MjpegError, match="bytes"):
        PictureParser("frame").feed(b"--frame\r\nContent-Length: 99999999\r\n\r\n")
    parser = PictureParser("frame")
    parser.feed(b"--frame\r\n\r\n" + b"x" * MAX_PICTURE_BYTES)
    with pytest.raises(MjpegError, match="bytes"):
        parser.feed(b"x" * 100)


def test_a_stream_without_parts_is_not_kept():
    parser = PictureParser("frame")
    for _ in range(100):
        assert parser.feed(b"x" * 65536) == []
    assert len(parser._held) < 100


@pytest.mark.parametrize(
    ("content_type", "boundary"),
    [
        ("multipart/x-mixed-replace; boundary=frame", "frame"),
        ('multipart/x-mixed-replace;boundary="--frame"', "frame"),
        ("Multipart/X-Mixed-Replace; Boundary=a b ; x=1", "a b"),
        ("multipart/mixed", ""),
        ("image/jpeg", None),
    ],
)
def test_what_is_between_the_parts(content_type, boundary):
    assert boundary_of(content_type) == boundary
