"""Arms whose links have no body, among obstacles: messages of the session and the doctor."""

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
from cardan.gateway.arm.verb_methods import ArmVerbs
from cardan.gateway.kinematics.collision import Obstacle
from cardan.gateway.session.assembly import load_config
from cardan.gateway.session.cautions import cautions
from cardan.gateway.session.scene import scene_of
from cardan.robots import OrientedBox, load_arm
from cardan.types import Vector3
from tests.doctor.levels_and_codes import levels_and_codes

SAID = "6 of 6 links have no body: "
BOX = '[[obstacles]]\nname = "box"\nbox = [[0.2, -0.2, 0.0], [0.6, 0.2, 0.4]]\n'
ACCEPTED = "i_accept_links_without_bodies = true\n"


def looked_at(file):
    """Results of the doctor for a file."""
    layout, wrong = read_files([file])
    return list(Files.look(Subject((file,), layout, wrong)))


@pytest.fixture
def session(tmp_path):
    """Write the file of a session whose arm is the UR5 with meshes as bodies."""
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
    assert json.loads(scene_of(config))["links_without_body"] in words


def test_an_arm_that_avoids_nothing_has_said_so(session):
    assert cautions(load_config(session("collisions = false\n"))) == []


def test_a_singular_home_is_said(session, tmp_path):
    file = session("collisions = false\n")
    bare = tmp_path / "arm" / "bare.toml"
    bare.write_text(bare.read_text().replace("-90, -90, -90", "-90, 0, -90"))
    (words,) = cautions(load_config(file))
    assert words.startswith("arm: its home is singular (0.000)")
    found = looked_at(file)
    assert levels_and_codes(Files, found) == [("caution", "caution")]


def test_the_doctor_says_it(session):
    file = session("")
    found = looked_at(file)
    assert levels_and_codes(Files, found) == [("caution", "caution")]
    assert SAID in found[0].what
    file = session(BOX)
    found = looked_at(file)
    assert ("failure", "file") in levels_and_codes(Files, found)
    assert any(SAID in each.what for each in found)


def test_a_program_is_refused_likewise(session):
    model = load_arm(load_config(session("")).arm.model)
    able = SimArm(SimArmOptions(robot="ur5")).capabilities
    box = [Obstacle("box", OrientedBox.between(Vector3(0.2, -0.2, 0.0), Vector3(0.6, 0.2, 0.4)))]
    with pytest.raises(ConfigurationError, match=f"obstacles: {SAID}.*{ACCEPTED[:-8]}"):
        ArmVerbs.alone(model, able, obstacles=box)
    ArmVerbs.alone(model, able)
    accepting = ControllerOptions(i_accept_links_without_bodies=True)
    ArmVerbs.alone(model, able, accepting, obstacles=box)


@pytest.fixture
def fist(tmp_path):
    """Write the file of a session with a UR5 whose base and upper arm always touch."""

    def write(toml, more=""):
        load_arm.cache_clear()
        (tmp_path / "fist.urdf").write_text(load_arm("ur5").urdf, encoding="utf-8")
        arm = tmp_path / "fist.toml"
        arm.write_text(f'urdf = "fist.urdf"\n{toml}', encoding="utf-8")
        file = tmp_path / "session.toml"
        file.write_text(
            f'[robot]\ndriver = "sim_arm"\nrobot = "ur5"\n[arm]\nmodel = "{arm}"\n{more}'
        )
        return file

    return write


FOLDED = "home_deg = [-90, 100, 120, 60, -120, 100]\n"


def test_bodies_that_overlap_at_home_are_said_with_the_remedy(fist):
    file = fist(FOLDED)
    said = [words for words in cautions(load_config(file)) if "at home" in words]
    assert said
    for words in said:
        names, line = re.search(
            r"at home (.*) overlap by [0-9.]+ mm.*(ignore = \[\[.*\]\])", words
        ).groups()
        assert all(f'"{name}"' in line for name in names.split(" and "))
    lines = [re.search(r"ignore = \[(\[.*\])\]", words)[1] for words in said]
    pasted = fist(f"{FOLDED}[collision]\nignore = [{', '.join(lines)}]\n")
    assert not any("at home" in words for words in cautions(load_config(pasted)))
    assert cautions(load_config(fist(FOLDED, "collisions = false\n"))) == []


def test_an_obstacle_that_the_arm_is_in_at_home_is_said(fist):
    box = BOX.replace("0.2, -0.2, 0.0", "-0.5, -0.5, 0.1")
    file = fist("home_deg = [0, -90, 90, -90, -90, 0]\n", box)
    said = [words for words in cautions(load_config(file)) if "at home" in words]
    assert any("box and " in words and "move the obstacle" in words for words in said)


def test_bodies_that_always_touch_are_said(fist):
    (words, *_) = cautions(load_config(fist("")))
    assert words.startswith("arm: touch in every posture, and are not kept apart: ")
    assert "base_link_inertia and upper_arm_link" in words
