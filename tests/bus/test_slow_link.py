"""A link saturated by pictures: commands and their answers overtake them."""

from __future__ import annotations

import os
import socket
import statistics
import threading
import time
from contextlib import contextmanager, suppress

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.protocols.ros2.cdr import codec_of
from tests.serving import free_tcp_port
from tests.waiting import until

pytestmark = pytest.mark.matrix

IMAGE, TRIGGER = "sensor_msgs/msg/CompressedImage", "std_srvs/srv/Trigger"

BYTES_PER_S = 500_000.0
"""4 Mbit/s, each way."""

PIECE, BUFFER_BYTES = 4096, 8192
"""Sizes in bytes: a read of the slow link, and its buffers."""

AHEAD = 200_000
"""Most bytes of pictures that an answer waits for: a batch of Zenoh, the kernel's buffer and those
of the slow link. With the kernel's default size they are 2 MB and more."""


@contextmanager
def slow_link(port):
    """Run a slow link to `port`; return its own port on this computer."""
    listening = socket.create_server(("127.0.0.1", 0))
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    ends = [listening]

    def carry(source, sink):
        with suppress(OSError):
            while data := source.recv(PIECE):
                time.sleep(len(data) / BYTES_PER_S)
                sink.sendall(data)

    def accept():
        with suppress(OSError):
            while True:
                near, _ = listening.accept()
                far = socket.create_connection(("127.0.0.1", port))
                for end in (near, far):
                    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                    ends.append(end)
                for way in ((near, far), (far, near)):
                    threading.Thread(target=carry, args=way, daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    try:
        yield listening.getsockname()[1]
    finally:
        for end in ends:
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()


def test_an_answer_waits_for_few_bytes_of_the_pictures_that_fill_its_link():
    own_port = free_tcp_port()
    here = BusOptions(router="", listen=(f"tcp/127.0.0.1:{own_port}",))
    codec = codec_of(IMAGE)
    pictures = []
    with (
        BusNetwork(here, "page") as page,
        slow_link(own_port) as port,
        BusNetwork(BusOptions(router=f"tcp/127.0.0.1:{port}", mode="client"), "robot") as robot,
    ):
        retained = [
            robot.serve("/stop", TRIGGER, lambda request, answer: answer(request)),
            page.subscribe("/camera", IMAGE, lambda cdr, _ns: pictures.append(len(cdr))),
        ]
        publisher = robot.advertise("/camera", IMAGE, False)
        assert page.wait_for_service("/stop", 10.0)
        until(lambda: "/camera" in robot.topics() and robot.topics()["/camera"].subscribers, "seen")

        def round_s():
            answered, began_s = threading.Event(), time.monotonic()
            page.call("/stop", TRIGGER, b"\0\1\0\0\0", lambda _reply: answered.set(), 10.0)
            assert answered.wait(20.0)
            return time.monotonic() - began_s

        alone_s = statistics.median(round_s() for _ in range(9))
        ended = threading.Event()

        def film():
            message = {"format": "jpeg", "data": os.urandom(40_000)}
            cdr = codec.encode(
                {"header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}, **message}
            )
            while not ended.wait(0.02):
                publisher.publish(cdr)

        filming = threading.Thread(target=film)
        filming.start()
        try:
            until(lambda: len(pictures) >= 5, "pictures fill the link")
            beside_s = statistics.median(round_s() for _ in range(9))
            seen = len(pictures)
            until(lambda: len(pictures) > seen, "pictures still come")
        finally:
            ended.set()
            filming.join()
        for each in retained:
            each.close()
    ahead = (beside_s - alone_s) * BYTES_PER_S
    print(
        f"{1e3 * alone_s:.1f} ms alone, {1e3 * beside_s:.0f} ms beside pictures: {ahead:.0f} bytes"
    )
    assert ahead <= AHEAD
