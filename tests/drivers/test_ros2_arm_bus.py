"""The ROS 2 arm driver with the simulated arm, over Zenoh and over DDS."""

import re
import time

import pytest

pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')

from cardan.bus.node import BusNode
from cardan.bus.options import BusOptions
from cardan.demos.examples import free_ports
from cardan.drivers.ros2_arm import Ros2Arm
from cardan.drivers.ros2_arm.session import STATE_TYPE
from cardan.errors import ConfigurationError, DriverError
from cardan.robots import load_arm
from cardan.sim_peers.ros2_arm import RosArmOptions, RosArmPeer
from cardan.types import HoldCommand, JointCommand, RobotLink
from cardan_dds.node import DdsNode
from tests.dds_network import OPTIONS
from tests.drivers.ros2_bench import joint_states
from tests.waiting import WITHIN_S

pytestmark = pytest.mark.matrix

HOME = load_arm("ur5").home


def cycles(robot):
    """Yield the states; fail after WITHIN_S."""
    begun_s = time.monotonic()
    for state in robot.cycles():
        assert time.monotonic() - begun_s < WITHIN_S
        yield state


@pytest.fixture(params=["zenoh", "dds"])
def meeting(request):
    """Return options by which the driver and the simulated arm connect."""
    if request.param == "zenoh":
        return {"port": free_ports()}
    pytest.importorskip("cyclonedds", reason='cyclonedds is not installed: "cardan[dds]"')
    return {"transport": "dds", "domain": OPTIONS.dds_domain}


@pytest.mark.parametrize("command", ["position", "joint_state", "trajectory"])
def test_it_moves_the_arm(command, meeting):
    peer = RosArmPeer(RosArmOptions(**meeting, controller=command))
    with peer, Ros2Arm(**meeting, command=command) as robot:
        for state in cycles(robot):
            if not state.ready:
                continue
            assert state.joints[1:] == pytest.approx(HOME[1:], abs=0.01)
            if state.joints[0] > HOME[0] + 0.09:
                break
            robot.send(JointCommand((HOME[0] + 0.1, *HOME[1:])))


def test_limits_come_from_the_description(meeting):
    with RosArmPeer(RosArmOptions(**meeting)):
        with Ros2Arm(**meeting, robot="", joints=load_arm("ur5").joint_names) as robot:
            assert robot.capabilities.limits == load_arm("ur5").limits
        with pytest.raises(DriverError, match="no joint 'one'"):
            Ros2Arm(**meeting, robot="", joints=("one",)).open()


def test_a_controller_of_another_name_is_reported(meeting):
    peer = RosArmPeer(RosArmOptions(**meeting))
    with peer, Ros2Arm(**meeting, command_topic="/other/commands") as robot:
        for state in cycles(robot):
            if state.link is RobotLink.LIVE:
                assert "no controller subscribes to /other/commands" in state.hold_reason
                break


def test_a_second_publisher_of_the_joints_ends_readiness_and_both_are_named(meeting):
    """The arm's node, and a forgotten joint_state_publisher that sends zeros at 10 Hz."""
    names = load_arm("ur5").joint_names
    peer = RosArmPeer(RosArmOptions(**meeting))
    if "port" in meeting:
        node = BusNode(BusOptions(router=peer.endpoint), "joint_state_publisher")
    else:
        node = DdsNode(OPTIONS, "joint_state_publisher")
    reasons, said_s, ended_s = [], 0.0, 0.0
    with peer, node, Ros2Arm(**meeting) as robot:
        publisher = node.publisher("/joint_states", STATE_TYPE)
        for state in cycles(robot):
            now_s = time.monotonic()
            assert state.joints == pytest.approx(HOME, abs=0.05)
            if state.ready:
                robot.send(JointCommand(tuple(q + 0.002 for q in state.joints)))
                if reasons:
                    break
                said_s = said_s or now_s
            elif "publishers of" in state.hold_reason:
                reasons.append(state.hold_reason)
                ended_s = ended_s or now_s + 1.5
            if said_s and not 0.0 < ended_s < now_s and now_s >= said_s:
                said_s += 0.1
                publisher.put(joint_states(names, (0.0,) * 6, stamp_s=time.time()), time.time_ns())
        assert len(reasons) > 100
        assert robot.session.sessions == 1
    assert re.match(
        r"2 publishers of \w+ are heard at once on /joint_states, /simulated_arm \(at -?1\.57\d*\) "
        r"and /joint_state_publisher \(at 0\): end all but the arm's own",
        reasons[-1],
    )
    assert peer.core.plant.positions == pytest.approx(HOME, abs=0.05)


@pytest.mark.real
def test_a_node_that_is_started_anew_is_a_new_session(meeting):
    peer = RosArmPeer(RosArmOptions(**meeting, faults={"restart": 1.0}))
    links = []
    with peer, Ros2Arm(**meeting) as robot:
        for state in cycles(robot):
            links.append(state.link)
            if state.ready:
                robot.send(HoldCommand())
            if state.session == 2 and state.ready:
                break
    assert RobotLink.LOST in links


def test_nobody_on_dds_is_reported_with_advice():
    pytest.importorskip("cyclonedds", reason='cyclonedds is not installed: "cardan[dds]"')
    with Ros2Arm(transport="dds", domain=OPTIONS.dds_domain, states_topic="/nothing") as robot:
        for _ in cycles(robot):
            if robot.diagnosis():
                break
        assert any("a middleware of DDS in the same domain" in each for each in robot.diagnosis())


def test_what_does_not_go_with_dds_is_refused():
    with pytest.raises(ConfigurationError, match=r"port: .* nodes on DDS discover each other"):
        Ros2Arm(transport="dds", port=7447)
    with pytest.raises(ConfigurationError, match="duplicate: DDS gives each message once"):
        RosArmOptions(transport="dds", faults={"duplicate": 0.1, "drop": 0.1})
