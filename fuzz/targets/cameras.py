"""Streams of cameras that pages in a browser show."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from cardan.protocols import mjpeg
from fuzz.target import Form, Target
from fuzz.targets.common import joined_streams, kinds


def _pictures(data: bytes) -> object:
    found = joined_streams(lambda: _Reader().feed, data)
    assert all(isinstance(each, str) or each[:2] == mjpeg.START for each in found)
    return kinds(found)


class _Reader:
    """Pictures until the stream is none; then that once."""

    def __init__(self) -> None:
        self._parser: mjpeg.PictureParser | None = mjpeg.PictureParser("frame")

    def feed(self, data: bytes) -> Iterable[bytes | str]:
        found: list[bytes | str] = []
        # As little at a time as a socket may give: what came before a fault counts.
        for at in range(len(data)):
            if self._parser is None:
                break
            try:
                found += self._parser.feed(data[at : at + 1])
            except mjpeg.MjpegError:
                self._parser = None
                found.append("no stream")
        return found


def _streams() -> Iterator[bytes]:
    picture = b"\xff\xd8picture\xff\xd9"
    head = b"--frame\r\nContent-Type: image/jpeg\r\n"
    yield head + b"Content-Length: 11\r\n\r\n" + picture + b"\r\n" + head + b"\r\n" + picture
    yield (head + b"\r\n" + picture + b"\r\n") * 3 + b"--frame--"
    yield b"--frame\n\n" + picture + b"\n--frame"


TARGETS = (
    Target(
        "mjpeg.stream",
        Form.BYTES,
        _pictures,
        _streams,
        words=(b"--frame", b"\r\n\r\n", b"\n\n", b"Content-Length: ", b"\xff\xd8"),
        longest=8192,
    ),
)
