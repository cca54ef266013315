"""Sessions whose operator devices are on a page: a phone, a left and a right VR controller."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.gateway.session.snapshot import Snapshot
from cardan.protocols.ros2.cdr import codec_of
from tests.console.robot_and_server import ServerProcess, console_server
from tests.serving import free_endpoint
from tests.waiting import until

STRING = "std_msgs/msg/String"

SESSION = """
[robot]
driver = "sim_arm"
robot = "ur5"
drive = "ideal"
period_s = 0.008

[arm]
model = "ur5"

[device]
driver = "{driver}"
wait_for_device = true
router = "{endpoint}"
{device}

[mapping]
mode = "{mode}"
frame = "base"
deadman = "hold"
linear_speed_m_s = 0.1
angular_speed_rad_s = 0.5

[network]
name = "arm"
namespace = "{name}"
router = "{endpoint}"
"""


class Session:
    """Published state of a session."""

    def __init__(self, network: BusNetwork, name: str) -> None:
        self._snapshot: Snapshot | None = None
        self._codec = codec_of(STRING)
        self._handle = network.subscribe(f"/{name}/arm/state/snapshot", STRING, self._hear)

    def _hear(self, cdr: bytes, _stamp_ns: int) -> None:
        message = self._codec.decode(cdr)
        self._snapshot = Snapshot.from_bytes(message["data"].encode())

    @property
    def now(self) -> Snapshot:
        """Newest snapshot of the session."""
        until(lambda: self._snapshot is not None, "a snapshot")
        assert self._snapshot is not None
        return self._snapshot

    def until(self, wanted: str, **context: object) -> Snapshot:
        """Wait until an expression of the snapshot's fields holds."""
        end_s = time.monotonic() + 20.0
        while True:
            now = self.now
            if eval(wanted, {**context}, vars(now)):
                return now
            assert time.monotonic() < end_s, (
                wanted,
                now.device.link,
                now.device.reason,
                now.device.axes,
            )
            time.sleep(0.02)

    def rests(self, seconds: float = 0.4) -> None:
        """Wait until the arm is at rest, and check that nothing moves it for this time."""
        self.until("not any(arm.twist)")
        at = self.now.robot.pose
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            now = self.now.robot.pose
            assert all(abs(a - b) < 2e-3 for a, b in zip(at, now, strict=True)), (at, now)
            time.sleep(0.02)


class Hands(NamedTuple):
    """Running server and sessions."""

    server: ServerProcess
    phone: Session
    left: Session
    right: Session


KINDS = {
    "phone": {"driver": "phone", "mode": "rate", "device": ""},
    "left": {"driver": "xr", "mode": "position", "device": 'part = "left"'},
    "right": {"driver": "xr", "mode": "rate", "device": 'part = "right"'},
}


@contextlib.contextmanager
def hands(folder: Path) -> Iterator[Hands]:
    """Three sessions, the router that connects them, and the console server."""
    endpoint = free_endpoint()
    cardan = [sys.executable, "-m", "cardan"]
    with contextlib.ExitStack() as stack:

        def run(*words: str) -> None:
            process = stack.enter_context(
                subprocess.Popen(
                    [*cardan, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
                )
            )
            stack.callback(process.terminate)

        run("net", "server", "router", "--endpoint", endpoint)
        for name, kind in KINDS.items():
            path = folder / f"{name}.toml"
            path.write_text(SESSION.format(name=name, endpoint=endpoint, **kind))
            run("run", str(path), "--seconds", "3000")
        server = stack.enter_context(console_server(endpoint))
        network = stack.enter_context(BusNetwork(BusOptions(router=endpoint), "watcher"))
        for name in KINDS:
            assert network.wait_for_service(f"/{name}/arm/ask", 30.0)
        yield Hands(server, *(Session(network, name) for name in KINDS))
