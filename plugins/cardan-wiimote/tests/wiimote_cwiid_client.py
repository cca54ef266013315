"""Uses a remote through Debian's libcwiid and prints its readings as JSON.

Runs in a separate process, because the library does not always end its threads. usage:
wiimote_cwiid_client.py LIBRARY DIRECTORY WHAT, with WHAT remote, nunchuk or motion-plus
"""

from __future__ import annotations

import ctypes
import json
import os
import socket
import sys
import time
from collections.abc import Callable

MOTION_PLUS_FLAG = 0x10
MODE_BUTTONS, MODE_ACCELEROMETER, MODE_CAMERA = 0x02, 0x04, 0x08
MODE_NUNCHUK, MODE_MOTION_PLUS = 0x10, 0x80
EXTENSION_NONE, EXTENSION_NUNCHUK, EXTENSION_MOTION_PLUS = 0, 1, 4
EEPROM_SPACE, REGISTER_SPACE = 0x00, 0x04
PATIENCE_S = 4.0


class Dot(ctypes.Structure):
    _fields_ = [
        ("valid", ctypes.c_char),
        ("position", ctypes.c_uint16 * 2),
        ("size", ctypes.c_int8),
    ]


class Nunchuk(ctypes.Structure):
    _fields_ = [
        ("stick", ctypes.c_uint8 * 2),
        ("accelerometer", ctypes.c_uint8 * 3),
        ("buttons", ctypes.c_uint8),
    ]


class MotionPlus(ctypes.Structure):
    _fields_ = [("rates", ctypes.c_uint16 * 3), ("slow", ctypes.c_uint8 * 3)]


class Extension(ctypes.Union):
    _fields_ = [("nunchuk", Nunchuk), ("motion_plus", MotionPlus)]


class State(ctypes.Structure):
    _fields_ = [
        ("mode", ctypes.c_uint8),
        ("led", ctypes.c_uint8),
        ("rumble", ctypes.c_uint8),
        ("battery", ctypes.c_uint8),
        ("buttons", ctypes.c_uint16),
        ("accelerometer", ctypes.c_uint8 * 3),
        ("dots", Dot * 4),
        ("extension_type", ctypes.c_int),
        ("extension", Extension),
        ("error", ctypes.c_int),
    ]


class Calibration(ctypes.Structure):
    _fields_ = [("zero", ctypes.c_uint8 * 3), ("one", ctypes.c_uint8 * 3)]


def connect(directory: str, psm: int) -> int:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    sock.connect(os.path.join(directory, f"psm{psm:x}"))
    return sock.detach()


def main(library: str, directory: str, what: str) -> int:
    cwiid = ctypes.CDLL(library, use_errno=True)
    cwiid.cwiid_new.restype = ctypes.c_void_p
    handle = cwiid.cwiid_new(connect(directory, 0x11), connect(directory, 0x13), 0)
    if not handle:
        return 1
    remote = ctypes.c_void_p(handle)
    state = State()

    def wait_for(predicate: Callable[[State], bool]) -> bool:
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            cwiid.cwiid_get_state(remote, ctypes.byref(state))
            if predicate(state):
                return True
            time.sleep(0.01)
        return False

    seen: dict[str, object] = {}
    # libcwiid requests the status by itself; 0 is its memory's initial value.
    seen["battery-told"] = wait_for(lambda s: s.battery != 0)
    seen["battery"] = state.battery
    calibration = Calibration()
    seen["calibration-status"] = cwiid.cwiid_get_acc_cal(remote, 0, ctypes.byref(calibration))
    seen["zero"], seen["one"] = list(calibration.zero), list(calibration.one)
    memory = ctypes.create_string_buffer(20)
    seen["read-status"] = cwiid.cwiid_read(remote, EEPROM_SPACE, 0x16, 20, memory)
    seen["eeprom"] = memory.raw.hex()
    cwiid.cwiid_set_led(remote, 0b1010)
    cwiid.cwiid_set_rumble(remote, 1)
    if what == "remote":
        mode = MODE_BUTTONS | MODE_ACCELEROMETER | MODE_CAMERA
        seen["mode-status"] = cwiid.cwiid_set_rpt_mode(remote, mode)
        seen["tilted"] = wait_for(
            lambda s: s.accelerometer[0] > 0 and s.buttons != 0 and s.dots[0].valid != b"\0"
        )
        seen["dot"] = list(state.dots[0].position)
    elif what == "nunchuk":
        seen["found"] = wait_for(lambda s: s.extension_type == EXTENSION_NUNCHUK)
        seen["nunchuk-status"] = cwiid.cwiid_get_acc_cal(
            remote, EXTENSION_NUNCHUK, ctypes.byref(calibration)
        )
        seen["nunchuk-zero"] = list(calibration.zero)
        cwiid.cwiid_set_rpt_mode(remote, MODE_BUTTONS | MODE_ACCELEROMETER | MODE_NUNCHUK)
        seen["moved"] = wait_for(lambda s: s.extension.nunchuk.stick[1] > 200 and s.buttons != 0)
        nunchuk = state.extension.nunchuk
        seen["stick"], seen["nunchuk-buttons"] = list(nunchuk.stick), nunchuk.buttons
        seen["nunchuk-accelerometer"] = list(nunchuk.accelerometer)
    else:
        cwiid.cwiid_set_rpt_mode(remote, MODE_BUTTONS | MODE_ACCELEROMETER | MODE_MOTION_PLUS)
        seen["enable-status"] = cwiid.cwiid_enable(remote, MOTION_PLUS_FLAG)
        seen["found"] = wait_for(lambda s: s.extension_type == EXTENSION_MOTION_PLUS)
        seen["turning"] = wait_for(
            lambda s: s.extension.motion_plus.rates[0] > 0 and s.buttons != 0
        )
        time.sleep(0.1)  # The first frame after activation may be invalid.
        cwiid.cwiid_get_state(remote, ctypes.byref(state))
        plus = state.extension.motion_plus
        seen["rates"], seen["slow"] = list(plus.rates), list(plus.slow)
    seen["extension"] = state.extension_type
    seen["accelerometer"], seen["buttons"] = list(state.accelerometer), state.buttons
    seen["led"], seen["rumble"], seen["error"] = state.led, state.rumble, state.error
    print(json.dumps(seen), flush=True)
    sys.stdin.readline()  # Meanwhile the test inspects the remote.
    cwiid.cwiid_close(remote)
    return 0


if __name__ == "__main__":
    # Skip the interpreter's clean-up, which the library's threads may outlive.
    os._exit(main(*sys.argv[1:4]))
