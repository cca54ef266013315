"""Events and requests of evdev and uinput: worked bytes, round trips, and kernel headers."""

import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from cardan.protocols.evdev import (
    codes,
    events as evdev_events,
    requests,
    uinput,
)
from cardan.protocols.evdev.events import EVENT_BYTES, InputEvent, MalformedPacket

pytestmark = pytest.mark.skipif(
    struct.calcsize("@l") != 8 or sys.byteorder != "little",
    reason="the worked bytes are those of a 64-bit little-endian machine",
)

HEADERS = Path("/usr/include/linux")
# The kernel's names, not Cardan's labels.
OTHER_NAMES = {
    "left-shoulder": "TL",
    "right-shoulder": "TR",
    "left-trigger": "TL2",
    "right-trigger": "TR2",
    "left-stick": "THUMBL",
    "right-stick": "THUMBR",
    "dpad-up": "DPAD_UP",
    "dpad-down": "DPAD_DOWN",
    "dpad-left": "DPAD_LEFT",
    "dpad-right": "DPAD_RIGHT",
}


@pytest.mark.judged(device="Gamepad", transport="evdev", by="worked bytes")
def test_worked_frame_of_a_pad():
    """Example of docs/gamepad.md: left stick half away, and a button."""
    data = bytes.fromhex(
        "00f15365 00000000 80380100 00000000 0300 0100 00c0ffff"
        "00f15365 00000000 80380100 00000000 0100 3001 01000000"
        "00f15365 00000000 80380100 00000000 0000 0000 00000000"
    )
    frame = [
        InputEvent(1700000000, 80000, evdev_events.EV_ABS, codes.ABS_Y, -16384),
        InputEvent(1700000000, 80000, evdev_events.EV_KEY, codes.BTN_SOUTH, 1),
        InputEvent(1700000000, 80000, evdev_events.EV_SYN, evdev_events.SYN_REPORT, 0),
    ]
    assert evdev_events.decode_events(data) == frame
    assert evdev_events.encode_events(frame) == data


@pytest.mark.judged(device="Gamepad", transport="evdev", by="worked bytes")
def test_worked_rumble():
    data = bytes.fromhex("5000 ffff 0000 0000 0000 9001 0000 0000 0080 0040").ljust(48, b"\0")
    assert requests.encode_rumble(requests.Rumble(-1, 0x8000, 0x4000, 400)) == data
    assert requests.decode_rumble(data) == requests.Rumble(-1, 0x8000, 0x4000, 400)


@pytest.mark.parametrize(
    ("request_number", "published"),
    [
        (requests.EVIOCGID, 0x80084502),
        (requests.EVIOCSFF, 0x40304580),
        (requests.EVIOCGRAB, 0x40044590),
        (requests.eviocgabs(codes.ABS_X), 0x80184540),
        (uinput.UI_DEV_CREATE, 0x5501),
        (uinput.UI_DEV_SETUP, 0x405C5503),
        (uinput.UI_ABS_SETUP, 0x401C5504),
        (uinput.UI_BEGIN_FF_UPLOAD, 0xC06855C8),
        (uinput.UI_END_FF_UPLOAD, 0x406855C9),
    ],
)
def test_published_request_numbers(request_number, published):
    assert request_number == published


events = st.builds(
    InputEvent,
    st.integers(-(2**63), 2**63 - 1),
    st.integers(-(2**63), 2**63 - 1),
    st.integers(0, 0xFFFF),
    st.integers(0, 0xFFFF),
    st.integers(-(2**31), 2**31 - 1),
)


@given(st.lists(events, min_size=1, max_size=8))
def test_events_come_back(frame):
    assert evdev_events.decode_events(evdev_events.encode_events(frame)) == frame


@given(st.binary(max_size=200))
def test_no_bytes_raise(data):
    value = evdev_events.decode_events(data)
    assert isinstance(value, MalformedPacket) == (not data or len(data) % EVENT_BYTES != 0)
    requests.decode_rumble(data)
    requests.decode_call(data)
    requests.decode_absinfo(data)
    requests.decode_id(data)
    requests.decode_int(data)
    requests.decode_bits(data)


def test_what_does_not_fit_is_refused():
    assert requests.decode_id(bytes(7)) == requests.InputId(0, 0, 0, 0)
    with pytest.raises(ValueError, match="cannot encode"):
        evdev_events.encode_events([InputEvent(0, 0, 0x10000, 0, 0)])
    with pytest.raises(ValueError, match="cannot encode"):
        requests.encode_rumble(requests.Rumble(-1, 0x10000, 0, 0))


@given(st.sets(st.integers(0, 0x2FF)))
def test_masks_come_back(keys):
    assert requests.decode_bits(requests.encode_bits(keys, 96)) == keys


@given(
    st.sampled_from(
        [
            requests.EVIOCGID, requests.EVIOCGNAME, requests.EVIOCGKEY, requests.EVIOCSFF,
            requests.EVIOCGRAB, requests.EVIOCGEFFECTS, *map(requests.eviocgabs, range(64)),
            *map(requests.eviocgbit, requests.BITS_BYTES),
        ]
    ),
    st.integers(-200, 0),
    st.data(),
)  # fmt: skip
def test_calls_come_back_and_are_never_taken_for_events(number, result, data):
    size = requests.argument_bytes(number)
    call = requests.IoctlCall(number, result, data.draw(st.binary(min_size=size, max_size=size)))
    packet = requests.encode_call(call)
    assert len(packet) % EVENT_BYTES
    assert requests.decode_call(packet) == call


def test_an_upload_of_another_effect_is_distinguished():
    argument = bytearray(uinput.begin_upload(7))
    argument[8:56] = requests.encode_rumble(requests.Rumble(3, 1, 2, 100))
    assert uinput.decode_upload(bytes(argument)) == (7, requests.Rumble(3, 1, 2, 100))
    assert uinput.end_upload(bytes(argument), -22)[:8] == struct.pack("@Ii", 7, -22)
    argument[8] = 0x51  # FF_PERIODIC
    assert uinput.decode_upload(bytes(argument)) == (7, None)


# ---------------------------------------------------------------------------------------------
# The kernel's headers


def header_codes():
    path = HEADERS / "input-event-codes.h"
    if not path.exists():
        pytest.skip(f"{path} is not there: install the Debian package linux-libc-dev")
    text = path.read_text() + (HEADERS / "input.h").read_text()
    found = {}
    for name, value in re.findall(r"^#define\s+(\w+)\s+(\w+)", text, re.MULTILINE):
        found[name] = found.get(value, value)
    return {name: int(value, 0) for name, value in found.items() if value[0].isdigit()}


@pytest.mark.judged(device="Keyboard", transport="evdev", by="the kernel's headers")
@pytest.mark.judged(device="Gamepad", transport="evdev", by="the kernel's headers")
def test_codes_are_those_of_the_header():
    header = header_codes()
    for label, code in codes.KEY_CODES.items():
        assert header[f"KEY_{label.replace('-', '').upper()}"] == code, label
    for label, code in codes.PAD_CODES.items():
        assert header[f"BTN_{OTHER_NAMES.get(label, label.upper())}"] == code, label
    names = [
        (module, name)
        for module in (codes, evdev_events)
        for name in vars(module)
        if name.startswith(("ABS_", "BTN_", "EV_", "SYN_", "MSC_", "FF_"))
    ]
    for module, name in names:
        if name in ("ABS_COUNT", "FF_COUNT", "EV_UINPUT"):
            continue
        assert header[name] == getattr(module, name), name
    assert header["KEY_MAX"] + 1 == codes.KEY_COUNT
    assert header["ABS_MAX"] + 1 == codes.ABS_COUNT
    assert header["FF_MAX"] + 1 == codes.FF_COUNT


@pytest.mark.judged(device="Gamepad", transport="evdev", by="the kernel's headers")
def test_numbers_and_layouts_are_those_of_the_compiled_headers(tmp_path):
    compiler = shutil.which("cc")
    if compiler is None or not (HEADERS / "uinput.h").exists():
        pytest.skip("no C compiler or no headers: install the Debian packages gcc, linux-libc-dev")
    ours = {
        "sizeof(struct input_event)": EVENT_BYTES,
        "sizeof(struct ff_effect)": requests.EFFECT_BYTES,
        "offsetof(struct ff_effect, u)": requests._UNION_AT,
        "offsetof(struct uinput_ff_upload, effect)": uinput._UPLOAD_AT,
        "EVIOCGID": requests.EVIOCGID,
        "EVIOCGNAME(128)": requests.EVIOCGNAME,
        "EVIOCGKEY(96)": requests.EVIOCGKEY,
        "EVIOCSFF": requests.EVIOCSFF,
        "EVIOCRMFF": requests.EVIOCRMFF,
        "EVIOCGEFFECTS": requests.EVIOCGEFFECTS,
        "EVIOCGRAB": requests.EVIOCGRAB,
        "EVIOCGBIT(0, 4)": requests.eviocgbit(0),
        "EVIOCGBIT(EV_KEY, 96)": requests.eviocgbit(1),
        "EVIOCGBIT(EV_ABS, 8)": requests.eviocgbit(3),
        "EVIOCGBIT(EV_FF, 16)": requests.eviocgbit(0x15),
        "EVIOCGABS(ABS_HAT0Y)": requests.eviocgabs(codes.ABS_HAT0Y),
        "UI_GET_SYSNAME(64)": uinput.UI_GET_SYSNAME,
        "EV_UINPUT": evdev_events.EV_UINPUT,
        **{
            name: getattr(uinput, name)
            for name in vars(uinput)
            if name.startswith("UI_") and name != "UI_GET_SYSNAME"
        },
    }
    lines = "\n".join(f'printf("%lu\\n", (unsigned long)({words}));' for words in ours)
    source = tmp_path / "numbers.c"
    source.write_text(
        "#include <stdio.h>\n#include <stddef.h>\n#include <linux/input.h>\n"
        f"#include <linux/uinput.h>\nint main(void) {{\n{lines}\nreturn 0; }}\n"
    )
    program = tmp_path / "numbers"
    subprocess.run([compiler, "-o", program, source], check=True, timeout=60)
    printed = subprocess.run([program], check=True, timeout=10, capture_output=True, text=True)
    theirs = dict(zip(ours, map(int, printed.stdout.split()), strict=True))
    assert theirs == ours
