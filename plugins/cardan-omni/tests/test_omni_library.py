"""Finding and loading libHD, and the errors of that."""

import ctypes
import ctypes.util
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from cardan.errors import DeviceAccessError, DeviceNotFoundError
from cardan_omni.driver import library
from cardan_omni.driver.library import SIGNATURES, SOMETIMES, ErrorInfo, LibHD, error_words
from cardan_omni.protocol import ERROR_INFO, Capability, Error, Info

pytestmark = pytest.mark.matrix

COMPILER = shutil.which("cc") or shutil.which("gcc")
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")

FUNCTIONS = set(
    re.findall(
        r"\w+",
        """
hdInitDevice hdDisableDevice hdMakeCurrentDevice hdGetCurrentDevice hdBeginFrame hdEndFrame
hdGetBooleanv hdGetIntegerv hdGetFloatv hdGetDoublev hdGetLongv hdSetBooleanv hdSetIntegerv
hdSetFloatv hdSetDoublev hdSetLongv hdGetString hdEnable hdDisable hdIsEnabled hdGetError
hdGetErrorString hdCheckCalibration hdUpdateCalibration hdCheckCalibrationStyle
hdUpdateCalibrationMessage hdScaleGimbalAngles hdStartScheduler hdStopScheduler hdSetSchedulerRate
hdScheduleAsynchronous hdScheduleSynchronous hdUnschedule hdWaitForCompletion
hdGetSchedulerTimeStamp hdDeploymentLicense
""",
    )
)
"""Functions of HDAPI."""

FAKE = """
#include "hdapi.h"
#include <string.h>
static char written[1000];
static int errors[8], internals[8], count;
static HHD next;
static void say(const char *what) { strcat(written, what); strcat(written, " "); }
const char *said(void) { return written; }
void forget(void) { written[0] = 0; count = 0; }
void fail(int code, int internal) { errors[count] = code; internals[count++] = internal; }
void hand_out(HHD handle) { next = handle; }
HHD hdInitDevice(HDstring name)
{ say("init"); say(name ? name : "NULL"); return next; }
void hdDisableDevice(HHD d) { say(d == 0 ? "disable0" : d == 1 ? "disable1" : "disable"); }
void hdMakeCurrentDevice(HHD d) { say(d ? "current1" : "current0"); }
HHD hdGetCurrentDevice(void) { return 0; }
void hdBeginFrame(HHD d) {} void hdEndFrame(HHD d) {}
void hdGetBooleanv(HDenum n, HDboolean *v) {} void hdGetFloatv(HDenum n, HDfloat *v) {}
void hdGetIntegerv(HDenum n, HDint *v) { if (n == HD_OUTPUT_DOF) *v = 3; }
void hdGetDoublev(HDenum n, HDdouble *v) { if (n == HD_NOMINAL_MAX_FORCE) *v = 3.3; }
void hdGetLongv(HDenum n, HDlong *v) {}
void hdSetBooleanv(HDenum n, const HDboolean *v) {} void hdSetFloatv(HDenum n, const HDfloat *v) {}
void hdSetIntegerv(HDenum n, const HDint *v) { say(*v == 6 ? "light6" : "light"); }
void hdSetDoublev(HDenum n, const HDdouble *v) {} void hdSetLongv(HDenum n, const HDlong *v) {}
HDstring hdGetString(HDenum n) { return n == HD_DEVICE_MODEL_TYPE ? " Touch " : NULL; }
void hdEnable(HDenum n) { say("on"); } void hdDisable(HDenum n) { say("off"); }
HDboolean hdIsEnabled(HDenum n) { return n == HD_FORCE_OUTPUT; }
HDErrorInfo hdGetError(void)
{
    HDErrorInfo none = {0, 0, HD_INVALID_HANDLE}, error = {0, 0, 7};
    if (!count) return none;
    error.errorCode = errors[--count]; error.internalErrorCode = internals[count];
    return error;
}
HDstring hdGetErrorString(HDerror e) { return "?"; }
HDenum hdCheckCalibration(void) { return HD_CALIBRATION_NEEDS_MANUAL_INPUT; }
void hdUpdateCalibration(HDenum style) { say(style == 4 ? "inkwell" : "calibrate"); }
void hdStartScheduler(void) { say("start"); } void hdStopScheduler(void) { say("stop"); }
void hdSetSchedulerRate(HDulong hz) { say(hz == 1000 ? "rate1000" : "rate"); }
HDSchedulerHandle hdScheduleAsynchronous(HDSchedulerCallback f, void *u, HDushort p)
{ say(p == 65535 ? "schedule" : "late"); return 0x100000000ul + (HDSchedulerHandle)u; }
void hdScheduleSynchronous(HDSchedulerCallback f, void *u, HDushort p) {}
void hdUnschedule(HDSchedulerHandle h)
{ say(h == 0x100000001ul ? "unschedule1" : "unschedule2"); }
HDboolean hdWaitForCompletion(HDSchedulerHandle h, HDWaitCode c) { return c == 0 && h >> 32; }
HDdouble hdGetSchedulerTimeStamp(void) { return 0.0; }
"""
"""Source of a libHD that only records its calls."""


def compiled(folder, name, source, *flags):
    path = folder / name
    text = folder / f"{name}.c"
    text.write_text(source, encoding="utf-8")
    header = library.__file__.rsplit("/driver/", 1)[0] + "/protocol"
    command = [COMPILER, "-shared", "-fPIC", "-w", f"-I{header}", "-o", path, text, *flags]
    subprocess.run(command, check=True, timeout=30)
    return str(path)


@pytest.fixture(autouse=True)
def nothing_loaded(monkeypatch):
    """Start as in a new process, and keep the loaded libraries away from later tests."""
    monkeypatch.setattr(ctypes, "RTLD_GLOBAL", ctypes.RTLD_LOCAL)
    monkeypatch.setattr(library, "_loaded", [])
    monkeypatch.delenv(library.ENVIRONMENT, raising=False)


@pytest.fixture(scope="module")
def fake_path(tmp_path_factory):
    return compiled(tmp_path_factory.mktemp("fake"), "libHD-fake.so", FAKE)


@pytest.fixture
def fake(fake_path):
    """Return a loaded fake library and its log of calls."""
    found = library.load(fake_path)
    side = ctypes.CDLL(fake_path)
    side.said.restype = ctypes.c_char_p
    side.hand_out.argtypes = (ctypes.c_uint,)
    side.forget()
    side.hand_out(0)

    def said():
        words = side.said().decode().split()
        side.forget()
        return words

    return found, side, said


def test_every_function_of_hdapi_has_its_types():
    assert set(SIGNATURES) | set(SOMETIMES) == FUNCTIONS
    assert SIGNATURES["hdScheduleAsynchronous"][0] is ctypes.c_ulong
    assert SIGNATURES["hdIsEnabled"][0] is ctypes.c_ubyte
    assert ctypes.sizeof(ErrorInfo) == ERROR_INFO.size == 12


# -- missing files -----------------------------------------------------------------------------


def test_a_path_of_the_option_that_leads_nowhere(tmp_path):
    with pytest.raises(DeviceNotFoundError, match=r"option `library`.*no such file"):
        library.load(str(tmp_path / "libHD.so"))


def test_a_path_of_the_environment_that_leads_nowhere(tmp_path, monkeypatch):
    monkeypatch.setenv("CARDAN_LIBHD", str(tmp_path / "libHD.so"))
    with pytest.raises(DeviceNotFoundError, match=r"CARDAN_LIBHD.*no such file"):
        library.load()
    path, words = library.presence()
    assert path.endswith("libHD.so")
    assert "there is no file" in words


def test_a_name_that_the_loader_does_not_find():
    with pytest.raises(DeviceNotFoundError, match="give its path"):
        library.load("libHD-nowhere.so")


def test_no_library_at_all_says_what_to_install_and_how_to_try_without(monkeypatch):
    monkeypatch.setattr(library, "NAMES", ("libHD-a.so", "libHD-b.so"))
    with pytest.raises(DeviceNotFoundError) as caught:
        library.load()
    words = str(caught.value)
    for needed in ("libHD-a.so, libHD-b.so", "vendor", "`library`", "$CARDAN_LIBHD", "cardan sim"):
        assert needed in words
    assert library.presence() == ("", f"there is no libHD: {library.ADVICE}")


def test_the_loaders_own_folders_are_looked_through(tmp_path, monkeypatch):
    (tmp_path / "libHD-c.so").write_bytes(b"")
    monkeypatch.setattr(library, "NAMES", ("libHD-b.so", "libHD-c.so"))
    monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))
    assert library.presence() == ("libHD-c.so", "")


# -- files that do not load --------------------------------------------------------------------


def test_a_text_is_no_library(tmp_path):
    path = tmp_path / "libHD.so"
    path.write_text("version https://git-lfs.github.com/spec/v1\n" * 40, encoding="utf-8")
    with pytest.raises(DeviceAccessError, match="not a library for this machine"):
        library.load(str(path))


def test_a_file_that_was_cut_off_is_not_mapped(fake_path, tmp_path):
    """The loader would map the missing part, and the process would die of SIGBUS."""
    whole = Path(fake_path).read_bytes()
    for size in (30, 64, 500, len(whole) // 2):
        cut = tmp_path / f"cut-{size}.so"
        cut.write_bytes(whole[:size])
        with pytest.raises(DeviceAccessError, match=r"not whole|not a library"):
            library.load(str(cut))


def test_another_library_is_no_libhd():
    name = ctypes.util.find_library("m")
    with pytest.raises(DeviceAccessError, match="not libHD: it has no hdInitDevice"):
        library.load(name)


@needs_compiler
@pytest.mark.parametrize(
    ("dependency", "advice"),
    [
        ("libPhantomIOLib42.so", "Touch device driver"),
        ("libPHANToMIO.so.4", "FireWire"),
        ("libncurses.so.5", "libncurses5"),
        ("libsomething.so.1", "LD_LIBRARY_PATH"),
    ],
)
def test_a_dependency_that_is_missing_is_named(tmp_path, dependency, advice):
    needed = compiled(
        tmp_path, dependency, "int io(void) { return 1; }", f"-Wl,-soname={dependency}"
    )
    path = compiled(tmp_path, "libHD.so", "int io(void); int hd(void) { return io(); }", needed)
    (tmp_path / dependency).unlink()
    with pytest.raises(DeviceAccessError) as caught:
        library.load(path)
    assert f"needs {dependency}" in str(caught.value)
    assert advice in str(caught.value)


@needs_compiler
def test_a_device_driver_of_another_release_is_reported(tmp_path):
    path = compiled(tmp_path, "libHD.so", "int newer(void); int hd(void) { return newer(); }")
    with pytest.raises(DeviceAccessError, match=r"it lacks newer\b.*same release"):
        library.load(path)


# -- one library in a process ------------------------------------------------------------------


@pytest.mark.real
@needs_compiler
def test_it_is_loaded_once_and_no_other_beside_it(fake_path, tmp_path, monkeypatch):
    found = library.load(fake_path)
    assert library.load(fake_path) is found
    assert library.load() is found
    monkeypatch.setenv("CARDAN_LIBHD", fake_path)
    assert library.load() is found
    other = compiled(tmp_path, "libHD.so", FAKE)
    with pytest.raises(DeviceAccessError, match="cannot be loaded beside it"):
        library.load(other)


@needs_compiler
def test_the_addresses_are_those_of_the_library(fake, fake_path):
    found, *_ = fake
    known = ctypes.CDLL(fake_path)
    address = ctypes.cast(known.hdBeginFrame, ctypes.c_void_p).value
    assert found.functions["hdBeginFrame"] == address
    assert set(SIGNATURES) <= set(found.functions)
    assert "hdScaleGimbalAngles" not in found.functions


# -- devices -----------------------------------------------------------------------------------


@needs_compiler
def test_handle_0_is_a_device_and_the_first_has_no_name(fake):
    found, _, said = fake
    assert found.init_device("") == 0
    assert said() == ["init", "NULL"]
    found.disable_device(0)
    found.disable_device(0)
    assert said() == ["disable0"]
    assert found.init_device("left") == 0
    assert said() == ["init", "left"]
    found.disable_device(0)


@needs_compiler
@pytest.mark.parametrize(
    ("code", "internal", "kind", "words"),
    [
        (Error.INVALID_LICENSE, 0, DeviceAccessError, "license"),
        (Error.DEVICE_ALREADY_INITIATED, 0, DeviceAccessError, "already open"),
        (Error.COMM_ERROR, -28, DeviceNotFoundError, "link-local.*-28|-28.*link-local"),
        (Error.COMM_ERROR, 0, DeviceNotFoundError, "plugged in.*GTDD_HOME"),
        (Error.DEVICE_FAULT, 0, DeviceNotFoundError, "'right'"),
        (None, 0, DeviceNotFoundError, "setup tool"),
    ],
)
def test_a_device_that_does_not_open_is_explained(fake, code, internal, kind, words):
    found, side, _ = fake
    side.hand_out(0xFFFFFFFF)
    genuine = found.errors
    if code is not None:
        calls = iter(range(10))

        def errors():
            if next(calls) == 1:
                side.fail(int(code), internal)
            return genuine()

        found.errors = errors
    with pytest.raises(kind, match=words):
        found.init_device("right")


@needs_compiler
def test_bad_handle_is_a_number_like_any(fake):
    """The informational code 0x104 is no failure of hdInitDevice."""
    found, side, _ = fake
    side.hand_out(Error.BAD_HANDLE)
    assert found.init_device("") == Error.BAD_HANDLE
    found.disable_device(Error.BAD_HANDLE)


@needs_compiler
def test_values_of_a_device(fake):
    found, _, said = fake
    handle = found.init_device("")
    assert found.string(handle, Info.DEVICE_MODEL_TYPE) == "Touch"
    assert found.string(handle, Info.DEVICE_VENDOR) == ""
    assert found.integer(handle, Info.OUTPUT_DOF) == 3
    assert found.doubles(handle, Info.NOMINAL_MAX_FORCE, 1) == (3.3,)
    assert found.doubles(handle, Info.NOMINAL_MAX_STIFFNESS, 2) == (0.0, 0.0)
    said()
    found.enable(handle, Capability.FORCE_OUTPUT, True)
    found.enable(handle, Capability.FORCE_OUTPUT, False)
    found.update_calibration(handle, 4)
    assert said() == ["on", "off", "inkwell"]
    found.disable_device(handle)


@needs_compiler
def test_errors_are_taken_newest_first_and_whole(fake):
    found, side, _ = fake
    side.fail(int(Error.WARM_MOTORS), 0)
    side.fail(int(Error.COMM_ERROR), -28)
    errors = found.errors()
    assert [(each.code, each.internal, each.device) for each in errors] == [
        (Error.COMM_ERROR, -28, 7),
        (Error.WARM_MOTORS, 0, 7),
    ]
    assert "0x0302, internal -28" in errors[0].words
    assert found.errors() == []


@needs_compiler
def test_one_loop_serves_two_devices_until_the_last_has_gone(fake):
    found, side, said = fake
    first = found.init_device("left")
    one = found.schedule(1, 1, first)
    assert one == 0x100000001  # not truncated to 32 bits
    assert found.scheduled(one)
    assert said() == ["init", "left", "rate1000", "schedule", "start"]
    side.hand_out(1)
    second = found.init_device("right")
    two = found.schedule(1, 2, second)
    assert said() == ["stop", "init", "right", "start", "schedule"]
    found.string(first, Info.VERSION)
    assert said() == ["current0"]
    found.unschedule(one, first)
    found.disable_device(first)
    assert said() == ["stop", "unschedule1", "start", "disable0"]
    found.unschedule(two, second)
    found.disable_device(second)
    assert said() == ["stop", "unschedule2", "disable1"]


@needs_compiler
def test_a_loop_that_does_not_take_the_callback(fake):
    found, side, said = fake
    handle = found.init_device("")
    genuine = found.errors
    calls = iter(range(10))

    def errors():
        if next(calls) == 1:
            side.fail(int(Error.SCHEDULER_FULL), 0)
        return genuine()

    found.errors = errors
    with pytest.raises(DeviceAccessError, match=r"does not start.*no more callbacks"):
        found.schedule(1, 1, handle)
    assert "start" not in said()
    found.disable_device(handle)


def test_every_error_has_words_and_its_number():
    for code in Error:
        if code is not Error.SUCCESS:
            words = error_words(code)
            assert "does not name" not in words
            assert f"0x{code:04x}" in words
    assert "0x0999" in error_words(0x999)


def test_the_library_is_a_libhd_only_with_all_its_functions():
    class Empty:
        pass

    with pytest.raises(DeviceAccessError, match="has no hdInitDevice, hdDisableDevice"):
        LibHD(Empty(), "somewhere")
