"""Third-party programs that watch and command an arm, each in a separate process.

Programs that `tools/ros2` installs outside of our environment run with their own Python. Neither
environment affects the other.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from cardan.gateway.bus.commands import REARM_APART_S
from cardan.protocols.ros2.messages import completed
from tests.judge_node import JudgeNode
from tests.ros2_packages import write_packages
from tests.waiting import until, until_streamed

ROOT, HERE = Path(__file__).parents[2], Path(__file__).parent
INHERITED = ("HOME", "PATH", "LANG", "TMPDIR")

ARM = "/left/arm"
POSES, JOINTS, VELOCITY = f"{ARM}/state/pose", "/left/joint_states", "/left/cmd_vel"
DIAGNOSTICS, RESULTS = "/diagnostics", f"{ARM}/result_text"
STRING, EMPTY, TWIST = "std_msgs/msg/String", "std_msgs/msg/Empty", "geometry_msgs/msg/Twist"
HEARD = {
    POSES: "geometry_msgs/msg/PoseStamped",
    JOINTS: "sensor_msgs/msg/JointState",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
    RESULTS: STRING,
}
AGAIN_S = REARM_APART_S + 1.0
"""A command that is not accepted within this time is sent again."""


class Lab(NamedTuple):
    """A session, and the servers next to it."""

    endpoint: str
    """Zenoh endpoint."""
    domain: int
    """DDS domain."""
    port: int = 0
    """Port of the rosbridge server."""


def python_of(environment: str) -> Path:
    """The Python of a judge; skips the test if it is not installed."""
    made = ROOT / "build" / "ros2" / environment
    lock = ROOT / "locks" / "ros2" / f"{environment}.txt"
    if not (made / ".ready").exists() or (made / ".ready").read_bytes() != lock.read_bytes():
        found = subprocess.run(
            [ROOT / "tools" / "python-of", "3.12"], stdout=subprocess.DEVNULL, check=False
        )
        if found.returncode:
            pytest.skip("no Python 3.12 on this machine, which ROS 2's wheels are for")
        pytest.skip(f"{environment} is not installed: tools/ros2 {environment}")
    return made / "bin" / "python"


def own_environment(**more: str) -> dict[str, str]:
    """Environment variables for a judge that has a separate Python."""
    return {**{name: os.environ[name] for name in INHERITED if name in os.environ}, **more}


class Operator(JudgeNode):
    """A judge that carries out the commands of line_protocol.py and keeps the newest messages
    received."""

    def do(self, what: str, **how: Any) -> None:
        """Send a command to the judge."""
        self.say(json.dumps({"do": what, **how}, default=list))  # bytes as lists

    def watch(self) -> None:
        """Subscribe to the arm's reports."""
        self._since_s = time.time()
        for topic, kind in HEARD.items():
            self.do("subscribe", topic=topic, kind=kind)
        for topic in (POSES, JOINTS, DIAGNOSTICS):
            self.wait("sample", topic=topic)

    def newest(self, topic: str) -> Any:
        """Newest message of a topic, or None."""
        found = self.found("sample", topic=topic)
        return found[-1]["message"] if found else None

    def z(self) -> float:
        """Height of the TCP, m."""
        found: float = self.newest(POSES)["pose"]["position"]["z"]
        return found

    def results(self) -> list[tuple[str, str]]:
        """Commands and outcomes since this judge subscribed. Over DDS, a judge that starts after
        another was killed may receive what the killed one had not acknowledged."""
        samples = self.found("sample", topic=RESULTS)
        found = [json.loads(each["message"]["data"]) for each in samples]
        return [
            (each["command"], each["outcome"])
            for each in found
            if each["header"]["stamp"]["sec"] + 1e-9 * each["header"]["stamp"]["nanosec"]
            > self._since_s
        ]

    def status(self) -> dict[str, str]:
        """Return the arm's values in `/diagnostics`."""
        rows = {row["name"].rpartition(" ")[2]: row for row in self.newest(DIAGNOSTICS)["status"]}
        return {each["key"]: each["value"] for each in rows["arm"]["values"]}

    def graph(self) -> dict[str, Any]:
        """Return the graph that the judge sees now."""
        known = len(self.found("graph"))
        self.do("graph")
        return self.wait("graph", known + 1)

    def called(self, service: str, kind: str, wait_s: float = 10.0, **request: Any) -> Any:
        """Response of a service; None if none came, or if the service does not exist."""
        known = len(self.found("answer"))
        request = completed(f"{kind}_Request", request)
        self.do("call", service=service, kind=kind, request=request, wait_s=wait_s)
        return self.wait("answer", known + 1)["message"]

    def advertise(self, topic: str, kind: str) -> None:
        self.do("advertise", topic=topic, kind=kind)
        self.wait("matched", topic=topic)

    def tell(self, verb: str, kind: str = EMPTY, **message: Any) -> None:
        """Send a command until the arm accepts it. Commands sent before the server has discovered
        their publisher are lost; commands sent before the server knows the node's name are
        refused."""
        topic = f"{ARM}/command/{verb}"
        self.advertise(topic, kind)
        known, due_s = len(self.results()), 0.0

        def answered() -> bool:
            nonlocal due_s
            if time.monotonic() >= due_s:
                due_s = time.monotonic() + AGAIN_S
                self.do("publish", topic=topic, message=completed(kind, message) if message else {})
            return any(
                command == verb and outcome != "refused"
                for command, outcome in self.results()[known:]
            )

        until(answered, f"that {verb} is taken")

    def tell_and_wait(self, verb: str) -> None:
        self.tell(verb)
        until(lambda: (verb, "done") in self.results(), verb)

    def stream(self, speed: float) -> None:
        """Move the arm by a stream that runs until the judge ends."""
        self.wait_for_authority()
        self.advertise(VELOCITY, TWIST)
        begun = self.z()
        message = completed(TWIST, {"linear": {"z": speed}})
        self.do("publish", topic=VELOCITY, message=message, period_s=0.02)
        until_streamed(
            lambda: (self.z() - begun) / speed > 0.2,
            lambda: [outcome for command, outcome in self.results() if command == "twist"],
            lambda: self.do("publish", topic=VELOCITY, message=completed(TWIST, {})),
            "the motion",
        )

    def wait_for_authority(self) -> None:
        """Wait until the lease of an earlier, killed source has run out."""
        until(lambda: not self.status()["authority"], "that nobody has the arm")


def rclpy(distribution: str, lab: Lab, folder: Path) -> Operator:
    """Real ROS 2 of a distribution, over its default middleware."""
    return Operator(
        [python_of(distribution), HERE / "rclpy_node.py", "judge"],
        own_environment(
            ROS_DOMAIN_ID=str(lab.domain),
            ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
            ROS_HOME=str(folder),
        ),
    )


def zenoh_ros2_sdk(lab: Lab, folder: Path) -> Operator:
    """ROS 2 over Zenoh, with rmw_zenoh."""
    write_packages(folder)
    port = lab.endpoint.rpartition(":")[2]
    return Operator(
        [python_of("zenoh-ros2-sdk"), HERE / "sdk_node.py", port, folder / "share"],
        own_environment(GIT_ALLOW_PROTOCOL="file", GIT_PYTHON_REFRESH="quiet"),
    )


def roslibpy(lab: Lab, _folder: Path) -> Operator:
    """rosbridge client roslibpy."""
    pytest.importorskip("roslibpy", reason="roslibpy is not installed: pip install cardan[test]")
    return Operator([sys.executable, "-m", "tests.sweep.roslibpy_node", str(lab.port)])


def dora_rs(lab: Lab, folder: Path) -> Operator:
    """ROS 2 over Zenoh, with zenoh-ros2-sdk."""
    pytest.importorskip("dora", reason="dora-rs is not installed: pip install dora-rs pyarrow")
    write_packages(folder)
    config = folder / "zenoh.json5"
    config.write_text(
        f'{{mode: "peer", connect: {{endpoints: ["{lab.endpoint}"]}}, '
        "listen: {endpoints: []}, scouting: {multicast: {enabled: false}}}"
    )
    return Operator(
        [sys.executable, "-m", "tests.sweep.dora_node", str(config)],
        {**os.environ, "AMENT_PREFIX_PATH": str(folder)},
    )


def operator(judge: str, lab: Lab, folder: Path) -> Operator:
    """Start the program of that name."""
    made = {"zenoh-ros2-sdk": zenoh_ros2_sdk, "roslibpy": roslibpy, "dora-rs": dora_rs}
    return made[judge](lab, folder) if judge in made else rclpy(judge, lab, folder)
