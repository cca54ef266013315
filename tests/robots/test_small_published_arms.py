"""Three published descriptions from small wheels, unchanged; tested with every change."""

import importlib.metadata

import pytest

pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from tests.published_arms import INSTALL_SMALL, SMALL, Measured, folder_of

UP_AND_DOWN = (2,)


@pytest.fixture(scope="module", params=SMALL, ids=lambda published: published.name)
def measured(request, tmp_path_factory):
    try:
        folder_of(request.param.package)
    except importlib.metadata.PackageNotFoundError:
        pytest.skip(INSTALL_SMALL.format(request.param.package))
    return Measured(request.param, tmp_path_factory.mktemp("arms"))


def test_home_is_free_and_bent(measured):
    assert measured.room_m > 0.005
    assert measured.singular_value > 0.05


def test_forward_kinematics_are_those_of_the_whole_tree(measured):
    assert measured.forward_error_m() < 1e-9


def test_the_inverse_of_reachable_poses_is_found(measured):
    assert measured.inverse_share(poses=100) >= 0.99


def test_lines_of_five_centimeters(measured):
    ended = measured.lines(UP_AND_DOWN)
    assert not any(ended.values()), ended


def test_a_joint_motion_arrives(measured):
    assert measured.joint_motion() < 1e-3


def test_jogging(measured):
    assert measured.jogged(UP_AND_DOWN) == ["+z", "-z"]
