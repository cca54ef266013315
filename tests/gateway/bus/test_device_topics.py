"""Topics of the session's operator device, compatible with programs for the standard ROS nodes."""

import time

import pytest

from cardan.bus.node import BusNode, Received
from cardan.bus.options import BusOptions
from cardan.demos.examples import free_ports
from cardan.drivers.bus_devices import Ros2Joy, Ros2Spacenav
from cardan.gateway.bus.device_topics import (
    RUMBLE_ENDS_S,
    RUMBLE_TOPIC,
    SPACENAV_FULL,
    DeviceTopics,
)
from cardan.protocols.ros2.cdr import codec_of
from cardan.types import NEUTRAL, Axes, DeviceFeedback, DeviceLink, DeviceState, Inertia, Vector3
from tests.gateway.bus.fakes import FakeNode

AXES = Axes(0.1, -0.2, 0.3, -0.4, 0.5, -1.0)
WITHIN_S = 10.0


def state(axes=NEUTRAL, buttons=(), link=DeviceLink.LIVE, stamp_s=0.0):
    return DeviceState(stamp_s, link, axes, frozenset(buttons))


def played(device_of, seconds, buttons=("left", "right"), period_s=0.004, **more):
    """Return the messages by topic after a session's loop has offered `device_of(now_s)` for some
    time."""
    node = FakeNode()
    topics = DeviceTopics(node, buttons, **more)
    for cycle in range(round(seconds / period_s)):
        now_s = cycle * period_s
        topics.offer(device_of(now_s), now_s, round(now_s * 1e9))
    return {name: each.messages for name, each in node.publishers.items()}


def test_messages_have_the_stock_nodes_scales_and_axes():
    sent = played(lambda now_s: state(AXES, ["right"], stamp_s=now_s), 0.1)
    scaled = [SPACENAV_FULL * each for each in AXES]
    offset, rotation = sent["spacenav/offset"][-1], sent["spacenav/rot_offset"][-1]
    assert [offset[axis] for axis in "xyz"] == pytest.approx(scaled[:3])
    assert [rotation[axis] for axis in "xyz"] == pytest.approx(scaled[3:])
    twist = sent["spacenav/twist"][-1]
    assert [twist["linear"][axis] for axis in "xyz"] == pytest.approx(scaled[:3])
    assert [twist["angular"][axis] for axis in "xyz"] == pytest.approx(scaled[3:])
    joy = sent["spacenav/joy"][-1]
    assert joy["axes"] == pytest.approx(scaled, abs=1e-6)
    assert joy["buttons"] == [0, 1]
    assert sent["joy"][-1]["axes"] == pytest.approx(AXES, abs=1e-6)
    assert sent["joy"][-1]["header"]["frame_id"] == "joy"


def test_rates_are_the_stock_nodes():
    moved = played(lambda now_s: state(AXES, stamp_s=now_s), 2.0)
    assert len(moved["spacenav/twist"]) == pytest.approx(250, rel=0.05)
    assert len(moved["joy"]) == pytest.approx(40, abs=3)
    rest = played(lambda now_s: state(), 2.0)
    assert len(rest["spacenav/twist"]) == pytest.approx(63, abs=3)
    assert len(rest["spacenav/offset"]) == len(rest["spacenav/joy"])


def test_a_button_is_reported_at_once():
    sent = played(lambda now_s: state(buttons=["left"] if now_s > 0.101 else ()), 0.11)
    assert [message["buttons"] for message in sent["joy"]][-2:] == [[0, 0], [1, 0]]


def test_a_device_that_is_not_live_is_silent_after_zeros():
    def device(now_s):
        link = DeviceLink.LIVE if 0.1 <= now_s < 0.2 else DeviceLink.LOST
        return state(AXES if link is DeviceLink.LIVE else NEUTRAL, link=link, stamp_s=now_s)

    sent = played(device, 1.0)
    assert len(sent["spacenav/joy"]) < 20
    assert any(sent["spacenav/joy"][0]["axes"])
    assert not any(sent["spacenav/joy"][-1]["axes"])
    assert any(sent["spacenav/joy"][-2]["axes"])
    assert not any(sent["joy"][-1]["axes"])


def test_buttons_that_show_up_later_come_behind():
    sent = played(lambda now_s: state(buttons=["late"] if now_s > 0.1 else ()), 0.3, buttons=())
    assert sent["joy"][0]["buttons"] == []
    assert sent["joy"][-1]["buttons"] == [1]


def test_inertial_sensors_are_reported_as_they_measure():
    def device(now_s):
        measured_s = now_s - now_s % 0.01
        rates = Vector3(0.1, 0.2, 0.3) if now_s > 0.5 else None
        inertia = Inertia(Vector3(0.5, -0.5, 9.8), rates)
        return state(stamp_s=measured_s)._replace(inertia=inertia)

    sent = played(device, 1.0, inertia=True)["imu/data_raw"]
    assert len(sent) == pytest.approx(100, abs=1)
    still, turning = sent[10], sent[-1]
    assert still["linear_acceleration"] == {"x": 0.5, "y": -0.5, "z": 9.8}
    assert still["orientation_covariance"][0] == -1.0
    assert (still["angular_velocity"]["x"], still["angular_velocity_covariance"][0]) == (0.0, -1.0)
    assert turning["angular_velocity"] == {"x": 0.1, "y": 0.2, "z": 0.3}
    assert turning["angular_velocity_covariance"][0] == 0.0
    stamp = turning["header"]["stamp"]
    assert stamp["sec"] + stamp["nanosec"] * 1e-9 == pytest.approx(0.99, abs=1e-6)


def test_a_device_whose_sensors_are_not_heard_tells_nothing_of_them():
    assert played(lambda now_s: state(stamp_s=now_s), 0.1, inertia=True)["imu/data_raw"] == []
    assert "imu/data_raw" not in played(lambda now_s: state(stamp_s=now_s), 0.1)


def feedback(level, kind=1):
    codec = codec_of("sensor_msgs/msg/JoyFeedback")
    return Received(codec.encode({"type": kind, "id": 0, "intensity": level}), "", None)


def test_rumble_is_asked_for_and_ends_by_itself():
    node = FakeNode()
    topics = DeviceTopics(node, ())
    assert topics.rumble(0.0) == 0.0
    waiting = node.queues[RUMBLE_TOPIC].waiting
    waiting.append(feedback(0.5))
    assert topics.rumble(1.0) == 0.5
    assert topics.rumble(1.0 + 0.9 * RUMBLE_ENDS_S) == 0.5
    assert topics.rumble(1.0 + 1.1 * RUMBLE_ENDS_S) == 0.0
    junk = Received(b"junk", "", None)
    waiting += [feedback(0.7), feedback(9.0), feedback(float("nan")), feedback(1.0, 0), junk]
    assert topics.rumble(3.0) == pytest.approx(0.7)


@pytest.mark.matrix
def test_our_own_drivers_read_it_from_the_bus():
    pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
    port = free_ports()
    node = BusNode(BusOptions(router="", listen=(f"tcp/127.0.0.1:{port}",)), "session")
    with node:
        topics = DeviceTopics(node, ("left", "right"))
        begun_s = time.monotonic()

        def until(found, device_of):
            while not found():
                now_s = time.monotonic()
                assert now_s - begun_s < WITHIN_S
                topics.offer(device_of(now_s), now_s, time.time_ns())
                time.sleep(0.002)

        def moved(now_s):
            return state(AXES, ["left"], stamp_s=now_s)

        def rest(now_s):
            return state(stamp_s=now_s)

        mouse = Ros2Spacenav(port=port, full_scale=SPACENAV_FULL, dead_zone=0.0)
        pad = Ros2Joy(port=port, axes=(1, 2, 3, 4, 5, 6), dead_zone=0.0)
        with mouse, pad:
            until(lambda: mouse.state().reason and pad.metrics()["lost_edges"] == 0, rest)
            for device in (mouse, pad):
                until(lambda device=device: "button-0" in device.state().buttons, moved)
                until(lambda device=device: device.state().link is DeviceLink.LIVE, rest)
                until(lambda device=device: any(device.state().axes), moved)
                assert device.state().axes == pytest.approx(AXES, abs=0.01)
            pad.feedback(DeviceFeedback(rumble=1.0))
            until(lambda: topics.rumble(time.monotonic()) == 1.0, rest)
