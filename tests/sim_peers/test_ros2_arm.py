"""Simulated ROS 2 arm in virtual time, and on the bus."""

import threading
import time

import pytest

from cardan.bus.node import BusNode
from cardan.bus.options import BusOptions
from cardan.demos.examples import free_ports
from cardan.errors import ConfigurationError, DriverError, ScriptError
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import default_message
from cardan.protocols.ros2.zenoh import LATCHED_QOS, PUBLISHER, SUBSCRIPTION
from cardan.robots import load_arm
from cardan.sim_peers.ros2_arm import RosArm, RosArmOptions, RosArmPeer
from cardan.sim_peers.ros2_arm.controllers import JOINT_STATE, TOPICS
from tests.waiting import until

ARM = load_arm("ur5")
CODEC = codec_of(JOINT_STATE)
WITHIN_S = 10.0
"""Longest wait for the bus, on a busy computer."""


def array(values):
    message = default_message("std_msgs/msg/Float64MultiArray") | {"data": list(values)}
    return codec_of("std_msgs/msg/Float64MultiArray").encode(message)


def trajectory(*points, names=ARM.joint_names, speeds=()):
    made = []
    for at_s, positions in points:
        point = default_message("trajectory_msgs/msg/JointTrajectoryPoint")
        point |= {"positions": list(positions), "velocities": list(speeds)}
        point["time_from_start"] = {"sec": int(at_s), "nanosec": round(at_s % 1.0 * 1e9)}
        made.append(point)
    message = default_message(TOPICS["trajectory"][1])
    return codec_of(TOPICS["trajectory"][1]).encode(
        message | {"joint_names": list(names), "points": made}
    )


def run(arm, seconds):
    return [
        state for _ in range(round(seconds / arm.options.period_s)) for state in arm.cycle(100.0)
    ]


def decoded(state):
    return CODEC.decode(state.data)


def made(**options):
    return RosArm(RosArmOptions(**options))


def test_joint_states_are_in_alphabetical_order():
    arm = made()
    message = decoded(run(arm, 0.1)[-1])
    assert message["name"] == sorted(ARM.joint_names)
    at = dict(zip(message["name"], message["position"], strict=True))
    assert [at[name] for name in ARM.joint_names] == pytest.approx(ARM.home, abs=1e-3)
    assert len(message["velocity"]) == len(message["effort"]) == 6
    assert message["header"]["stamp"]["sec"] == 100


def test_a_state_is_stamped_with_the_time_at_which_it_was():
    arm = made(rate_hz=20.0)
    for now_s in (100.0, 100.05, 100.1):
        (state,) = arm.cycle(now_s)
        stamp = decoded(state)["header"]["stamp"]
        assert stamp["sec"] + 1e-9 * stamp["nanosec"] == pytest.approx(now_s, abs=1e-6)


@pytest.mark.parametrize(("missed", "passed_s"), [(0, 0.01), (3, 0.04), (1000, 0.51)])
def test_cycles_left_out_do_not_slow_its_clock_down(missed, passed_s):
    arm = made(rate_hz=100.0)

    def stamp_s(missed):
        (state,) = arm.cycle(0.0, missed)
        stamp = decoded(state)["header"]["stamp"]
        return stamp["sec"] + 1e-9 * stamp["nanosec"]

    before_s = stamp_s(0)
    assert stamp_s(missed) - before_s == pytest.approx(passed_s)


def test_positions_are_gone_to_at_once():
    arm = made()
    arm.receive(array((0.2, *ARM.home[1:])))
    run(arm, 1.0)
    assert arm.plant.positions[0] == pytest.approx(0.2, abs=2e-3)
    arm.receive(array([0.0] * 5))
    arm.receive(array([float("nan")] * 6))
    assert arm.ignored == {"5 values for 6 joints": 1, "not finite": 1}


def test_speeds_are_kept_for_ever():
    arm = made(controller="velocity")
    arm.receive(array((0.1, *[0.0] * 5)))
    run(arm, 3.0)
    assert arm.plant.positions[0] == pytest.approx(0.3, abs=0.02)


def test_a_trajectory_replaces_the_one_before():
    arm = made(controller="trajectory", drive="ideal")
    far = (1.0, *ARM.home[1:])
    arm.receive(trajectory((2.0, far)))
    run(arm, 1.0)
    assert arm.plant.positions[0] == pytest.approx(0.5, abs=0.02)
    arm.receive(trajectory((1.0, ARM.home)))
    run(arm, 2.0)
    assert arm.plant.positions == pytest.approx(ARM.home, abs=1e-3)
    for bad in (
        trajectory((1.0, far), names=[*ARM.joint_names[:5], "other"]),
        trajectory((1.0, far), (0.5, far)),
        trajectory((1.0, far), speeds=[1.0] * 6),
        trajectory(),
        b"",
    ):
        arm.receive(bad)
    assert sum(arm.ignored.values()) == 5
    assert arm.taken == 2


def test_joint_states_as_commands_are_ordered_by_their_names():
    arm = made(controller="joint_state")
    order = [5, 4, 3, 2, 1, 0]
    target = (0.1, *ARM.home[1:])
    message = default_message(JOINT_STATE)
    message["name"] = [ARM.joint_names[index] for index in order]
    message["position"] = [target[index] for index in order]
    arm.receive(CODEC.encode(message))
    run(arm, 1.0)
    assert arm.plant.positions == pytest.approx(target, abs=5e-3)


@pytest.mark.parametrize(
    ("fault", "value", "shows"),
    [
        ("nan", 1.0, lambda m: any(each != each for each in m["position"])),
        ("absurd", 1.0, lambda m: max(m["position"]) == 1e9),
        ("wrong-names", 0.0, lambda m: m["name"][0].startswith("other_")),
        ("missing", 0.0, lambda m: len(m["name"]) == 5),
        ("extra", 1.0, lambda m: "finger_joint" in m["name"]),
        ("no-stamps", 1.0, lambda m: m["header"]["stamp"] == {"sec": 0, "nanosec": 0}),
    ],
)
def test_faults_of_the_messages(fault, value, shows):
    assert shows(decoded(run(made(faults={fault: value}), 0.1)[-1]))


def test_faults_in_time():
    stale = run(made(faults={"stale": 0.5}), 1.0)
    assert len({state.data for state in stale}) == 49
    assert stale[-1].sequence == 100
    restarted = run(made(faults={"restart": 0.5}), 2.0)
    assert [state.sender for state in (restarted[0], restarted[-1])] == [1, 2]
    assert len(restarted) == pytest.approx(100, abs=2)
    assert restarted[-1].sequence < 60
    silent = run(made(faults={"silence": 0.3}), 6.0)
    assert len(silent) == pytest.approx(570, abs=1)
    stepped = run(made(faults={"clock-step": 3600.0}), 6.0)
    assert decoded(stepped[-1])["header"]["stamp"]["sec"] == 3705
    gripper = run(made(faults={"gripper": 1.0}), 0.1)
    assert decoded(gripper[1])["name"] == ["finger_joint"]
    arm = made(faults={"inactive": 0.1, "jam": 2.0})
    run(arm, 0.2)
    arm.receive(array(ARM.home))
    assert arm.ignored == {"no controller": 1}


def test_options_that_cannot_be():
    with pytest.raises(ScriptError, match="no fault 'none'"):
        RosArmOptions(faults={"none": 1.0})
    with pytest.raises(ConfigurationError, match="not a joint"):
        RosArmOptions(faults={"jam": 7.0})


@pytest.fixture
def free_tcp_port():
    return free_ports()


# -- on the bus ---------------------------------------------------------------------------------


@pytest.mark.matrix
def test_it_is_on_the_bus_as_nodes_of_ros_are(free_tcp_port):
    pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
    peer = RosArmPeer(RosArmOptions(port=free_tcp_port, faults={"restart": 1.5}))
    assert peer.endpoint == f"tcp/127.0.0.1:{free_tcp_port}"
    node = BusNode(BusOptions(router=peer.endpoint), "observer")
    with peer, node:
        publishers = node.presence(PUBLISHER, "/joint_states")
        takers = node.presence(SUBSCRIPTION, TOPICS["position"][0])
        until(lambda: publishers.others() and takers.others(), "publisher of /joint_states")
        assert publishers.others()[0].full_node == "/simulated_arm"
        assert publishers.others()[0].type_name == JOINT_STATE
        description = node.waiting_subscription(
            "/robot_description", "std_msgs/msg/String", 1, LATCHED_QOS
        )
        received = description.wait(WITHIN_S)
        assert received is not None
        assert codec_of("std_msgs/msg/String").decode(received.data)["data"] == ARM.urdf
        states = node.waiting_subscription("/joint_states", JOINT_STATE, 10)
        first = states.wait(WITHIN_S)
        assert first is not None
        assert CODEC.decode(first.data)["name"] == sorted(ARM.joint_names)
        commands = node.publisher(*TOPICS["position"])
        commands.put(array((0.1, *ARM.home[1:])), time.time_ns())
        until(lambda: peer.core.taken == 1, "command taken")
        until(lambda: not publishers.others(), "end of the node")
        until(publishers.others, "node that is there anew")
        gids = set()

        def two_senders():
            received = states.wait(0.1)
            if received is not None:
                gids.add(received.attachment.gid)
            return len(gids) == 2

        until(two_senders, "second publisher")


@pytest.mark.matrix
def test_a_wait_ends_in_time_and_at_once_when_woken(free_tcp_port):
    pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
    with BusNode(BusOptions(router="", listen=(f"tcp/127.0.0.1:{free_tcp_port}",)), "one") as node:
        waiting = node.waiting_subscription("/silent", "std_msgs/msg/String", 2)
        begun_s = time.monotonic()
        assert waiting.wait(0.05) is None
        assert time.monotonic() - begun_s >= 0.05
        timer = threading.Timer(0.05, waiting.wake)
        timer.start()
        assert waiting.wait(30.0) is None
        timer.join()
        assert waiting.poll() is None
        publisher = node.publisher("/silent", "std_msgs/msg/String")
        text = codec_of("std_msgs/msg/String")
        for word in "abc":
            publisher.put(text.encode({"data": word}), 1)
        # The queue keeps the newest two.
        assert text.decode(waiting.wait(WITHIN_S).data)["data"] == "b"
        assert waiting.poll().attachment.sequence == 3


def test_a_port_that_a_router_has_is_reported(free_tcp_port):
    options = BusOptions(router="", listen=(f"tcp/127.0.0.1:{free_tcp_port}",))
    with BusNode(options, "router"), pytest.raises(DriverError, match="cannot be joined"):
        RosArmPeer(RosArmOptions(port=free_tcp_port)).open()


@pytest.mark.parametrize("key", ["position", "velocity"])
def test_joint_states_that_are_not_finite_move_nothing(key):
    arm = RosArm(RosArmOptions(controller="joint_state"))
    zeros = [0.0] * 6
    message = {"name": list(ARM.joint_names), "position": zeros, "velocity": zeros}
    message = {**default_message(JOINT_STATE), **message, key: [float("nan")] * 6}
    arm.receive(CODEC.encode(message))
    assert (arm.taken, arm.ignored.total()) == (0, 1)
    (state,) = arm.cycle(0.0)
    assert all(abs(each) < 7.0 for each in CODEC.decode(bytes(state.data))["position"])
