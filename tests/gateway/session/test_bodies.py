"""Arms whose links have no body, beside obstacles: what the session and the doctor say."""

from __future__ import annotations

import json
import re
from importlib.resources import files

import pytest

from cardan.doctor.base import Subject
from cardan.doctor.files import Files, read_files
from cardan.drivers.sim_arm import SimArm, SimArmOptions
from cardan.errors import ConfigurationError
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.arm.verbs import ArmVerbs
from cardan.gateway.kinematics.collision import Obstacle
from cardan.gateway.session.assembly import cautions, load_config
from cardan.gateway.session.surroundings import surroundings
from cardan.robots import Box, load_arm
from cardan.types import Vector3
from tests.doctor.told import told

SAID = "6 of 6 links have no body: "
BOX = '[[obstacles]]\nname = "box"\nbox = [[0.2, -0.2, 0.0], [0.6, 0.2, 0.4]]\n'
ACCEPTED = "i_accept_links_without_bodies = true\n"


@pytest.fixture
def session(tmp_path):
    """Writes the file of a session whose arm is the UR5 with meshes for bodies."""
    text = (files("cardan") / "robots" / "ur5.urdf").read_text(encoding="utf-8")
    bodies = re.sub(r"<(sphere|cylinder|capsule|box)\b[^>]*/>", '<mesh filename="m"/>', text)
    assert bodies != text
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "bare.urdf").write_text(bodies, encoding="utf-8")
    bare = tmp_path / "arm" / "bare.toml"
    home = "home_deg = [0, -90, -90, -90, 90, 0]\n"
    bare.write_text(f'urdf = "bare.urdf"\ncollision.meshes = "ignore"\n{home}')

    def write(more):
        file = tmp_path / "session.toml"
        file.write_text(
            f'[robot]\ndriver = "sim_arm"\nrobot = "ur5"\n[arm]\nmodel = "{bare}"\n{more}'
        )
        return file

    return write


def test_obstacles_that_would_stop_nothing_are_refused(session):
    with pytest.raises(ConfigurationError, match=rf"arm\.model: {SAID}.*{ACCEPTED[:-8]}"):
        load_config(session(BOX))


@pytest.mark.parametrize("more", ["", ACCEPTED, ACCEPTED + BOX])
def test_what_is_allowed_is_said(session, more):
    config = load_config(session(more))
    (words,) = cautions(config)
    assert words.startswith(f"arm: {SAID}")
    assert json.loads(surroundings(config, rigid=True))["links_without_body"] in words


def test_an_arm_that_avoids_nothing_has_said_so(session):
    assert cautions(load_config(session("collisions = false\n"))) == []


def test_a_singular_home_is_said(session, tmp_path):
    file = session("collisions = false\n")
    bare = tmp_path / "arm" / "bare.toml"
    bare.write_text(bare.read_text().replace("-90, -90, -90", "-90, 0, -90"))
    (words,) = cautions(load_config(file))
    assert words.startswith("arm: its home is singular (0.000)")
    layout, wrong = read_files([file])
    found = list(Files.look(Subject((file,), layout, wrong)))
    assert told(Files, found) == [("caution", "caution")]


def test_the_doctor_says_it(session):
    file = session("")
    layout, wrong = read_files([file])
    found = list(Files.look(Subject((file,), layout, wrong)))
    assert told(Files, found) == [("caution", "caution")]
    assert SAID in found[0].what
    file = session(BOX)
    layout, wrong = read_files([file])
    found = list(Files.look(Subject((file,), layout, wrong)))
    assert ("failure", "file") in told(Files, found)
    assert any(SAID in each.what for each in found)


def test_a_program_is_refused_likewise(session):
    model = load_arm(load_config(session("")).arm.model)
    able = SimArm(SimArmOptions(robot="ur5")).capabilities
    box = [Obstacle("box", Box.between(Vector3(0.2, -0.2, 0.0), Vector3(0.6, 0.2, 0.4)))]
    with pytest.raises(ConfigurationError, match=f"obstacles: {SAID}.*{ACCEPTED[:-8]}"):
        ArmVerbs.alone(model, able, obstacles=box)
    ArmVerbs.alone(model, able)
    accepting = ControllerOptions(i_accept_links_without_bodies=True)
    ArmVerbs.alone(model, able, accepting, obstacles=box)
