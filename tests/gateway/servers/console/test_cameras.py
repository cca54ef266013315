"""Cameras are shown to whoever may come in, the newest picture, and rest while nobody looks."""

from __future__ import annotations

import base64
import errno
import mmap
import os
import re
import struct
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")

from websockets.exceptions import InvalidStatus

from cardan.errors import OptionError
from cardan.gateway.servers.console import cameras, video
from cardan.gateway.servers.console.cameras import parse_camera
from cardan.gateway.servers.console.face import ConsoleOptions
from tests.gateway.servers.console.rig import console, page_program
from tests.gateway.servers.memory_network import MemoryNetwork
from tests.gateway.servers.rig import WAIT_S
from tests.waiting import until

pytestmark = pytest.mark.matrix

VIEWER = "viewers-0123456789"
ALLOWED = "Basic " + base64.b64encode(b"me:secret").decode()


class Handler(BaseHTTPRequestHandler):
    """A camera with a stream at /stream, a picture at /one, and a page elsewhere."""

    def do_GET(self):
        server = self.server
        if self.headers.get("Authorization") != ALLOWED:
            self.send_error(401)
            return
        self.send_response(200)
        kind = {
            "/stream": "multipart/x-mixed-replace; boundary=frame",
            "/one": "image/jpeg",
        }.get(self.path, "text/html")
        self.send_header("Content-Type", kind)
        self.end_headers()
        server.looks += 1
        try:
            if self.path != "/stream":
                server.pictures += 1
                start = b"\xff\xd8" if self.path == "/one" else b"<p>"
                self.wfile.write(start + str(server.pictures).encode())
                return
            while not server.ended.wait(0.01):
                server.pictures += 1
                picture = server.image or b"\xff\xd8" + str(server.pictures).encode()
                self.wfile.write(b"--frame\r\nContent-Length: %d\r\n\r\n" % len(picture) + picture)
        except OSError:
            pass
        finally:
            server.looks -= 1

    def log_message(self, *_words):
        """Say nothing."""


@contextmanager
def camera(path="/stream", image=b""):
    """A camera on this machine, and its address; its pictures are `image`, or numbers."""
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.ended, server.looks, server.pictures = threading.Event(), 0, 0
        server.image = image
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        try:
            yield server, f"http://me:secret@127.0.0.1:{server.server_port}{path}"
        finally:
            server.ended.set()
            server.shutdown()
            thread.join(WAIT_S)


def picture(page):
    """The next picture."""
    while True:
        frame = page.connection.recv(timeout=WAIT_S)
        if isinstance(frame, bytes):
            assert frame.startswith(b"\xff\xd8")
            return int(frame[2:])


@pytest.mark.parametrize("path", ["/stream", "/one"])
def test_pages_see_the_newest_picture_and_the_camera_rests_when_they_are_gone(tmp_path, path):
    with (
        camera(path) as (server, address),
        console(MemoryNetwork(), tmp_path, camera=(f"front={address}",)) as running,
    ):
        with page_program(running) as page, page_program(running) as other:
            for each in (page, other):
                each.ask("cardan.camera", id=1, do="list")
                assert each.next("cardan.camera")["cameras"] == ["front"]
                each.ask("cardan.camera", do="open", camera=0)
            numbers = [picture(page) for _ in range(3)]
            assert numbers == sorted(set(numbers))
            picture(other)
            assert server.looks <= 1
            page.ask("cardan.camera", id=2, do="close")
            picture(other)
        until(lambda: server.looks == 0, "the camera rests")


def test_who_has_no_token_sees_nothing(tmp_path):
    tokens = tmp_path / "tokens"
    tokens.write_text(f"viewer {VIEWER}\n")
    tokens.chmod(0o600)
    with camera() as (server, address):
        options = {"camera": (address,), "token_file": str(tokens)}
        with console(MemoryNetwork(), tmp_path, **options) as running:
            with pytest.raises(InvalidStatus), page_program(running):
                pass
            with (
                pytest.raises(InvalidStatus),
                page_program(running, f"/ws?t={VIEWER}", origin="http://elsewhere.example"),
            ):
                pass
            assert server.looks == 0
            with page_program(running, f"/ws?t={VIEWER}") as page:
                page.ask("cardan.camera", do="open", camera=0)
                assert page.next("cardan.camera")["cameras"] == ["127.0.0.1"]
                assert picture(page) > 0


@pytest.mark.parametrize(
    ("change", "why"),
    [(("/stream", "/page"), "text/html, and no JPEG"), (("secret", "wrong"), "401|Unauthorized")],
)
def test_a_camera_that_gives_no_picture_says_why(tmp_path, change, why):
    with camera() as (_, address), console(
        MemoryNetwork(), tmp_path, camera=(address.replace(*change),)
    ) as running, page_program(running) as page:  # fmt: skip
        page.ask("cardan.camera", id=1, do="open", camera=0)
        page.next("cardan.camera", id=1)
        assert re.search(why, page.next("cardan.camera")["why"])


def test_there_is_no_other_camera(tmp_path):
    with console(MemoryNetwork(), tmp_path) as running, page_program(running) as page:
        for number in (0, -1, True, "0", None):
            page.ask("cardan.camera", id=1, do="open", camera=number)
            assert "there is no camera" in page.next("cardan.refused", id=1)["why"]


@pytest.mark.parametrize("address", ["", "front", "ftp://x/y", "file:///etc/passwd", "http://"])
def test_addresses_that_are_none_are_refused(address):
    with pytest.raises(OptionError, match="camera"):
        ConsoleOptions(camera=(address,))


def test_a_camera_is_called_by_its_name_and_never_by_what_is_secret():
    assert parse_camera("wrist 1=http://a:b@c.example/d?key=e").name == "wrist 1"
    assert parse_camera("http://a:b@c.example/d?key=e").name == "c.example"
    assert parse_camera("/dev/video0") == ("video0", "/dev/video0")


# -- a device of this machine ------------------------------------------------------------------


class Driver:
    """The kernel's part, by the same calls."""

    def __init__(self, form=video.MJPEG, capabilities=video.CAPTURE | video.STREAMING):
        self.form, self.capabilities = form, capabilities
        self.queued, self.calls = [], []
        self.writer = None

    def __call__(self, device, request, data):
        self.calls.append(request)
        if request == video.QUERYCAP:
            struct.pack_into("=II", data, 84, 0, self.capabilities)
        elif request == video.S_FMT:
            struct.pack_into("=I", data, 16, self.form)
        elif request == video.QUERYBUF:
            (index,) = struct.unpack_from("=I", data)
            struct.pack_into("=IxxxxI", data, 64, index * mmap.PAGESIZE, mmap.PAGESIZE)
        elif request == video.QBUF:
            self.queued.append(struct.unpack_from("=I", data)[0])
        elif request == video.DQBUF:
            if not self.queued:
                raise BlockingIOError(errno.EAGAIN, "nothing")
            index = self.queued.pop(0)
            os.pwrite(device, b"\xff\xd8" + bytes([index]), index * mmap.PAGESIZE)
            struct.pack_into("=I", data, 0, index)
            struct.pack_into("=I", data, 8, 3)
        return 0


@pytest.fixture
def device(tmp_path):
    path = tmp_path / "video0"
    path.write_bytes(bytes(video.BUFFERS * mmap.PAGESIZE))
    return str(path)


def test_a_device_gives_its_buffers_in_turn(device):
    driver, taken = Driver(), []
    taken.extend(video.pictures(device, lambda: len(driver.calls) >= 20, driver))
    assert taken == [b"\xff\xd8" + bytes([index]) for index in (0, 1, 2, 0, 1)]
    assert driver.calls[-1] == video.STREAMOFF


@pytest.mark.parametrize(
    ("driver", "why"),
    [
        (Driver(form=int.from_bytes(b"YUYV", "little")), "no MJPEG: serve it by a program"),
        (Driver(capabilities=video.STREAMING), "no camera"),
    ],
)
def test_a_device_that_gives_none_says_what_to_do(device, driver, why):
    with pytest.raises(OSError, match=why):
        next(video.pictures(device, lambda: False, driver))


def test_what_is_no_device_is_told_in_words(device, tmp_path):
    with pytest.raises(OSError, match="no V4L2 device"):
        next(video.pictures(device, lambda: False))
    where = str(tmp_path / "none")
    with pytest.raises(FileNotFoundError):
        next(video.pictures(where, lambda: False))


def test_structures_are_as_long_as_the_kernels():
    for request, structure in (
        (video.QUERYCAP, video._CAPABILITY),
        (video.S_FMT, video._FORMAT),
        (video.REQBUFS, video._REQUEST),
        (video.QUERYBUF, video._BUFFER),
    ):
        assert request >> 16 & 0x3FFF == structure.size
    assert cameras.SILENT_S >= video.SILENT_S
