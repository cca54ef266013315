"""The files of a LeRobotDataset v3.0 written by Cardan without LeRobot, read with pyarrow and
pandas' rules; test_learning_reading.py reads them with LeRobot."""

import json
import statistics

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from cardan.errors import CaptureError
from cardan_learning import dataset
from cardan_learning.dataset import statistics_of, vector_feature, write_dataset

FEATURES = {
    "observation.state": vector_feature(["a.pos", "b.pos", "gripper.pos"]),
    "action": vector_feature(["ee.x", "ee.gripper_pos"]),
}
EPISODES = [
    {
        "observation.state": [(0.1 * n + e, 1.0, 100.0) for n in range(10 + e)],
        "action": [(float(n), 0.0) for n in range(10 + e)],
    }
    for e in range(3)
]
LENGTHS = [10, 11, 12]


@pytest.fixture
def written(tmp_path):
    folder = tmp_path / "set"
    write_dataset(folder, EPISODES, FEATURES, fps=20, task="lift it", robot_type="cardan")
    return folder


def test_the_files_are_those_of_v3(written):
    assert sorted(str(each.relative_to(written)) for each in written.rglob("*.*")) == [
        "data/chunk-000/file-000.parquet",
        "meta/episodes/chunk-000/file-000.parquet",
        "meta/info.json",
        "meta/stats.json",
        "meta/tasks.parquet",
    ]


def test_info(written):
    info = json.loads((written / "meta/info.json").read_text())
    features = info.pop("features")
    assert info == {
        "codebase_version": "v3.0",
        "robot_type": "cardan",
        "total_episodes": 3,
        "total_frames": 33,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": 20,
        "splits": {"train": "0:3"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
    }
    assert features["action"] == {
        "dtype": "float32",
        "shape": [2],
        "names": ["ee.x", "ee.gripper_pos"],
    }
    own = {"timestamp": "float32"} | dict.fromkeys(
        ("frame_index", "episode_index", "index", "task_index"), "int64"
    )
    for name, dtype in own.items():
        assert features.pop(name) == {"dtype": dtype, "shape": [1], "names": None}
    assert list(features) == ["observation.state", "action"]


def test_frames(written):
    table = pq.read_table(written / "data/chunk-000/file-000.parquet")
    assert table.schema.field("observation.state").type == pa.list_(pa.float32(), 3)
    assert table.schema.field("timestamp").type == pa.float32()
    assert table.schema.field("index").type == pa.int64()
    rows = table.to_pylist()
    assert [row["index"] for row in rows] == list(range(33))
    assert [row["episode_index"] for row in rows] == [0] * 10 + [1] * 11 + [2] * 12
    assert rows[10]["timestamp"] == 0.0
    assert rows[12]["timestamp"] == pytest.approx(0.1)
    assert rows[12]["frame_index"] == 2
    assert rows[12]["observation.state"] == pytest.approx([1.2, 1.0, 100.0])
    assert {row["task_index"] for row in rows} == {0}


def test_episodes(written):
    rows = pq.read_table(written / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [row["length"] for row in rows] == LENGTHS
    assert [row["dataset_from_index"] for row in rows] == [0, 10, 21]
    assert [row["dataset_to_index"] for row in rows] == [10, 21, 33]
    for number, row in enumerate(rows):
        assert row["episode_index"] == number
        assert row["tasks"] == ["lift it"]
        for place in ("data/chunk_index", "data/file_index"):
            assert row[place] == row[f"meta/episodes/{place.partition('/')[2]}"] == 0
        assert row["stats/action/max"] == [9.0 + number, 0.0]
        assert row["stats/action/count"] == [LENGTHS[number]]
        assert len(row["stats/observation.state/q50"]) == 3


def test_tasks_are_the_index_of_a_table_of_pandas(written):
    table = pq.read_table(written / "meta/tasks.parquet")
    described = json.loads(table.schema.metadata[b"pandas"])
    (index,) = described["index_columns"]
    assert table.column(index).to_pylist() == ["lift it"]
    assert table.column("task_index").to_pylist() == [0]
    assert {each["field_name"] for each in described["columns"]} == {index, "task_index"}


def test_statistics(written):
    stats = json.loads((written / "meta/stats.json").read_text())
    assert stats.keys() == {
        *("observation.state", "action", "timestamp"),
        *("frame_index", "episode_index", "index", "task_index"),
    }
    action = [each for length in LENGTHS for each in range(length)]
    found = stats["action"]
    assert found["count"] == [33]
    assert (found["min"], found["max"]) == ([0.0, 0.0], [11.0, 0.0])
    assert found["mean"][0] == pytest.approx(statistics.fmean(action))
    assert found["std"][0] == pytest.approx(statistics.pstdev(action))
    quantiles = statistics.quantiles(action, n=100, method="inclusive")
    for percent in (1, 10, 50, 90, 99):
        assert found[f"q{percent:02d}"][0] == pytest.approx(quantiles[percent - 1])


def test_statistics_of_one_number():
    found = statistics_of([[2.0]])
    assert found.pop("count") == [1]
    assert found.pop("std") == [0.0]
    assert set(map(tuple, found.values())) == {(2.0,)}


def test_a_file_that_is_full_is_followed_by_another_one(tmp_path, monkeypatch):
    monkeypatch.setattr(dataset, "DATA_FILE_MB", 0)
    monkeypatch.setattr(dataset, "CHUNKS_SIZE", 2)
    folder = tmp_path / "set"
    write_dataset(folder, EPISODES, FEATURES, fps=20, task="", robot_type="cardan")
    found = sorted(str(each.relative_to(folder)) for each in (folder / "data").rglob("*.parquet"))
    assert found == [
        "data/chunk-000/file-000.parquet",
        "data/chunk-000/file-001.parquet",
        "data/chunk-001/file-000.parquet",
    ]
    rows = pq.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(row["data/chunk_index"], row["data/file_index"]) for row in rows] == [
        *((0, 0), (0, 1), (1, 0)),
    ]


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CaptureError, match="cannot be written"):
        write_dataset(
            tmp_path / "file" / "set", EPISODES, FEATURES, fps=20, task="", robot_type="cardan"
        )


def test_numbers_are_finite_in_its_json(written):
    for name in ("info", "stats"):
        text = (written / "meta" / f"{name}.json").read_text()
        json.loads(text, parse_constant=lambda word: pytest.fail(word))
