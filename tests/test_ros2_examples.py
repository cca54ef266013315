"""The examples of examples/ros2, as far as possible without ROS: programs and command lines against
sessions on the bus, configuration files by the programs that read them."""

import contextlib
import json
import re
import shlex
import subprocess
import sys
import tempfile
import time
from itertools import dropwhile
from pathlib import Path

import pytest
import zenoh
from websockets.sync.client import connect

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.errors import DriverError, MotionLoopError
from cardan.gateway.bus.remote import network_arm
from cardan.gateway.session.assembly import load_config
from cardan.gateway.session.force_assembly import load_haptic
from cardan.gateway.session.subprocesses import cardan_subprocess
from tests.gateway.servers.test_rosbridge_judges import installed
from tests.serving import free_endpoint, free_tcp_port
from tests.waiting import until

pytestmark = pytest.mark.timeout(180)  # sessions, routers and servers start one after the other

EXAMPLES = Path(__file__).parents[1] / "examples" / "ros2"
TWO = EXAMPLES / "two-computers"
ARM = "/cartesian_control_server_ros2"
MOUSE = ("sim", "spacemouse", "--hid", "spacemouse.sock", "--script", "demo")
PAUSE_S = 1.5
"""Pause after a stream until another one may begin."""


# -- files ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.name)
def test_the_sessions_are_fine(path):
    load = load_haptic if path.stem == "haptic" else load_config
    assert load(path).network is not None


@pytest.mark.parametrize("path", sorted(TWO.glob("*.json5")), ids=lambda path: path.name)
def test_zenoh_reads_its_configurations(path):
    zenoh.Config.from_file(path)


def test_every_example_has_its_place_on_the_page():
    page = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    for path in EXAMPLES.iterdir():
        assert path.name == "README.md" or f"]({path.name})" in page, path.name
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page):
        assert (EXAMPLES / target).exists(), target


def panels(layout):
    """Yield the names of the panels in a layout."""
    if isinstance(layout, str):
        return [layout]
    return [*panels(layout["first"]), *panels(layout["second"])]


# -- on the bus -----------------------------------------------------------------------------------


class Client:
    """Performs a `ros2` command line over rosbridge."""

    def __init__(self, socket) -> None:
        self._socket, self._number = socket, 0

    def send(self, **operation):
        self._socket.send(json.dumps(operation))

    def until(self, wanted, timeout_s=20.0):
        """Return the next operation for which `wanted` is true."""
        end_s = time.monotonic() + timeout_s
        while True:
            operation = json.loads(self._socket.recv(max(0.0, end_s - time.monotonic())))
            if wanted(operation):
                return operation

    def results(self, seconds):
        """Return the messages of ~/result in this time."""
        reported = []
        with contextlib.suppress(TimeoutError):
            self.until(lambda operation: reported.append(operation.get("msg")), seconds)
        return [each for each in reported if each is not None]

    def publish(self, topic, kind, message, rate_hz, once):
        for _ in range(1 if once else int(0.5 * rate_hz)):
            self.send(op="publish", topic=topic, type=kind, msg=message)
            time.sleep(1.0 / rate_hz)

    def call(self, service, values):
        self._number += 1
        name = str(self._number)
        self.send(op="call_service", id=name, service=service, args=values)
        answer = self.until(lambda operation: operation.get("id") == name)
        assert answer["result"], (service, answer)
        return answer["values"]

    def wait_for(self, service):
        """Wait until the server knows the service: it may not have discovered the session yet."""
        until(lambda: service in self.call("/rosapi/services", {})["services"])

    def reach(self, action, kind, goal):
        self.send(op="send_action_goal", id="goal", action=action, action_type=kind, args=goal)
        return self.until(lambda operation: operation["op"] == "action_result")


@pytest.fixture
def bus():
    """Run a router, and a rosbridge server."""
    endpoint = free_endpoint()
    with (
        cardan_subprocess("net", "server", "router", "--endpoint", endpoint),
        cardan_subprocess("net", "server", "rosbridge", "--port", "0", "--router", endpoint) as url,
    ):
        yield endpoint, url


@contextlib.contextmanager
def session(endpoint, name="session.toml"):
    """Run the session of an example on the bus; yield an observing node."""
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    with (
        tempfile.TemporaryDirectory() as folder,
        BusNetwork(BusOptions(router=endpoint), "looks") as looks,
    ):
        Path(folder, name).write_text(f'{text}router = "{endpoint}"\n', encoding="utf-8")
        with launched_session(folder, name):
            until(lambda: f"{ARM}/stop" in looks.services())
            yield looks


def lines(heading):
    """Return the `ros2` command lines below a heading of the page."""
    page = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    part = page.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return [shlex.split(line) for line in re.findall(r"^ros2 (.*)$", part, re.MULTILINE)]


def read_yaml(text):
    from ruamel.yaml import YAML

    return YAML(typ="safe").load(text)


def run_line(words, client, looks):
    """Perform a `ros2` command line; fail if it is invalid."""
    match words:
        case ["node", "list"]:
            until(lambda: ARM in looks.nodes())
        case ["topic", "echo", topic, kind]:
            assert seen(looks, topic, "publishers").type == kind
        case ["param", "set", node, name, value]:
            reported = {"type": 4, "string_value": value}
            values = {"parameters": [{"name": name, "value": reported}]}
            client.wait_for(f"{node}/set_parameters")
            (result,) = client.call(f"{node}/set_parameters", values)["results"]
            assert result["successful"], result["reason"]
        case ["service", "call", service, kind, *values]:
            assert until(lambda: looks.services().get(service)).type == kind
            given = read_yaml(values[0]) if values else {}
            client.wait_for(service)
            assert client.call(service, given).get("success", True), words
        case ["action", "send_goal", "--feedback", action, kind, goal]:
            answer = client.reach(action, kind, read_yaml(goal))
            assert answer["status"] == 4, answer
        case ["topic", "pub", "--once", topic, kind]:
            publish(words, client, looks, topic, kind, {}, ["--once"])
        case ["topic", "pub", *how, topic, kind, message]:
            publish(words, client, looks, topic, kind, read_yaml(message), how)
        case _:
            pytest.fail(f"no line of ros2: {words}")


def seen(looks, name, side):
    """Return a topic once that side of it is on the graph, where a session appears gradually."""
    return until(lambda: (topic := looks.topics().get(name)) and getattr(topic, side) and topic)


def publish(words, client, looks, topic, kind, message, how):
    taken = seen(looks, topic, "subscribers")
    assert taken.type in (kind, "geometry_msgs/msg/TwistStamped"), words
    client.results(0.1)
    once = how == ["--once"]
    client.publish(topic, kind, message, 50.0 if once else float(how[1]), once)
    # Commands are refused until their node has been on the bus for 0.3 s, or two of its stamps
    # agree with their arrival.
    reported = [
        *dropwhile(
            lambda each: re.search("has been connected|not known yet", each["reason"]),
            client.results(PAUSE_S),
        )
    ]
    assert not [each["reason"] for each in reported if each["outcome"] == "refused"], words
    if topic != "/joy/set_feedback":
        assert reported, words


@pytest.mark.matrix
@pytest.mark.parametrize(
    ("heading", "name"),
    [("Watch", "session.toml"), ("Command", "session.toml"), ("Other names", "other-names.toml")],
)
def test_the_lines_of_ros2_do_what_the_page_says(bus, heading, name):
    endpoint, url = bus
    with session(endpoint, name) as looks, connect(url) as socket:
        client = Client(socket)
        kind = "cardan_msgs/CommandResult"
        client.send(op="subscribe", topic=f"{ARM}/result", type=kind, queue_length=100)
        for words in lines(heading):
            run_line(words, client, looks)


@pytest.mark.matrix
def test_a_device_of_ours_is_one_of_ros(tmp_path):
    """The session of device.toml runs in its own process with its simulated SpaceMouse."""
    endpoint = free_endpoint()
    text = (EXAMPLES / "device.toml").read_text(encoding="utf-8")
    (tmp_path / "device.toml").write_text(f'{text}router = "{endpoint}"\n', encoding="utf-8")
    with (
        cardan_subprocess(
            "sim", "spacemouse", "--hid", "spacemouse.sock", "--script", "demo", folder=tmp_path
        ),
        launched_session(tmp_path, "device.toml"),
        BusNetwork(BusOptions(router=endpoint), "looks") as looks,
    ):
        until(lambda: "/joy/set_feedback" in looks.topics())
        heard = []
        looks.subscribe("/spacenav/joy", "sensor_msgs/msg/Joy", lambda data, _: heard.append(data))
        until(lambda: heard)
        _, pub = lines("Operator devices")
        assert looks.topics()[pub[3]].type == pub[4]
        assert read_yaml(pub[5]).keys() == {"type", "intensity"}


@contextlib.contextmanager
def launched_session(folder, name):
    """Run `cardan run NAME` in its folder."""
    process = subprocess.Popen(
        [sys.executable, "-m", "cardan", "run", name, "--seconds", "40"],
        cwd=folder,
        stdout=subprocess.DEVNULL,
    )
    try:
        yield
    finally:
        process.terminate()
        assert process.wait(20.0) == 0


@pytest.mark.matrix
def test_the_layout_shows_what_a_session_publishes(bus):
    layout = json.loads((EXAMPLES / "foxglove-layout.json").read_text(encoding="utf-8"))
    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    named = set(re.findall(r'"(/\w[\w/]*)', json.dumps(layout["configById"])))
    with session(bus[0]) as looks:
        until(lambda: named <= looks.topics().keys() | looks.services().keys())


# -- programs -------------------------------------------------------------------------------------


def reported(*command):
    """Run a program; return its output."""
    done = subprocess.run(
        [sys.executable, *map(str, command)],
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:] + done.stdout[-1000:]
    return done.stdout


@pytest.mark.matrix
def test_the_programs_move_the_arm(bus):
    endpoint, url = bus
    with session(endpoint):
        text = reported(EXAMPLES / "remote_arm.py", f"{endpoint}/cartesian_control_server_ros2")
        assert text.count("movl arrived: True") == 2
        assert 5 < int(re.search(r"streamed (\d+) mm", text)[1]) < 30

        text = reported(EXAMPLES / "rosbridge_client.py", "--url", url, "--seconds", "2")
        assert "result: twist of ros2 /rosbridge_client_1 accepted: fine" in text
        way_mm = int(re.search(r"the TCP moved by (\d+) mm and is stopped: True", text)[1])
        assert 25 < way_mm < 60

        text = reported(EXAMPLES / "follow_joint_trajectory.py", "--url", url)
        assert "error code 0" in text
        assert float(re.search(r"at most ([\d.]+) rad from the plan", text)[1]) < 0.05


@pytest.mark.matrix
def test_a_record_is_a_regression_test(tmp_path):
    text = (EXAMPLES / "session.toml").read_text(encoding="utf-8")
    (tmp_path / "s.toml").write_text(f'{text}router = "{free_endpoint()}"\n', encoding="utf-8")
    path = tmp_path / "s.mcap"
    reported("-m", "cardan", "run", tmp_path / "s.toml", "--record", path, "--seconds", "1")
    assert "bit for bit the recorded one" in reported(EXAMPLES / "check_record.py", path)


PAGE = """
const elements = {}, handlers = {};
const element = jog => ({dataset: {jog}, textContent: '', on: {},
  addEventListener(name, take) { this.on[name] = take; }});
const jogs = JOGS.map(element);
globalThis.document = {
  getElementById: id => elements[id] = elements[id] || element(),
  querySelectorAll: () => jogs,
  addEventListener: (name, take) => { handlers[name] = take; },
};
globalThis.window = {addEventListener: (name, take) => { handlers[name] = take; }};
globalThis.ROSLIB = require('roslib');
PROGRAM
const shown = id => document.getElementById(id).textContent;
const wait = ms => new Promise(resolve => setTimeout(resolve, ms));
const y = () => Number(/y (-?[\\d.]+)/.exec(shown('pose'))[1]);
(async () => {
  while (!shown('pose')) await wait(20);
  const before = y();
  jogs[1].on.pointerdown();
  await wait(1000);
  const after = y(), phase = shown('status');
  handlers.blur();
  await wait(500);
  const rest = y();
  await wait(300);
  const still = y();
  elements.stop.on.click();
  await wait(300);
  console.log(JSON.stringify({before, after, rest, still, phase, link: shown('link'),
                              result: shown('result')}));
  process.exit(0);
})();
"""


@pytest.mark.matrix
def test_the_page_moves_the_arm_while_a_button_is_held(bus):
    endpoint, url = bus
    folder = installed("roslib", "1.4.1")
    page = (EXAMPLES / "page.html").read_text(encoding="utf-8")
    program = re.search(r'<script id="program">\n(.*?)</script>', page, re.DOTALL)[1]
    assert "ws://127.0.0.1:9090" in program
    program = program.replace("ws://127.0.0.1:9090", url)
    jogs = json.dumps(re.findall(r'data-jog="([^"]+)"', page))
    with session(endpoint):
        done = subprocess.run(
            ["node", "-e", PAGE.replace("JOGS", jogs).replace("PROGRAM", program)],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
        )
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout.splitlines()[-1])
    assert 20.0 < found["after"] - found["before"] < 80.0, found  # 0.15 of 0.4 m/s
    assert found["rest"] == pytest.approx(found["still"], abs=0.1)
    assert found["phase"].startswith("moving")
    assert found["link"] == f"connected to {url}"
    assert found["result"] == "stop: true"


# -- two computers --------------------------------------------------------------------------------


@pytest.fixture
def made(tmp_path):
    """Adapt a configuration of the example to this computer."""
    subprocess.run(
        [str(TWO / "certificates"), "127.0.0.1", "operator", "viewer", "stranger"],
        cwd=tmp_path,
        check=True,
        capture_output=True,
    )

    def make(name, to, *changes):
        text = (TWO / name).read_text(encoding="utf-8")
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        text = re.sub(r'"([\w-]+\.pem)"', rf'"{tmp_path}/\1"', text)
        (tmp_path / to).write_text(text, encoding="utf-8")
        return str(tmp_path / to)

    return make


@pytest.mark.matrix
def test_two_computers_by_tls_and_who_may_do_what(made):
    inside, outside, operator_port, viewer_port = (free_tcp_port() for _ in range(4))
    local = "127.0.0.1:7447"
    far = ("192.168.1.10:7448", f"127.0.0.1:{outside}")

    def endpoint(port):
        return f"tcp/127.0.0.1:{port}"

    robot = made(
        "robot-router.json5",
        "robot.json5",
        (local, f"127.0.0.1:{inside}"),
        ("0.0.0.0:7448", f"127.0.0.1:{outside}"),
    )
    operator = made("operator-router.json5", "o.json5", (local, f"127.0.0.1:{operator_port}"), far)
    viewer = made(
        "operator-router.json5",
        "v.json5",
        (local, f"127.0.0.1:{viewer_port}"),
        far,
        ("operator", "viewer"),
    )
    client = BusOptions(zenoh_config=made("operator-client.json5", "c.json5", far))
    stranger = made("operator-client.json5", "s.json5", far, ("operator", "stranger"))
    with (
        cardan_subprocess("net", "server", "router", "--zenoh-config", robot),
        cardan_subprocess("net", "server", "router", "--zenoh-config", operator),
        cardan_subprocess("net", "server", "router", "--zenoh-config", viewer),
        session(endpoint(inside)) as here,
    ):
        # The operator may command, through a router of its own or directly.
        for options in (BusOptions(router=endpoint(operator_port)), client):
            with network_arm(options=options, source="far") as arm:
                x, y, z, *turn = arm.stat().pose
                arm.movl([x, y + 0.02, z, *turn])
                assert arm.wait(timeout_s=10.0), arm.status()

        # The viewer sees everything, including latched topics, and commands nothing.
        poses, described = [], []
        options = BusOptions(router=endpoint(viewer_port))
        with BusNetwork(options, "viewer") as looks:
            until(lambda: f"{ARM}/stop" in looks.services())
            kind = "geometry_msgs/msg/PoseStamped"
            looks.subscribe(f"{ARM}/state/pose", kind, lambda *each: poses.append(each))
            until(lambda: "/robot_description" in looks.topics())
            kind = "std_msgs/msg/String"
            looks.subscribe("/robot_description", kind, lambda *each: described.append(each))
            until(lambda: len(poses) > 20 and described)
            kind = "geometry_msgs/msg/Twist"
            publisher = looks.advertise(f"{ARM}/command/twist", kind, False)
            results = []
            kind = "cardan_msgs/msg/CommandResult"
            here.subscribe(f"{ARM}/result", kind, lambda *each: results.append(each))
            for _ in range(20):  # without its preset each command would be refused
                publisher.publish(b"\0\1\0\0" + bytes(48))
                time.sleep(0.02)
            # An admitted command is refused with a reason, and causes the only message.
            own = here.advertise(f"{ARM}/command/twist", "geometry_msgs/msg/Twist", False)
            own.publish(b"\0\1\0\0" + bytes(48))
            until(lambda: results)
            assert len(results) == 1
        with pytest.raises((MotionLoopError, DriverError)):
            network_arm(options=options).open()

        # With another certificate of the same authority, no message passes.
        with BusNetwork(BusOptions(zenoh_config=stranger), "stranger") as looks:
            heard, seen = [], []
            looks.subscribe(f"{ARM}/state/pose", None, lambda *each: heard.append(each))
            here.subscribe(f"{ARM}/state/pose", None, lambda *each: seen.append(each))
            until(lambda: len(seen) > 50)  # 1 s of messages that it would otherwise receive
            assert not heard
            assert ARM not in looks.nodes()


@pytest.mark.matrix
def test_without_a_certificate_nobody_gets_in(made):
    inside, outside = free_tcp_port(), free_tcp_port()
    robot = made(
        "robot-router.json5",
        "robot.json5",
        ("127.0.0.1:7447", f"127.0.0.1:{inside}"),
        ("0.0.0.0:7448", f"127.0.0.1:{outside}"),
    )
    far = ("192.168.1.10:7448", f"127.0.0.1:{outside}")
    known = made("operator-client.json5", "known.json5", far)
    bare = made(
        "operator-client.json5",
        "bare.json5",
        far,
        ('connect_certificate: "operator.pem",', ""),
        ('connect_private_key: "operator-key.pem",', ""),
        ("enable_mtls: true", "enable_mtls: false"),
    )
    with (
        cardan_subprocess("net", "server", "router", "--zenoh-config", robot),
        session(f"tcp/127.0.0.1:{inside}"),
    ):
        with BusNetwork(BusOptions(zenoh_config=known), "somebody") as network:
            until(lambda: ARM in network.nodes())
        with pytest.raises(DriverError):
            BusNetwork(BusOptions(zenoh_config=bare), "nobody").open()
