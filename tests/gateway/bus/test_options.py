"""Options of a session on the network: refused values, and the error messages."""

import pytest

from cardan.errors import OptionError
from cardan.gateway.bus.compatibility import ServoScales
from cardan.gateway.bus.options import NetworkOptions


def test_servo_scales_are_servos_own_unless_reported():
    assert NetworkOptions().servo_scales == ServoScales(True, 0.4, 0.8, 0.5)
    options = NetworkOptions(
        servo_units="speed", servo_linear_m_s=0.1, servo_angular_rad_s=0.2, servo_joint_rad_s=0.3
    )
    assert options.servo_scales == ServoScales(False, 0.1, 0.2, 0.3)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("other_names", ["ros_control"], "servo"),
        ("servo", "", "words of letters"),
        ("servo", "a/b", "words of letters"),
        ("servo_units", "m/s", "unitless"),
        ("servo_linear_m_s", 0.0, "0.0001 to 5"),
        ("base_frame", "", "the name of a frame"),
        ("tcp_frame", "base_link", "another name than base_frame"),
        ("source", "device", "is the device"),
        ("name", "two words", "words of letters"),
        ("name", "", "words of letters"),
        ("name", "a/b", "without slashes"),
        ("namespace", "a/b", "without slashes"),
        ("trajectory_controller", "", "words of letters"),
    ],
)
def test_what_is_not_allowed_is_refused_by_key(key, value, words):
    with pytest.raises(OptionError, match=key) as caught:
        NetworkOptions(**{key: value})
    assert words in str(caught.value)


def test_a_frame_may_have_any_name_and_the_other_names_be_none():
    options = NetworkOptions(base_frame="left/base", tcp_frame="left/tcp", other_names=())
    assert options.other_names == ()
