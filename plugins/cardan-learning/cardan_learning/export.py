"""Exports records as LeRobot data sets for robot learning, by LeRobot's own program if it is
installed."""

from __future__ import annotations

import importlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cardan.common.resource_errors import shortage
from cardan.errors import CaptureError, OptionError
from cardan.recording.arms import NS
from cardan_learning.dataset import (
    CODEBASE_VERSION,
    Rows,
    vector_feature,
    write_dataset,
)
from cardan_learning.resample import LONGEST_FILL_S, Frames, read_frames

OBSERVATION, ACTION = "observation.state", "action"
ROBOT_TYPE = "cardan"
"""Name of Cardan's arms as robots of LeRobot."""

REFERENCE_PATH = "meta/cardan.json"
"""File beside LeRobot's own, which ignores it: the reference of rotation vectors, rad, and the
model of its home pose."""

MOST_FPS = 1000
MOST_GAPS = 5
"""Most problems of an episode that are reported one by one."""


@dataclass
class ExportReport:
    """Contents and problems of an export."""

    folder: Path
    frames: Frames
    writer: str
    """Name of the program that wrote the data set."""

    @property
    def complete(self) -> bool:
        """True if nothing was left out or missing."""
        return not self.frames.problems and not any(each.gaps for each in self.frames.episodes)

    def lines(self) -> list[str]:
        """Return the report as text."""
        fps = self.frames.fps
        said = []
        for number, episode in enumerate(self.frames.episodes):
            count = len(episode.actions)
            said.append(
                f"episode {number}: {episode.record.name}: {count} frames, {count / fps:.1f} s"
            )
            for gap in episode.gaps[:MOST_GAPS]:
                at_s = (gap.at_ns - episode.began_ns) / NS
                said.append(
                    f"  {gap.what}: nothing for {gap.long_ns / NS:.2f} s from {at_s:.2f} s on, "
                    "the values before it are held"
                )
            if len(episode.gaps) > MOST_GAPS:
                said.append(f"  and {len(episode.gaps) - MOST_GAPS} more gaps")
        said += self.frames.problems
        total = sum(len(each.actions) for each in self.frames.episodes)
        said.append(
            f"{self.folder}: {len(self.frames.episodes)} episodes, {total} frames at {fps} a "
            f"second, LeRobotDataset {CODEBASE_VERSION}, written by {self.writer}"
        )
        return said


def export_lerobot(
    records: Sequence[Path],
    folder: Path,
    *,
    fps: int = 30,
    task: str = "",
    repo_id: str = "",
    arm: str = "",
    each_engagement: bool = False,
    longest_gap_s: float = LONGEST_FILL_S,
    by_lerobot: bool = True,
) -> ExportReport:
    """Write records as a LeRobotDataset into a new folder.

    Observed are joints, TCP and gripper; the action is the commanded pose of the TCP and the
    gripper's command. `longest_gap_s`: longest time without a state that is filled; a longer one
    ends an episode. `repo_id`: LeRobot's name for it; empty: by the folder's name. `by_lerobot`:
    by LeRobot's own program, where it is installed and writes that version. Raises CaptureError,
    OptionError, ExtraMissingError.
    """
    if not 0 < fps <= MOST_FPS:
        raise OptionError("--fps", fps, f"1 to {MOST_FPS} frames a second")
    if not longest_gap_s > 0.0:
        raise OptionError("--longest-gap", longest_gap_s, "a number above 0")
    if os.path.lexists(folder):
        raise CaptureError(f"{folder} exists: choose another name, or delete it")
    frames = read_frames(
        records, fps, arm=arm, each_engagement=each_engagement, longest_gap_s=longest_gap_s
    )
    features = {
        OBSERVATION: vector_feature(frames.observation_names),
        ACTION: vector_feature(frames.action_names),
    }
    episodes = [{OBSERVATION: each.observations, ACTION: each.actions} for each in frames.episodes]
    task = task or "teleoperation"
    lerobot, why_not = _lerobot() if by_lerobot else (None, "as asked")
    if lerobot is None:
        write_dataset(folder, episodes, features, fps=fps, task=task, robot_type=ROBOT_TYPE)
        _write_reference(folder, frames)
        return ExportReport(folder, frames, f"Cardan ({why_not})")
    name = repo_id or f"cardan/{folder.name}"
    _write_by_lerobot(lerobot, folder, episodes, features, fps, task, name)
    _write_reference(folder, frames)
    version = getattr(importlib.import_module("lerobot"), "__version__", "")
    return ExportReport(folder, frames, f"LeRobot {version}".strip())


def _write_reference(folder: Path, frames: Frames) -> None:
    """Write the reference of rotation vectors, which LeRobot's own files have no field for."""
    table = {"model": frames.model, "rotation_vector_reference": frames.written.reference}
    path = folder / REFERENCE_PATH
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(table) + "\n", encoding="utf-8")
    except OSError as error:
        raise CaptureError(f"{path} cannot be written: {error.strerror or error}") from None


def _lerobot() -> tuple[Any, str]:
    """Return the module with LeRobot's class of data sets; or None and why it is not used."""
    try:
        importlib.import_module("lerobot")
        package = importlib.import_module("lerobot.datasets")
        module = importlib.import_module("lerobot.datasets.lerobot_dataset")
    except Exception as error:  # Its own imports may fail with any error.
        if shortage(error):
            raise
        missing = isinstance(error, ModuleNotFoundError) and error.name == "lerobot"
        why = "LeRobot is not installed" if missing else f"LeRobot cannot be imported: {error}"
        return None, why
    # 0.4 has it in the module, 0.6 in the package.
    version = getattr(module, "CODEBASE_VERSION", getattr(package, "CODEBASE_VERSION", None))
    if version != CODEBASE_VERSION:
        return None, f"the LeRobot that is installed writes version {version}"
    return module, ""


def _write_by_lerobot(
    lerobot: Any,
    folder: Path,
    episodes: Sequence[Mapping[str, Rows]],
    features: Mapping[str, Any],
    fps: int,
    task: str,
    repo_id: str,
) -> None:
    torch: Any = importlib.import_module("torch")
    dataset = lerobot.LeRobotDataset.create(
        repo_id=repo_id,
        fps=fps,
        features=dict(features),
        root=folder,
        robot_type=ROBOT_TYPE,
        use_videos=False,
    )
    for episode in episodes:
        for rows in zip(*episode.values(), strict=True):
            vectors = (torch.tensor(row, dtype=torch.float32) for row in rows)
            dataset.add_frame({**dict(zip(episode, vectors, strict=True)), "task": task})
        dataset.save_episode()
    dataset.finalize()
