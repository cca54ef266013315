"""Teleoperate a simulated GoFa with a simulated SpaceMouse, record episodes and load them.

With LeRobot and the distributions of plugins/, LeRobot's loop runs: its teleoperator, robot and
data set. Without LeRobot, sessions of Cardan are recorded, and `cardan net export` of
plugins/cardan-learning makes the data set.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
FPS = 30
TASK = "move forward and back, up and down"
CARDAN = (sys.executable, "-m", "cardan")
PLUGINS = ("lerobot", "lerobot_teleoperator_cardan", "lerobot_robot_cardan")


def free_port(kind: socket.SocketKind) -> int:
    """Return a port of this computer that is not in use now."""
    with socket.socket(type=kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def served(*words: str) -> Iterator[None]:
    """Run a simulated peer until the end of the context."""
    with subprocess.Popen(
        [*CARDAN, "sim", *words], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            assert process.stdout is not None
            if not process.stdout.readline().startswith("READY"):
                raise SystemExit(f"cardan sim {' '.join(words)} does not serve")
            yield
        finally:
            process.terminate()


@contextlib.contextmanager
def simulated(folder: Path) -> Iterator[Path]:
    """Write the session's file; run its simulated device and robot meanwhile."""
    puck, egm = folder / "spacemouse.sock", free_port(socket.SOCK_DGRAM)
    text = (HERE / "gofa.toml").read_text(encoding="utf-8")
    text = text.replace("spacemouse.sock", str(puck)).replace("6510", str(egm))
    text = text.replace("7447", str(free_port(socket.SOCK_STREAM)))
    session = folder / "session.toml"
    session.write_text(text, encoding="utf-8")
    hand = ("spacemouse", "--hid", str(puck), "--script", str(HERE / "hand.txt"))
    with served(*hand), served("abb-gofa", "--to", f"127.0.0.1:{egm}"):
        yield session


# -- without LeRobot ------------------------------------------------------------------------------


def record_sessions(session: Path, folder: Path, episodes: int, seconds: float) -> Path:
    """Make a record for each episode, and a data set of all."""
    records = [str(folder / f"episode-{number}.mcap") for number in range(episodes)]
    for record in records:
        run = [*CARDAN, "run", str(session), "--record", record, "--seconds", str(seconds)]
        # Exit code 4: a busy computer has missed cycles; the data set has the rest.
        if (code := subprocess.run(run, stdout=subprocess.DEVNULL, check=False).returncode) not in (
            0,
            4,
        ):
            raise SystemExit(code)
    out = folder / "dataset"
    words = ["net", "export", *records, "--lerobot", str(out), "--fps", str(FPS), "--task", TASK]
    subprocess.run([*CARDAN, *words], check=False)
    return out


def load_files(dataset: Path) -> Iterator[tuple[int, list[dict[str, Any]]]]:
    """Return number and frames of each episode, read by pyarrow."""
    import pyarrow.parquet as parquet

    rows: list[dict[str, Any]] = []
    for file in sorted(dataset.glob("data/*/*.parquet")):
        rows += parquet.read_table(file).to_pylist()
    for number in range(1 + max(row["episode_index"] for row in rows)):
        yield number, [row for row in rows if row["episode_index"] == number]


# -- with LeRobot ---------------------------------------------------------------------------------


def record_by_lerobot(session: Path, folder: Path, episodes: int, seconds: float) -> Path:
    """Run LeRobot's loop; the recorded action is the one actually sent."""
    import torch
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from lerobot_robot_cardan import CardanRobot, CardanRobotConfig
    from lerobot_teleoperator_cardan import CardanTeleop, CardanTeleopConfig

    calibration = folder / "calibration"
    robot = CardanRobot(CardanRobotConfig(session=str(session), calibration_dir=calibration))
    teleop = CardanTeleop(CardanTeleopConfig(session=str(session), calibration_dir=calibration))
    names = {"observation.state": robot.observation_features, "action": robot.action_features}
    dataset = LeRobotDataset.create(
        repo_id="cardan/dataset",
        root=folder / "dataset",
        fps=FPS,
        robot_type=robot.name,
        features={
            key: {"dtype": "float32", "shape": (len(each),), "names": list(each)}
            for key, each in names.items()
        },
        use_videos=False,
    )
    with robot, teleop:
        for _ in range(episodes):
            due_s = time.monotonic()
            for _ in range(round(seconds * FPS)):
                seen = robot.get_observation()
                sent = robot.send_action(teleop.get_action())
                numbers = {"observation.state": seen, "action": sent}
                frame = {
                    key: torch.tensor([each[name] for name in names[key]], dtype=torch.float32)
                    for key, each in numbers.items()
                }
                dataset.add_frame({**frame, "task": TASK})
                due_s += 1.0 / FPS
                time.sleep(max(0.0, due_s - time.monotonic()))
            dataset.save_episode()
    dataset.finalize()
    return folder / "dataset"


def load_by_lerobot(folder: Path) -> Iterator[tuple[int, list[dict[str, Any]]]]:
    """Return number and frames of each episode, read by LeRobot."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("cardan/dataset", root=folder)
    for number, episode in enumerate(dataset.meta.episodes):
        frames = range(episode["dataset_from_index"], episode["dataset_to_index"])
        yield number, [dataset[index] for index in frames]


def main() -> None:
    """Record and load the episodes; print what was loaded."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="a new one, for records and the data set")
    parser.add_argument("--episodes", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each episode")
    given = parser.parse_args()
    given.folder.mkdir(parents=True)
    there = all(importlib.util.find_spec(name) for name in PLUGINS)
    record, load = (record_by_lerobot, load_by_lerobot) if there else (record_sessions, load_files)
    with simulated(given.folder) as session:
        out = record(session, given.folder, given.episodes, given.seconds)
    print(f"{out}, recorded by {'LeRobot' if there else 'Cardan'} and loaded again:")
    for number, frames in load(out):
        heights = [float(frame["observation.state"][8]) for frame in frames]
        span_mm = 1e3 * (max(heights) - min(heights))
        print(
            f"  episode {number}: {len(frames)} frames; the TCP went {span_mm:.0f} mm up and down"
        )


if __name__ == "__main__":
    main()
