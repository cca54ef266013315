"""The device on the network without an arm: in virtual time, and on the real bus."""

import contextlib
import json
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cardan.gateway.session.force_assembly import load_haptic
from cardan.gateway.session.haptic_session import PERIOD_S
from cardan.types import Vector3
from cardan_omni.driver.limits import TickLimits
from cardan_omni.peer.library import available
from tests.gateway.force.fakes import FakeHaptic
from tests.gateway.session.test_haptic_session import MAX_AGE_S, Bench
from tests.serving import free_endpoint

EXAMPLES = Path(__file__).parents[3] / "examples" / "ros2"


def test_the_example_is_of_this_device():
    assert load_haptic(EXAMPLES / "haptic.toml").network.haptic == "omni"


@pytest.mark.skipif(not available(), reason="the simulated libHD was not compiled")
@pytest.mark.matrix
def test_the_devices_own_limits_hold_of_what_a_program_asks(monkeypatch):
    """Commands of 5 N, then 5 N in the opposite direction, then silence, on the simulated Omni and
    its tick."""
    from studies.haptics.loop import Bench as OmniBench

    limits = TickLimits()

    class Omni(FakeHaptic):
        def render(self, command):
            omni.tick.command(command)

        def haptics(self):
            return omni.tick.snapshot()

        def enable(self):
            omni.tick.enable()

    with OmniBench(limits) as omni:
        bench = Bench(Omni())
        omni.run(0.1, None)
        bench.now_s = omni.now_s
        clock = SimpleNamespace(monotonic=lambda: bench.now_s)
        monkeypatch.setattr("cardan.drivers.ihaptic.time", clock)

        def publish(seconds, asked):
            for _ in range(round(seconds / PERIOD_S)):
                bench.run(PERIOD_S, asked)
                omni.run(bench.now_s - omni.now_s, None)

        publish(1.5, Vector3(5.0, 0.0, 0.0))
        publish(0.3, Vector3(-5.0, 0.0, 0.0))
        begun_s = bench.now_s
        publish(0.3, None)
        trace = omni.trace
        sent = np.linalg.norm(trace.sent_n, axis=1)
        assert 1.0 < sent.max() <= limits.clamp_n + 1e-9
        assert np.abs(np.diff(trace.sent_n, axis=0)).max() <= limits.slew_fall_n_s * 1e-3 + 1e-9
        assert sent[trace.times_s > begun_s + MAX_AGE_S + 0.05].max() == 0.0


# -- over the real bus -----------------------------------------------------------------------------

WITHIN_S = 60.0


@contextlib.contextmanager
def running(*words, **options):
    """Run a program that prints READY once it is ready."""
    command = [sys.executable, "-m", "cardan", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, **options) as process:
        try:
            assert process.stdout.readline().startswith("READY")
            yield process
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=WITHIN_S)


VECTOR, WRENCH = "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Wrench"
POSE, RESULT = "geometry_msgs/msg/Pose", "cardan_msgs/msg/CommandResult"
TRIGGER = "std_srvs/srv/Trigger"

HAND = "\n".join(
    ["0.5 move -0.03 0 0", "2 click 2"]
    + [
        line
        for second in range(3, 120, 5)
        for line in (f"{second} move 0.03 0 0 over 1", f"{second + 3} move -0.03 0 0 over 1")
    ]
)
"""The hand clutches in, and moves forward and back repeatedly."""

DEVICE = """
[device]
driver = "omni"
stale_after_s = 0.1
"""

SESSION = """
[robot]
driver = "sim_arm"
robot = "ur5"
gravity_feedforward = true
start = [-0.251, -1.712, 1.782, -1.641, -1.571, -0.251]

[arm]
model = "ur5"
collisions = false

[mapping]
mode = "position"
clutch = "button_2"
orientation = "fixed"
device_rpy_deg = [0.0, 0.0, 180.0]

[force]
source = "network"
"""


class Program:
    """A node that renders a wall from the device's pose, like the papers' nodes."""

    def __init__(self, node, codec_of, name):
        self.node, self.codec_of, self.name = node, codec_of, name
        self.heard = {}
        self.pushing = True
        for topic, kind in (
            ("state/pose", POSE), ("state/force_feedback", WRENCH), ("result", RESULT),
        ):  # fmt: skip
            self.heard[topic] = node.subscription(f"{name}/{topic}", kind, 500), codec_of(kind)
        self.feedback = node.publisher(f"{name}/feedback", VECTOR)
        self.forces, self.results = [], []

    def step(self):
        """Read the received messages, and answer the newest pose."""
        pose = None
        for topic, (subscription, codec) in self.heard.items():
            for received in iter(subscription.poll, None):
                message = codec.decode(received.data)
                if topic == "state/pose":
                    pose = message["position"]
                elif topic == "result":
                    self.results.append(message)
                else:
                    self.forces.append(message["force"])
        if pose is not None and self.pushing:
            self.publish(x=-60.0 * max(0.0, pose["x"]))

    def publish(self, x=0.0, y=0.0, z=0.0):
        data = self.codec_of(VECTOR).encode({"x": x, "y": y, "z": z})
        self.feedback.put(data, time.time_ns())

    def until(self, found, what):
        end_s = time.monotonic() + WITHIN_S
        while not (answer := found()):
            assert time.monotonic() < end_s, f"{what} did not happen"
            self.step()
            threading.Event().wait(0.004)
        return answer

    def until_felt(self):
        self.until(lambda: self.forces and self.forces[-1]["x"] < -0.7, "the wall's force")

    def call(self, service, kind, **given):
        from cardan.protocols.ros2.messages import completed

        client = self.node.client(f"{self.name}/{service}", kind)
        reply = client.call(
            self.codec_of(f"{kind}_Request").encode(completed(f"{kind}_Request", given))
        )
        client.close()
        return self.codec_of(f"{kind}_Response").decode(reply)


@contextlib.contextmanager
def program(endpoint, name):
    pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
    from cardan.bus.node import BusNode
    from cardan.bus.options import BusOptions
    from cardan.protocols.ros2.cdr import codec_of

    with BusNode(BusOptions(router=endpoint, listen=()), "program") as node:
        yield Program(node, codec_of, name)


def bus(endpoint, **more):
    lines = "".join(f"{key} = {value}\n" for key, value in more.items())
    return f'[network]\nrouter = ""\nlisten = ["{endpoint}"]\nrate_hz = 200.0\n{lines}'


@pytest.fixture
def simulated(tmp_path):
    if not available():
        pytest.skip("the simulated libHD was not compiled")
    script = tmp_path / "hand.txt"
    script.write_text(HAND)
    return "sim", "omni", "--script", str(script), "--", sys.executable, "-m", "cardan"


@pytest.mark.matrix
def test_a_program_makes_a_wall_over_the_bus(simulated, tmp_path):
    endpoint = free_endpoint()
    file = tmp_path / "haptic.toml"
    file.write_text(DEVICE + bus(endpoint, haptic='"omni"'))
    words = (*simulated, "devices", "haptic", str(file))
    with running(*words), program(endpoint, "/omni") as user:
        user.until_felt()
        largest = user.call("get_max_feedback", "yarp_control_msgs/srv/GetMaxFeedback")
        assert largest["max_feedback"]["x"] == 2.0
        assert max(abs(force["x"]) for force in user.forces) <= 2.0
        # An invalid force is refused with a reason, and the force stays that of the wall.
        user.publish(y=float("nan"))
        refused = user.until(
            lambda: [each for each in user.results if each["outcome"] == "refused"], "a refusal"
        )
        assert "is not finite" in refused[0]["reason"]
        user.until_felt()
        # The force of a program that falls silent ends.
        user.pushing = False
        user.until(lambda: abs(user.forces[-1]["x"]) < 0.01, "the end of the force")
        user.pushing = True
        user.until_felt()
        user.pushing = False
        assert user.call("stop_feedback", TRIGGER)["success"]
        user.until(lambda: abs(user.forces[-1]["x"]) < 0.01, "the end of the force")


@pytest.mark.matrix
def test_a_second_one_of_its_name_does_not_begin(simulated, tmp_path):
    endpoint = free_endpoint()
    first, second = tmp_path / "first.toml", tmp_path / "second.toml"
    first.write_text(DEVICE + bus(endpoint, haptic='"omni"'))
    second.write_text(f'{DEVICE}\n[network]\nrouter = "{endpoint}"\nhaptic = "omni"\n')
    with running(*simulated, "devices", "haptic", str(first)):
        ended = subprocess.run(
            [sys.executable, "-m", "cardan", *simulated, "devices", "haptic", str(second)],
            stderr=subprocess.PIPE,
            text=True,
            timeout=WITHIN_S,
        )
    assert ended.returncode == 2
    assert "network.haptic: another node on" in ended.stderr


@pytest.mark.matrix
def test_the_example_is_a_wall(simulated, tmp_path):
    endpoint = free_endpoint()
    file = tmp_path / "haptic.toml"
    text = (EXAMPLES / "haptic.toml").read_text(encoding="utf-8")
    file.write_text(f'{text}router = ""\nlisten = ["{endpoint}"]\n')
    with running(*simulated, "devices", "haptic", str(file)):
        wall = subprocess.run(
            [sys.executable, str(EXAMPLES / "haptic_wall.py"), "8", endpoint],
            stdout=subprocess.PIPE,
            text=True,
            check=True,
            timeout=WITHIN_S,
        )
    said = re.search(r"strongest force ([\d.]+) N", wall.stdout)
    assert 0.5 < float(said[1]) < 3.0


@pytest.mark.matrix
def test_a_program_makes_a_wall_for_the_hand_that_drives_an_arm(simulated, tmp_path):
    """When the program falls silent, the session disengages, as after any loss of the force."""
    endpoint = free_endpoint()
    file = tmp_path / "session.toml"
    file.write_text(DEVICE + SESSION + bus(endpoint, device="true", name='"arm"'))
    command = [sys.executable, "-m", "cardan", *simulated, "run", str(file), "--seconds", "200"]
    with (
        subprocess.Popen(command, stdout=subprocess.DEVNULL) as session,
        program(endpoint, "/hapticDevice_nws_ros2") as user,
    ):
        try:
            kind = "std_msgs/msg/String"
            snapshots = user.node.subscription("/arm/state/snapshot", kind, 50)
            said = []

            def message():
                for received in iter(snapshots.poll, None):
                    text = user.codec_of(kind).decode(received.data)["data"]
                    said.append(json.loads(text)["arm"]["message"])
                return [each for each in said if "the measured force is lost" in each]

            user.until_felt()
            answer = user.call("set_force_mode", "std_srvs/srv/SetBool", data=False)
            assert "a session renders forces" in answer["message"]
            said.clear()
            user.pushing = False
            user.until(message, "the end of teleoperation")
            user.until(lambda: abs(user.forces[-1]["x"]) < 0.01, "the end of the force")
        finally:
            session.send_signal(signal.SIGINT)
            session.wait(WITHIN_S)
