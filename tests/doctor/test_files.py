"""Findings about files: an error in one hides no finding about the others."""

from cardan.doctor.base import Subject
from cardan.doctor.files import Files, read_files
from tests.doctor.levels_and_codes import levels_and_codes

GOOD = '[robot]\ndriver = "abb_egm"\n'
OPEN = '[robot]\ndriver = "abb_egm"\nlisten_host = "0.0.0.0"\n'
WRONG = '[robot]\ndriver = "abb_egm"\nlisten_prot = 1\n'


def look(tmp_path, **files):
    for name, text in files.items():
        (tmp_path / f"{name}.toml").write_text(text)
    config, wrong = read_files([tmp_path])
    return config, list(Files.look(Subject((tmp_path,), config, wrong)))


def test_no_file():
    config, wrong = read_files([])
    assert (config.sessions, wrong) == ({}, "")
    assert levels_and_codes(Files, Files.look(Subject())) == []


def test_files_that_are_fine(tmp_path):
    _, found = look(tmp_path, good=GOOD, web="[servers.rosbridge]\n")
    assert levels_and_codes(Files, found) == [("good", "file"), ("good", "file")]


def test_what_a_driver_warns_of(tmp_path):
    _, found = look(tmp_path, open=OPEN)
    assert levels_and_codes(Files, found) == [("caution", "caution")]
    assert found[0].what.startswith("open: robot: listen_host 0.0.0.0 without controller_host")


def test_a_wrong_file_beside_a_good_one(tmp_path):
    config, found = look(tmp_path, bad=WRONG, good=GOOD)
    assert levels_and_codes(Files, found) == [("failure", "file"), ("good", "file")]
    assert "bad.toml" in found[0].what
    assert "listen_prot" in found[0].what
    assert list(config.sessions) == ["good"]


def test_a_file_that_is_not_there(tmp_path):
    config, wrong = read_files([tmp_path / "none.toml"])
    assert "none.toml" in wrong
    assert not config.sessions
