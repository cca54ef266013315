"""A phone's motion sensors as a sensor on the network, while an operator requests them."""

from __future__ import annotations

import time

import pytest

pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")

from cardan.protocols.handheld.frames import JogTwist, PhoneFrame
from cardan.protocols.ros2.cdr import codec_of
from cardan.types import Vector3
from tests.gateway.servers.console.bench import VIEWER, page_program
from tests.waiting import until

pytestmark = pytest.mark.matrix

TOPIC, IMU = "/phone/imu", "sensor_msgs/msg/Imu"

UPRIGHT = PhoneFrame(
    angles_deg=Vector3(0.0, 90.0, 0.0),
    rates_rad_s=Vector3(0.1, 0.2, 0.3),
    acceleration_m_s2=Vector3(0.0, 9.8, 0.0),
)
BLIND = PhoneFrame(None, acceleration_m_s2=Vector3(0.0, 0.0, 9.8))


@pytest.fixture
def heard(network):
    messages = []
    codec = codec_of(IMU)
    network.subscribe(TOPIC, IMU, lambda cdr, _ns: messages.append(codec.decode(cdr)))
    return messages


def test_what_the_phone_measures_is_an_imu_by_its_definition(operator, heard):
    operator.open(7, imu=TOPIC)
    operator.frame(UPRIGHT, False, channel=7)
    until(lambda: heard, "it is published")
    (message,) = heard
    assert message["header"]["frame_id"] == "phone"
    stamp = message["header"]["stamp"]
    assert abs(stamp["sec"] + 1e-9 * stamp["nanosec"] - time.time()) < 5.0
    turned = [message["orientation"][each] for each in "wxyz"]
    assert turned == pytest.approx([0.707107, 0.707107, 0.0, 0.0], abs=1e-6)
    assert [message["angular_velocity"][each] for each in "xyz"] == pytest.approx([0.1, 0.2, 0.3])
    assert message["linear_acceleration"]["y"] == pytest.approx(9.8)
    assert set(message["orientation_covariance"]) == {0.0}


def test_what_it_does_not_measure_is_marked(operator, heard):
    operator.open(7, imu=TOPIC)
    operator.frame(BLIND, False, channel=7)
    until(lambda: heard, "it is published")
    (message,) = heard
    assert message["orientation_covariance"][0] == -1.0
    assert message["angular_velocity_covariance"][0] == -1.0
    assert message["linear_acceleration_covariance"][0] == 0.0


def test_what_is_old_or_nothing_is_not_published(operator, heard):
    operator.open(7, imu=TOPIC)
    operator.frame(UPRIGHT, False, channel=7, late_s=1.0)
    operator.frame(PhoneFrame(None), False, channel=7)
    operator.frame(UPRIGHT, False, channel=7, visible=False)
    operator.frame(UPRIGHT, False, channel=7)
    until(lambda: heard, "it is published")
    assert len(heard) == 1


def test_it_ends_with_the_channel(operator, heard, network):
    operator.open(7, imu=TOPIC)
    assert network.topics()[TOPIC].publishers
    operator.ask("cardan.close", channel=7)
    until(lambda: not network.topics()[TOPIC].publishers, "nobody publishes it")
    operator.frame(UPRIGHT, False, channel=7)
    operator.settle()
    assert not heard


def test_a_viewer_publishes_nothing_and_no_hand_is_an_imu(with_tokens, operator):
    with page_program(with_tokens, f"/ws?t={VIEWER}") as viewer:
        viewer.ask("cardan.open", channel=7, imu=TOPIC)
        assert "viewer" in viewer.next("cardan.refused")["why"]
    operator.open(7, imu=TOPIC)
    operator.frame(JogTwist(Vector3(0.1, 0, 0), Vector3(0, 0, 0)), channel=7)
    assert "phone's sensors" in operator.next("cardan.refused")["why"]
