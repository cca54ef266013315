"""The server's cameras on the bus, under image_transport's names for compressed pictures: read
while there is a subscriber, newest picture only, at lowest priority."""

from __future__ import annotations

import asyncio
import logging
import re
import time
from collections.abc import Sequence
from typing import Final

from cardan.bus.network import Network, NetworkError, PublisherHandle
from cardan.errors import OptionError
from cardan.gateway.servers.console.cameras import Camera
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import Stamp

TYPE: Final = "sensor_msgs/msg/CompressedImage"

LOOK_S: Final = 0.5
"""Period of checks for a subscriber."""

_log = logging.getLogger(__name__)


def frame_of(name: str) -> str:
    """Return a camera's name in the form of ROS, which is its frame too."""
    word = re.sub("[^A-Za-z0-9]+", "_", name).strip("_") or "camera"
    return f"camera_{word}" if word[0].isdigit() else word


def topic_of(name: str) -> str:
    """Return the topic of the pictures of the camera of this name."""
    return f"/camera/{frame_of(name)}/image_raw/compressed"


def check_names(names: Sequence[str]) -> None:
    """Raise OptionError if two cameras would have one topic."""
    topics = [topic_of(each) for each in names]
    for topic in topics:
        if topics.count(topic) > 1:
            raise OptionError(
                "camera", topic, "a topic of its own for each camera: name them NAME=ADDRESS"
            )


async def publish(network: Network, camera: Camera) -> None:
    """Publish a camera until this task is canceled."""
    topic = topic_of(camera.address.name)
    try:
        publisher = network.advertise(topic, TYPE, False)
    except NetworkError as error:
        _log.warning("camera %s is not published: %s", camera.address.name, error)
        return
    changed, number = asyncio.Event(), 0
    loop = asyncio.get_running_loop()
    try:
        while True:
            there = network.topics().get(topic)
            wanted = there is not None and bool(there.subscribers)
            if wanted:
                camera.watch(changed)
            else:
                camera.leave(changed)
                changed.clear()
            look = loop.call_later(LOOK_S, changed.set)
            try:
                await changed.wait()
            finally:
                look.cancel()
            changed.clear()
            if wanted and camera.newest and camera.number != number:
                number = camera.number
                # It waits for a slow link, up to 50 ms, which pages do not.
                await asyncio.to_thread(_put, publisher, camera)
    finally:
        camera.leave(changed)
        publisher.close()


def _put(publisher: PublisherHandle, camera: Camera) -> None:
    picture, had_s = camera.newest, camera.newest_s
    stamp = Stamp.of_ns(time.time_ns() - int(1e9 * (time.monotonic() - had_s)))
    header = {"stamp": stamp._asdict(), "frame_id": frame_of(camera.address.name)}
    message = {"header": header, "format": "jpeg", "data": picture}
    publisher.publish(codec_of(TYPE).encode(message))
