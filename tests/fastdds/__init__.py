"""Node of ROS 2's default middleware (eProsima Fast DDS, from Debian), which judges messages sent
to it over DDS. It is a program in C++, built when it is first needed.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.protocols.ros2.messages import completed
from cardan.protocols.ros2.type_hash import type_hash
from tests.judge_node import JudgeNode

SOURCE = Path(__file__).parent / "node.cpp"
HEADERS = Path("/usr/include/fastdds/dds/domain/DomainParticipant.hpp")


def program() -> Path:
    """Return the program, built once per user and source."""
    if not HEADERS.exists():
        pytest.skip("Fast DDS is not installed (Debian package libfastrtps-dev)")
    if not shutil.which("g++"):
        pytest.skip("g++ is not installed (Debian package g++)")
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "cardan-tests"
    name = f"fastdds-{hashlib.sha256(SOURCE.read_bytes()).hexdigest()[:16]}"
    built = cache / name
    if not built.exists():
        cache.mkdir(parents=True, exist_ok=True)
        making = cache / f"{name}.{os.getpid()}"
        command = ["g++", "-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", str(SOURCE)]
        subprocess.run([*command, "-o", making, "-lfastrtps", "-lfastcdr"], check=True)
        making.rename(built)
    return built


class FastNode(JudgeNode):
    """Node over Fast DDS in its own process, for a with statement."""

    def __init__(
        self, domain: int, discovery: str = "whitelist", gid_length: int = 16, name: str = "fast"
    ) -> None:
        """`discovery`: "whitelist" like ROS_LOCALHOST_ONLY of Humble, "unicast" like
        ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST; `gid_length`: 24 in Humble."""
        super().__init__([program(), str(domain), discovery, str(gid_length), name])
        self.name = name

    # -- actions ---------------------------------------------------------------------------------

    def do(self, *words: object) -> None:
        """Send a command of node.cpp to the node."""
        self.say(" ".join(map(str, words)))

    def subscribe(
        self, topic: str, type_name: str, *, reliable: bool = True, latched: bool = False
    ) -> None:
        """Subscribe with rclcpp's defaults."""
        self._endpoint("subscribe", topic, type_name, reliable, latched)

    def advertise(
        self, topic: str, type_name: str, *, reliable: bool = True, latched: bool = False
    ) -> None:
        """Create a publisher with rclcpp's defaults."""
        self._endpoint("advertise", topic, type_name, reliable, latched)

    def _endpoint(
        self, verb: str, topic: str, type_name: str, reliable: bool, latched: bool
    ) -> None:
        reliability = "reliable" if reliable else "best_effort"
        durability = "transient_local" if latched else "volatile"
        self.do(verb, topic, type_name, reliability, durability, 10, type_hash(type_name))

    def publish(
        self,
        topic: str,
        type_name: str,
        message: dict[str, Any] | bytes,
        *,
        count: int = 1,
        period_ms: int = 0,
    ) -> None:
        """Publish a message, or any bytes, `count` times."""
        self.do("publish", topic, _encoded(type_name, message).hex(), count, period_ms)

    def request(self, service: str, type_name: str, message: dict[str, Any]) -> None:
        """Send a request in the service mapping of the default middleware."""
        self.do("request", service, _encoded(f"{type_name}_Request", message).hex())

    def serve(self, service: str, type_name: str, reply: dict[str, Any]) -> None:
        """Offer a service that always returns the same response."""
        self.do("server", service, type_name, _encoded(f"{type_name}_Response", reply).hex())

    # -- observations ----------------------------------------------------------------------------

    def heard(self, topic: str, type_name: str, count: int = 1) -> dict[str, Any]:
        """Return the newest message of a topic after at least `count` messages."""
        sample = self.wait("sample", count, topic=topic)
        message = codec_of(type_name).decode(bytes.fromhex(sample["cdr"]))
        assert not isinstance(message, MalformedCdr), message.reason
        return message


def user_data(event: dict[str, Any]) -> dict[str, str]:
    """Return the pairs in the user_data of discovered entities."""
    pairs = (each.split("=", 1) for each in event["user_data"].split(";") if each)
    return dict(pairs)


def _encoded(type_name: str, message: dict[str, Any] | bytes) -> bytes:
    if isinstance(message, bytes):
        return message
    return codec_of(type_name).encode(completed(type_name, message))
