"""YARP's IHapticDevice over a haptic device that is not the Omni."""

import math

import pytest

from cardan.common.haptics import FeedbackLimits
from cardan.drivers.ihaptic import IHapticDevice
from cardan.errors import CommandError, DriverError, NotOpenError, OptionError
from cardan.types import IDENTITY, ZERO3, DeviceLink, Pose, Quaternion, Vector3
from tests.gateway.force.fakes import FakeHaptic

QUARTER = Quaternion(math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))


@pytest.fixture
def device():
    made = FakeHaptic()
    made.enable()
    return made


@pytest.fixture
def yarp(device):
    return IHapticDevice(device)


def test_it_measures_in_the_frame_of_the_transformation(device, yarp):
    device.pose = Pose(Vector3(0.02, 0.01, 0.0), IDENTITY)
    device.buttons = frozenset({"button_2"})
    yarp.set_transformation(Pose(Vector3(10.0, 20.0, 30.0), QUARTER))
    assert yarp.get_position() == pytest.approx((9.99, 20.02, 30.0))
    assert yarp.get_orientation() == pytest.approx((0.0, 0.0, math.pi / 2))
    assert yarp.get_buttons() == (False, True)


def test_feedback_becomes_a_command_along_the_axes_of_the_hand(device, yarp):
    yarp.set_transformation(Pose(ZERO3, QUARTER))
    yarp.set_feedback(Vector3(0.0, 0.5, 0.0))
    yarp.stop_feedback()
    pushed, stopped = device.commands
    assert pushed.engaged
    assert pushed.force == pytest.approx((0.5, 0.0, 0.0))
    assert not stopped.engaged
    assert stopped.sequence > pushed.sequence


def test_its_commands_count_on_from_those_of_others(device, yarp):
    yarp.set_feedback(ZERO3)
    device.haptic_state = device.haptic_state._replace(command_sequence=70)
    yarp.set_feedback(ZERO3)
    assert [command.sequence for command in device.commands] == [1, 71]


def test_a_device_without_joint_torques_stays_with_forces(device, yarp):
    assert yarp.get_max_feedback() == (3.0, 3.0, 3.0)
    with pytest.raises(CommandError, match="FakeHaptic takes forces, no joint torques"):
        yarp.set_joint_torque_mode()
    assert yarp.is_cartesian_force_mode_enabled()
    assert device.commands == []


def test_a_change_of_mode_passes_through_no_force(device):
    device.feedback_limits = FeedbackLimits(3.0, 0.2)
    yarp = IHapticDevice(device, "joint")
    assert yarp.get_max_feedback() == (0.2, 0.2, 0.2)
    yarp.set_feedback(Vector3(0.1, 0.0, 0.0))
    yarp.set_cartesian_force_mode()
    yarp.set_cartesian_force_mode()
    torques, none = device.commands
    assert torques.joint_torques_n_m == (0.1, 0.0, 0.0)
    assert not none.engaged


def test_a_position_that_is_not_known_is_an_error_in_words(device, yarp, monkeypatch):
    state = device.state()._replace(pose=None, link=DeviceLink.LOST, reason="unplugged")
    monkeypatch.setattr(device, "state", lambda: state)
    with pytest.raises(DriverError, match="no position to give: unplugged"):
        yarp.get_position()
    monkeypatch.setattr(device, "state", lambda: state._replace(link=DeviceLink.CLOSED))
    with pytest.raises(NotOpenError):
        yarp.get_orientation()


def test_the_first_mode_is_checked_like_every_other(device):
    with pytest.raises(CommandError, match="FakeHaptic takes forces, no joint torques"):
        IHapticDevice(device, "joint")
    for mode in ("nonsense", "", 1):
        with pytest.raises(OptionError, match=r"^force_mode: .* one of cartesian, joint"):
            IHapticDevice(device, mode)
    assert IHapticDevice(device, "cartesian").is_cartesian_force_mode_enabled()
