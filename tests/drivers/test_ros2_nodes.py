"""Operator devices of ROS 2 nodes: data that prove an operator, and data that do not."""

import math

import pytest

from cardan.demos.examples import free_ports
from cardan.drivers.bus_devices import Ros2Joy, Ros2Spacenav
from cardan.drivers.ros2_nodes import Ros2JoyOptions, Ros2SpacenavOptions
from cardan.drivers.ros2_nodes.core import JOY_TYPE
from cardan.errors import DeviceNotFoundError, OptionError
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import default_message
from cardan.sim_peers.ros2_device import NodePeer, NodePeerOptions
from cardan.types import NEUTRAL, DeviceFeedback, DeviceLink
from tests.drivers.ros2_node_bench import KEY, Bench, received
from tests.waiting import until

NODES = ("spacenav", "joy_node", "game_controller")


def joy(axes, buttons=(0, 0)):
    message = default_message(JOY_TYPE) | {"axes": list(axes), "buttons": list(buttons)}
    return codec_of(JOY_TYPE).encode(message)


@pytest.mark.parametrize("node", NODES)
def test_zeros_alone_are_no_operator(node):
    bench = Bench(node)
    bench.run(3.0)
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    assert "not seen at rest yet: touch it once" in bench.state.reason
    bench.touch()
    assert bench.state.link is DeviceLink.LIVE


@pytest.mark.parametrize("node", NODES)
def test_a_button_shows_a_device_too(node):
    bench = Bench(node)
    bench.run(0.2)
    bench.device.press("button-1")
    bench.run(0.2)
    assert bench.state.link is DeviceLink.LIVE
    assert bench.state.buttons == {"button-1"}
    assert [(e.button, e.pressed) for e in bench.core.events()] == [("button-1", True)]


def test_a_device_that_was_deflected_at_first_has_to_be_let_go():
    bench = Bench()
    bench.run(0.5, (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert (bench.state.link, bench.state.axes) == (DeviceLink.NEEDS_NEUTRAL, NEUTRAL)
    bench.run(0.1, (0.0,) * 6)
    assert bench.state.link is DeviceLink.LIVE


def test_a_spacenav_has_the_axes_of_ros():
    bench = Bench(dead_zone=0.0)
    bench.touch()
    bench.run(0.1, (0.1, -0.2, 0.3, -0.4, 0.5, -1.0))
    assert bench.state.axes == pytest.approx((0.1, -0.2, 0.3, -0.4, 0.5, -1.0), abs=0.01)


@pytest.mark.parametrize("node", NODES[1:])
def test_sticks_in_both_layouts(node):
    bench = Bench(node, dead_zone=0.0)
    bench.touch()
    bench.run(0.2, (0.1, -0.2, 0.3, 0.0, 0.0, 0.4))
    assert bench.state.axes == pytest.approx((0.1, -0.2, 0.3, 0.0, 0.0, 0.4), abs=0.01)
    bench.device.press("button-5" if node == "joy_node" else "button-10")
    bench.run(0.2)
    # Left stick away is pitch; to the left is a roll to the left.
    assert bench.state.axes == pytest.approx((0.0, 0.0, 0.3, 0.2, 0.1, 0.4), abs=0.01)


def test_axes_by_number():
    bench = Bench("joy_node", axes=(-2, 0, 1, 0, 0, 0), dead_zone=0.0)
    bench.touch()
    bench.run(0.1, (0.5, 0.25, 0.0, 0.0, 0.0, 0.0))
    assert bench.state.axes == pytest.approx((-0.5, 0.0, 0.25, 0.0, 0.0, 0.0))


def test_a_device_that_is_unplugged_in_motion_stops_the_arm():
    """Nodes of 3D mice send zeros then; the others send no message."""
    for node, link in (("spacenav", DeviceLink.LIVE), ("joy_node", DeviceLink.STALE)):
        bench = Bench(node)
        bench.touch()
        bench.run(0.2, (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
        assert bench.state.axes.x > 0.4
        bench.device.unplug()
        bench.run(0.3)
        assert (bench.state.axes, bench.state.link) == (NEUTRAL, link)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (received(b"\0\1\0\0", 999), "malformed"),
        (received(joy([math.nan] * 6), 999), "not numbers"),
        (received(joy([1e9] * 6), 999), "not numbers"),
        (received(joy([0.5] * 5), 999), "5 axes: fewer"),
        (received(joy([0.5] * 6), 999, key=KEY.replace("Joy_", "Imu_")), "another type"),
        (received(joy([0.5] * 6), 999)._replace(attachment=None), "without the attachment"),
    ],
)
def test_what_means_nothing_is_reported_and_moves_nothing(message, words):
    bench = Bench()
    bench.touch()
    bench.sequence = 0
    bench.core.on_received(message, bench.now_s)
    assert bench.state.axes == NEUTRAL
    assert any(words in line for line in bench.core.diagnosis(bench.now_s))


def test_of_many_buttons_the_first_are_read():
    """A SpaceMouse Enterprise has key numbers up to 175."""
    bench = Bench()
    bench.touch()
    bench.sequence = 0
    down = [number in (3, 175) for number in range(176)]
    bench.core.on_received(received(joy([0.5] * 6, down), 999), bench.now_s)
    assert bench.state.link is DeviceLink.LIVE
    assert bench.state.buttons == {"button-3"}
    assert bench.core.labels[-1] == "button-63"
    assert any(bench.state.axes)


def test_messages_that_come_twice_or_late_have_no_effect():
    bench = Bench()
    bench.touch()
    number = bench.sequence
    for sequence, x, acts in ((number, 0.5, False), (number + 2, 0.5, True), (number + 1, 0, True)):
        bench.core.on_received(received(joy((x, 0, 0, 0, 0, 0)), sequence), bench.now_s)
        assert any(bench.state.axes) is acts
    assert bench.core.metrics(bench.now_s)["late"] == 2


def test_of_two_nodes_the_first_counts_while_it_speaks():
    bench = Bench()
    bench.touch()
    bench.core.on_received(received(joy([0.6] * 6), 900, sender=2), bench.now_s)
    assert bench.state.axes == NEUTRAL
    assert any("second node" in line for line in bench.core.diagnosis(bench.now_s))
    bench.device.silence()
    bench.run(0.2)
    bench.core.on_received(received(joy([0.6] * 6), 901, sender=2), bench.now_s)
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    bench.now_s += 0.05
    bench.core.on_received(received(joy([0.0] * 6), 902, sender=2), bench.now_s)
    assert bench.state.link is DeviceLink.LIVE


def test_a_second_node_that_takes_over_shows_an_operator_of_its_own():
    """The second node may have no device: neither zeros nor the first node's data prove an
    operator."""
    bench = Bench()
    bench.touch()
    bench.device.silence()
    bench.run(0.2)
    for sequence in range(1, 50):
        bench.now_s += 0.05
        bench.core.on_received(received(joy([0.0] * 6), sequence, sender=2), bench.now_s)
        assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    for x in (0.6, 0.0):
        sequence += 1
        bench.now_s += 0.05
        bench.core.on_received(received(joy([x] * 6), sequence, sender=2), bench.now_s)
    assert bench.state.link is DeviceLink.LIVE


@pytest.mark.parametrize(
    ("kind", "options", "words"),
    [
        (Ros2JoyOptions, {"axes": (1, 2)}, "six numbers"),
        (Ros2JoyOptions, {"axes": (99, 0, 0, 0, 0, 0)}, "-32 to 32"),
        (Ros2JoyOptions, {"feedback_topic": "a b"}, "a name of ROS 2"),
        (Ros2JoyOptions, {"layout": "spacenav"}, "joy_node"),
        (Ros2SpacenavOptions, {"topic": "a//b"}, "a name of ROS 2"),
        (Ros2SpacenavOptions, {"stale_after_s": 0.01}, "0.1 to 1"),
        (Ros2SpacenavOptions, {"full_scale": 0.0}, "0.01 to 1000"),
    ],
)
def test_options_that_cannot_be(kind, options, words):
    with pytest.raises(OptionError, match=words):
        kind(**options)


# -- on the bus ---------------------------------------------------------------------------------


@pytest.mark.real
@pytest.mark.judged(device="spacenav_node", transport="ROS 2, Zenoh", by="simulated node")
def test_a_spacenav_node_is_met_on_the_bus_and_its_end_is_seen():
    pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
    port = free_ports()
    peer = NodePeer(NodePeerOptions(port=port, script="wiggle"))
    with peer, Ros2Spacenav(port=port) as device:
        until(lambda: device.state().link is DeviceLink.LIVE, "operator")
        until(lambda: any(device.state().axes), "motion")
        assert device.capabilities.buttons == ("button-0", "button-1")
        peer.device.exit()
        until(lambda: device.state().link is DeviceLink.LOST, "loss")
        assert "has ended" in device.state().reason or "nobody" in device.state().reason
        assert device.state().axes == NEUTRAL


@pytest.mark.real
@pytest.mark.judged(device="joy_node", transport="ROS 2, Zenoh", by="simulated node")
def test_a_joy_node_rumbles():
    pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
    port = free_ports()
    peer = NodePeer(NodePeerOptions(port=port, node="joy_node", script="taps"))
    with peer:
        with Ros2Joy(port=port) as device:
            until(lambda: device.state().link is DeviceLink.LIVE, "operator")
            until(lambda: "button-0" in device.state().buttons, "button")
            device.feedback(DeviceFeedback(rumble=0.5))
            until(lambda: peer.device.rumble == 0.5, "rumble")
        until(lambda: peer.device.rumble == 0.0, "end of the rumble")


@pytest.mark.matrix
def test_without_its_node_it_says_what_to_start():
    pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
    with pytest.raises(DeviceNotFoundError, match="no node publishes /joy: start joy_node"):
        Ros2Joy(port=free_ports()).open()
