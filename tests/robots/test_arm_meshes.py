"""Arms whose bodies are meshes: fitted covers, and messages about missing files."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cardan.errors import ConfigurationError
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.collision import CollisionModel
from cardan.robots import Capsule, OrientedBox, load_arm
from cardan.spatial import from_euler_zyx, rotate, subtract, transform
from cardan.types import Pose, Vector3

SIZE = (0.2, 0.1, 0.4)
CORNERS = [
    Vector3(x * SIZE[0], y * SIZE[1], z * SIZE[2]) for x in (0, 1) for y in (0, 1) for z in (0, 1)
]
FACES = "124 143 568 587 126 165 378 374 135 157 248 286"
OBJ = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "".join(
    f"f {' '.join(face)}\n" for face in FACES.split()
)
AT = Pose(Vector3(0.1, 0.2, 0.3), from_euler_zyx(0.3, -0.4, 0.5))
MESH = '<mesh filename="package://own_description/{}" scale="1 2 0.5"/>'
ORIGIN = '<origin xyz="0.1 0.2 0.3" rpy="0.3 -0.4 0.5"/>'
BALL = '<collision><geometry><sphere radius="0.01"/></geometry></collision>'
URDF = f"""<robot name="own"><link name="base"/><link name="arm">{BALL}
<collision>{ORIGIN}<geometry>{MESH.format("arm.obj")}</geometry></collision></link>
<link name="hand"/>
<joint name="one" type="revolute"><parent link="base"/><child link="arm"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
<joint name="two" type="revolute"><parent link="arm"/><child link="hand"/>
<origin xyz="0 0 1"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>
</robot>"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Write the file of an arm in a package with its mesh."""
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "cache"))
    package = tmp_path / "own_description"
    (package / "urdf").mkdir(parents=True)
    (package / "arm.obj").write_text(OBJ)
    (package / "urdf" / "own.urdf").write_text(URDF)
    path = package / "urdf" / "own.toml"

    def write(text=""):
        path.write_text(f'urdf = "own.urdf"\n{text}')
        load_arm.cache_clear()
        return str(path)

    return write


def holds(shape, point, slack_m):
    if isinstance(shape, Capsule):
        start, end = np.array(shape.start), np.array(shape.end)
        along = end - start
        share = 0.0
        if along.any():
            share = min(1.0, max(0.0, (np.array(point) - start) @ along / (along @ along)))
        return math.dist(start + share * along, point) <= shape.radius_m + slack_m
    w, x, y, z = shape.pose.orientation
    inside = rotate(
        type(shape.pose.orientation)(w, -x, -y, -z), subtract(point, shape.pose.position)
    )
    return all(
        abs(each) <= 0.5 * size + slack_m for each, size in zip(inside, shape.size_m, strict=True)
    )


@pytest.mark.parametrize("how", ["", "[collision]\nfit = 'coarse'\n"])
def test_a_mesh_is_covered_where_the_link_has_it(own, how):
    arm = load_arm(own(how))
    ball, *cover = arm.shapes
    assert isinstance(ball.shape, Capsule)
    assert {(each.name, each.body) for each in cover} == {("arm", 1)}
    if how:
        assert len(cover) == 1
    for x, y, z in CORNERS:
        corner = transform(AT, Vector3(x, 2.0 * y, 0.5 * z))
        assert any(holds(each.shape, corner, 1e-9) for each in cover)
    # The cover of a box is the box itself.
    (box,) = (each.shape for each in cover)
    assert isinstance(box, OrientedBox)
    assert sorted(box.size_m) == pytest.approx([0.2, 0.2, 0.2], abs=1e-3)
    assert arm.links_without_body().startswith("1 of 2 links have no body: hand")
    CollisionModel(ArmKinematics(arm))


def test_a_mesh_that_is_not_there_is_reported(own, tmp_path):
    (tmp_path / "own_description" / "arm.obj").unlink()
    arm = load_arm(own())
    (words,) = arm.missing_meshes
    assert "mesh 'package://own_description/arm.obj' is not there; looked for: " in words
    assert str(tmp_path / "own_description" / "arm.obj") in words
    assert arm.bare_links == ("arm", "hand")  # the ball covers only a part
    assert arm.links_without_body().endswith(words)


def test_it_is_looked_for_in_given_folders_first(own, tmp_path):
    (tmp_path / "own_description" / "arm.obj").unlink()
    other = tmp_path / "elsewhere" / "own_description"
    other.mkdir(parents=True)
    (other / "arm.obj").write_text(OBJ)
    assert load_arm(own("package_dirs = ['../../elsewhere']\n")).missing_meshes == ()


def test_ignored_meshes_need_no_file_and_are_no_body(own, tmp_path):
    (tmp_path / "own_description" / "arm.obj").unlink()
    arm = load_arm(own("collision.meshes = 'ignore'\n"))
    assert arm.missing_meshes == ()
    assert len(arm.shapes) == 1


def test_a_damaged_mesh_is_an_error_that_names_it(own, tmp_path):
    (tmp_path / "own_description" / "arm.obj").write_text("v 1 2\n")
    with pytest.raises(ConfigurationError, match=r"arm\.obj is damaged"):
        load_arm(own())


def test_another_mesh_is_another_arm_and_the_same_one_is_not_read_again(own, tmp_path, monkeypatch):
    path = own()
    before = load_arm(path)
    with monkeypatch.context() as patched:
        patched.setattr("cardan.robots.arm_loader._build", None)
        load_arm.cache_clear()
        assert load_arm(path) == before
    (tmp_path / "own_description" / "arm.obj").write_text(OBJ.replace("0.4", "0.8"))
    load_arm.cache_clear()
    assert load_arm(path).shapes != before.shapes
