"""Sessions and devices whose model is of another arm than their driver's robot."""

from __future__ import annotations

import re
from importlib.resources import files

import pytest

from cardan.drivers.sim_arm import SimArm, SimArmOptions
from cardan.drivers.ur_rtde import UrRtde, UrRtdeOptions
from cardan.errors import ConfigurationError
from cardan.gateway.arm.device import CartesianDevice
from cardan.gateway.session.assembly import load_config
from cardan.gateway.session.cautions import cautions
from tests.gateway.session.test_bodies import looked_at

OURS = files("cardan") / "robots"


@pytest.fixture
def session(tmp_path):
    """Write the file of a session."""

    def write(robot, model):
        file = tmp_path / "session.toml"
        file.write_text(f'[robot]\n{robot}\n[arm]\nmodel = "{model}"\n', encoding="utf-8")
        return file

    return write


@pytest.fixture
def own_file(tmp_path):
    """Write the file of a built-in arm with a TCP and limits of its own, and return its path."""

    def write(arm, more=""):
        path = tmp_path / "own.toml"
        text = (OURS / f"{arm}.urdf").read_text(encoding="utf-8")
        (tmp_path / "own.urdf").write_text(text, encoding="utf-8")
        path.write_text(f'urdf = "own.urdf"\n{more}', encoding="utf-8")
        return path

    return write


@pytest.mark.parametrize(
    ("robot", "model", "its"),
    [
        ('driver = "ur_rtde"\nrobot = "ur5e"', "gofa_crb15000_5", "ur5e"),
        ('driver = "ur_rtde"\nrobot = "ur5e"', "ur5", "ur5e"),
        ('driver = "ur_rtde"', "ur5", "ur5e"),
        ('driver = "sim_arm"\nrobot = "ur5"', "gp8", "ur5"),
        ('driver = "sim_arm"\nrobot = "ur5"', "ur5e", "ur5"),
        ('driver = "ros2"\nrobot = "ur5"', "ur5e", "ur5"),
        ('driver = "motoros"\nrobot = "gp8"', "ur5", "gp8"),
        ('driver = "abb_egm"\nmode = "joint"\nrobot = "gofa_crb15000_5"', "gp8", "gofa_crb15000_5"),
    ],
)
def test_the_model_of_another_arm_is_refused(session, robot, model, its):
    file = session(robot, model)
    with pytest.raises(ConfigurationError, match=rf"arm\.model: is '{model}', .*'{its}'"):
        load_config(file)
    (result,) = looked_at(file)
    assert "arm.model" in str(result)
    assert its in str(result)


def test_the_model_of_another_arm_is_refused_by_the_library():
    with pytest.raises(ConfigurationError, match=r"arm: is 'ur5', .*'ur5e'"):
        CartesianDevice(UrRtde(UrRtdeOptions()), arm="ur5")
    with pytest.raises(ConfigurationError, match=r"arm: is 'gp8', .*'ur5'"):
        CartesianDevice(SimArm(SimArmOptions()), arm="gp8")


def test_a_file_of_the_same_arm_is_taken(session, own_file):
    own = own_file("ur5")
    for robot, model in (("ur5", own), (own, "ur5"), (own, own)):
        config = load_config(session(f'driver = "sim_arm"\nrobot = "{robot}"', model))
        assert not [words for words in cautions(config) if "range" in words]


def test_a_robot_without_a_name_takes_any_model(session):
    load_config(session('driver = "abb_egm"\nmode = "joint"', "gofa_crb15000_5"))
    joints = ", ".join(f'"j{number}"' for number in range(6))
    load_config(session(f'driver = "ros2"\nrobot = ""\njoints = [{joints}]', "ur5e"))


@pytest.mark.parametrize("side", ["model", "robot"])
def test_a_file_with_wider_ranges_than_the_robots_is_a_caution(session, own_file, side):
    own = own_file("ur5")
    if side == "model":
        words = cautions(load_config(session('driver = "motoros"\nrobot = "gp8"', own)))
    else:
        words = cautions(load_config(session(f'driver = "sim_arm"\nrobot = "{own}"', "gp8")))
    (said,) = [each for each in words if "range" in each]
    assert re.search(r"^arm: .*shoulder_lift_joint.*gp8", said)
