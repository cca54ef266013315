"""Published descriptions, unchanged, with a few lines of TOML like a user's.

Cardan's own files of two of them describe the same arms.
"""

import importlib.metadata

import numpy as np
import pytest

pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

import pinocchio as pin

from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.robots import OrientedBox, load_arm
from cardan.robots.arm_bodies import to_se3
from cardan.robots.mesh_files import find_mesh
from cardan.robots.meshes import points_in
from cardan.robots.urdf import read_tree
from tests.published_arms import ARMS, INSTALL, OURS, Measured, folder_of, loading

pytestmark = pytest.mark.matrix

try:
    folder_of("example-robot-data")
except importlib.metadata.PackageNotFoundError:
    pytest.skip(INSTALL.format("example-robot-data"), allow_module_level=True)

ELEVEN = [each for each in ARMS if each.package == "example-robot-data"]


@pytest.fixture(scope="module", params=ARMS, ids=lambda published: published.name)
def measured(request, tmp_path_factory):
    try:
        folder_of(request.param.package)
    except importlib.metadata.PackageNotFoundError:
        pytest.skip(INSTALL.format(request.param.package))
    return Measured(request.param, tmp_path_factory.mktemp("arms"))


@pytest.mark.timeout(600)
@pytest.mark.parametrize("published", ELEVEN, ids=lambda published: published.name)
def test_it_is_loaded_within_seconds_and_from_the_cache_at_once(published, tmp_path):
    took = loading(published, tmp_path)
    assert took.first < 6.0
    assert took.again < 0.3


def test_home_is_free_and_bent(measured):
    assert measured.room_m > 0.005
    assert measured.singular_value > 0.05


def test_forward_kinematics_are_those_of_the_whole_tree(measured):
    assert measured.forward_error_m() < 1e-9


def test_the_inverse_of_reachable_poses_is_found(measured):
    assert measured.inverse_share() >= 0.99


@pytest.mark.timeout(600)
def test_lines_of_five_centimeters(measured):
    ended = measured.lines()
    assert sum(not why for why in ended.values()) >= 4, ended


def test_a_joint_motion_arrives(measured):
    assert measured.joint_motion() < 1e-3


@pytest.mark.timeout(600)
def test_jogging(measured):
    assert len(measured.jogged()) >= 4


@pytest.mark.parametrize("published", OURS, ids=lambda published: published.name)
def test_our_own_file_is_the_published_arm(published, tmp_path):
    found, ours = Measured(published, tmp_path), load_arm(published.name)
    theirs, found.kinematics = found.arm, ArmKinematics(ours)
    assert ours.joint_names == theirs.joint_names
    assert found.forward_error_m() < 1e-9
    for one, other in zip(ours.joints, theirs.joints, strict=True):
        assert (one.lower, one.upper) == (other.lower, other.upper)
        assert (one.velocity, one.effort) == (other.velocity, other.effort)
    # The published last link may be heavier.
    for one, other in zip(ours.inertias[:-1], theirs.inertias, strict=False):
        assert one.mass_kg == other.mass_kg
        assert one.center_m == pytest.approx(other.center_m, abs=1e-9)
        assert one.moments == pytest.approx(other.moments, abs=1e-9)


@pytest.mark.parametrize("published", OURS, ids=lambda published: published.name)
def test_our_own_covers_contain_the_published_meshes(published):
    ours = load_arm(published.name)
    file = published.file
    tree = read_tree(file.read_text(encoding="utf-8"))
    for link in {each.name for each in ours.shapes}:
        points = mesh_points(tree, file, link)
        if (joint := tree.above.get(link)) and joint.name not in ours.joint_names:
            points = placed(joint.element, points)
        shapes = [each.shape for each in ours.shapes if each.name == link]
        assert len(points) > 100
        assert np.any([inside(shape, points) for shape in shapes], axis=0).all(), link


def mesh_points(tree, file, link):
    """Return the corners of all collision meshes of a link, in its frame."""
    found = []
    for collision in tree.links[link].iterfind("collision"):
        path, why = find_mesh(collision.find("geometry/mesh").get("filename"), file)
        assert path, why
        found.append(placed(collision, points_in(path.read_bytes(), path)))
    return np.concatenate(found)


def placed(element, points):
    """Transform points into the frame in which the origin of `element` is given."""
    if (origin := element.find("origin")) is None:
        return points
    xyz, rpy = (np.array(origin.get(key, "0 0 0").split(), dtype=float) for key in ("xyz", "rpy"))
    return points @ pin.rpy.rpyToMatrix(rpy).T + xyz


def inside(shape, points):
    """Return for each point whether it is in a capsule or a box."""
    if isinstance(shape, OrientedBox):
        local = (points - shape.pose.position) @ to_se3(shape.pose).rotation
        return (np.abs(local) <= 0.5 * np.array(shape.size_m)).all(axis=1)
    along, offset = np.subtract(shape.end, shape.start), points - shape.start
    share = np.clip(offset @ along / (along @ along), 0.0, 1.0)
    return np.linalg.norm(offset - share[:, None] * along, axis=1) <= shape.radius_m
