"""Cameras that the server shows to pages: each is read once for all pages, and only while a page
shows it; a slow page gets fewer pictures, never older ones, because each is sent after the page has
shown the previous one."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import http.client
import logging
import re
import threading
import time
import urllib.error
import urllib.request
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import PurePosixPath
from typing import Final, NamedTuple
from urllib.parse import urlsplit, urlunsplit

from cardan.common.text_sanitizer import printable
from cardan.errors import OptionError
from cardan.gateway.servers.console.video import pictures as pictures_of_device
from cardan.protocols.mjpeg import MAX_PICTURE_BYTES, START, PictureParser, boundary_of

SILENT_S: Final = 5.0
"""Silence after which a camera counts as gone."""

AGAIN_S: Final = 2.0
"""Pause before the next attempt with a camera that failed."""

SINGLE_S: Final = 0.2
"""Shortest time between two pictures of a camera that gives one per request."""

PIECE_BYTES: Final = 65536

UNSHOWN_S: Final = 5.0
"""Time without a shown picture after which a camera is not read for a page any more."""

_NAMED = re.compile(r"([\w][\w .-]{0,39})=(.+)")

_log = logging.getLogger(__name__)


class Address(NamedTuple):
    """A camera in the options."""

    name: str
    """Name for pages; never with secrets of its address."""
    where: str


def parse_camera(text: str) -> Address:
    """Parse ``NAME=ADDRESS`` or ``ADDRESS``, which is a URL of http or https, or a device's path.
    Raises OptionError."""
    named = _NAMED.fullmatch(text)
    name, where = (named.group(1), named.group(2)) if named else ("", text)
    if where.startswith("/dev/"):
        return Address(name or PurePosixPath(where).name, where)
    try:
        parts = urlsplit(where)
        host = parts.hostname if parts.scheme in ("http", "https") else None
    except ValueError:
        host = None
    if not host:
        raise OptionError(
            "camera", text, "NAME=ADDRESS or ADDRESS: http://…, https://… or a device, /dev/video0"
        )
    return Address(name or host, where)


class Camera:
    """A camera. `watch` and `leave` are called in the server's loop."""

    def __init__(self, address: Address) -> None:
        self.address = address
        self.newest = b""
        self.newest_s = 0.0
        """Monotonic time of reception: a camera's own time is not read."""
        self.number = 0
        """Number of the newest picture; 0: none yet."""
        self.why = ""
        """Reason why there is no picture now."""
        self._watchers: set[asyncio.Event] = set()
        self._reader: _Reader | None = None

    def watch(self, changed: asyncio.Event) -> None:
        """Set `changed` at each picture, and now if there is one; idempotent."""
        if changed in self._watchers:
            return
        self._watchers.add(changed)
        if self.newest:
            changed.set()
        if self._reader is None:
            loop = asyncio.get_running_loop()
            self._reader = reader = _Reader(self.address, lambda *it: _put(loop, self._take, *it))
            reader.start()

    def leave(self, changed: asyncio.Event) -> None:
        """Remove a waiting page; idempotent."""
        self._watchers.discard(changed)
        if not self._watchers and self._reader is not None:
            self._reader.ended.set()
            self._reader, self.newest, self.why = None, b"", ""

    def _take(self, reader: _Reader, picture: bytes, why: str, had_s: float) -> None:
        if reader is not self._reader:
            return
        if picture:
            self.newest, self.newest_s, self.number = picture, had_s, self.number + 1
        self.why = why
        for each in self._watchers:
            each.set()


def _put(loop: asyncio.AbstractEventLoop, take: Callable[..., None], *values: object) -> None:
    with contextlib.suppress(RuntimeError):  # The server has ended.
        loop.call_soon_threadsafe(take, *values)


class _Reader(threading.Thread):
    """Thread that reads a camera until `ended`. It ends within SILENT_S without being joined."""

    def __init__(self, address: Address, put: Callable[[_Reader, bytes, str, float], None]) -> None:
        super().__init__(name=f"cardan-camera-{address.name}", daemon=True)
        self.ended = threading.Event()
        self._address, self._put = address, put

    def run(self) -> None:
        where = self._address.where
        reported = ""
        while not self.ended.is_set():
            why = "the camera has ended its stream"
            try:
                for picture in _pictures(where, self.ended):
                    self._put(self, picture, "", time.monotonic())
                    reported = ""
            except (OSError, ValueError, http.client.HTTPException) as error:
                reason = getattr(error, "reason", None) or getattr(error, "strerror", None)
                why = printable(str(reason or error))[:300]
            if self.ended.is_set():
                return
            if why != reported:
                _log.warning("camera %s: %s", self._address.name, why)
                reported = why
            self._put(self, b"", why, time.monotonic())
            self.ended.wait(AGAIN_S)


def _pictures(where: str, ended: threading.Event) -> Iterator[bytes]:
    """Yield pictures. Raises OSError, ValueError or HTTPException."""
    if where.startswith("/dev/"):
        yield from pictures_of_device(where, ended.is_set)
        return
    while not ended.is_set():
        with _ask(where) as answer:
            content_type = str(answer.headers.get("Content-Type", ""))
            boundary = boundary_of(content_type)
            if boundary is None:
                picture = answer.read(MAX_PICTURE_BYTES + 1)
                if picture[: len(START)] != START or len(picture) > MAX_PICTURE_BYTES:
                    raise ValueError(f"it answers {content_type or 'nothing'}, and no JPEG")
                yield picture
                ended.wait(SINGLE_S)
                continue
            parser = PictureParser(boundary)
            picture_s = time.monotonic()
            while not ended.is_set() and (data := answer.read1(PIECE_BYTES)):
                found = parser.feed(data)
                if found:
                    picture_s = time.monotonic()
                    yield found[-1]
                elif time.monotonic() - picture_s > SILENT_S:
                    raise OSError(f"no picture for {SILENT_S:.0f} s")
            return


def _ask(url: str) -> http.client.HTTPResponse:
    """Request a URL, without a proxy: cameras are near. A name and password in the address are sent
    to its host only."""
    parts = urlsplit(url)
    request = urllib.request.Request(
        urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))
    )
    if parts.username:
        said = f"{parts.username}:{parts.password or ''}".encode()
        basic = base64.b64encode(said).decode()
        request.add_unredirected_header("Authorization", f"Basic {basic}")
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    answer: http.client.HTTPResponse = opener.open(request, timeout=SILENT_S)
    return answer


class Unshown:
    """Pictures that were sent to a page and not reported as shown: one, or two if the page reports
    that its link is long rather than slow."""

    def __init__(self, page_us: float | None, now_s: float) -> None:
        """`page_us`: time of the page when it requested pictures; None: it sent none."""
        self.room = asyncio.Event()
        """Set while a picture may be sent."""
        self.room.set()
        self.page_us = page_us
        """Page time of its last report, µs of its clock."""
        self._heard_s = now_s
        self._numbers: deque[int] = deque()
        self._most = 1

    def held_s(self, now_s: float) -> float:
        """Return the time since that report."""
        return now_s - self._heard_s

    def sent(self, number: int) -> None:
        """Record a sent picture; of two the later one has the higher number."""
        self._numbers.append(number)
        self._look()

    def shown(self, number: object, page_us: float, two: bool, now_s: float) -> None:
        """Record that the page has shown this picture, or skipped it, and those before it; no
        effect unless it is under way."""
        if number not in self._numbers:
            return
        while self._numbers and self._numbers.popleft() != number:
            pass
        self.page_us, self._heard_s, self._most = page_us, now_s, 2 if two else 1
        self._look()

    def _look(self) -> None:
        if len(self._numbers) < self._most:
            self.room.set()
        else:
            self.room.clear()


class Cameras:
    """All cameras of a server."""

    def __init__(self, addresses: Sequence[str]) -> None:
        self._cameras = [Camera(parse_camera(each)) for each in addresses]

    def __iter__(self) -> Iterator[Camera]:
        return iter(self._cameras)

    @property
    def names(self) -> list[str]:
        """Names by number."""
        return [each.address.name for each in self._cameras]

    def camera(self, number: object) -> Camera | None:
        """Return the camera of this number; None: there is none."""
        if isinstance(number, bool) or not isinstance(number, int):
            return None
        return self._cameras[number] if 0 <= number < len(self._cameras) else None
