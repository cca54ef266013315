"""The wrapper of the simulated libHD, and the programs in its README."""

from __future__ import annotations

import contextlib
import ctypes
import io
import itertools
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from cardan.errors import ScriptError
from cardan.sim_peers.base import parse_script
from cardan_omni import peer as omni, protocol as hdapi
from cardan_omni.peer import (
    FAULTS,
    SCRIPT_VERBS,
    SCRIPTS,
    OmniFault,
    OmniSettings,
    SimulatedOmni,
    compile_script,
    load_motion,
    run_program,
)
from cardan_omni.protocol import (
    MAX_SCHEDULER_PRIORITY,
    Calibration,
    CalibrationStyle,
    CallbackCode,
    Capability,
    State,
)
from tests.waiting import STOOD_STILL, done_again

pytestmark = [
    pytest.mark.skipif(not omni.available(), reason="the C parts were not compiled"),
    pytest.mark.matrix,
]

HELD_S = 0.025
"""Time for which the amplifier holds a force that is not renewed."""
SETTLES_S = 1.0
"""Time until the hand rests on the floor again after the force was dropped."""
ROOT = Path(__file__).parents[3]
PAGE = ROOT / "plugins" / "cardan-omni" / "README.md"
TOUCH = ROOT / "examples" / "peers" / "touch.c"
CALLBACK = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p)


class Program:
    """A program for libHD that sends a force (N, device frame) and reads the state."""

    def __init__(self, **settings):
        self.omni = SimulatedOmni(OmniSettings(virtual=True, **settings))

        def function(name, result, *arguments):
            return ctypes.CFUNCTYPE(result, *arguments)(self.omni.address(name))

        self.init = function("hdInitDevice", ctypes.c_uint, ctypes.c_char_p)
        self.begin = function("hdBeginFrame", None, ctypes.c_uint)
        self.end = function("hdEndFrame", None, ctypes.c_uint)
        self.get = function("hdGetDoublev", None, ctypes.c_uint, ctypes.c_void_p)
        self.get_int = function("hdGetIntegerv", None, ctypes.c_uint, ctypes.c_void_p)
        self.set = function("hdSetDoublev", None, ctypes.c_uint, ctypes.c_void_p)
        self.enable = function("hdEnable", None, ctypes.c_uint)
        self.start = function("hdStartScheduler", None)
        self.stop = function("hdStopScheduler", None)
        self.disable = function("hdDisableDevice", None, ctypes.c_uint)
        self.schedule = function(
            "hdScheduleAsynchronous", ctypes.c_ulong, CALLBACK, ctypes.c_void_p, ctypes.c_ushort
        )
        self.force = (ctypes.c_double * 3)()
        self.position = (ctypes.c_double * 3)()
        self.transform = (ctypes.c_double * 16)()
        self.buttons = ctypes.c_int()
        self.seen = []

    def __enter__(self):
        self.device = self.init(None)
        assert self.device != hdapi.INVALID_HANDLE
        self.enable(Capability.FORCE_OUTPUT)
        self._callback = CALLBACK(self._tick)
        self.schedule(self._callback, None, MAX_SCHEDULER_PRIORITY)
        self.start()
        return self

    def __exit__(self, *_exception):
        self.stop()
        self.disable(self.device)

    def _tick(self, _user):
        self.begin(self.device)
        self.get(State.CURRENT_POSITION, self.position)
        self.get(State.CURRENT_TRANSFORM, self.transform)
        self.get_int(State.CURRENT_BUTTONS, ctypes.byref(self.buttons))
        self.set(State.CURRENT_FORCE, self.force)
        self.end(self.device)
        self.seen.append(self.buttons.value)
        return CallbackCode.CONTINUE


def test_time_is_what_steps_make_of_it():
    with Program() as program:
        before_s = program.omni.now_s
        assert program.omni.step(250) == 250
        assert program.omni.now_s - before_s == pytest.approx(0.25)
        assert program.omni.truth().ticks == 250
        assert len(program.seen) == 250
    assert program.omni.step(5) == 0


def test_the_hand_carries_the_stylus_along_its_own_axes():
    with Program() as program:
        program.omni.hand((0.02, 0.03, 0.04), (0.0, 0.0, 0.3))
        program.omni.step(1500)
        truth = program.omni.truth()
        assert truth.hand_target_m == pytest.approx((0.02, 0.03, 0.04))
        assert truth.position_m == pytest.approx((0.02, 0.03, 0.04), abs=0.002)
        # x right, y up, z to the operator, mm
        assert tuple(program.position) == pytest.approx((-30.0, 40.0, -20.0), abs=2.0)
        columns = [tuple(program.transform[4 * i : 4 * i + 3]) for i in range(3)]
        # After a turn to the left the stylus's z axis, which points at the operator, points to the
        # right.
        assert columns[2] == pytest.approx((0.2955, 0.0, 0.9553), abs=0.01)


def test_forces_have_the_hand_s_axes_too():
    with Program() as program:
        program.force[:] = (0.0, 0.0, -1.0)  # away from the operator: forward
        program.omni.step(3000)
        truth = program.omni.truth()
        assert truth.commanded_n == pytest.approx((1.0, 0.0, 0.0))
        assert truth.delivered_n == pytest.approx((1.0, 0.0, 0.0), abs=0.01)
        assert truth.amplifier
        assert truth.position_m.x == pytest.approx(1.0 / 200.0, abs=0.26 / 200.0 + 1e-4)
        assert truth.delivered_j > 0.0 > truth.hand_j


def test_a_push_of_the_world():
    with Program() as program:
        program.omni.push((0.0, 2.0, 0.0))
        program.omni.step(1000)
        pushed = program.omni.truth().position_m.y
        program.omni.push()
        program.omni.step(1000)
    assert pushed == pytest.approx(2.0 / 200.0, abs=0.002)
    assert abs(program.omni.truth().position_m.y) < 0.002


def test_letting_go_and_the_push_of_the_hand():
    with Program() as program:
        program.omni.hand(push_n=(0.0, 0.0, 1.5))
        program.omni.step(1000)
        assert program.omni.truth().position_m.z > 0.005
        program.omni.hand(gripped=False)
        program.omni.step(10)
        truth = program.omni.truth()
        assert not truth.gripped
        assert truth.hand_force_n == (0.0, 0.0, 0.0)


def test_the_stylus_that_a_script_lets_go_falls():
    with Program(motion=load_motion("let-go")) as program:
        program.omni.step(4700)
        assert not program.omni.truth().gripped
        assert program.omni.truth().position_m.z > -0.01
        program.omni.step(700)
        truth = program.omni.truth()
        assert truth.position_m.z < -0.1  # to the stop
        assert truth.hand_force_n == (0.0, 0.0, 0.0)
        program.omni.step(4000)
        assert program.omni.truth().position_m == pytest.approx((0.0, 0.0, 0.0), abs=0.002)


def test_buttons_and_inkwell():
    with Program() as program:
        program.omni.hand(buttons=2)
        program.omni.step(20)
        assert program.seen[-1] == 2
        program.omni.hand(docked=True)
        program.omni.step(2000)
        truth = program.omni.truth()
        assert truth.docked
        assert tuple(program.position) == pytest.approx((0.0, -65.5107, -88.1142), abs=0.1)


def test_faults_begin_and_end():
    with Program() as program:
        program.omni.step(100)
        program.omni.fault("warm-motors")
        program.omni.step(100)
        assert max(program.omni.truth().temperature) >= 1.0
        assert not program.omni.truth().amplifier
        with pytest.raises(ScriptError, match="there is no fault 'fire'"):
            program.omni.fault("fire")
        with pytest.raises(ScriptError, match="is not in"):
            program.omni.fault("slow-ticks", 0.5)
        program.omni.fault("warm-motors", 0.0)
        program.omni.step(100)
        assert max(program.omni.truth().temperature) < 0.8


def test_every_fault_and_every_script_is_known_to_the_library():
    with Program() as program:
        for switch in FAULTS:
            for value in (switch.default, switch.lowest, min(switch.highest, 1e9)):
                program.omni.fault(switch.name, value)
            program.omni.fault(switch.name, 0.0)
    for switch in FAULTS:
        planned = (OmniFault(switch.name, switch.default, 2.0),)
        SimulatedOmni(OmniSettings(virtual=True, faults=planned))
    for name in SCRIPTS:
        SimulatedOmni(OmniSettings(virtual=True, motion=load_motion(name)))


def test_settings_at_their_limits_are_taken(tmp_path):
    for settings in (
        OmniSettings(virtual=True, hand_stiffness_n_m=5000.0, hand_damping_n_s_m=100.0),
        OmniSettings(hand_mass_kg=0.0, droop_n=0.0, friction_n=0.0, rate_hz=2000, thermal_s=0.1),
        OmniSettings(serial="", device="Left Device", log=str(tmp_path / "truth.csv")),
    ):
        assert SimulatedOmni(settings).settings is settings


def test_a_script_is_played_as_it_was_worked_out():
    text = "0.2 click 1\n0.5 move 0 0.04 0 over 1\n2 grip off"
    motion = compile_script(parse_script(text, SCRIPT_VERBS))
    with Program(motion=motion) as program:
        program.omni.step(1000)
        assert program.omni.truth().hand_target_m.y == pytest.approx(0.02, abs=1e-4)
        assert 90 <= program.seen.count(1) <= 110
        program.omni.step(800)
        truth = program.omni.truth()
        assert truth.position_m.y == pytest.approx(0.04, abs=0.002)
        assert truth.gripped
        assert not truth.script_done
        program.omni.step(300)
        assert not program.omni.truth().gripped
        assert program.omni.truth().script_done


def test_the_drawing_presses_on_a_surface():
    with Program(motion=load_motion("drawing")) as program:
        pressed = []
        for _ in range(19_000):
            program.omni.step()
            # The surface: 20 mm below the origin, 1 N/mm with some damping, up to 3 N.
            depth_mm = -20.0 - program.position[1]
            program.force[1] = min(max(0.3 * depth_mm, 0.0), 3.0)
            if program.omni.now_s > 9.0:
                pressed.append(program.omni.truth().delivered_n.z)
    assert sum(pressed) / len(pressed) == pytest.approx(0.7, abs=0.15)


def test_a_cold_device_is_calibrated_in_the_inkwell():
    with Program(cold=True, motion=load_motion("inkwell")) as program:
        hd_check = ctypes.CFUNCTYPE(ctypes.c_uint)(program.omni.address("hdCheckCalibration"))
        hd_update = ctypes.CFUNCTYPE(None, ctypes.c_uint)(
            program.omni.address("hdUpdateCalibration")
        )
        program.omni.step(10)
        assert program.omni.truth().docked
        assert not program.omni.truth().calibrated
        assert hd_check() == Calibration.NEEDS_UPDATE
        hd_update(CalibrationStyle.INKWELL)
        program.omni.step(100)
        assert hd_check() == Calibration.OK
        program.omni.step(5000)
        truth = program.omni.truth()
        assert not truth.docked
        assert truth.position_m == pytest.approx((0.0, 0.0, 0.0), abs=0.002)
        assert tuple(program.position) == pytest.approx((0.0, 0.0, 0.0), abs=2.0)


def test_the_device_as_new_with_each_wrapper():
    with Program() as program:
        program.omni.step(100)
        with pytest.raises(ScriptError, match="initialized"):
            program.omni.configure(OmniSettings())
    assert SimulatedOmni().truth().ticks == 0


def test_addresses():
    program = SimulatedOmni()
    assert program.address("hdBeginFrame") != program.address("hdEndFrame") != 0
    with pytest.raises(AttributeError):
        program.address("hdNothing")


# -- the page ----------------------------------------------------------------------------------


def reported():
    page = PAGE.read_text(encoding="utf-8")
    start = page.index("## The haptic device: `cardan sim omni`")
    end = re.search(r"^## ", page[start + 3 :], re.MULTILINE)
    return page[start : start + 3 + end.start()] if end else page[start:]


def blocks(language):
    found = re.findall(r"^```(\w*)\n(.*?)^```$", reported(), re.MULTILINE | re.DOTALL)
    return [text for name, text in found if name == language]


@pytest.mark.real
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_the_program_in_c_feels_its_floor(tmp_path):
    headers = Path(hdapi.__file__).parent
    strict = ["-Wall", "-Wextra", "-Werror", "-std=gnu11"]
    subprocess.run(
        ["cc", *strict, "-I", headers, "-o", tmp_path / "touch", TOUCH, "-ldl"],
        check=True,
        timeout=60,
    )
    script = next(block for block in blocks("") if "let the floor carry" in block)
    motion = compile_script(parse_script(script, SCRIPT_VERBS))
    log = tmp_path / "truth.csv"

    def touched():
        # The program's output bypasses Python and goes to the test's standard output.
        with (tmp_path / "out").open("w+") as out, _standard_output(out.fileno()):
            code = run_program([str(tmp_path / "touch")], OmniSettings(motion=motion, log=str(log)))
        assert code == 0
        stamps_s = [float(row.partition(",")[0]) for row in log.read_text().splitlines()[1:]]
        newest_s = [stamp_s for stamp_s in stamps_s if stamp_s > stamps_s[-1] - SETTLES_S]
        gap_s = max(later - earlier for earlier, later in itertools.pairwise(newest_s))
        # The amplifier drops a force that is not renewed, including the floor's.
        return f"the scheduler {STOOD_STILL} {gap_s:.3f} s" if gap_s > HELD_S else ""

    done_again(touched)
    lines = (tmp_path / "out").read_text(encoding="utf-8").splitlines()
    values = [tuple(map(float, re.findall(r"-?\d+\.\d", line))) for line in lines]
    assert len(values) == 10
    assert values[0] == pytest.approx((0.0, 0.0), abs=0.5)
    height_mm, force_n = values[-1]
    assert height_mm == pytest.approx(-10.0 - 0.8 / 0.3, abs=1.5)
    assert force_n == pytest.approx(0.8, abs=0.4)
    rows = log.read_text(encoding="utf-8").splitlines()
    assert rows[0].startswith("monotonic_s,")
    assert len(rows) > 1000


@contextlib.contextmanager
def _standard_output(descriptor):
    before = os.dup(1)
    os.dup2(descriptor, 1)
    try:
        yield
    finally:
        os.dup2(before, 1)
        os.close(before)


def test_the_program_in_python_says_what_the_page_says():
    (source,) = blocks("python")
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(source, {})
    assert said.getvalue() in blocks("")
