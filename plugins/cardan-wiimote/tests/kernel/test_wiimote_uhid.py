"""A Wii Remote created with /dev/uhid, judged by the kernel's own driver and Debian's library."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cardan.types import DeviceFeedback, DeviceLink
from cardan_wiimote.driver import Wiimote, WiimoteOptions
from cardan_wiimote.peer import WiimotePeer, WiimotePeerOptions
from cardan_wiimote.peer.bus import GYROSCOPES, NUNCHUK
from tests.kernel.evdev_nodes import EV_ABS, EV_KEY, events_of, nodes_called
from tests.kernel.waiting import wait_for
from tests.serving import in_a_thread

REMOTE = "Nintendo Wii Remote"
ACCELEROMETER = f"{REMOTE} Accelerometer"
MOTION_PLUS = f"{REMOTE} Motion Plus"
BTN_EAST, BTN_1 = 0x131, 0x101
BTN_C, BTN_Z = 0x132, 0x135
ABS_HAT0X, ABS_HAT0Y = 16, 17
ABS_RX, ABS_RY, ABS_RZ = 3, 4, 5
HID_WIIMOTE_SLOW = 9.0
"""Factor by which hid-wiimote scales a gyroscope's slow reading (counts less 0x2000); that of a
fast reading is 2000 / 440 times larger."""
MOVES = """
    0.3  press a
    0.6  tilt 30 0 0 over 0.2
    2.0  level over 0.1
    2.3  release a
    2.6  loop
"""


@pytest.fixture(autouse=True)
def kernel(modules: Callable[..., None]) -> None:
    modules("uhid", "hid-wiimote", "evdev")


@pytest.fixture
def remote(tmp_path: Path) -> Callable[..., WiimotePeer]:
    def make(script: str = MOVES, **options: object) -> WiimotePeer:
        file = tmp_path / "script.txt"
        file.write_text(script)
        return WiimotePeer(WiimotePeerOptions(uhid=True, script=str(file), **options))

    return make


@pytest.mark.judged(device="Wiimote", transport="uhid", by="Linux kernel 6.1: hid-wiimote, evdev")
def test_the_kernels_driver_binds_and_gives_keys_and_acceleration(remote):
    with in_a_thread(remote()):
        (keys,) = wait_for(lambda: nodes_called(REMOTE))
        (acceleration,) = wait_for(lambda: nodes_called(ACCELEROMETER))
        with events_of(keys) as pressed, events_of(acceleration) as moved:
            wait_for(lambda: len(pressed.gather()) >= 4)
            wait_for(lambda: {code for _, code, _ in moved.gather()} >= {ABS_RX, ABS_RZ})
        values = [value for kind, _, value in pressed.events if kind == EV_KEY]
        assert len({code for _, code, _ in pressed.events}) == 1
        assert values[:2] in ([1, 0], [0, 1])
        assert values[2:4] == values[:2]
        assert {kind for kind, _, _ in moved.events} == {EV_ABS}
        # The kernel reports raw counts less 0x200; 1 g is about 100, in any attitude.
        upright = [value for _, code, value in moved.events if code == ABS_RZ]
        assert max(upright) == pytest.approx(110, abs=20)


@pytest.mark.judged(device="Wiimote", transport="uhid", by="Debian libxwiimote over hid-wiimote")
def test_debians_library_reads_keys_acceleration_and_battery_and_drives_the_motor(remote):
    with in_a_thread(remote()) as peer, XwiiRemote() as judge:
        seen = {}
        wait_for(lambda: (seen.update(judge.events()) or True) and {0, 1} <= seen.keys())
        assert seen[0][0] == XwiiRemote.KEY_A
        assert math.hypot(*seen[1]) == pytest.approx(105, abs=25)
        assert 0 < judge.battery() <= 100
        judge.rumble(True)
        wait_for(lambda: peer.device.rumble)
        judge.rumble(False)
        wait_for(lambda: not peer.device.rumble)
        judge.led(3)
        wait_for(lambda: peer.device.leds & 0b0100)


def deg_s(values: tuple[int, ...]) -> list[float]:
    """Return the rates about the MotionPlus's three axes from hid-wiimote's values, by the
    calibration."""
    slow = GYROSCOPES.slow
    return [
        4.0 * (value / HID_WIIMOTE_SLOW + 0x2000 - zero / 4.0) / ((scale - zero) / slow.degrees_s)
        for value, zero, scale in zip(values, slow.zero, slow.scale, strict=True)
    ]


@pytest.mark.judged(
    device="Wiimote", transport="MotionPlus over uhid", by="Debian libxwiimote over hid-wiimote"
)
def test_debians_library_reads_the_gyroscopes_of_a_motion_plus(remote):
    """Each axis in turn swings by 25 degrees, once a second."""
    script = """
        0.5  swing 0 0 25 over 1 times 3
        4.0  swing 25 0 0 over 1 times 3
        7.5  swing 0 25 0 over 1 times 3
        11.0 loop
    """
    peak_deg_s = 25.0 * math.tau
    rates: list[list[float]] = []
    with (
        in_a_thread(remote(script, motion_plus=True)),
        XwiiRemote(XwiiRemote.CORE | XwiiRemote.MOTION_PLUS) as judge,
    ):

        def swung() -> bool:
            for kind, values in judge.stream():
                if kind == XwiiRemote.GYROSCOPES:
                    rates.append(deg_s(values))
            return all(
                any(sign * rate[axis] > 0.8 * peak_deg_s for rate in rates)
                for axis in range(3)
                for sign in (1, -1)
            )

        wait_for(swung)
    for rate in rates:
        fastest = max(map(abs, rate))
        assert fastest < 1.1 * peak_deg_s
        if fastest > 0.5 * peak_deg_s:
            assert sorted(map(abs, rate))[1] < 0.1 * peak_deg_s


@pytest.mark.judged(
    device="Wiimote", transport="Nunchuk over uhid", by="Linux kernel 6.1: hid-wiimote, evdev"
)
def test_the_kernels_driver_reads_a_nunchuk(remote):
    """Judged without libxwiimote, which reports that it opens a Nunchuk, and does not."""
    script = """
        0.5  press z
        1.0  stick 1 0 over 0.2
        2.0  stick 0 -1 over 0.2
        3.0  stick 0 0 over 0.2
        3.4  release z
        3.6  press c
        3.8  release c
        4.0  loop
    """
    (_, middle_x, most_x), (least_y, middle_y, _) = NUNCHUK.stick_x, NUNCHUK.stick_y
    with in_a_thread(remote(script, extension="nunchuk")):
        (node,) = wait_for(lambda: nodes_called(f"{REMOTE} Nunchuk"))
        with events_of(node) as reported:
            expected = {
                *((EV_KEY, key, state) for key in (BTN_C, BTN_Z) for state in (0, 1)),
                (EV_ABS, ABS_HAT0X, most_x - middle_x),
                (EV_ABS, ABS_HAT0X, 0),
                (EV_ABS, ABS_HAT0Y, least_y - middle_y),
                (EV_ABS, ABS_HAT0Y, 0),
            }
            wait_for(lambda: expected <= set(reported.gather()))
    assert min(value for _, code, value in reported.events if code == ABS_HAT0X) == 0
    assert max(value for _, code, value in reported.events if code == ABS_HAT0Y) == 0


@pytest.mark.judged(
    device="Wiimote", transport="hidraw", by="Linux kernel 6.1: uhid, hid-wiimote bound, hidraw"
)
def test_the_driver_works_over_hidraw_beside_the_kernels(remote):
    with in_a_thread(remote()) as peer:
        (found,) = wait_for(Wiimote.find)
        assert found.path.startswith("/dev/hidraw")
        assert "hid-wiimote" in found.obstacle
        assert found.identity == peer.options.address
        with Wiimote(WiimoteOptions(transport="hidraw")) as wiimote:
            state = wait_for(
                lambda: (s := wiimote.state()).link is DeviceLink.LIVE and any(s.axes) and s
            )
            assert "a" in state.buttons
            assert any("hid-wiimote" in words for words in wiimote.diagnosis())
            edges = []
            wait_for(lambda: edges.extend(wiimote.button_events()) or len(edges) >= 3)
            assert {edge.button for edge in edges} == {"a"}
            wiimote.feedback(DeviceFeedback(rumble=1.0))
            wait_for(lambda: peer.device.rumble)
            wiimote.feedback(DeviceFeedback(rumble=0.0))
            wait_for(lambda: not peer.device.rumble)
            # Data continues although the kernel's driver sets its own mode after every status
            # report.
            stamps = set()
            wait_for(lambda: stamps.add(wiimote.state().stamp_s) or len(stamps) > 50)
            # A stall of the emulated processor makes the link stale until the button is released.
            wait_for(lambda: wiimote.state().link is DeviceLink.LIVE)


@pytest.mark.judged(
    device="Wiimote", transport="hidraw, link lost", by="Linux kernel 6.1: uhid, hidraw"
)
def test_out_of_radio_range_it_is_lost_and_comes_back(remote):
    script = """
        0.3  press a
        0.6  tilt 30 0 0 over 0.2
        6.0  leave
        6.5  release a
        7.0  come-back
        9.0  press a
        60.0 release a
    """
    with in_a_thread(remote(script)):
        wait_for(Wiimote.find)
        with Wiimote(WiimoteOptions(transport="hidraw", wait_for_device=True)) as wiimote:
            wait_for(lambda: wiimote.state().link is not DeviceLink.LOST)
            wait_for(lambda: not any(wiimote.state().axes))
            lost = wait_for(lambda: (s := wiimote.state()).link is DeviceLink.LOST and s)
            assert not any(lost.axes)
            assert not lost.buttons
            wait_for(lambda: any(wiimote.state().axes))


class XwiiEvent(ctypes.Structure):
    """struct xwii_event of libxwiimote 2: a time, a type, and three numbers per axis."""

    _fields_ = (
        ("seconds", ctypes.c_long),
        ("microseconds", ctypes.c_long),
        ("type", ctypes.c_uint),
        ("values", ctypes.c_int32 * 24),
        ("room", ctypes.c_uint8 * 128),
    )


class XwiiRemote:
    """The first remote that libxwiimote sees."""

    KEY, ACCELERATION, GYROSCOPES = 0, 1, 4
    KEY_A = 4
    CORE, ACCELEROMETER, MOTION_PLUS, WRITABLE = 0x1, 0x2, 0x100, 0x10000

    def __init__(self, wanted: int = CORE | ACCELEROMETER) -> None:
        """`wanted`: the parts to read."""
        self._wanted = wanted
        self._library = ctypes.CDLL("libxwiimote.so.2")
        for name in ("xwii_monitor_new", "xwii_monitor_poll"):
            getattr(self._library, name).restype = ctypes.c_void_p
        self._remote = ctypes.c_void_p()

    def __enter__(self) -> XwiiRemote:
        wait_for(lambda: nodes_called(ACCELEROMETER))
        if self._wanted & self.MOTION_PLUS:
            wait_for(lambda: nodes_called(MOTION_PLUS))
        wait_for(self._open)
        return self

    def _open(self) -> bool:
        """Open the wanted parts; return whether all are present. The library checks only once."""
        wanted = self._wanted
        path = self._path()
        if path is None or self._library.xwii_iface_new(ctypes.byref(self._remote), path):
            return False
        if (
            self._library.xwii_iface_open(self._remote, wanted | self.WRITABLE) == 0
            and self._library.xwii_iface_opened(self._remote) & wanted == wanted
        ):
            return True
        self._library.xwii_iface_unref(self._remote)
        return False

    def __exit__(self, *_: object) -> None:
        self._library.xwii_iface_unref(self._remote)

    def _path(self) -> bytes | None:
        """Return the path found by libxwiimote's monitor."""
        monitor = ctypes.c_void_p(self._library.xwii_monitor_new(False, False))
        found = self._library.xwii_monitor_poll(monitor)
        path = ctypes.string_at(found) if found else None
        self._library.xwii_monitor_unref(monitor)
        return path

    def events(self) -> dict[int, tuple[int, ...]]:
        """Return the newest pending event of each type."""
        return dict(self.stream())

    def stream(self) -> Iterator[tuple[int, tuple[int, ...]]]:
        """Return all pending events: type, and the first three numbers."""
        event = XwiiEvent()
        size = ctypes.sizeof(event)
        while self._library.xwii_iface_dispatch(self._remote, ctypes.byref(event), size) == 0:
            yield event.type, tuple(event.values[:3])

    def battery(self) -> int:
        """Battery level, percent."""
        percent = ctypes.c_uint8()
        assert self._library.xwii_iface_get_battery(self._remote, ctypes.byref(percent)) == 0
        return percent.value

    def rumble(self, on: bool) -> None:
        """Switch the rumble motor."""
        assert self._library.xwii_iface_rumble(self._remote, on) == 0

    def led(self, number: int) -> None:
        """Light one of 1 to 4."""
        assert self._library.xwii_iface_set_led(self._remote, number, True) == 0
