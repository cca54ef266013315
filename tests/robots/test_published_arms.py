"""Eleven published descriptions as they are, with two lines of TOML: what a user does with one."""

import importlib.metadata

import pytest

pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from tests.published_arms import ARMS, INSTALL, Measured, robots

pytestmark = pytest.mark.matrix

try:
    robots()
except importlib.metadata.PackageNotFoundError:
    pytest.skip(INSTALL, allow_module_level=True)


@pytest.fixture(scope="module", params=ARMS, ids=lambda published: published.name)
def measured(request, tmp_path_factory):
    return Measured(request.param, tmp_path_factory.mktemp("arms"))


def test_home_is_free_and_bent(measured):
    assert measured.room_m > 0.005
    assert measured.singular_value > 0.05


def test_forward_kinematics_are_those_of_the_whole_tree(measured):
    assert measured.forward_error_m() < 1e-9


def test_the_inverse_of_reachable_poses_is_found(measured):
    assert measured.inverse_share() >= 0.99


@pytest.mark.timeout(600)
def test_lines_of_five_centimetres(measured):
    ended = measured.lines()
    assert sum(not why for why in ended.values()) >= 4, ended


def test_a_joint_motion_arrives(measured):
    assert measured.joint_motion() < 1e-3


@pytest.mark.timeout(600)
def test_jogging(measured):
    assert len(measured.jogged()) >= 4
