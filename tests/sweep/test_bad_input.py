"""Invalid commands, sent to a live session over Zenoh and rosbridge: each is counted and refused
with a reason to its sender, and moves nothing."""

from __future__ import annotations

import json
import random
import struct
import threading
import time

import pytest

zenoh = pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')

from websockets.exceptions import ConnectionClosed  # noqa: E402

from cardan.gateway.arm.backlog import BACKLOGGED  # noqa: E402
from cardan.protocols.ros2.cdr import codec_of  # noqa: E402
from cardan.protocols.ros2.messages import completed  # noqa: E402
from cardan.protocols.ros2.zenoh import data_key  # noqa: E402
from tests import network_table  # noqa: E402
from tests.gateway.servers.bench import plain_client  # noqa: E402
from tests.sweep.plan import NODE, RESULT, full_name  # noqa: E402
from tests.waiting import until  # noqa: E402

pytestmark = pytest.mark.matrix

TIMEOUT_S = 20.0
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
POSE, TWIST = "geometry_msgs/Pose", "geometry_msgs/Twist"
STAT = "cardan_msgs/srv/Stat"


class Watch:
    """Reports of the session about its commands, received by a node that sends none."""

    def __init__(self, session):
        self._diagnostics = session.node.subscription("/diagnostics", DIAGNOSTICS, 1)
        self._stat = session.node.client(f"{NODE}/stat", STAT)

    def counts(self):
        """Counts of the commands' row in the current diagnostics."""

        def row():
            received = self._diagnostics.poll()
            status = codec_of(DIAGNOSTICS).decode(received.data)["status"] if received else ()
            return [each for each in status if each["name"] == f"{NODE}: commands"]

        self._diagnostics.poll()
        (found,) = until(row, "the diagnostics")
        return {each["key"]: int(each["value"]) for each in found["values"]}

    def where(self):
        """Measured pose of the arm once it is at rest."""

        def rests():
            before, self._last = getattr(self, "_last", None), self._pose()
            return before == self._last and before

        return until(rests, "the rest")

    def _pose(self):
        request = codec_of(f"{STAT}_Request").encode(completed(f"{STAT}_Request", {}))
        # None, until client and service have discovered each other.
        reply = until(lambda: self._stat.call(request, TIMEOUT_S), "the answer")
        return codec_of(f"{STAT}_Response").decode(reply)["pose"]["pose"]


@pytest.fixture(scope="module")
def watch(session):
    return Watch(session)


@pytest.fixture
def nothing_moves(watch):
    """Check that the arm is at the same pose afterwards."""
    before = watch.where()
    yield
    assert watch.where() == before


@pytest.fixture
def client(running):
    """A rosbridge client that receives errors and results."""
    with plain_client(running) as found:
        found.send("set_level", level="error")
        found.send("subscribe", topic=RESULT, type="cardan_msgs/CommandResult")
        found.settle()
        yield found


def said(client, words):
    """Next status or result that contains these words."""
    until_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < until_s:
        frame = client.receive()
        text = frame.get("msg", "")
        text = text["reason"] if isinstance(text, dict) else text
        if words in text:
            return frame
    raise AssertionError(f"nobody said {words}")


TOO_LARGE = "1e999"
"""A valid JSON number that overflows a float. It is sent without its quotes."""
JOG = {"joint_names": ["no_joint"], "velocities": [0.1]}


@pytest.mark.usefixtures("nothing_moves")
@pytest.mark.parametrize(
    ("name", "type_name", "message", "words"),
    [
        ("~/command/movl", POSE, {"position": {"x": None}}, "not numbers"),
        ("~/command/movl", POSE, {"position": {"x": TOO_LARGE}}, "not numbers"),
        ("~/command/movl", POSE, {"position": {"x": 9.0}}, "out of reach"),
        ("~/command/movl", POSE, {"orientation": {"w": 7.0}}, "movl: "),
        ("~/command/movl", TWIST, {"linear": {"x": 1.0}}, "geometry_msgs/msg/Pose"),
        ("~/command/twist", TWIST, {}, "zero begins no stream"),
        ("~/command/gripper", "std_msgs/Int32", {"data": 9}, "9 is not an action"),
        (
            "servo_node/delta_twist_cmds",
            "geometry_msgs/TwistStamped",
            {"header": {"frame_id": "map"}, "twist": {"linear": {"x": 0.1}}},
            "the frame 'map' is not known",
        ),
        (
            "servo_node/delta_joint_cmds",
            "control_msgs/JointJog",
            {"header": {"frame_id": "base_link"}, **JOG},
            "there is no joint 'no_joint'",
        ),
        (
            "servo_jv",
            "sensor_msgs/JointState",
            {"name": ["elbow_joint"], "velocity": [0.1, 0.2]},
            "1 joint names and 2 velocities",
        ),
    ],
)
def test_values_that_are_none_are_refused_at_the_client(client, name, type_name, message, words):
    topic = full_name(name)
    client.send("advertise", topic=topic, type=type_name)
    client.settle()
    frame = json.dumps({"op": "publish", "topic": topic, "type": type_name, "msg": message})
    client.connection.send(frame.replace(f'"{TOO_LARGE}"', TOO_LARGE))
    assert said(client, words)


@pytest.mark.usefixtures("nothing_moves")
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"linear": {"x": NaN}}', "JSON has no NaN"),
        ('{"linear": {"x": ' + "9" * 5000 + "}}", "limit"),
        ("[" * 20000, "not JSON"),
        ('{"linear": {"x": true}}', "takes a number, not True"),
        ('{"linear": {"q": 1}}', "has no such field"),
    ],
)
def test_frames_that_are_no_messages_are_refused_at_the_client(client, running, text, words):
    before = running.server.counts["refused"]
    topic = f"{NODE}/command/twist"
    client.connection.send(
        f'{{"op": "publish", "topic": "{topic}", "type": "{TWIST}", "msg": {text}}}'
    )
    assert said(client, words)["op"] == "status"
    assert running.server.counts["refused"] == before + 1


@pytest.mark.usefixtures("nothing_moves")
def test_a_flood_by_rosbridge_is_survived(client, running):
    topic, cut_off = f"{NODE}/command/movl", ""
    try:
        for number in range(3000):
            client.send("publish", topic=topic, type=POSE, msg={"position": {"x": 9.0 + number}})
        assert said(client, "out of reach")
        assert client.call(f"{NODE}/stop")["values"]["success"]
    except ConnectionClosed as closed:
        # A busy computer cannot handle commands as fast as they arrive, and reports that.
        cut_off = str(closed)
    assert not cut_off or BACKLOGGED in cut_off
    with plain_client(running) as another:
        assert another.call(f"{NODE}/stop")["values"]["success"]


def test_a_client_that_dies_in_the_midst_of_a_stream_brakes_the_arm(running, session, watch):
    status = session.node.subscription(f"{NODE}/state/status", "cardan_msgs/msg/ArmStatus", 8)

    def phases():
        found = [each.data for each in iter(status.poll, None)]
        return {codec_of("cardan_msgs/msg/ArmStatus").decode(each)["phase"] for each in found}

    with plain_client(running) as client:
        over = threading.Event()

        def stream():
            while not over.wait(0.02):
                message = {"linear": {"z": -0.03}}
                client.send("publish", topic="/left/cmd_vel", type=TWIST, msg=message)

        streaming = threading.Thread(target=stream)
        streaming.start()
        try:
            until(lambda: "moving" in phases(), "the motion")
        finally:
            over.set()
            streaming.join()
        client.connection.socket.close()
        until(lambda: phases() & {"holding", "disarmed"}, "the rest")
    where = watch.where()
    assert watch.where() == where


# -- over Zenoh -----------------------------------------------------------------------------------


@pytest.fixture
def stranger(session):
    """A Zenoh session that is not a ROS 2 node."""
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", f'["{session.endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("listen/endpoints", "[]")
    with zenoh.open(config) as found:
        yield found


def garbage(chance, type_name):
    """Random bytes that are not a valid message of a type, except by accident."""
    good = codec_of(type_name).encode(completed(type_name, {}))
    return chance.choice(
        [
            b"",
            chance.randbytes(chance.randrange(300)),
            b"\0\1\0\0" + chance.randbytes(chance.randrange(300)),
            b"\0\1\0\0" + b"\xff" * chance.randrange(300),
            good[: chance.randrange(len(good))],
            good + b"\1" * chance.randrange(1, 9),
        ]
    )


def attachment(chance):
    """Attachments with an invalid size, or with implausible numbers."""
    numbers = chance.choice([0, 1, -1, 2**63 - 1, -(2**63)]), chance.choice([0, -1, 2**63 - 1])
    odd = struct.pack("<qq", *numbers) + bytes([chance.choice([0, 16, 255])])
    return chance.choice(
        [b"", chance.randbytes(chance.randrange(64)), odd + chance.randbytes(16), odd]
    )


@pytest.mark.usefixtures("nothing_moves")
@pytest.mark.parametrize("seed", [1, 2])
def test_bytes_of_no_sense_are_survived_and_counted(session, stranger, watch, seed):
    chance = random.Random(seed)
    before = watch.counts()["refused"]
    every = network_table.rows()
    taken = [row for row in every if row.kind == "taken" and row.name != "~/command/stop"]
    served = [
        row
        for row in every
        if row.kind == "service" and not row.name.startswith("~/set_parameters")
    ]
    for number in range(2000):
        row = chance.choice(taken)
        key = data_key(0, full_name(row.name), row.type_name)
        odd = chance.choice([key, key, f"{key[:-4]}0000", "/".join([*key.split("/")[:-2], "x/y"])])
        stranger.put(odd, garbage(chance, row.type_name), attachment=attachment(chance))
        if number % 10 == 0:
            stranger.delete(key)
            asked = chance.choice(served)
            payload = garbage(chance, f"{asked.type_name}_Request") if number % 20 else None
            stranger.get(
                data_key(0, full_name(asked.name), asked.type_name),
                zenoh.handlers.RingChannel(2),
                payload=payload,
                attachment=attachment(chance),
                timeout=1.0,
            )
    until(lambda: watch.counts()["refused"] > before + 20, "the count")


@pytest.mark.usefixtures("nothing_moves")
def test_tokens_of_no_sense_are_survived(stranger, watch):
    topic = "%left%arm%command%movv/geometry_msgs::msg::dds_::Twist_/RIHS01_x/::,10:,:,:,,"
    zid = stranger.info.zid()
    tokens = [
        stranger.liveliness().declare_token(text)
        for number in range(500)
        for text in (
            f"@ros2_lv/0/{zid}/{number}/{number}/NN/%/%/n{number}",
            f"@ros2_lv/0/x/{number}",
            f"@ros2_lv/0/{zid}/0/{number}/MP/%/%/n/{topic}",
            f"@ros2_lv/0/{zid}/a/b/c/d/e/f/g/h/i/j/k{number}",
        )
    ]
    for each in tokens:
        each.undeclare()
    before = watch.counts()["refused"]
    key = data_key(0, f"{NODE}/command/movl", "geometry_msgs/msg/Pose")

    def counted():
        stranger.put(key, b"")
        return watch.counts()["refused"] > before

    until(counted, "the count")
