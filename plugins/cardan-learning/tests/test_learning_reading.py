"""LeRobot loads the data sets that Cardan writes, and writes equal ones itself.

Only `make test-lerobot` runs these, in an environment that has LeRobot.
"""

import importlib
import json

import pytest

from cardan_learning.export import export_lerobot
from test_learning_resample import recorded, steadily

pytest.importorskip("lerobot", reason="LeRobot is not installed: make test-lerobot")

OFTEN = ("mean", "std", "min", "max", "count")


@pytest.fixture
def exported(tmp_path):
    """The folders of the same records, written by Cardan and by LeRobot."""
    records = [
        recorded(tmp_path / f"{n}.mcap", steadily(1.0 + n, first_s=1.0 + n)) for n in range(3)
    ]
    folders = tmp_path / "own", tmp_path / "theirs"
    for folder, by_lerobot in zip(folders, (False, True), strict=True):
        report = export_lerobot(
            records, folder, fps=30, task="lift it", repo_id="cardan/test", by_lerobot=by_lerobot
        )
        assert f"written by {'LeRobot' if by_lerobot else 'Cardan'}" in report.lines()[-1]
    return folders


def test_lerobot_loads_both_alike(exported):
    module = importlib.import_module("lerobot.datasets.lerobot_dataset")
    own, theirs = (module.LeRobotDataset("cardan/test", root=folder) for folder in exported)
    assert (len(own), own.num_episodes, own.fps) == (len(theirs), theirs.num_episodes, 30)
    assert own.num_episodes == 3
    assert own.features == theirs.features
    for index in range(0, len(own), 7):
        a, b = own[index], theirs[index]
        assert a.keys() == b.keys()
        for key in a:
            if key == "task":
                assert a[key] == b[key] == "lift it"
            else:
                assert (a[key].dtype, a[key].shape) == (b[key].dtype, b[key].shape), key
                assert a[key].tolist() == pytest.approx(b[key].tolist())
    for one, other in zip(own.meta.episodes, theirs.meta.episodes, strict=True):
        assert one == other


def test_statistics_agree(exported):
    own, theirs = (json.loads((each / "meta/stats.json").read_text()) for each in exported)
    assert own.keys() == theirs.keys()
    for name in own:
        assert own[name].keys() == theirs[name].keys(), name
        for key in OFTEN:
            assert own[name][key] == pytest.approx(theirs[name][key], rel=1e-4, abs=1e-4), (
                name,
                key,
            )


def test_a_subset_and_neighboring_frames(exported):
    """Access pattern of training."""
    module = importlib.import_module("lerobot.datasets.lerobot_dataset")
    part = module.LeRobotDataset(
        "cardan/test", root=exported[0], delta_timestamps={"action": [0.0, 1 / 30, 2 / 30]}
    )
    assert part[0]["action"].shape == (3, 7)
    assert part[len(part) - 1]["action_is_pad"].tolist() == [False, True, True]
