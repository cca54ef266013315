"""The rosbridge server, judged by unmodified client libraries: roslibpy, roslib 1.4 and 2.1; and by
the requests that Lichtblick sends when it connects."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time

import pytest

from tests.gateway.servers.memory_network import MemoryNetwork
from tests.gateway.servers.nodes import Mover, Parameters

cbor2 = pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")

from cardan.protocols.ros2.cdr import codec_of  # noqa: E402
from tests.gateway.servers.bench import plain_client, rosbridge  # noqa: E402
from tests.npm import installed  # noqa: E402

pytestmark = pytest.mark.matrix

RUN_TIMEOUT_S = 30.0
POSE, JOINTS = "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/JointState"
STRING, TRIGGER = "std_msgs/msg/String", "std_srvs/srv/Trigger"


class World:
    """Network for a client: topics published once it is ready, services, parameters, an action."""

    def __init__(self) -> None:
        self.network = network = MemoryNetwork()
        self.parameters = Parameters(network, speed={"type": 3, "double_value": 0.5})
        network.latch("/robot_description", STRING, data="<robot/>")
        network.known.update({"/state/pose": POSE, "/joint_states": JOINTS})
        network.offer("/stop", TRIGGER, lambda _: {"success": True, "message": "stopped"})
        network.offer("/on", "std_srvs/srv/SetBool", lambda asked: {"success": asked["data"]})
        network.offer("/ready", TRIGGER, self.speak)
        network.serve("/poke", TRIGGER, self.poke)
        mover = Mover(network)
        network.serve(
            "/move/_action/get_result",
            "control_msgs/action/FollowJointTrajectory_GetResult",
            lambda request, answered: self.move(mover, answered),
        )

    def speak(self, _request):
        """Publish one message on each topic."""
        position = {"x": 1, "y": 2.5, "z": -3}
        self.network.publish(
            "/state/pose", POSE, header={"frame_id": "base"}, pose={"position": position}
        )
        self.network.publish(
            "/joint_states", JOINTS, name=["a", "b"], position=[0.5, -1], effort=[None]
        )
        return {"success": True}

    def poke(self, _request, answered):
        """Call the client's service in a thread, because the reply may take time."""

        def ask():
            found = self.network.ask("/client_srv", data=True)
            kind = f"{TRIGGER}_Response"
            answered(codec_of(kind).encode({"success": True, "message": found["message"]}))

        threading.Thread(target=ask).start()

    def move(self, mover, answered):
        """Publish the goal's feedback, and report its end."""
        mover.answered = answered
        mover.feed_back(mover.goals[-1]["goal_id"]["uuid"])
        mover.end(4, error_string="arrived")


@pytest.fixture
def world():
    return World()


def reported(command, folder=None):
    """Return a program's output, a JSON object."""
    result = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=RUN_TIMEOUT_S, check=False
    )
    assert result.returncode == 0, result.stderr[-3000:] + result.stdout[-1000:]
    return json.loads(result.stdout.splitlines()[-1])


def check_common(found, world):
    """Check the results that every client must report."""
    assert found["pose"]["header"]["frame_id"] == "base"
    assert found["pose"]["pose"]["position"] == {"x": 1, "y": 2.5, "z": -3}
    assert found["description"] == {"data": "<robot/>"}
    assert found["stop"] == {"success": True, "message": "stopped"}
    assert found["on"]["success"] is True
    assert found["nope"] == "Service /nope does not exist"
    assert found["poke"]["message"] == "hello from the client"
    assert found["topics"]["types"][found["topics"]["topics"].index("/state/pose")] == POSE
    assert found["topic_type"] == POSE
    assert found["for_type"] == ["/state/pose"]
    assert "/stop" in found["services"]
    assert found["service_type"] == TRIGGER
    assert "/arm" in found["nodes"]
    assert found["params"] == ["/arm:speed"]
    assert found["param"] == 0.5
    assert found["action_servers"] == ["/move"]
    assert world.parameters.values["speed"]["double_value"] == 2.0
    (published,) = [message for topic, message in world.network.published if topic == "/cmd/twist"]
    assert published["linear"] == {"x": 0.1, "y": 0.0, "z": 0.0}


# -- roslibpy -------------------------------------------------------------------------------------

ROSLIBPY = """
import json, sys, threading
import roslibpy

ros = roslibpy.Ros("127.0.0.1", int(sys.argv[1]))
ros.run(10)
found = {}

def heard(topic, kind, key, **options):
    there = threading.Event()
    def take(message):
        found[key] = message
        there.set()
    each = roslibpy.Topic(ros, topic, kind, **options)
    each.subscribe(take)
    return each, there

def call(service, kind, request=None):
    return roslibpy.Service(ros, service, kind).call(roslibpy.ServiceRequest(request), timeout=10)

pose, pose_there = heard("/state/pose", "geometry_msgs/PoseStamped", "pose", throttle_rate=10)
joints, joints_there = heard("/joint_states", "sensor_msgs/JointState", "joints", queue_length=5)
_, described = heard("/robot_description", "std_msgs/String", "description")
assert described.wait(10)
call("/ready", "std_srvs/Trigger")
assert pose_there.wait(10) and joints_there.wait(10)
pose.unsubscribe()

command = roslibpy.Topic(ros, "/cmd/twist", "geometry_msgs/Twist")
command.publish(roslibpy.Message({"linear": {"x": 0.1, "y": 0, "z": 0}}))
found["stop"] = dict(call("/stop", "std_srvs/Trigger"))
command.unadvertise()
found["on"] = dict(call("/on", "std_srvs/SetBool", {"data": True}))
try:
    call("/nope", "std_srvs/Trigger")
except Exception as error:
    found["nope"] = error.args[0]

def serve(request, response):
    response["success"] = request["data"]
    response["message"] = "hello from the client"
    return True

mine = roslibpy.Service(ros, "/client_srv", "std_srvs/SetBool")
mine.advertise(serve)
found["poke"] = dict(call("/poke", "std_srvs/Trigger"))
mine.unadvertise()

found["topics"] = dict(call("/rosapi/topics", "rosapi/Topics"))
found["topic_type"] = ros.get_topic_type("/state/pose")
found["for_type"] = ros.get_topics_for_type("geometry_msgs/PoseStamped")
found["services"] = ros.get_services()
found["service_type"] = ros.get_service_type("/stop")
found["for_service"] = ros.get_services_for_type("std_srvs/SetBool")
found["request"] = dict(ros.get_service_request_details("std_srvs/SetBool"))
found["response"] = dict(ros.get_service_response_details("std_srvs/SetBool"))
found["message"] = dict(ros.get_message_details("geometry_msgs/Twist"))
found["nodes"] = ros.get_nodes()
found["node"] = dict(ros.get_node_details("/arm"))
found["time"] = ros.get_time().to_sec()
found["params"] = ros.get_params()
found["param"] = ros.get_param("/arm:speed")
ros.set_param("/arm:speed", 2)

ended = threading.Event()
def result(each):
    found["result"] = each
    ended.set()
action = roslibpy.ActionClient(ros, "/move", "control_msgs/FollowJointTrajectory")
goal = roslibpy.Goal({"trajectory": {"joint_names": ["a"]}})
feedback = []
action.send_goal(goal, result, feedback.append, result)
assert ended.wait(10)
found["feedback"] = feedback
servers = threading.Event()
def take(each):
    found["action_servers"] = each["action_servers"]
    servers.set()
ros.get_action_servers(take)
assert servers.wait(10)
def plain(each):
    return getattr(each, "value", None) or dict(each)
print(json.dumps(found, default=plain))
ros.terminate()
"""


@pytest.mark.real
def test_roslibpy(world):
    pytest.importorskip("roslibpy", reason="roslibpy is not installed: pip install cardan[test]")
    with rosbridge(world.network) as running:
        found = reported([sys.executable, "-c", ROSLIBPY, str(running.port)])
    check_common(found, world)
    assert found["joints"]["position"] == [0.5, -1]
    assert found["joints"]["effort"] == [None]
    assert found["for_service"] == ["/on"]
    assert found["request"]["typedefs"][0]["fieldnames"] == ["data"]
    assert found["response"]["typedefs"][0]["fieldnames"] == ["success", "message"]
    assert found["message"]["typedefs"][0]["fieldnames"] == ["linear", "angular"]
    assert "/state/pose" in found["node"]["publishing"]
    assert found["time"] == pytest.approx(time.time(), abs=60)
    assert found["result"]["status"] == 4
    assert found["result"]["values"]["error_string"] == "arrived"
    assert found["feedback"][0]["joint_names"] == ["a"]
    assert running.server.counts["refused"] == 1, "the service that does not exist"


# -- roslib in Node -------------------------------------------------------------------------------

COMMON = """
const port = process.argv[process.argv.length - 1];
const ros = new ROSLIB.Ros({url: `ws://127.0.0.1:${port}`});
const found = {};
const made = (kind, value) => ROSLIB[kind] ? new ROSLIB[kind](value) : value;
const ask = (function_, ...args) => new Promise(
  (resolve, reject) => ros[function_](...args, resolve, reject));
const call = (name, serviceType, request) => new Promise((resolve, reject) =>
  new ROSLIB.Service({ros, name, serviceType}).callService(
    made('ServiceRequest', request || {}), resolve, reject));
const hear = (key, name, messageType, options) => {
  const topic = new ROSLIB.Topic({ros, name, messageType, ...options});
  const there = new Promise(resolve => topic.subscribe(message => {
    found[key] = message; resolve();
  }));
  return {topic, there};
};
const plain = array => Array.from(array);

async function common() {
  const pose = hear('pose', '/state/pose', 'geometry_msgs/PoseStamped', {throttle_rate: 10});
  const joints = hear('joints', '/joint_states', 'sensor_msgs/JointState', {compression: 'cbor'});
  await hear('description', '/robot_description', 'std_msgs/String').there;
  await call('/ready', 'std_srvs/Trigger');
  await pose.there; await joints.there;
  found.joints = {name: found.joints.name, position: plain(found.joints.position),
                  kind: found.joints.position.constructor.name,
                  effort: plain(found.joints.effort).map(String)};
  pose.topic.unsubscribe();
  joints.topic.unsubscribe();
  const command = new ROSLIB.Topic({ros, name: '/cmd/twist', messageType: 'geometry_msgs/Twist'});
  command.publish(made('Message', {linear: {x: 0.1, y: 0, z: 0}}));
  found.stop = await call('/stop', 'std_srvs/Trigger');
  command.unadvertise();
  found.on = await call('/on', 'std_srvs/SetBool', {data: true});
  found.nope = await call('/nope', 'std_srvs/Trigger').catch(error => error);
  const mine = new ROSLIB.Service({ros, name: '/client_srv', serviceType: 'std_srvs/SetBool'});
  await mine.advertise((request, response) => {
    response.success = request.data; response.message = 'hello from the client'; return true;
  });
  found.poke = await call('/poke', 'std_srvs/Trigger');
  await mine.unadvertise();
  found.topics = await ask('getTopics');
  found.topic_type = await ask('getTopicType', '/state/pose');
  found.for_type = await ask('getTopicsForType', 'geometry_msgs/PoseStamped');
  found.services = await ask('getServices');
  found.service_type = await ask('getServiceType', '/stop');
  found.for_service = await ask('getServicesForType', 'std_srvs/SetBool');
  found.request = await ask('getServiceRequestDetails', 'std_srvs/SetBool');
  found.response = await ask('getServiceResponseDetails', 'std_srvs/SetBool');
  found.decoded = ros.decodeTypeDefs(await ask('getMessageDetails', 'geometry_msgs/PoseStamped'));
  found.raw = await ask('getTopicsAndRawTypes');
  found.nodes = await ask('getNodes');
  found.params = await ask('getParams');
  found.action_servers = await ask('getActionServers');
  const speed = new ROSLIB.Param({ros, name: '/arm:speed'});
  found.param = await new Promise((resolve, reject) => speed.get(resolve, reject));
  await new Promise((resolve, reject) => speed.set(2.0, resolve, reject));
  const raw = hear('raw', '/state/pose', 'geometry_msgs/PoseStamped', {compression: 'cbor-raw'});
  await call('/ready', 'std_srvs/Trigger');
  await raw.there;
  found.raw_pose = Buffer.from(found.raw.bytes).toString('hex');
  raw.topic.unsubscribe();
}
ros.on('error', error => { console.error('error', error); process.exit(2); });
ros.on('connection', () => common().then(own).then(() => {
  ros.on('close', () => {
    process.stdout.write(JSON.stringify(found) + '\\n', () => process.exit(0));
  });
  ros.close();
}).catch(error => { console.error('failed', error); process.exit(3); }));
setTimeout(() => { console.error('late', Object.keys(found)); process.exit(4); }, 20000);
"""

ROSLIB_1 = (
    "const ROSLIB = require('roslib');"
    + COMMON
    + """
async function own() {
  const png = hear('png', '/joint_states', 'sensor_msgs/JointState', {compression: 'png'});
  found.node = await new Promise((resolve, reject) => ros.getNodeDetails('/arm',
    (subscribing, publishing, services) => resolve({subscribing, publishing, services}), reject));
  await call('/ready', 'std_srvs/Trigger');
  await png.there;
}
"""
)

ROSLIB_2 = (
    "import * as ROSLIB from 'roslib';"
    + COMMON
    + """
async function own() {
  found.node = await ask('getNodeDetails', '/arm');
  const whole = new Promise(resolve => {
    const topic = new ROSLIB.Topic({ros, name: '/joint_states',
                                    messageType: 'sensor_msgs/JointState'});
    topic.subscribe(message => { if (Array.isArray(message.position)) resolve(message); });
  });
  ros.callOnConnection({op: 'subscribe', topic: '/joint_states', type: 'sensor_msgs/JointState',
                        fragment_size: 40});
  await call('/ready', 'std_srvs/Trigger');
  found.fragmented = await whole;
  const action = new ROSLIB.Action({ros, name: '/move',
                                    actionType: 'control_msgs/FollowJointTrajectory'});
  found.feedback = [];
  found.result = await new Promise((resolve, reject) => action.sendGoal(
    {trajectory: {joint_names: ['a']}}, resolve, each => found.feedback.push(each), reject));
  const status = new Promise(resolve => ros.on('status:bad', resolve));
  ros.setStatusLevel('error');
  ros.callOnConnection({op: 'publish', id: 'bad', topic: '/cmd/twist', type: 'geometry_msgs/Twist',
                        msg: {foo: 1}});
  found.status = await status;
}
"""
)


@pytest.fixture(params=[False, True], ids=["plain", "compressed"])
def serving(request, world):
    """The server with and without permessage-deflate, which Node's client offers."""
    with rosbridge(world.network, compress=request.param) as running:
        yield running


def check_roslib(found, world):
    check_common(found, world)
    assert found["joints"]["position"] == [0.5, -1]
    assert found["joints"]["kind"] == "Float64Array"
    assert found["joints"]["effort"] == ["NaN"]
    assert found["for_service"] == ["/on"]
    assert found["request"]["typedefs"][0]["fieldnames"] == ["data"]
    assert found["response"]["typedefs"][0]["fieldnames"] == ["success", "message"]
    assert set(found["decoded"]) == {"header", "pose"}
    assert found["decoded"]["pose"]["position"] == {"x": "float64", "y": "float64", "z": "float64"}
    assert "/state/pose" in found["node"]["publishing"]
    decoded = codec_of(POSE).decode(bytes.fromhex(found["raw_pose"]))
    assert decoded["pose"]["position"] == {"x": 1.0, "y": 2.5, "z": -3.0}


def test_roslib_1(world, serving):
    found = reported(
        ["node", "-e", ROSLIB_1, "--", str(serving.port)], installed("roslib", "1.4.1")
    )
    check_roslib(found, world)
    assert found["png"]["position"] == [0.5, -1]


def test_roslib_2(world, serving):
    command = ["node", "--input-type=module", "-e", ROSLIB_2, "--", str(serving.port)]
    found = reported(command, installed("roslib", "2.1.0"))
    check_roslib(found, world)
    assert found["fragmented"]["position"] == [0.5, -1]
    assert found["feedback"][0]["joint_names"] == ["a"]
    assert found["result"]["error_string"] == "arrived"
    assert (found["status"]["level"], found["status"]["id"]) == ("error", "bad")
    assert "foo" in found["status"]["msg"]


# -- Lichtblick -----------------------------------------------------------------------------------


def test_what_lichtblick_does_when_it_connects(world):
    """Connect like lichtblick-suite (packages/suite-base/src/players/RosbridgePlayer.ts), step by
    step."""
    network = world.network
    with rosbridge(network) as running, plain_client(running) as client:
        answer = client.call("rosapi/topics_and_raw_types", {})["values"]
        texts = dict(zip(answer["topics"], answer["typedefs_full_text"], strict=True))
        # Lichtblick detects ROS 2 by this type among the topics.
        assert "rcl_interfaces/msg/Log" in answer["types"]
        assert all(texts.values()), "a definition of each topic"
        assert "\n" + "=" * 80 + "\nMSG: std_msgs/Header\n" in texts["/state/pose"]
        nodes = client.call("rosapi/nodes", {})["values"]["nodes"]
        for node in nodes:
            details = client.call("rosapi/node_details", {"node": node})["values"]
            assert set(details) == {"subscribing", "publishing", "services"}
        for topic in ("/state/pose", "/rosout"):
            client.send("subscribe", id=f"subscribe:{topic}:1", topic=topic, compression="cbor-raw")
        client.call("/ready")
        message = cbor2.loads(client.receive())
        assert (message["op"], message["topic"]) == ("publish", "/state/pose")
        assert set(message["msg"]) == {"secs", "nsecs", "bytes"}
        decoded = codec_of(POSE).decode(message["msg"]["bytes"])
        assert decoded["header"]["frame_id"] == "base"
        network.publish("/rosout", "rcl_interfaces/msg/Log", msg="hello")
        assert cbor2.loads(client.receive())["topic"] == "/rosout"
        # Lichtblick repeats this every three seconds.
        assert client.call("rosapi/topics_and_raw_types", {})["result"]
        assert client.call("rosapi/service_type", {"service": "/stop"})["values"]["type"] == TRIGGER
        assert client.call("/stop", {})["values"]["success"]
        client.send("advertise", topic="/cmd_vel", type="geometry_msgs/Twist", queue_size=1)
        client.send("publish", topic="/cmd_vel", msg={"linear": {"x": 1, "y": 0, "z": 0}})
        client.send("unsubscribe", id="subscribe:/state/pose:1", topic="/state/pose")
        client.send("unadvertise", topic="/cmd_vel")
        names = client.call("rosapi/get_param_names")["values"]["names"]
        assert client.call("rosapi/get_param", {"name": names[0]})["values"]["value"] == "0.5"
        assert network.published[-1][1]["linear"]["x"] == 1.0
        assert network.publishers == []
        assert client.heard == []
        assert running.server.counts["refused"] == 0
