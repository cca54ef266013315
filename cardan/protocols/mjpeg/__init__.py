"""Motion JPEG over HTTP: pictures as the parts of one endless response.

Source: RFC 2046, 5.1 (multipart); `multipart/x-mixed-replace`, as network cameras, mjpg-streamer,
ESP32 cameras and web_video_server of ROS send it.
"""

from __future__ import annotations

import re
from typing import Final

MAX_PICTURE_BYTES: Final = 4 * 2**20
"""Largest picture, bytes; those of 4K cameras have 1 to 2 MB."""

MAX_HEAD_BYTES: Final = 4096
"""Largest head, the lines before a picture, bytes."""

START: Final = b"\xff\xd8"
"""First bytes of every JPEG."""

_LENGTH = re.compile(rb"^content-length:[ \t]*([0-9]{1,9})[ \t]*\r?$", re.IGNORECASE | re.MULTILINE)
_BOUNDARY = re.compile(r'boundary="?([^";,]{1,200})"?', re.IGNORECASE)


class MjpegError(ValueError):
    """The received data is no stream of pictures."""


def boundary_of(content_type: str) -> str | None:
    """Return the boundary between the parts from Content-Type; None: not a stream of parts."""
    if not content_type.lower().startswith("multipart/"):
        return None
    found = _BOUNDARY.search(content_type)
    return found.group(1).strip().removeprefix("--") if found else ""


class PictureParser:
    """Parser of a response's body to pictures. It holds at most one picture."""

    def __init__(self, boundary: str) -> None:
        self._line = b"--" + boundary.encode("latin-1", "replace")
        self._held = bytearray()
        self._length: int | None = None
        """Length of the current picture, bytes, if its head has it."""
        self._within = False
        """True once the head of a part has been read."""
        self._searched = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Return the pictures that are complete now. Raises MjpegError."""
        self._held += data
        found: list[bytes] = []
        while self._within or self._head():
            picture = self._picture()
            if picture is None:
                break
            if picture[: len(START)] == START:
                found.append(picture)
        return found

    def _head(self) -> bool:
        """Read the lines before a picture; return True once they are complete."""
        held = self._held
        begin = held.find(self._line)
        if begin < 0:
            # Drop bytes before the first boundary; their end may be a part of it.
            del held[: max(0, len(held) - len(self._line))]
            return False
        ends = [
            (at, len(mark))
            for mark in (b"\r\n\r\n", b"\n\n")
            if (at := held.find(mark, begin)) >= 0
        ]
        if not ends:
            if len(held) - begin > MAX_HEAD_BYTES:
                raise MjpegError(f"a picture's head has more than {MAX_HEAD_BYTES} bytes")
            return False
        end, mark = min(ends)
        if end - begin > MAX_HEAD_BYTES:
            raise MjpegError(f"a picture's head has more than {MAX_HEAD_BYTES} bytes")
        length = _LENGTH.search(bytes(held[begin:end]))
        self._length = None if length is None else int(length.group(1))
        if self._length is not None and self._length > MAX_PICTURE_BYTES:
            raise MjpegError(f"a picture has {self._length} bytes")
        del held[: end + mark]
        self._within, self._searched = True, 0
        return True

    def _picture(self) -> bytes | None:
        held = self._held
        if self._length is not None:
            if len(held) < self._length:
                return None
            end = self._length
        else:
            end = held.find(self._line, self._searched)
            if (end if end >= 0 else len(held) - len(self._line)) > MAX_PICTURE_BYTES:
                raise MjpegError(f"a picture has more than {MAX_PICTURE_BYTES} bytes")
            if end < 0:
                self._searched = max(0, len(held) - len(self._line))
                return None
        picture = bytes(held[:end])
        del held[:end]
        self._within = False
        return picture if self._length is not None else picture.rstrip(b"\r\n")
