"""`cardan net export`: data sets and reports, written by LeRobot where it is installed."""

import json
import subprocess
import sys
import types

import pytest

from cardan.errors import CaptureError, ExtraMissingError, OptionError
from cardan_learning.export import export_lerobot
from test_learning_resample import recorded, steadily


@pytest.fixture
def record(tmp_path):
    return recorded(tmp_path / "r.mcap", steadily(1.0))


@pytest.fixture
def without_lerobot(monkeypatch):
    monkeypatch.setitem(sys.modules, "lerobot", None)


def test_it_tells_what_it_has_written(record, tmp_path, without_lerobot):
    report = export_lerobot([record], tmp_path / "set", fps=10, task="lift it")
    assert report.complete
    assert report.lines() == [
        "episode 0: r.mcap: 11 frames, 1.1 s",
        f"{tmp_path / 'set'}: 1 episodes, 11 frames at 10 a second, LeRobotDataset v3.0, written "
        "by Cardan (LeRobot is not installed)",
    ]
    info = json.loads((tmp_path / "set/meta/info.json").read_text())
    assert info["features"]["observation.state"]["names"] == [
        *("one.pos", "two.pos", "ee.x", "ee.y", "ee.z", "ee.wx", "ee.wy", "ee.wz", "gripper.pos"),
    ]
    stored = json.loads((tmp_path / "set/meta/cardan.json").read_text())
    assert stored["model"] == ""
    assert stored["rotation_vector_reference"] == pytest.approx([0.0, 0.0, 1.0])


def test_gaps_are_reported_and_make_it_incomplete(tmp_path, without_lerobot):
    times = [each for each in steadily(3.0) if not 1.5 < each < 2.5]
    report = export_lerobot([recorded(tmp_path / "r.mcap", times)], tmp_path / "set", fps=10)
    assert not report.complete
    assert any(
        "joints: nothing for 1.00 s from 0.50 s on, the values before it are held" in line
        for line in report.lines()
    )


def test_what_cannot_be_written_is_refused_before_anything_is(record, tmp_path, without_lerobot):
    folder = tmp_path / "set"
    for fps in (0, -1, 1001):
        with pytest.raises(OptionError, match="--fps"):
            export_lerobot([record], folder, fps=fps)
    with pytest.raises(OptionError, match="--longest-gap"):
        export_lerobot([record], folder, longest_gap_s=0.0)
    assert not folder.exists()
    folder.mkdir()
    with pytest.raises(CaptureError, match="set exists: choose another name, or delete it"):
        export_lerobot([record], folder)
    assert list(folder.iterdir()) == []


def test_without_pyarrow_it_says_what_to_install(record, tmp_path, monkeypatch, without_lerobot):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ExtraMissingError, match=r'pip install "cardan\[lerobot\]"'):
        export_lerobot([record], tmp_path / "set")
    assert not (tmp_path / "set").exists()


class Dataset:
    """Stand-in for the used part of LeRobot's class."""

    made = ()

    @classmethod
    def create(cls, **given):
        self = cls()
        self.given, self.frames, self.saved, self.final = given, [], [], False
        Dataset.made = (*Dataset.made, self)
        return self

    def add_frame(self, frame):
        self.frames.append(frame)

    def save_episode(self):
        self.saved.append(len(self.frames))

    def finalize(self):
        self.final = True


MODULE, PACKAGE = "lerobot.datasets.lerobot_dataset", "lerobot.datasets"


def installed(monkeypatch, version="v3.0", home=MODULE):
    names = ("lerobot", "lerobot.datasets", "lerobot.datasets.lerobot_dataset", "torch")
    modules = {name: types.ModuleType(name) for name in names}
    modules["lerobot"].__version__ = "0.6.1"
    modules[home].CODEBASE_VERSION, modules[MODULE].LeRobotDataset = version, Dataset
    modules["torch"].tensor = lambda row, dtype: (dtype, row)
    modules["torch"].float32 = "float32"
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(Dataset, "made", ())


@pytest.mark.parametrize("home", [MODULE, PACKAGE])  # signatures of LeRobot 0.4 and 0.6
def test_lerobots_own_program_writes_where_it_is_there(record, tmp_path, monkeypatch, home):
    installed(monkeypatch, home=home)
    report = export_lerobot([record, record], tmp_path / "set", fps=10, task="lift it")
    (made,) = Dataset.made
    assert made.given["repo_id"] == "cardan/set"
    assert made.given["root"] == tmp_path / "set"
    assert made.given["fps"] == 10
    assert made.given["features"]["action"]["shape"] == (7,)
    assert (made.saved, made.final) == ([11, 22], True)
    frame = made.frames[0]
    assert frame["task"] == "lift it"
    dtype, row = frame["action"]
    assert (dtype, len(row)) == ("float32", 7)
    assert report.lines()[-1].endswith("written by LeRobot 0.6.1")
    assert (tmp_path / "set/meta/cardan.json").is_file()


def test_a_lerobot_of_another_version_is_not_used_and_that_is_reported(
    record, tmp_path, monkeypatch
):
    installed(monkeypatch, "v2.1")
    report = export_lerobot([record], tmp_path / "set", fps=10)
    assert Dataset.made == ()
    assert (
        "written by Cardan (the LeRobot that is installed writes version v2.1)"
        in report.lines()[-1]
    )


def test_a_lerobot_that_cannot_be_imported_is_reported(record, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "lerobot", types.ModuleType("lerobot"))
    report = export_lerobot([record], tmp_path / "set", fps=10)
    assert "written by Cardan (LeRobot cannot be imported:" in report.lines()[-1]


def test_as_a_program(record, tmp_path):
    def cardan(*words):
        return subprocess.run(
            [sys.executable, "-m", "cardan", "net", "export", *map(str, words)],
            capture_output=True,
            text=True,
            check=False,
        )

    done = cardan(record, "--lerobot", tmp_path / "set", "--fps", "10", "--task", "lift it")
    assert done.returncode == 0, done.stderr
    assert "1 episodes, 11 frames at 10 a second" in done.stdout
    done = cardan(record, "--lerobot", tmp_path / "set")
    assert done.returncode == 2
    assert done.stderr.startswith("cardan: ")
    assert "exists: choose another name" in done.stderr
