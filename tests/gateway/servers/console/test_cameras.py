"""Cameras send each authorized client the newest picture, and are closed without viewers."""

from __future__ import annotations

import base64
import errno
import json
import mmap
import os
import re
import struct
import threading
import time
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")

from websockets.exceptions import InvalidStatus

from cardan.errors import OptionError
from cardan.gateway.servers.console import cameras, client, video
from cardan.gateway.servers.console.camera_topics import TYPE as IMAGE, topic_of
from cardan.gateway.servers.console.cameras import parse_camera
from cardan.gateway.servers.console.server import ConsoleOptions
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.names import checked_name
from tests.gateway.servers.bench import WAIT_S
from tests.gateway.servers.console.bench import VIEWER, console, page_program, token_file
from tests.gateway.servers.memory_network import MemoryNetwork
from tests.waiting import until

pytestmark = pytest.mark.matrix

ALLOWED = "Basic " + base64.b64encode(b"me:secret").decode()


class Handler(BaseHTTPRequestHandler):
    """A camera with a stream at /stream, a picture at /one, and an HTML page elsewhere."""

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
                if server.still.is_set():
                    server.stands.set()
                    continue
                server.pictures += 1
                picture = server.image or b"\xff\xd8" + str(server.pictures).encode()
                self.wfile.write(b"--frame\r\nContent-Length: %d\r\n\r\n" % len(picture) + picture)
        except OSError:
            pass
        finally:
            server.looks -= 1

    def log_message(self, *_words):
        """Log nothing."""


@contextmanager
def camera(path="/stream", image=b""):
    """A camera on this computer, and its address; its pictures are `image`, or numbers."""
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.ended, server.still, server.stands = (threading.Event() for _ in range(3))
        server.looks = server.pictures = 0
        server.image = image
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        try:
            yield server, f"http://me:secret@127.0.0.1:{server.server_port}{path}"
        finally:
            server.ended.set()
            server.shutdown()
            thread.join(WAIT_S)


def announced(page):
    """Next picture, and the message about it that precedes it."""
    about = None
    while True:
        frame = page.connection.recv(timeout=WAIT_S)
        if isinstance(frame, bytes):
            assert frame.startswith(b"\xff\xd8")
            return int(frame[2:]), about
        said = json.loads(frame)
        about = said if "picture" in said else about


def show(page, number, page_us=0, **more):
    page.ask("cardan.camera", do="shown", picture=number, page_us=page_us, **more)


def picture(page):
    """Next picture, acknowledged as shown."""
    number, about = announced(page)
    show(page, about["picture"])
    return number


def settled(page):
    """True if only text frames arrived until the server replied."""
    page.ask("cardan.camera", id="settled", do="list")
    while isinstance(frame := page.connection.recv(timeout=WAIT_S), str):
        if json.loads(frame).get("id") == "settled":
            return True
    return False


@pytest.fixture
def server():
    """A camera with a stream."""
    with camera() as (server, address):
        server.address = address
        yield server


@pytest.fixture
def running(network, tmp_path, server):
    """A console that shows this camera."""
    with console(network, tmp_path, camera=(server.address,)) as running:
        yield running


@pytest.fixture
def page(running):
    with page_program(running) as page:
        yield page


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


def test_the_next_picture_goes_out_when_the_one_before_was_shown_and_is_the_newest(server, page):
    page.ask("cardan.camera", do="open", camera=0, page_us=123)
    first, about = announced(page)
    assert about["page_us"] == 123
    passed = server.pictures + 20
    until(lambda: server.pictures >= passed, "pictures come that nobody has room for")
    show(page, about["picture"] + 1)
    assert settled(page)
    show(page, about["picture"], page_us=456)
    second, about = announced(page)
    assert second >= passed - 1 > first
    assert about["page_us"] == 456
    # A page with room for two pictures gets two before it acknowledges one, and no third.
    show(page, about["picture"], two=True)
    ahead = [announced(page)[1]["picture"] for _ in range(2)]
    passed = server.pictures + 5
    until(lambda: server.pictures >= passed, "pictures come that nobody has room for")
    assert settled(page)
    # Acknowledging the second picture also acknowledges a skipped first one.
    show(page, ahead[1])
    assert announced(page)[1]["picture"] == ahead[1] + 1


def test_a_picture_comes_with_its_age_and_with_how_long_the_page_was_waited_for(
    server, running, page
):
    with page_program(running) as later:
        asked_s = time.monotonic()
        page.ask("cardan.camera", do="open", camera=0, page_us=0)
        _, about = announced(page)
        assert 0 <= about["age_us"] <= about["held_us"] <= 1e6 * (time.monotonic() - asked_s)
        server.still.set()
        until(lambda: server.stands.is_set(), "the camera stands still")
        stood_s = time.monotonic()
        until(lambda: time.monotonic() > stood_s + 0.3, "its picture grows old")
        later.ask("cardan.camera", do="open", camera=0, page_us=0)
        _, about = announced(later)
        assert about["age_us"] >= 0.3e6 > about["held_us"]


def test_a_camera_rests_while_a_page_shows_nothing_of_it(server, page, monkeypatch):
    monkeypatch.setattr(client, "UNSHOWN_S", 0.1)
    page.ask("cardan.camera", do="open", camera=0)
    _, about = announced(page)
    until(lambda: server.looks == 0, "the camera rests")
    assert settled(page)
    show(page, about["picture"])
    announced(page)
    assert server.looks == 1


@pytest.mark.parametrize("page_us", [None, -1, "0", True, float("inf")])
def test_what_is_no_time_shows_nothing(page, page_us):
    show(page, 1)  # no picture is in transit
    page.ask("cardan.camera", do="open", camera=0)
    _, about = announced(page)
    page.ask("cardan.camera", do="shown", id=1, picture=about["picture"], page_us=page_us)
    assert "page_us" in page.next("cardan.refused", id=1)["why"]
    assert settled(page)
    show(page, about["picture"])
    announced(page)


def test_pictures_are_on_the_bus_while_somebody_subscribes(tmp_path):
    network, heard = MemoryNetwork(), []
    options = {"camera": ("wrist 1=",), "publish_cameras": True}
    with camera() as (server, address):
        options["camera"] = (f"wrist 1={address}",)
        with console(network, tmp_path, **options):
            topic = "/camera/wrist_1/image_raw/compressed"
            until(lambda: topic in network.topics(), "it is on the bus")
            assert server.looks == 0
            begun_ns = time.time_ns()
            handle = network.subscribe(topic, IMAGE, lambda cdr, _ns: heard.append(cdr))
            until(lambda: len(heard) >= 3, "pictures come")
            handle.close()
            until(lambda: server.looks == 0, "the camera rests")
        until(lambda: topic not in network.topics(), "it has left the bus")
    pictures = [codec_of(IMAGE).decode(each) for each in heard]
    numbers = [int(each["data"][2:]) for each in pictures]
    assert numbers == sorted(set(numbers))
    assert {(each["format"], each["header"]["frame_id"]) for each in pictures} == {
        ("jpeg", "wrist_1")
    }
    times = [each["header"]["stamp"] for each in pictures]
    stamps = [1_000_000_000 * each["sec"] + each["nanosec"] for each in times]
    stamps = [begun_ns, *stamps, time.time_ns()]
    assert stamps == sorted(stamps)


def test_cameras_are_not_on_the_bus_unless_that_is_wanted(network, running):
    assert not network.publishers


@pytest.mark.parametrize(
    ("name", "topic"),
    [("wrist", "wrist"), ("127.0.0.1", "camera_127_0_0_1"), ("-_a--b_", "a_b"), ("左", "camera")],
)
def test_a_topic_has_a_name_that_ros_allows(name, topic):
    made = topic_of(name)
    assert made == checked_name(made) == f"/camera/{topic}/image_raw/compressed"


def test_two_cameras_of_one_topic_are_refused_where_they_are_published():
    both = ("a b=http://x", "a-b=http://y")
    ConsoleOptions(camera=both)
    with pytest.raises(OptionError, match="camera/a_b/image_raw"):
        ConsoleOptions(camera=both, publish_cameras=True)


def test_who_has_no_token_sees_nothing(tmp_path):
    with camera() as (server, address):
        options = {"camera": (address,), "token_file": token_file(tmp_path)}
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


# -- a camera of this computer -----------------------------------------------------------------


class Driver:
    """Simulated kernel driver with the same system calls."""

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
        (Driver(capabilities=video.STREAMING), "not a camera"),
    ],
)
def test_a_device_that_gives_none_says_what_to_do(device, driver, why):
    with pytest.raises(OSError, match=why):
        next(video.pictures(device, lambda: False, driver))


def test_what_is_no_device_is_reported_in_words(device, tmp_path):
    with pytest.raises(OSError, match="not a V4L2 device"):
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
