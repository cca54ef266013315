"""The check of the compiled force loop in `cardan doctor`."""

from cardan.doctor import registry
from cardan.doctor.base import Subject
from cardan.doctor.files import read_files
from cardan_omni import check
from cardan_omni.check import Compiled
from cardan_omni.driver.native import NativeMissingError
from tests.doctor.levels_and_codes import levels_and_codes


def test_the_doctor_looks_at_it():
    assert registry.load("compiled") is Compiled


def test_a_compiled_part_that_is_missing(monkeypatch, tmp_path):
    def missing():
        raise NativeMissingError("the compiled tick x.so is not there: install a compiler")

    assert levels_and_codes(Compiled, Compiled.look(Subject())) in (
        [("good", "compiled")],
        [("caution", "compiled")],
    )
    monkeypatch.setattr(check, "tick_library", missing)
    found = list(Compiled.look(Subject()))
    assert levels_and_codes(Compiled, found) == [("caution", "compiled")]
    assert found[0].what == "the compiled tick x.so is not there"
    file = tmp_path / "omni.toml"
    file.write_text(
        '[device]\ndriver = "omni"\n[mapping]\nmode = "position"\n'
        'deadman = "button_2"\n[robot]\ndriver = "abb_egm"\n'
    )
    config, wrong = read_files([file])
    assert not wrong
    assert levels_and_codes(Compiled, Compiled.look(Subject((file,), config))) == [
        ("failure", "compiled")
    ]
