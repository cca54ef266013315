"""The core and a simulated remote in virtual time: start-up, roles, extensions, feedback."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.gateway.operator.mapping import MappingOptions, TwistMapping
from cardan.types import DeviceLink, Frame
from cardan_wiimote.driver import Identity, WiimoteCore, WiimoteOptions
from cardan_wiimote.driver.core import BUTTON_NAMES, STALE_AFTER_S
from cardan_wiimote.protocol import (
    AccelerometerCalibration,
    Data,
    DataMode,
    IrDot,
    button_mask,
    decode_output,
    encode_accelerometer_calibration,
    encode_data,
    to_g,
)
from wiimote_bench import REST, Bench

SIN = {degrees: math.sin(math.radians(degrees)) for degrees in (10, 20, 30, 45)}
A, TWO = button_mask(["a"]), button_mask(["2"])
CLOSE = 0.012  # the accelerometer's resolution is 0.01 g
PAPER = MappingOptions(frame=Frame.TOOL, linear_speed_m_s=0.01, angular_speed_rad_s=0.1)

EVERYTHING = [
    pytest.param({}, id="alone"),
    pytest.param({"extension": "nunchuk"}, id="nunchuk"),
    pytest.param({"motion_plus": True}, id="motion-plus"),
    pytest.param({"motion_plus": True, "extension": "nunchuk"}, id="both"),
    pytest.param({"tr": True, "motion_plus": True}, id="tr"),
]


def held(bench, *labels, right_deg=0.0, down_deg=0.0):
    """Return the state after the link is live, buttons are pressed and the remote is tilted."""
    bench.ready()
    bench.press(*labels)
    bench.tilt(right_deg, down_deg)
    return bench.run(0.3)


# -- start ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("remote", EVERYTHING)
@pytest.mark.parametrize("ir", [False, True])
@pytest.mark.parametrize("motion_plus", ["off", "on"])
def test_it_comes_alive_with_everything(remote, ir, motion_plus):
    bench = Bench(WiimoteOptions(ir=ir, motion_plus=motion_plus), noise_lsb=1, **remote)
    state = bench.run(0.004)
    assert (state.link, state.axes) == (DeviceLink.NEEDS_NEUTRAL, REST)
    assert "starting up" in state.reason
    bench.ready(0.5)
    state = bench.run(5.0)
    assert state.link is DeviceLink.LIVE
    assert 0.0 <= bench.now_s - state.stamp_s < 0.011
    assert state.battery == pytest.approx(192 / 200)
    with_plus = motion_plus == "on" and "motion_plus" in remote
    extended = with_plus or "extension" in remote
    modes = {(False, False): 0x31, (True, False): 0x35, (False, True): 0x33, (True, True): 0x37}
    assert (bench.remote.mode, bench.remote.continuous) == (modes[extended, ir], True)
    assert ("stick_x" in bench.metrics()) is ("extension" in remote)
    assert ("rate_x_rad_s" in bench.metrics()) is with_plus
    missing = motion_plus == "on" and not with_plus
    expected = ["it has no MotionPlus, or none that answers"] if missing else []
    assert bench.diagnosis() == expected
    assert bench.opened == 1


def test_the_first_reports_are_motor_leds_status():
    bench = Bench(WiimoteOptions(led=2))
    bench.ready()
    assert [report.hex() for _, report in bench.sent[:4]] == [
        "1000", "1120", "1500", "17000000160014"
    ]  # fmt: skip
    assert bench.sent[-1][1].hex() == "120431"


@pytest.mark.judged(device="Wiimote", transport="reports", by="worked bytes")
def test_the_worked_session():
    core = WiimoteCore(WiimoteOptions(dead_zone=0.0))
    core.on_opened(0.0, Identity())
    assert [r.hex() for r in core.outgoing(0.0)] == ["1000", "1110", "1500"]
    core.on_report(bytes.fromhex("200000100000c0"), 0.01)
    assert [r.hex() for r in core.outgoing(0.01)] == ["17000000160014"]
    block = "848286309f9d9f02402e"
    core.on_report(bytes.fromhex("210000f00016" + block + block[:12]), 0.02)
    core.on_report(bytes.fromhex("210000300026" + block[12:] + "00" * 12), 0.03)
    assert [r.hex() for r in core.outgoing(0.03)] == ["120431"]
    core.on_report(bytes.fromhex("31 60 40 84 82 9f"), 0.04)
    assert core.state(0.04).link is DeviceLink.LIVE
    core.on_report(bytes.fromhex("31 60 48 91 82 9c"), 0.05)
    state = core.state(0.05)
    assert state.buttons == {"a"}
    for at in range(6, 60):
        core.on_report(bytes.fromhex("31 60 48 91 82 9c"), at / 100)
    x, y, z, rx, ry, rz = core.state(0.59).axes
    assert (x, y, z, rz) == (0.0, 0.0, 1.0, 0.0)
    assert (rx, ry) == (pytest.approx(0.495, abs=0.001), pytest.approx(0.0, abs=0.001))
    core.on_report(bytes.fromhex("31 70 e4 84 74 9c"), 0.60)
    assert core.state(0.60).buttons == {"home", "b", "plus"}
    for at in range(61, 120):
        core.on_report(bytes.fromhex("31 70 e4 84 74 9c"), at / 100)
    x, y, z, rx, ry, rz = core.state(1.19).axes
    assert (z, rx, ry) == (-1.0, pytest.approx(0.0, abs=0.001), pytest.approx(-0.5, abs=0.001))
    assert core.state(1.19).battery == pytest.approx(0.96)


@pytest.mark.judged(device="Wiimote", transport="reports", by="worked bytes")
def test_the_worked_motion_plus():
    bench = Bench(WiimoteOptions(motion_plus="on"), motion_plus=True)
    block = "7983735472E830C3CC4A34FCC84FCC5B 774975A4739A3552CA2237262DE5B5A2"
    bench.remote.port.motion_plus.memory[0x20:0x40] = bytes.fromhex(block)
    bench.ready()
    frame = bytes.fromhex("fd5efc6e5a52")
    bench.remote.port.data = lambda size: frame.ljust(size, b"\0")
    bench.run(0.05)
    rates = [math.degrees(bench.metrics()[f"rate_{axis}_rad_s"]) for axis in "xyz"]
    # (-600.2, -90.0, -30.0) about left, tail and up
    assert rates == pytest.approx((90.0, -600.2, -30.0), abs=0.1)


@pytest.mark.judged(device="Wiimote", transport="reports", by="worked bytes")
def test_the_worked_nunchuk():
    bench = Bench(extension="nunchuk", faults={"no-calibration": 1.0})
    bench.ready()
    frame = bytes.fromhex("80c0807fb5e5")
    bench.remote.port.data = lambda size: frame.ljust(size, b"\0")
    state = bench.run(0.05)
    assert state.buttons == {"c"}
    assert bench.metrics()["stick_x"] == pytest.approx(64 / 96)
    assert bench.metrics()["stick_y"] == 0.0


@pytest.mark.judged(device="Wiimote", transport="reports", by="worked bytes")
def test_the_worked_camera():
    bench = Bench(WiimoteOptions(ir=True))
    bench.ready()
    bench.remote.camera.data = lambda ir_format: bytes.fromhex("bc2c63") + b"\xff" * 9
    bench.run(0.05)
    figures = bench.metrics()
    assert figures["pointer_dots"] == 1
    assert figures["pointer_x"] == pytest.approx(2 * 700 / 1023 - 1)
    assert figures["pointer_y"] == pytest.approx(2 * 300 / 767 - 1)


# -- roles "paper" --------------------------------------------------------------------------------


@pytest.mark.judged(device="Wiimote", transport="reports", by="worked bytes")
@pytest.mark.parametrize(
    ("buttons", "twist"),
    [
        ("a", (0, 0, 0.01, 0.04, 0.02, 0)),
        ("b", (0, 0, -0.01, 0.04, 0.02, 0)),
        ("ab", (0, 0, 0, 0.04, 0.02, 0)),
        ("", (0, 0, 0, 0, 0, 0)),
    ],
)
@pytest.mark.parametrize("yaw", [False, True])
def test_the_papers_numbers(buttons, twist, yaw):
    """The paper's acceleration is (0.4, -0.2) g, with the second one negated: nose up is positive
    there."""
    bench = Bench()
    bench.remote.set_attitude(math.atan2(0.4, math.sqrt(0.8)), -math.asin(0.2))
    bench.ready()
    if yaw:
        bench.press("2")
        bench.release("2")
    bench.press(*buttons)
    asked = TwistMapping(PAPER).twist(bench.run(0.2).axes)
    vx, vy, vz, wx, wy, wz = twist
    expected = (vx, vy, vz, wz, wy, wx) if yaw else twist
    assert (*asked.linear, *asked.angular) == pytest.approx(expected, abs=6e-4)
    assert asked.frame is Frame.TOOL


# The program of uc3m has the offsets (-30, -22, 72) from 512 counts at 0 g, and 99, 101 and 97
# counts per g. Its y is negated, so that nose up is positive; its twist negates it back.
UC3M = AccelerometerCalibration((482, 490, 584), (581, 591, 681))


def uc3m_twist(*counts, yaw=False):
    """Return the tool's twist (m/s, rad/s) after a second of reports with `counts`, with A held."""
    core = WiimoteCore(WiimoteOptions(dead_zone=0.0))
    core.on_opened(0.0, Identity())
    core.outgoing(0.0)
    block = encode_accelerometer_calibration(UC3M)
    core.on_report(bytes.fromhex("200000100000c0"), 0.01)
    core.outgoing(0.01)
    core.on_report(bytes.fromhex("210000f00016") + block + block[:6], 0.02)
    core.on_report(bytes.fromhex("210000300026") + block[6:] + bytes(12), 0.03)
    core.outgoing(0.03)

    def tell(buttons, accelerometer, now_s):
        core.on_report(encode_data(Data(0x31, buttons, accelerometer, b"", b"")), now_s)

    level = (482, 490, 680)
    tell(0, level, 0.04)
    assert core.state(0.04).link is DeviceLink.LIVE
    if yaw:
        tell(TWO, level, 0.05)
        tell(0, level, 0.06)
    for at in range(7, 107):
        tell(A, counts, at / 100)
    assert core.metrics(1.06)["yaw_mode"] == yaw
    asked = TwistMapping(PAPER).twist(core.state(1.06).axes)
    return (*asked.linear, *asked.angular)


@pytest.mark.judged(device="Wiimote", transport="reports", by="worked bytes")
def test_the_sample_of_uc3ms_program():
    """(97, -60) counts are 1.283 and 0.376 g, and give the twist (0, 0, 0.01, 0.128, -0.038, 0)
    there."""
    sample = (512 + 97, 512 - 60, 584)
    x, y, z = to_g(sample, UC3M.zero, UC3M.one_g)
    assert (x, -y, z) == pytest.approx((1.283, 0.376, 0.0), abs=5e-4)
    # A hand at rest never measures 1.34 g: the driver ignores such samples.
    assert uc3m_twist(*sample) == pytest.approx((0, 0, 0.01, 0, 0, 0))
    # The same tilt, at 1 g.
    size = math.hypot(x, y)
    tilted = (482 + round(99 * x / size), 490 + round(101 * y / size), 584)
    expected = (0, 0, 0.01, 0.128 / size, -0.038 / size, 0)
    assert uc3m_twist(*tilted) == pytest.approx(expected, abs=1e-3)
    turned = (0, 0, 0.01, 0, -0.038 / size, 0.128 / size)
    assert uc3m_twist(*tilted, yaw=True) == pytest.approx(turned, abs=1e-3)
    # Within the tolerance of gravity, a tilt beyond 1 g counts as 1 g.
    assert uc3m_twist(482 + 113, 490, 584) == pytest.approx((0, 0, 0.01, 0.1, 0, 0))
    assert uc3m_twist(482, 490 - 115, 584) == pytest.approx((0, 0, 0.01, 0, -0.1, 0), abs=1e-9)


def test_paper_signs():
    bench = Bench()
    assert held(bench, "a", right_deg=30).axes == pytest.approx((0, 0, 1, SIN[30], 0, 0), abs=CLOSE)
    bench.tilt(0, 30)
    assert bench.run(0.4).axes == pytest.approx((0, 0, 1, 0, SIN[30], 0), abs=CLOSE)
    bench.press("b")
    assert bench.state.axes == pytest.approx((0, 0, 0, 0, SIN[30], 0), abs=CLOSE)
    bench.release("a")
    assert bench.state.axes == pytest.approx((0, 0, -1, 0, SIN[30], 0), abs=CLOSE)
    state = bench.release("b")
    assert (state.axes, state.link) == (REST, DeviceLink.LIVE)


def test_yaw_is_latched():
    bench = Bench()
    bench.ready()
    bench.press("2")
    bench.release("2")
    assert bench.metrics()["yaw_mode"] == 1.0
    assert any("about z (button 2)" in words for words in bench.diagnosis())
    assert held(bench, "a", right_deg=-20).axes == pytest.approx(
        (0, 0, 1, 0, 0, -SIN[20]), abs=CLOSE
    )
    bench.press("1")
    assert bench.release("1").axes == pytest.approx((0, 0, 1, -SIN[20], 0, 0), abs=CLOSE)
    assert bench.metrics()["yaw_mode"] == 0.0
    assert bench.diagnosis() == []


def test_yaw_off_wins_over_on():
    bench = Bench()
    bench.ready()
    bench.remote.press("2")
    bench.press("1")
    assert bench.metrics()["yaw_mode"] == 0.0
    bench.release("1", "2")
    bench.press("2")
    assert bench.metrics()["yaw_mode"] == 1.0


def test_a_press_that_wakes_the_remote_sets_no_mode():
    bench = Bench()
    bench.remote.press("2")
    bench.ready()
    assert bench.metrics()["yaw_mode"] == 0.0
    bench.release("2")
    bench.press("2")
    assert bench.metrics()["yaw_mode"] == 1.0


def test_the_dead_zone():
    bench = Bench(WiimoteOptions())
    assert held(bench, "a", "b", right_deg=3.5, down_deg=3.5).axes == REST
    bench.tilt(45, 0)
    assert bench.run(0.4).axes[3] == pytest.approx((SIN[45] - 0.07) / 0.93, abs=CLOSE)


def test_full_tilt():
    bench = Bench(WiimoteOptions(dead_zone=0.0, full_tilt_deg=30.0))
    assert held(bench, "a", right_deg=60, down_deg=10).axes == pytest.approx(
        (0, 0, 1, 1, SIN[10] / SIN[30], 0), abs=2 * CLOSE
    )


def test_roll_fades_where_it_cannot_be_reported():
    bench = Bench()
    bench.ready()
    bench.press("a")
    bench.tilt(60, 88)
    assert abs(bench.run(0.5).axes[3]) < 0.05


# -- neutral at the press -------------------------------------------------------------------------


@given(st.floats(-80, 80), st.floats(-80, 80))
def test_neutral_at_the_press(right_deg, down_deg):
    bench = Bench(WiimoteOptions(dead_zone=0.0, neutral="press"))
    bench.tilt(right_deg, down_deg)
    bench.ready()
    bench.run(0.2)
    bench.press("a", "b")
    assert bench.state.axes == pytest.approx(REST, abs=2 * CLOSE)


def test_a_tilt_from_the_press_on():
    bench = Bench(WiimoteOptions(dead_zone=0.0, neutral="press"))
    bench.tilt(0, -40)
    bench.ready()
    bench.run(0.3)
    bench.press("a")
    bench.tilt(0, -20)
    assert bench.run(0.4).axes == pytest.approx((0, 0, 1, 0, SIN[20], 0), abs=CLOSE)
    bench.release("a")
    bench.press("a")
    assert bench.run(0.1).axes == pytest.approx((0, 0, 1, 0, 0, 0), abs=CLOSE)


@pytest.mark.parametrize("before", ["nothing", "another attitude"])
def test_a_press_while_its_tilt_is_unknown_waits_for_it(before):
    bench = Bench(WiimoteOptions(dead_zone=0.0, neutral="press", roles="tilt"))
    if before == "nothing":
        bench.remote.set_acceleration((0.0, 0.0, 1.0))
    bench.tilt(60, 0)
    bench.ready()
    bench.run(1.0)
    bench.remote.set_acceleration((0.0, 0.0, 1.0))
    bench.tilt(40, 0)
    bench.run(0.1)
    assert bench.press("b").axes == REST
    bench.remote.set_acceleration((0.0, 0.0, 0.0))
    assert bench.run(1.0).axes == pytest.approx(REST, abs=2 * CLOSE)
    bench.tilt(40, 20)
    assert bench.run(0.4).axes[0] == pytest.approx(SIN[20] / SIN[45], abs=3 * CLOSE)


# -- the other roles ------------------------------------------------------------------------------


def test_tilt_roles():
    bench = Bench(WiimoteOptions(roles="tilt", dead_zone=0.0))
    share = SIN[20] / SIN[45]
    assert held(bench, "b", down_deg=20).axes == pytest.approx(
        (share, 0, 0, 0, 0, 0), abs=2 * CLOSE
    )
    bench.tilt(20, 0)
    assert bench.run(0.4).axes == pytest.approx((0, -share, 0, 0, 0, 0), abs=2 * CLOSE)
    bench.press("a")
    assert bench.state.axes == pytest.approx((0, 0, 0, share, 0, 0), abs=2 * CLOSE)
    bench.press("up", "left")
    assert bench.state.axes == pytest.approx((0, 0, 1, share, 0, 1), abs=2 * CLOSE)
    bench.release("up", "left")
    bench.press("down", "right")
    assert bench.state.axes == pytest.approx((0, 0, -1, share, 0, -1), abs=2 * CLOSE)
    bench.release("b")
    assert bench.state.axes == REST


@pytest.mark.parametrize("extension", ["", "nunchuk"])
def test_gyro_roles(extension):
    bench = Bench(
        WiimoteOptions(roles="gyro", dead_zone=0.0, gyro_full_scale_rad_s=2.0),
        motion_plus=True,
        extension=extension,
    )
    bench.ready()
    bench.press("b")
    for rates, axes in (
        ((1.0, 0.0, 0.0), (0, 0, 0, 0.5, 0, 0)),
        ((0.0, 1.0, 0.0), (0, 0, 0, 0, -0.5, 0)),  # nose up
        ((0.0, 0.0, 1.0), (0, 0, 0, 0, 0, 0.5)),
        ((0.0, 0.0, -8.0), (0, 0, 0, 0, 0, -1)),
    ):
        bench.remote.set_attitude(0.0, 0.0, 0.0, rates)
        assert bench.run(0.1).axes == pytest.approx(axes, abs=0.01)
    bench.remote.set_attitude(0.0, 0.0)
    bench.press("up", "left", "minus")
    assert bench.run(0.1).axes == pytest.approx((1, 1, -1, 0, 0, 0), abs=0.01)


def test_gyro_roles_need_a_motion_plus():
    bench = Bench(WiimoteOptions(roles="gyro"))
    state = bench.run(2.0)
    assert (state.link, state.axes) == (DeviceLink.NEEDS_NEUTRAL, REST)
    assert "MotionPlus" in state.reason


def test_the_rest_point_is_refined():
    bench = Bench(WiimoteOptions(motion_plus="on"), motion_plus=True, noise_lsb=1)
    bench.ready()
    drift = math.radians(2.5)
    bench.remote.set_attitude(0.0, 0.0, 0.0, (drift, 0.0, 0.0))
    bench.run(3.0)
    assert abs(bench.metrics()["rate_x_rad_s"]) < math.radians(1.0)
    bench.press("a")
    bench.remote.set_attitude(0.0, 0.0, 0.0, (2 * drift, 0.0, 0.0))
    bench.run(3.0)
    assert bench.metrics()["rate_x_rad_s"] == pytest.approx(drift, abs=math.radians(1.0))


def test_a_slow_turn_before_the_clutch_moves_nothing_after():
    """A slow, steady turn looks like a changed rest point."""
    options = WiimoteOptions(roles="gyro", gyro_full_scale_rad_s=0.3)
    bench = Bench(options, motion_plus=True)
    bench.ready()
    bench.remote.set_attitude(0.0, 0.0, 0.0, (0.0, 0.0, math.radians(9.0)))
    bench.run(2.5)
    assert bench.metrics()["rest_point_updates"] > 0
    bench.remote.set_attitude(0.0, 0.0)
    bench.press("b")
    assert bench.run(0.5).axes == pytest.approx(REST, abs=0.01)


# -- Nunchuk --------------------------------------------------------------------------------------


@pytest.mark.parametrize("motion_plus", [False, True])
def test_the_stick(motion_plus):
    options = WiimoteOptions(dead_zone=0.0, motion_plus="on" if motion_plus else "off")
    bench = Bench(options, extension="nunchuk", motion_plus=motion_plus)
    bench.ready()
    bench.remote.set_stick(0.5, 1.0)
    assert bench.run(0.2).axes == REST
    state = bench.press("z")
    assert state.axes == pytest.approx((1, -0.5, 0, 0, 0, 0), abs=0.02)
    assert state.buttons == {"z"}
    bench.press("c")
    assert bench.state.buttons == {"c", "z"}
    bench.release("z", "c")
    assert bench.state.axes == REST
    bench.tilt(30, 0)
    bench.run(0.3)
    assert bench.press("a").axes == pytest.approx((1, -0.5, 1, SIN[30], 0, 0), abs=0.02)
    assert bench.edges() == [
        ("z", True), ("c", True), ("c", False), ("z", False), ("a", True)
    ]  # fmt: skip


def test_a_deflected_stick_keeps_it_from_going():
    bench = Bench(extension="nunchuk")
    bench.remote.set_stick(0.0, -1.0)
    state = bench.run(1.0)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert "stick" in state.reason
    bench.remote.set_stick(0.0, 0.0)
    assert bench.run(0.1).link is DeviceLink.LIVE


def test_a_stick_without_calibration_is_centered_by_what_it_shows():
    bench = Bench(extension="nunchuk", faults={"no-calibration": 1.0})
    bench.remote.set_stick(0.1, -0.1)
    bench.ready()
    bench.run(0.5)
    assert bench.press("z").axes[:2] == pytest.approx((0, 0), abs=0.03)
    assert any("Nunchuk has no readable calibration" in words for words in bench.diagnosis())


@pytest.mark.parametrize("motion_plus", [False, True])
def test_a_nunchuk_comes_and_goes(motion_plus):
    options = WiimoteOptions(dead_zone=0.0, motion_plus="on" if motion_plus else "off")
    bench = Bench(options, motion_plus=motion_plus)
    bench.ready()
    bench.press("a")
    bench.remote.plug(bench.now_s)
    bench.until(lambda b: b.state.link is DeviceLink.NEEDS_NEUTRAL, 3.0)
    assert bench.run(1.0).axes == REST
    bench.release("a")
    bench.ready(3.0)
    bench.remote.set_stick(1.0, 0.0)
    assert bench.press("z").axes == pytest.approx((0, -1, 0, 0, 0, 0), abs=0.02)
    unplugged_s = bench.now_s
    bench.remote.unplug(bench.now_s)
    bench.until(lambda b: b.state.axes == REST, STALE_AFTER_S + 0.03)
    assert bench.now_s - unplugged_s <= STALE_AFTER_S + 0.03
    assert bench.run(3.0).link is DeviceLink.LIVE
    assert bench.edges()[-1] == ("z", False)
    assert "stick_x" not in bench.metrics()


def test_a_motion_plus_left_on_is_taken_over():
    bench = Bench(WiimoteOptions(roles="gyro"), motion_plus=True, extension="nunchuk")
    bench.ready()
    bench.remote.disconnect(bench.now_s)
    bench.core = WiimoteCore(WiimoteOptions(dead_zone=0.0))
    bench.run(0.1)
    bench.ready()
    bench.remote.set_stick(0.0, 1.0)
    assert bench.press("z").axes == pytest.approx((1, 0, 0, 0, 0, 0), abs=0.02)


# -- camera ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("extension", ["", "nunchuk"])
def test_the_camera(extension):
    bench = Bench(WiimoteOptions(ir=True), extension=extension)
    bench.ready()
    assert bench.metrics()["pointer_dots"] == 0
    bench.remote.set_dots([IrDot(500, 100, 3), IrDot(700, 100, 3)])
    bench.run(0.1)
    figures = bench.metrics()
    assert figures["pointer_dots"] == 2
    assert figures["pointer_x"] == pytest.approx(2 * 600 / 1023 - 1)
    assert figures["pointer_y"] == pytest.approx(2 * 100 / 767 - 1)


def test_the_camera_fits_what_is_plugged_in():
    bench = Bench(WiimoteOptions(ir=True))
    bench.ready()
    bench.remote.set_dots([IrDot(0, 767, 3)])
    bench.remote.plug(bench.now_s)
    bench.run(1.0)
    assert bench.remote.mode == 0x37
    assert (bench.metrics()["pointer_x"], bench.metrics()["pointer_y"]) == (-1.0, 1.0)


# -- unknown tilt ---------------------------------------------------------------------------------


def test_a_shaken_remote_freezes_and_then_rests():
    bench = Bench()
    assert held(bench, "a", right_deg=20).axes[3] == pytest.approx(SIN[20], abs=CLOSE)
    bench.remote.set_acceleration((0.0, 0.0, 1.0))
    assert bench.run(0.1).axes[3] == pytest.approx(SIN[20], abs=CLOSE)
    state = bench.run(0.3)
    assert (state.axes[3], state.link) == (0.0, DeviceLink.LIVE)
    bench.remote.set_acceleration((0.0, 0.0, 0.0))
    assert bench.run(0.2).axes[3] == pytest.approx(SIN[20], abs=CLOSE)


# -- buttons --------------------------------------------------------------------------------------


def test_every_button_is_heard():
    bench = Bench()
    bench.ready()
    names = {"1": "one", "2": "two"}
    labels = ("a", "b", "1", "2", "plus", "minus", "home", "up", "down", "left", "right")
    for label in labels:
        assert names.get(label, label) in bench.press(label).buttons
        assert not bench.release(label).buttons
    assert bench.edges() == [
        (names.get(label, label), down) for label in labels for down in (True, False)
    ]
    assert {names.get(label, label) for label in labels} == set(BUTTON_NAMES)
    assert set(bench.core.labels) == {*BUTTON_NAMES, "c", "z"}


# -- feedback -------------------------------------------------------------------------------------


def test_leds():
    bench = Bench(WiimoteOptions(led=3))
    bench.ready()
    assert bench.remote.leds == 0b0100
    bench.core.set_led(False)
    bench.run(0.1)
    assert bench.remote.leds == 0
    bench.core.set_led(True)
    bench.run(0.1)
    assert bench.remote.leds == 0b0100


def test_no_led():
    bench = Bench(WiimoteOptions(led=0))
    bench.ready()
    assert bench.remote.leds == 0
    bench.core.set_led(True)
    bench.run(0.1)
    assert bench.remote.leds == 0b0001


@pytest.mark.parametrize("level", [0.25, 0.5, 0.8])
def test_rumble_by_pulses(level):
    bench = Bench()
    bench.ready()
    on = 0
    before = len(bench.sent)
    for _ in range(1000):
        bench.core.set_rumble(level, bench.now_s)
        bench.run(0.002)
        on += bench.remote.rumble
    assert on / 1000 == pytest.approx(level, abs=0.07)
    assert len(bench.sent) - before <= 2.0 * 50


def test_the_motor_keeps_its_bit_whatever_is_sent():
    bench = Bench()
    bench.ready()
    bench.core.set_rumble(1.0, bench.now_s)
    bench.run(0.05)
    assert bench.remote.rumble
    before = len(bench.sent)
    bench.core.set_led(False)
    bench.remote.plug(bench.now_s)
    bench.run(0.5)
    assert bench.remote.rumble
    assert len(bench.sent) - before > 5
    assert all(report[1] & 1 for _, report in bench.sent[before:])


def test_the_motor_stops_when_nobody_renews_it():
    bench = Bench()
    bench.ready()
    bench.core.set_rumble(1.0, bench.now_s)
    bench.run(0.1)
    assert bench.remote.rumble
    bench.run(0.88)
    assert not bench.remote.rumble


# -- other programs, battery ----------------------------------------------------------------------


def test_the_kernels_driver_is_named():
    bench = Bench(identity=Identity(kernel_driver=True))
    bench.ready()
    assert any("hid-wiimote" in words for words in bench.diagnosis())


def test_a_mode_that_somebody_set_is_put_right():
    bench = Bench()
    bench.ready()
    for _ in range(5):
        bench.remote.output(bytes.fromhex("120030"), bench.now_s)
        assert bench.run(0.2).link is DeviceLink.LIVE
        assert bench.remote.mode == 0x31
    assert any("data mode" in words for words in bench.diagnosis())


def test_the_kernels_habit_after_a_status():
    """The other program's data mode (12 00 30) follows ours."""
    bench = Bench(identity=Identity(kernel_driver=True))
    bench.ready()
    for _ in range(5):
        bench.remote.output(bytes.fromhex("1500"), bench.now_s)
        bench.run(0.006)
        bench.remote.output(bytes.fromhex("120030"), bench.now_s)
        assert bench.run(0.3).link is DeviceLink.LIVE


def test_the_battery_is_asked_for_now_and_then_but_not_while_driving():
    bench = Bench()
    bench.ready()
    bench.remote.battery = 0x10
    bench.press("a")
    bench.run(70.0)
    assert bench.state.battery == pytest.approx(0.96)
    bench.release("a")
    assert bench.run(0.1).battery == pytest.approx(0.08)
    assert "its batteries are nearly empty" in bench.diagnosis()
    assert bench.state.link is DeviceLink.LIVE


def test_modes_come_after_every_status():
    bench = Bench(faults={"stale-mode": 1.0})
    bench.ready()
    bench.remote.output(bytes.fromhex("1500"), bench.now_s)
    assert bench.run(0.2).link is DeviceLink.LIVE
    assert isinstance(decode_output(bench.sent[-1][1]), DataMode)


# -- arbitrary input ------------------------------------------------------------------------------


@given(st.lists(st.binary(max_size=24), max_size=60))
def test_no_bytes_raise_or_move(packets):
    core = WiimoteCore(WiimoteOptions(motion_plus="on", ir=True))
    core.on_opened(0.0)
    now_s = 0.0
    for packet in packets:
        now_s += 0.007
        core.outgoing(now_s)
        core.on_report(packet, now_s)
        state = core.state(now_s)
        assert all(-1.0 <= u <= 1.0 for u in state.axes)
        core.diagnosis(now_s)
        core.metrics(now_s)
    core.on_closed(now_s)
    assert core.state(now_s).link is DeviceLink.CLOSED


_PACKETS = st.one_of(
    st.binary(max_size=24),
    st.tuples(
        st.sampled_from([0x20, 0x21, 0x22, 0x30, 0x31, 0x33, 0x35, 0x37, 0x3D, 0x3E]),
        st.binary(min_size=21, max_size=21),
    ).map(lambda pair: bytes((pair[0],)) + pair[1]),
)


@pytest.mark.parametrize("roles", ["paper", "tilt", "gyro"])
@given(packets=st.lists(_PACKETS, max_size=60))
def test_garbage_into_a_running_session(roles, packets):
    bench = Bench(WiimoteOptions(roles=roles), motion_plus=True, extension="nunchuk")
    bench.ready()
    bench.press("b")
    for packet in packets:
        bench.core.on_report(packet, bench.now_s)
        state = bench.core.state(bench.now_s)
        assert all(-1.0 <= u <= 1.0 for u in state.axes)
        bench.now_s += 0.005
        bench.core.outgoing(bench.now_s)
        bench.core.failure(bench.now_s)
    bench.core.diagnosis(bench.now_s)


def test_closed_is_closed():
    bench = Bench()
    bench.ready()
    bench.press("a")
    bench.core.on_closed(bench.now_s)
    state = bench.state
    assert (state.link, state.axes, state.buttons) == (DeviceLink.CLOSED, REST, frozenset())
    bench.core.on_report(bytes.fromhex("31604c84829f"), bench.now_s)
    assert bench.state == state
    assert bench.core.outgoing(bench.now_s) == []


def test_its_inertial_sensors_are_reported_while_they_are_heard():
    bench = Bench(WiimoteOptions(motion_plus="on"), motion_plus=True)
    bench.ready()
    bench.tilt(right_deg=30.0)
    inertia = bench.run(0.5).inertia
    # The specific force points up, which is left of a remote that is tilted to the right.
    assert inertia.acceleration == pytest.approx(
        (0.0, 9.80665 * SIN[30], 9.80665 * math.cos(math.radians(30.0))), abs=9.81 * CLOSE
    )
    assert inertia.rates == pytest.approx((0.0, 0.0, 0.0), abs=0.05)
    bench.deaf = True
    assert bench.run(2.0 * STALE_AFTER_S).inertia is None


def test_a_remote_without_a_motionplus_tells_no_rates():
    bench = Bench()
    bench.ready()
    assert bench.state.inertia.rates is None
    assert bench.state.inertia.acceleration.z == pytest.approx(9.81, abs=9.81 * CLOSE)
