"""Packages that colcon builds: written once; rosbags computes the hashes on the wire from them."""

import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from typer.testing import CliRunner

from cardan.bus.message_packages import write_packages
from cardan.cli import app
from cardan.protocols.ros2.interfaces import known_types
from cardan.protocols.ros2.packages import PACKAGES
from cardan.protocols.ros2.type_hash import type_hash
from tests.sweep.operators import own_environment, python_of

WRITTEN = [each for each in known_types() if each.split("/")[0] in PACKAGES]
PARTS = {
    "msg": ("",),
    "srv": ("_Request", "_Response"),
    "action": ("_Goal", "_Result", "_Feedback"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("workspace") / "src"
    write_packages(folder)
    return folder


@pytest.fixture(scope="module")
def store(folder):
    """Return rosbags' own types of Jazzy, extended by the written files: it reads each part of a
    service or an action as a message."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted(folder.glob("*/*/*.*")):
        package, kind, _ = path.relative_to(folder).parts
        texts = re.split(r"^---$", path.read_text(), flags=re.MULTILINE)
        for part, text in zip(PARTS[kind], texts, strict=True):
            name = f"{package}/{kind}/{path.stem}{part}"
            (read,) = get_types_from_msg(text, name).values()
            store.register({name: read})  # rosbags names parts of services differently
    return store


def test_every_definition_is_a_file_that_its_package_builds(folder):
    files = {f"{path.parts[-3]}/{path.parts[-2]}/{path.name}" for path in folder.glob("*/*/*.*")}
    assert files == {f"{each}.{each.split('/')[1]}" for each in WRITTEN}
    for package in PACKAGES:
        build = (folder / package / "CMakeLists.txt").read_text()
        built = {f"{package}/{each}" for each in re.findall(r'^  "(\S+)"$', build, re.MULTILINE)}
        assert built == {each for each in files if each.startswith(f"{package}/")}


def test_a_package_names_all_that_its_files_use(folder):
    needed = {
        "cardan_msgs": {"action_msgs", "geometry_msgs", "std_msgs"},
        "rl_cartesian_control_msgs": {"geometry_msgs", "std_msgs"},
    }
    for package in PACKAGES:
        manifest = ElementTree.parse(folder / package / "package.xml").getroot()
        assert manifest.findtext("name") == package
        assert {each.text for each in manifest.iter("depend")} == needed[package]
        build = (folder / package / "CMakeLists.txt").read_text()
        assert needed[package] <= set(re.findall(r"find_package\((\w+) REQUIRED\)", build))


@pytest.mark.parametrize("name", WRITTEN)
def test_rosbags_computes_of_the_file_the_hash_that_is_on_the_wire(store, name):
    for part in PARTS[name.split("/")[1]]:
        assert store.hash_rihs01(name + part) == type_hash(name + part)


def test_the_command_writes_them_and_says_where(tmp_path):
    reported = CliRunner().invoke(app, ["net", "messages", str(tmp_path / "src")])
    assert reported.exit_code == 0, reported.output
    assert reported.output.split() == [str(tmp_path / "src" / each) for each in PACKAGES]


def test_nothing_is_written_over_nor_beside_what_is_there(tmp_path):
    there = tmp_path / PACKAGES[-1]
    there.mkdir()
    reported = CliRunner().invoke(app, ["net", "messages", str(tmp_path)])
    assert reported.exit_code != 0
    assert f"{there} exists already and is not overwritten" in str(reported.exception)
    assert list(tmp_path.rglob("*")) == [there]


@pytest.mark.matrix
@pytest.mark.parametrize("distribution", ["jazzy", "kilted"])
def test_rosidl_parses_all_that_is_here_and_has_the_same_hashes(distribution, tmp_path):
    root = Path(__file__).parents[2]
    judged = subprocess.run(
        [python_of(distribution), root / "tests" / "rosidl_judge.py"],
        env=own_environment(PYTHONPATH=str(root), TMPDIR=str(tmp_path)),
        stdout=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    assert judged.returncode == 0, judged.stdout
