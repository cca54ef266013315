"""The settings of the simulated libHD: text format, limits, and error messages."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given, strategies as st

from cardan.errors import OptionError, ScriptError
from cardan.types import Vector3
from cardan_omni.peer import (
    FAULTS,
    HandMotion,
    OmniFault,
    OmniSettings,
    Waypoint,
    parse_omni_faults,
)


def lines(settings, word):
    return [line for line in settings.text.splitlines() if line.split()[0] == word]


def test_the_text_of_the_defaults():
    assert OmniSettings().text == (
        "clock real\nseed 0\nrate 1000\npowered calibrated\n"
        'model "PHANTOM Omni"\nmass 0.045\nfriction 0.26\nviscous 0.1\ndroop 0.3\n'
        "thermal 80\ngimbal 1 1 1 0 0 0\ngimbal_noise 5\nhand 0.2 5 200\ngrip 1\n"
        "serial 60907300123\n"
    )


def test_the_text_of_everything(tmp_path):
    settings = OmniSettings(
        virtual=True,
        seed=7,
        rate_hz=500,
        cold=True,
        model="touch",
        serial="12 34",
        device="Left Device",
        gimbal_scale=Vector3(-1.0, -1.0, -1.0),
        gimbal_offset_rad=Vector3(3.14159, -2.35619, -3.14159),
        gripped=False,
        faults=(OmniFault("slow-ticks", 250.0, 2.5), OmniFault("unplug")),
        log=str(tmp_path / "truth.csv"),
    )
    assert lines(settings, "clock") == ["clock virtual"]
    assert lines(settings, "powered") == ["powered cold"]
    assert lines(settings, "model") == ['model "Touch"']
    assert lines(settings, "serial") == ["serial 12 34"]
    assert lines(settings, "device") == ["device Left Device"]
    assert lines(settings, "gimbal") == ["gimbal -1 -1 -1 3.14159 -2.35619 -3.14159"]
    assert lines(settings, "grip") == ["grip 0"]
    assert lines(settings, "fault") == ["fault slow-ticks 250 2.5", "fault unplug 1 0"]
    assert lines(settings, "log") == [f"log {tmp_path / 'truth.csv'}"]


def test_the_noise_of_the_gimbal_is_that_of_the_model_unless_it_is_said():
    assert lines(OmniSettings(model="touch"), "gimbal_noise") == ["gimbal_noise 0"]
    reported = OmniSettings(model="touch", gimbal_noise_lsb=2.5)
    assert lines(reported, "gimbal_noise") == ["gimbal_noise 2.5"]
    with pytest.raises(OptionError, match=r"gimbal_noise_lsb: -1\.0 is not allowed"):
        OmniSettings(gimbal_noise_lsb=-1.0)


def test_a_log_is_written_where_the_settings_were_made(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert lines(OmniSettings(log="truth.csv"), "log") == [f"log {tmp_path / 'truth.csv'}"]


def test_waypoints_are_sixteen_numbers_each():
    motion = HandMotion(
        (
            Waypoint(0.0),
            Waypoint(
                0.5,
                Vector3(0.01, -0.02, 0.03),
                Vector3(0.1, 0.2, 0.3),
                False,
                2,
                True,
                Vector3(0.0, -1.0, 0.0),
                Vector3(300.0, 0.0, 300.0),
            ),
        ),
        loop_s=2.0,
    )
    settings = OmniSettings(motion=motion)
    assert lines(settings, "waypoint") == [
        "waypoint 0 0 0 0 0 0 0 1 0 0 0 0 0 200 200 200",
        "waypoint 0.5 0.01 -0.02 0.03 0.1 0.2 0.3 0 2 1 0 -1 0 300 0 300",
    ]
    assert lines(settings, "loop") == ["loop 2"]


@given(st.floats(-0.2, 0.2))
def test_a_number_keeps_a_nanometer(x):
    settings = OmniSettings(motion=HandMotion((Waypoint(0.0, Vector3(x, 0.0, 0.0)),)))
    (line,) = lines(settings, "waypoint")
    assert float(line.split()[2]) == pytest.approx(x, abs=1e-9)
    assert "-0 " not in line


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"model": "falcon"}, "it must be one of omni, touch"),
        ({"rate_hz": 100}, "rate_hz: 100 is not allowed; it must be 500 to 2000"),
        ({"mass_kg": float("nan")}, "mass_kg: nan is not allowed; it must be"),
        ({"hand_damping_n_s_m": -1.0}, "hand_damping_n_s_m: -1.0 is not allowed; it must be"),
        ({"seed": -1}, "seed: -1 is not allowed; it must be"),
        ({"serial": "a\nlog /etc/passwd"}, "serial: .* it must be a line of up to 63 bytes"),
        ({"device": "d" * 64}, "it must be a line of up to 63 bytes"),
        ({"faults": (OmniFault("fire"),)}, "there is no fault 'fire'"),
        ({"faults": (OmniFault("slow-ticks", 0.5),)}, "0.5 is not in 1 to 1000"),
        ({"motion": HandMotion((Waypoint(1.0), Waypoint(1.0)))}, "order of time"),
    ],
)
def test_what_is_refused(wrong, words):
    error = OptionError if "it must be" in words else ScriptError
    with pytest.raises(error, match=words):
        OmniSettings(**wrong)


def test_faults_in_words():
    assert parse_omni_faults(["unplug@3", "late-tick", "jitter=50", "slow-ticks=200@1.5"]) == (
        OmniFault("unplug", 1.0, 3.0),
        OmniFault("late-tick", 5.0, 0.0),
        OmniFault("jitter", 50.0, 0.0),
        OmniFault("slow-ticks", 200.0, 1.5),
    )


@pytest.mark.parametrize(
    ("word", "words"),
    [
        ("nonsense", "there are: button-bounce, comm-error"),
        ("unplug=3", "unplug@3 means from 3 s on"),
        ("late-tick=soon", "'soon' is not a number"),
        ("late-tick@soon", "'soon' is not a number"),
        ("late-tick@-1", "cannot begin at -1 s"),
        ("unplug@inf", "cannot begin at inf s"),
        ("late-tick=", "'' is not a number"),
        ("stuck-encoder=4", "4 is not in 1 to 3"),
    ],
)
def test_wrong_faults(word, words):
    with pytest.raises(ScriptError, match=words):
        parse_omni_faults([word])


def test_every_fault_can_be_had_with_its_default():
    faults = parse_omni_faults([switch.name for switch in FAULTS])
    assert [fault.value for fault in faults] == [switch.default for switch in FAULTS]
    settings = dataclasses.replace(OmniSettings(), faults=faults)
    assert len(lines(settings, "fault")) == len(FAULTS) == 14
