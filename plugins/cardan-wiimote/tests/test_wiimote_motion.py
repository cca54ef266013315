"""Motion scripts of the simulated remote."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, strategies as st

from cardan.errors import ScriptError
from cardan.sim_peers.base import load_script, parse_script
from cardan.sim_peers.scripted import play
from cardan_wiimote.peer import SCRIPT_VERBS, SCRIPTS, ScriptedWiimote, SimulatedWiimote
from cardan_wiimote.protocol import (
    Data,
    DataMode,
    decode_input,
    encode_output,
    roll_and_pitch_rad,
    to_g,
)
from wiimote_virtual import Host

ZERO, ONE = (531, 520, 536), (636, 628, 638)


def attitude_deg(host: Host) -> tuple[float, float, float]:
    roll, pitch, yaw = (round(math.degrees(angle), 6) for angle in host.remote.attitude_rad)
    return roll, pitch, yaw


def test_tilt_ramps_and_stays():
    host = Host("1 tilt 30 -20 10 over 2")
    host.run(1.0)
    assert attitude_deg(host) == (0, 0, 0)
    host.run(1.0)
    assert attitude_deg(host) == pytest.approx((15, -10, 5), abs=0.1)
    host.run(5.0)
    assert attitude_deg(host) == (30, -20, 10)
    assert host.motion.next_due_s == math.inf


def test_swing_returns_and_level_ends_it():
    host = Host("0 swing 20 0 0 over 1 times 2\n0 swing 0 10 0 over 4 phase 90")
    host.run(0.25)
    assert attitude_deg(host)[0] == pytest.approx(20, abs=0.1)
    host.run(0.5)
    assert attitude_deg(host)[0] == pytest.approx(-20, abs=0.1)
    host.run(4.0)
    assert attitude_deg(host) == (0, 0, 0)
    host = Host("0 swing 20 0 0 over 1 times 100\n0.25 level over 0.5")
    host.run(0.5)
    assert attitude_deg(host)[0] == pytest.approx(10, abs=0.3)
    host.run(1.0)
    assert attitude_deg(host) == (0, 0, 0)


def test_turn_rates_are_the_derivative_of_the_angles():
    host = Host("0 tilt 0 0 90 over 0.5\n1 swing 30 0 0 over 2", motion_plus=True)
    host.run(0.25)
    plus = host.remote.port.motion_plus
    assert plus.rates_rad_s == pytest.approx((0, 0, math.pi), abs=1e-9)
    host.run(0.5)
    assert plus.rates_rad_s == pytest.approx((0, 0, 0), abs=1e-9)
    host.run(0.255)
    # Right side down is a rotation about forward, which is minus the tail's axis.
    assert plus.rates_rad_s[1] == pytest.approx(-math.radians(30) * math.pi, rel=0.01)


def test_push_is_felt_along_the_remotes_own_axes():
    host = Host("0 push 1 0 0 over 1")
    host.send(DataMode(0x31))
    forces = [
        to_g(value.accelerometer, ZERO, ONE)
        for _, value in host.run(1.2)
        if isinstance(value, Data)
    ]
    assert min(force[1] for force in forces) == pytest.approx(-1.0, abs=0.05)
    assert max(force[1] for force in forces) == pytest.approx(1.0, abs=0.05)
    assert forces[-1] == pytest.approx((0, 0, 1), abs=0.02)


def test_buttons_stick_dots_and_battery():
    host = Host(
        "0 press a\n0 press z\n0 stick 1 -1 over 1\n0 dots 1 2 3 4\n0 battery 16\n"
        "2 release a\n2 release z\n2 dots",
        extension="nunchuk",
    )
    host.run(1.0)
    assert host.remote.held == ("a", "z")
    assert len(host.remote.camera.dots) == 2
    assert host.remote.battery == 16
    host.run(0.01)
    nunchuk = host.remote.port.nunchuk.measured
    assert (nunchuk.stick_x, nunchuk.stick_y) == (228, 27)
    host.run(1.0)
    assert host.remote.held == ()
    assert host.remote.camera.dots == ()


def test_plug_power_and_range():
    host = Host(
        "0.1 plug nunchuk\n0.2 press c\n0.3 unplug\n1 silence\n1.5 resume\n2 leave\n3 come-back"
    )
    host.run(0.25)
    assert host.remote.held == ("c",)
    host.run(0.25)
    assert host.remote.port.nunchuk is None
    host.send(DataMode(0x31))
    assert host.run(0.5)
    assert host.run(0.45) == []
    assert len(host.run(0.5)) > 30
    host.run(0.3)
    assert host.run(0.7) == []
    assert host.remote.connected  # for less than the link's timeout
    assert len(host.run(1.0)) > 70
    host = Host("0.5 leave\n6 power-off\n7 come-back\n8 power-on")
    host.run(2.4)
    assert host.remote.connected
    host.run(0.2)
    assert not host.remote.connected
    assert not host.remote.reachable
    host.run(5.0)
    assert not host.remote.reachable
    host.run(1.0)
    assert host.remote.connect(host.now_s)


def test_loop_starts_again():
    host = Host("0.5 press a\n1 release a\n2 loop")
    held = []
    for _ in range(12):
        host.run(0.5)
        held.append(bool(host.remote.held))
    assert held == [True, False, False, False] * 3


@pytest.mark.parametrize("name", SCRIPTS)
def test_built_in_scripts_end_level_with_nothing_held(name):
    extension = "nunchuk" if name == "nunchuk" else ""
    steps = load_script(name, SCRIPTS, SCRIPT_VERBS)
    remote = SimulatedWiimote(extension=extension, motion_plus=True)
    remote.connect(0.0)
    remote.output(encode_output(DataMode(0x35)), 0.0)
    motion = ScriptedWiimote(steps, extension)
    assert play(remote, motion, 30.0)
    if steps and steps[-1].verb != "loop":
        assert motion.next_due_s == math.inf
        assert remote.held == ()
        assert max(map(abs, remote.attitude_rad)) < 1e-9


def test_only_one_built_in_script_needs_the_nunchuk():
    for name in SCRIPTS:
        if name == "nunchuk":
            with pytest.raises(ScriptError, match="no Nunchuk"):
                ScriptedWiimote(load_script(name, SCRIPTS, SCRIPT_VERBS))
        else:
            ScriptedWiimote(load_script(name, SCRIPTS, SCRIPT_VERBS))


@pytest.mark.parametrize("name", ["demo", "circle", "short"])
def test_angles_never_jump(name):
    host = Host()
    host.motion = ScriptedWiimote(load_script(name, SCRIPTS, SCRIPT_VERBS))
    last = host.remote.attitude_rad
    begun = False
    for _ in range(6000):
        host.run(0.005)
        attitude = host.remote.attitude_rad
        step = max(abs(a - b) for a, b in zip(attitude, last, strict=True))
        assert step < math.radians(2.0)
        last, begun = attitude, begun or step > 0.0
    assert begun


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("1 tilt 1 2", "YAW is missing"),
        ("1 tilt 1 2 x", "YAW is 'x', must be a number from -720 to 720"),
        ("1 tilt 1 2 3 4", "'4' is too much"),
        ("1 swing 1 2 3", "'over' is missing"),
        ("1 swing 1 2 3 over 0", "SECONDS is '0'"),
        ("1 push 9 0 0 over 1", "X is '9'"),
        ("1 stick 2 0", "X is '2'"),
        ("1 stick 0 0", "there is no Nunchuk"),
        ("1 press c", "there is no Nunchuk"),
        ("1 press x", "there is no button 'x'; there are: left"),
        ("1 press", "LABEL is missing"),
        ("1 dots 1", "Y is missing"),
        ("1 dots 1024 0", "X is '1024'"),
        ("1 dots 1 1 1 1 1 1 1 1 1 1", "too much"),
        ("1 battery 256", "level is '256'"),
        ("1 plug guitar", "'guitar' cannot be plugged"),
        ("1 loop\n2 leave", "must be the last step"),
        ("0 loop", "must be the last step, after 0 s"),
        ("1 dance", "after the time comes one of"),
    ],
)
def test_nonsense_is_refused(script, words):
    with pytest.raises(ScriptError, match=words):
        ScriptedWiimote(parse_script(script, SCRIPT_VERBS))


def test_a_script_may_plug_its_nunchuk():
    steps = parse_script("0 plug nunchuk\n1 stick 0 1\n2 unplug\n3 press c", SCRIPT_VERBS)
    remote = SimulatedWiimote()
    remote.connect(0.0)
    play(remote, ScriptedWiimote(steps), 4.0)
    assert remote.held == ()


@given(st.floats(-60, 60), st.floats(-60, 60), st.floats(0.0, 2.0))
def test_any_tilt_is_what_the_accelerometer_shows(roll, pitch, over_s):
    host = Host(f"0 tilt {roll:.3f} {pitch:.3f} 0 over {over_s:.3f}")
    host.run(over_s + 0.01)
    raw = host.stream(0x31, 0.02)[-1].accelerometer
    measured = [math.degrees(angle) for angle in roll_and_pitch_rad(to_g(raw, ZERO, ONE))]
    assert measured == pytest.approx((roll, pitch), abs=2.5)


def test_reports_of_a_played_script_are_whole():
    remote = SimulatedWiimote(noise_lsb=1)
    remote.connect(0.0)
    remote.output(encode_output(DataMode(0x31)), 0.0)
    motion = ScriptedWiimote(load_script("short", SCRIPTS, SCRIPT_VERBS))
    reports = [decode_input(report) for report in play(remote, motion, 6.0)]
    assert len(reports) == pytest.approx(600, abs=3)
    assert {label for r in reports if isinstance(r, Data) for label in (r.buttons,)} >= {0, 0x800}
