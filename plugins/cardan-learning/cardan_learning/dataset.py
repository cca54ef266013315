"""Writes a LeRobotDataset v3.0 without LeRobot: numbers only, no videos.

Layout and columns as LeRobot 0.4 to 0.6 write and read them (lerobot/datasets); quantiles are
exact, while LeRobot's own come from a histogram.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from cardan.common.extras import missing_extra
from cardan.errors import CaptureError

CODEBASE_VERSION = "v3.0"
CHUNKS_SIZE, DATA_FILE_MB, VIDEO_FILE_MB = 1000, 100, 200
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)

OWN_FEATURES: Mapping[str, str] = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Columns of every frame besides the exported features, each a single number."""

Rows = Sequence[Sequence[float]]


def vector_feature(names: Sequence[str]) -> dict[str, Any]:
    """Return a data set's description of a vector of named numbers."""
    return {"dtype": "float32", "shape": (len(names),), "names": list(names)}


def write_dataset(
    folder: Path,
    episodes: Sequence[Mapping[str, Rows]],
    features: Mapping[str, Mapping[str, Any]],
    *,
    fps: int,
    task: str,
    robot_type: str,
) -> None:
    """Write episodes, each the rows of `features` by name, to a new folder. Raises CaptureError,
    ExtraMissingError."""
    try:
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise missing_extra("a data set", "pyarrow", "lerobot", error) from error
    try:
        folder.mkdir(parents=True)
        _Writer(folder, features, fps, task, robot_type).write(episodes)
    except OSError as error:
        raise CaptureError(f"{folder} cannot be written: {error.strerror or error}") from None


class _Writer:
    def __init__(
        self,
        folder: Path,
        features: Mapping[str, Mapping[str, Any]],
        fps: int,
        task: str,
        robot_type: str,
    ) -> None:
        import pyarrow as pa

        self._folder, self._features, self._fps = folder, features, fps
        self._task, self._robot_type = task, robot_type
        vectors = [
            (name, pa.list_(pa.float32(), feature["shape"][0]))
            for name, feature in features.items()
        ]
        own = [(name, getattr(pa, dtype)()) for name, dtype in OWN_FEATURES.items()]
        self._schema = pa.schema([*vectors, *own])

    def write(self, episodes: Sequence[Mapping[str, Rows]]) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        described: list[dict[str, Any]] = []
        columns: dict[str, list[list[float]]] = {}
        """Columns of all episodes, each number of each feature, for the statistics."""
        index = size = file_index = 0
        parquet: Any = None
        try:
            for number, episode in enumerate(episodes):
                rows = self._with_own(episode, number, index)
                table = pa.table(rows, self._schema)
                if parquet is not None and size + table.nbytes > DATA_FILE_MB << 20:
                    parquet.close()
                    parquet, size, file_index = None, 0, file_index + 1
                place = _place(file_index)
                if parquet is None:
                    parquet = pq.ParquetWriter(self._path(DATA_PATH, place), self._schema)
                parquet.write_table(table)
                size += table.nbytes
                length = table.num_rows
                own = {name: list(_columns(rows[name])) for name in rows}
                for name, found in own.items():
                    retained = columns.setdefault(name, [[] for _ in found])
                    for whole, more in zip(retained, found, strict=True):
                        whole += more
                described.append(
                    {
                        "episode_index": number,
                        "tasks": [self._task],
                        "length": length,
                        **{f"data/{key}": value for key, value in place.items()},
                        "dataset_from_index": index,
                        "dataset_to_index": index + length,
                        **_flat({name: statistics_of(found) for name, found in own.items()}),
                        **{f"meta/episodes/{key}": value for key, value in _place(0).items()},
                    }
                )
                index += length
        finally:
            if parquet is not None:
                parquet.close()
        pq.write_table(pa.Table.from_pylist(described), self._path(EPISODES_PATH, _place(0)))
        self._write_tasks()
        stats = {name: statistics_of(found) for name, found in columns.items()}
        self._write_json("meta/stats.json", stats)
        self._write_json("meta/info.json", self._info(len(described), index))

    def _with_own(
        self, episode: Mapping[str, Rows], number: int, index: int
    ) -> dict[str, Sequence[Any]]:
        length = len(next(iter(episode.values())))
        return {
            **{name: episode[name] for name in self._features},
            "timestamp": [frame / self._fps for frame in range(length)],
            "frame_index": list(range(length)),
            "episode_index": [number] * length,
            "index": list(range(index, index + length)),
            "task_index": [0] * length,
        }

    def _info(self, episodes: int, frames: int) -> dict[str, Any]:
        own = {
            name: {"dtype": dtype, "shape": (1,), "names": None}
            for name, dtype in OWN_FEATURES.items()
        }
        return {
            "codebase_version": CODEBASE_VERSION,
            "robot_type": self._robot_type,
            "total_episodes": episodes,
            "total_frames": frames,
            "total_tasks": 1,
            "chunks_size": CHUNKS_SIZE,
            "data_files_size_in_mb": DATA_FILE_MB,
            "video_files_size_in_mb": VIDEO_FILE_MB,
            "fps": self._fps,
            "splits": {"train": f"0:{episodes}"},
            "data_path": DATA_PATH,
            "video_path": None,
            "features": {**self._features, **own},
        }

    def _write_tasks(self) -> None:
        """Write the tasks as the index of a pandas table, described in the file's metadata."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        index = "__index_level_0__"
        column = {"field_name": "task_index", "name": "task_index", "pandas_type": "int64"}
        tasks = {"field_name": index, "name": None, "pandas_type": "unicode"}
        described = {
            "index_columns": [index],
            "column_indexes": [],
            "columns": [
                {**column, "numpy_type": "int64", "metadata": None},
                {**tasks, "numpy_type": "object", "metadata": None},
            ],
        }
        table = pa.table({"task_index": pa.array([0], pa.int64()), index: [self._task]})
        table = table.replace_schema_metadata({b"pandas": json.dumps(described).encode()})
        pq.write_table(table, self._path("meta/tasks.parquet", {}))

    def _write_json(self, name: str, value: Any) -> None:
        text = json.dumps(value, indent=4, ensure_ascii=False, allow_nan=False)
        self._path(name, {}).write_text(text + "\n", encoding="utf-8")

    def _path(self, pattern: str, place: Mapping[str, int]) -> Path:
        path = self._folder / pattern.format(**place)
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


def _place(file: int) -> dict[str, int]:
    """Return the chunk of a file and its number in the chunk."""
    return {"chunk_index": file // CHUNKS_SIZE, "file_index": file % CHUNKS_SIZE}


def _columns(rows: Sequence[Any]) -> Iterator[list[float]]:
    """Return the numbers of rows by their index."""
    if isinstance(rows[0], (int, float)):
        yield list(rows)
    else:
        yield from map(list, zip(*rows, strict=True))


def statistics_of(columns: Sequence[Sequence[float]]) -> dict[str, list[float]]:
    """Return minimum, maximum, mean, deviation, quantiles and count of each column."""
    ordered = [sorted(column) for column in columns]
    means = [math.fsum(column) / len(column) for column in columns]
    return {
        "min": [float(column[0]) for column in ordered],
        "max": [float(column[-1]) for column in ordered],
        "mean": means,
        "std": [
            math.sqrt(math.fsum((each - mean) ** 2 for each in column) / len(column))
            for column, mean in zip(columns, means, strict=True)
        ],
        "count": [len(ordered[0])],
        **{
            f"q{round(100 * share):02d}": [_quantile(column, share) for column in ordered]
            for share in QUANTILES
        },
    }


def _quantile(ordered: Sequence[float], share: float) -> float:
    whole, rest = divmod(share * (len(ordered) - 1), 1.0)
    before, after = ordered[int(whole)], ordered[min(int(whole) + 1, len(ordered) - 1)]
    return before + rest * (after - before)


def _flat(stats: Mapping[str, Mapping[str, list[float]]]) -> dict[str, list[float]]:
    return {
        f"stats/{name}/{key}": numbers
        for name, each in stats.items()
        for key, numbers in each.items()
    }
