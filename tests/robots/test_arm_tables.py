"""Tables of arms, for programs without Pinocchio and for a load in milliseconds."""

from __future__ import annotations

import json
import subprocess
import sys
import time

import pytest

from cardan.common.cache import content_key
from cardan.errors import ConfigurationError
from cardan.robots import arm_names, load_arm
from cardan.robots.arm_loader import FOLDER, our_texts
from cardan.robots.arm_table import from_table, to_table

OWN = '<robot name="own"><link name="a"/><link name="b"/><joint name="j" type="revolute">' + (
    '<parent link="a"/><child link="b"/><limit lower="-1" upper="1" velocity="3" effort="0"/>'
    "</joint></robot>"
)


@pytest.mark.parametrize("name", arm_names())
def test_the_table_beside_an_arm_is_what_pinocchio_reads(name):
    texts, table = our_texts(name), (FOLDER / f"{name}.json").read_text(encoding="utf-8")
    there = from_table(table, content_key(texts.texts), texts.urdf)
    assert there is not None, "make arm-tables rewrites it"
    made = texts.build()
    # Other builds of Pinocchio may round otherwise.
    assert parts(there) == pytest.approx(parts(made), abs=1e-12)
    assert parts(load_arm(name)) == parts(there)


def test_there_is_a_table_for_each_arm_and_none_else():
    assert {path.stem for path in FOLDER.glob("*.json")} == set(arm_names())


def parts(value):
    """Return all parts of a table in one list."""
    if isinstance(value, frozenset):
        value = sorted(value)
    if isinstance(value, tuple):
        return [each for part in value for each in parts(part)]
    return [value if isinstance(value, (int, float)) else repr(value)]


def test_a_table_holds_all_of_a_model_exactly():
    for name in arm_names():
        arm = our_texts(name).build()
        for urdf in (arm.urdf, "another"):
            assert from_table(to_table(arm, "k", urdf), "k", urdf) == arm


def changed(**parts_):
    arm = load_arm("ur5")
    table = {**json.loads(to_table(arm, "k", arm.urdf)), **parts_}
    return json.dumps(table)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "null",
        "{}",
        '{"of": "k"}',
        "[" * 100_000,
        changed(of="l"),
        changed(name=3),
        changed(joints=[["j"]]),
        changed(joints=None),
        changed(home=["x"]),
        changed(home=None),
        changed(tcp=[[0, 0], [1, 0, 0, 0], "base"]),
        changed(tcp=[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], "nowhere"]),
        changed(task={"axes": "moon"}),
        changed(shapes=[["a", 0, [1.0]]]),
        changed(ignored_pairs=[[0]]),
    ],
)
def test_a_table_that_is_none_counts_as_none(text):
    assert from_table(text, "k", "") is None


@pytest.fixture
def own(tmp_path, monkeypatch):
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "cache"))
    path = tmp_path / "own.urdf"
    path.write_text(OWN, encoding="utf-8")
    load_arm.cache_clear()
    return path


def stored(path):
    return list((path.parent / "cache" / "arms").iterdir())


def again(path):
    load_arm.cache_clear()
    return load_arm(str(path))


def test_what_was_read_is_kept_until_a_file_changes(own, monkeypatch):
    arm = load_arm(str(own))
    (file,) = stored(own)
    with monkeypatch.context() as patched:
        patched.setattr("cardan.robots.arm_loader._build", None)
        assert again(own) == arm
    own.write_text(OWN.replace('velocity="3"', 'velocity="2"'), encoding="utf-8")
    assert again(own).velocity == (2.0,)
    assert len(stored(own)) == 2
    assert file in stored(own)


@pytest.mark.parametrize("damage", ["", "{", "null", '{"of": "x"}', "\0"])
def test_a_damaged_file_of_the_cache_is_written_anew(own, damage):
    arm = load_arm(str(own))
    (file,) = stored(own)
    good = file.read_text(encoding="utf-8")
    file.write_text(damage, encoding="utf-8")
    assert again(own) == arm
    assert stored(own) == [file]
    assert file.read_text(encoding="utf-8") == good


def test_without_a_folder_for_the_cache_arms_load(own, monkeypatch):
    (own.parent / "file").write_text("")
    monkeypatch.setenv("CACHE_DIRECTORY", str(own.parent / "file"))
    assert again(own).joint_names == ("j",)
    for name in ("CACHE_DIRECTORY", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, "")
    monkeypatch.setenv("HOME", "nowhere")
    assert again(own).joint_names == ("j",)


def test_errors_are_not_kept(own):
    own.write_text(OWN.replace('velocity="3"', ""), encoding="utf-8")
    for _ in range(2):
        with pytest.raises(ConfigurationError, match="no velocity"):
            again(own)


LIGHT = """
import sys, time
sys.modules.update(dict.fromkeys(("numpy", "pinocchio", "coal", "eigenpy", "daqp")))
from cardan.errors import ExtraMissingError
from cardan.robots import arm_names, load_arm
names = arm_names()
assert all(load_arm(name).limits for name in names)
start = time.thread_time()
for file in sys.argv[1:]:
    try:
        print(load_arm(file).joint_names)
    except ExtraMissingError as error:
        print(error)
print(time.thread_time() - start)
"""


def test_without_pinocchio_our_arms_load_and_those_that_it_has_read(own):
    load_arm(str(own))
    other = own.parent / "other.urdf"
    other.write_text(OWN.replace('"own"', '"other"'), encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-c", LIGHT, str(own), str(other)],
        capture_output=True,
        text=True,
        check=True,
    )
    there, missing, took_s = done.stdout.splitlines()
    assert there == "('j',)"
    assert missing.endswith('pip install "cardan[arm]"')
    assert float(took_s) < 0.3


def test_a_file_whose_table_is_kept_is_loaded_fast(own):
    load_arm(str(own))
    start = time.thread_time()
    again(own)
    assert time.thread_time() - start < 0.3
