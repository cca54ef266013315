"""The simulated remote over its sockets, over a fake uhid, and with independent programs."""

from __future__ import annotations

import contextlib
import ctypes.util
import errno
import json
import os
import select
import socket
import stat
import subprocess
import sys
import time
import types
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cardan.errors import (
    AddressError,
    ConfigurationError,
    DeviceAccessError,
    OptionError,
    ScriptError,
)
from cardan.sim_peers import device_peer
from cardan.sim_peers.backends.uhid import (
    BUS_BLUETOOTH,
    OUTPUT_REPORT,
    Event,
    GetReport,
    HidIdentity,
    Output,
    SetReport,
)
from cardan_wiimote.peer import WiimotePeer, WiimotePeerOptions, l2cap, peer as peer_module
from cardan_wiimote.peer.l2cap import (
    BluetoothChannels,
    UnixChannels,
    parse_address,
    sockaddr_l2,
)
from cardan_wiimote.protocol import (
    Data,
    DataMode,
    Leds,
    Rumble,
    Status,
    StatusRequest,
    decode_input,
    encode_output,
    report_descriptor,
)
from tests.serving import in_a_thread

pytestmark = pytest.mark.matrix

CLIENT = Path(__file__).with_name("wiimote_cwiid_client.py")
DEADLINE_S = 30.0


def wait_until(condition: Callable[[], object]) -> None:
    deadline_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline_s, "the condition did not hold in time"
        time.sleep(0.002)


def channel(directory: Path, psm: str) -> socket.socket:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    sock.settimeout(DEADLINE_S)
    try:
        sock.connect(str(directory / psm))
    except BaseException:
        sock.close()
        raise
    return sock


def comes_back(directory: Path) -> bool:
    """Return True if both channels accept connections."""
    try:
        with channel(directory, "psm11"), channel(directory, "psm13"):
            return True
    except OSError:
        return False


@contextlib.contextmanager
def link(directory: Path) -> Iterator[tuple[socket.socket, socket.socket]]:
    """Open both channels, control first."""
    with channel(directory, "psm11") as control, channel(directory, "psm13") as interrupt:
        yield control, interrupt


def receive(interrupt: socket.socket, kind: type) -> object:
    """Return the next report of that type."""
    for _ in range(200):
        packet = interrupt.recv(64)
        assert packet[:1] == b"\xa1", "the link has ended"
        value = decode_input(packet[1:])
        if isinstance(value, kind):
            return value
    raise AssertionError(f"no {kind.__name__} in 200 reports")


def served(directory: Path, **settings: object) -> WiimotePeer:
    return WiimotePeer(WiimotePeerOptions(l2cap=str(directory), **settings))  # type: ignore[arg-type]


@pytest.fixture
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short path, as needed for a socket."""
    return tmp_path_factory.mktemp("w") / "d"


# -- Unix sockets --------------------------------------------------------------------------------


@pytest.mark.real
def test_the_old_and_the_new_way_over_sockets(place, monkeypatch):
    """In virtual time, so that the report period is independent of this machine."""
    now_s = 100.0
    monkeypatch.setattr(device_peer, "time", types.SimpleNamespace(monotonic=lambda: now_s))
    peer = served(place, script="rest")

    def turn(seconds: float = 0.0) -> None:
        """Send the due reports, and process those received."""
        nonlocal now_s
        now_s += seconds
        peer.step(now_s)
        peer.backend.wait(0.0)

    peer.open()
    with contextlib.closing(peer), link(place) as (control, interrupt):
        assert peer.endpoint == str(place)
        turn()
        control.send(b"\x52" + encode_output(Leds(0b0110)))
        turn()
        assert control.recv(16) == b"\x00"
        assert peer.device.leds == 0b0110
        interrupt.send(b"\xa2" + encode_output(StatusRequest()))
        turn()
        turn()
        assert receive(interrupt, Status).leds == 0b0110
        interrupt.send(b"\xa2" + encode_output(DataMode(0x31)))
        turn()
        begin_s = now_s
        modes: list[int] = []
        while len(modes) < 20:
            turn(0.001)
            while select.select([interrupt], [], [], 0.0)[0]:
                data = receive(interrupt, Data)
                assert isinstance(data, Data)
                modes.append(data.mode)
        assert modes == [0x31] * 20
        assert 0.15 < now_s - begin_s < 0.3


def test_the_last_words_of_a_host_that_hangs_up_are_heard(place):
    peer = served(place, script="rest")
    peer.open()
    try:
        with link(place) as (control, interrupt):
            step_until(peer, lambda: peer.device.connected)
            interrupt.send(b"\xa2" + encode_output(Rumble(True)))
            step_until(peer, lambda: peer.device.rumble)
            interrupt.send(b"\xa2" + encode_output(Rumble(False)))
            interrupt.close()
            control.close()
            # The remote sends before it has read, and finds the connection closed.
            peer.backend.send([b"\x30\0\0"])
        assert not peer.device.connected
        assert [entry.what for entry in peer.device.log if "rumble" in entry.what][-1] == (
            "rumble off"
        )
    finally:
        peer.close()


@pytest.mark.parametrize("closed", [0, 1])
def test_closing_either_channel_ends_the_link_and_it_listens_again(place, closed):
    with in_a_thread(served(place, script="rest")) as peer:
        for _ in range(3):
            with link(place) as channels:
                channels[1].send(b"\xa2" + encode_output(Rumble(True)))
                wait_until(lambda: peer.device.rumble)
                channels[closed].close()
                wait_until(lambda: not peer.device.connected)
                assert not peer.device.rumble
                other = channels[1 - closed]
                packet = b"?"
                while packet:
                    packet = other.recv(64)


def test_wrong_order_and_second_hosts_are_turned_away(place):
    with in_a_thread(served(place, script="rest")) as peer:
        with channel(place, "psm13") as alone:
            assert alone.recv(16) == b""
        # A host that has opened only the first channel gives way to the next host.
        with channel(place, "psm11") as half, link(place) as (_, interrupt):
            assert half.recv(16) == b""
            wait_until(lambda: peer.device.connected)
            with channel(place, "psm11") as second:
                assert second.recv(16) == b""
            interrupt.send(b"\xa2" + encode_output(StatusRequest()))
            assert receive(interrupt, Status)
        wait_until(lambda: not peer.device.connected)


def test_switched_off_it_cannot_be_reached(place):
    faults = {"power-off": 0.1, "power-on": 0.3}
    with in_a_thread(served(place, script="rest", faults=faults)) as peer:
        with link(place) as (control, _):
            assert control.recv(16) == b""
        wait_until(lambda: not (place / "psm13").exists())
        with pytest.raises(OSError, match="No such file"):
            channel(place, "psm11")
        wait_until(lambda: comes_back(place))
        with link(place):
            wait_until(lambda: peer.device.connected)


@pytest.mark.parametrize(("name", "closed"), [("control", 0), ("interrupt", 1)])
def test_the_remote_closes_one_channel(place, name, closed):
    faults = {f"close-{name}": 0.05}
    with in_a_thread(served(place, script="rest", faults=faults)) as peer:
        with link(place) as channels:
            packet = b"?"
            while packet:
                packet = channels[closed].recv(64)
            assert peer.device.connected
        wait_until(lambda: not peer.device.connected)
        with link(place):
            wait_until(lambda: peer.device.connected)


def test_refused_for_a_while(place):
    with in_a_thread(served(place, faults={"refuse": 0.2}, script="rest")):
        assert not (place / "psm11").exists()
        wait_until(lambda: comes_back(place))
        with link(place) as (_, interrupt):
            assert receive(interrupt, Data)


def test_a_host_that_comes_back_at_once_is_not_paired_with_the_channel_that_it_left(
    place, monkeypatch
):
    """The host disconnects and reconnects while the remote accepts its channels."""
    peer = served(place)
    peer.open()
    waiting = UnixChannels._waiting
    with contextlib.ExitStack() as first, contextlib.ExitStack() as second:
        first.enter_context(link(place))

        def left_between(backend: UnixChannels, psm: int, most: int) -> list[socket.socket]:
            found = waiting(backend, psm, most)
            if psm == 0x13 and found and not links:
                first.close()
                links.append(second.enter_context(link(place)))
            return found

        links: list[tuple[socket.socket, socket.socket]] = []
        monkeypatch.setattr(UnixChannels, "_waiting", left_between)
        with in_a_thread(peer):
            wait_until(lambda: links)
            assert receive(links[0][1], Data)


def test_the_script_starts_with_the_first_host(place):
    script = place.with_name("s")
    script.write_text("0.05 press a\n0.1 tilt 30 0 0\n")
    with in_a_thread(served(place, script=str(script))) as peer:
        time.sleep(0.15)
        assert peer.device.held == ()
        with link(place):
            wait_until(lambda: peer.device.held == ("a",))
            wait_until(lambda: peer.device.attitude_rad[0] > 0.5)


def test_what_open_created_is_removed(place):
    peer = served(place)
    peer.open()
    peer.open()
    assert (place / "psm11").exists()
    assert (place / "psm13").exists()
    peer.close()
    peer.close()
    assert not place.exists()
    place.mkdir()
    peer.open()
    peer.close()
    assert place.exists()


def test_a_dead_peers_sockets_are_taken_over_and_a_live_ones_not(place):
    first, second = served(place), served(place)
    with in_a_thread(first):
        with pytest.raises(AddressError, match="another program serves"):
            second.open()
        assert (place / "psm11").exists()
        with link(place):
            pass
    place.mkdir()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(place / "psm11"))
    second.open()
    second.close()


def test_places_that_cannot_be_used(place, tmp_path):
    place.write_text("")
    with pytest.raises(AddressError, match="is not a directory"):
        served(place).open()
    with pytest.raises(AddressError, match="cannot make the directory"):
        served(place / "x").open()
    (tmp_path / "psm11").write_text("")
    with pytest.raises(AddressError, match="is not a socket"):
        served(tmp_path).open()
    with pytest.raises(AddressError, match="short path"):
        served(tmp_path / ("x" * 120)).open()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"l2cap": "d", "script": "nosuch"}, "script 'nosuch'"),
        ({"l2cap": "d", "script": "nunchuk"}, "no Nunchuk"),
        ({"l2cap": "d", "extension": "drums"}, "extension: 'drums' is not allowed; it must be"),
        ({"bluetooth": "00:11:22"}, "bluetooth: .* it must be empty or six bytes"),
        ({"uhid": True, "address": "zz:11:22:33:44:55"}, "address: .* it must be six bytes"),
    ],
)
def test_nonsense_is_refused(settings, words):
    error = OptionError if "it must be" in words else ScriptError
    with pytest.raises(error, match=words):
        WiimotePeer(WiimotePeerOptions(**settings))


@pytest.mark.parametrize("settings", [{}, {"l2cap": "d", "uhid": True}])
def test_there_is_one_way_to_reach_it(settings):
    with pytest.raises(ConfigurationError, match="exactly one way"):
        WiimotePeer(WiimotePeerOptions(**settings))


# -- Bluetooth -----------------------------------------------------------------------------------


def test_bluetooth_addresses_on_the_wire():
    wire = parse_address("00:1F:32:5A:10:2B")
    assert wire == bytes.fromhex("2b105a321f00")
    # struct sockaddr_l2: family 31, PSM, address, no channel id, BR/EDR.
    assert sockaddr_l2(wire, 0x11) == bytes.fromhex("1f00 1100 2b105a321f00 0000 00 00")


def test_without_bluetooth_it_says_so(monkeypatch):
    class NoSocket:
        SOCK_SEQPACKET = socket.SOCK_SEQPACKET

        @staticmethod
        def socket(*_: object) -> socket.socket:
            raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")

    monkeypatch.setattr(l2cap, "socket", NoSocket)
    peer = WiimotePeer(WiimotePeerOptions(bluetooth="00:00:00:00:00:00"))
    with pytest.raises(AddressError, match="this system has no Bluetooth"):
        peer.open()
    assert (
        BluetoothChannels(peer.device, "00:00:00:00:00:00").endpoint
        == "bluetooth 00:00:00:00:00:00"
    )


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077], ids=oct)
@pytest.mark.parametrize(
    ("everybody", "folder", "channel"), [(False, 0o700, 0o600), (True, 0o755, 0o666)]
)
def test_who_may_open_it(place, umask, everybody, folder, channel):
    before = os.umask(umask)
    try:
        peer = served(place, everybody=everybody)
        peer.open()
    finally:
        os.umask(before)
    assert stat.S_IMODE(place.stat().st_mode) == folder
    assert {stat.S_IMODE(path.stat().st_mode) for path in place.iterdir()} == {channel}
    peer.close()
    assert everybody or not place.exists()


# -- uhid ----------------------------------------------------------------------------------------


class FakeUhid:
    """The interface of UhidDevice, with a pipe in place of the kernel."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.sent: list[bytes] = []
        self.replies: list[tuple[object, int]] = []
        self.identity: HidIdentity | None = None
        self.plugged = self.unplugged = 0
        self._read_end, self._write_end = -1, -1

    def open(self) -> None:
        self._read_end, self._write_end = os.pipe()

    def fileno(self) -> int:
        return self._read_end

    def plug(self, identity: HidIdentity) -> None:
        self.identity = identity
        self.plugged += 1

    def unplug(self) -> None:
        self.identity = None
        self.unplugged += 1

    def send(self, report: bytes) -> None:
        self.sent.append(report)

    def reply_to(self, request: object, error: int, report: bytes = b"") -> None:
        self.replies.append((request, error))

    def read(self) -> Event | None:
        if not self.events:
            return None
        os.read(self._read_end, 1)
        return self.events.pop(0)

    def close(self) -> None:
        os.close(self._read_end)
        os.close(self._write_end)

    def give(self, event: Event) -> None:
        self.events.append(event)
        os.write(self._write_end, b"x")


def uhid_peer(**settings: object) -> tuple[WiimotePeer, FakeUhid]:
    options = WiimotePeerOptions(uhid=True, script="rest", **settings)  # type: ignore[arg-type]
    peer = WiimotePeer(options)
    fake = FakeUhid()
    peer.backend.device = fake  # type: ignore[attr-defined]
    return peer, fake


def step_until(peer: WiimotePeer, condition: Callable[[], object]) -> None:
    deadline_s = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline_s, "the condition did not hold in time"
        peer.step(time.monotonic() + 0.01)


def test_uhid_device():
    peer, fake = uhid_peer()
    assert peer.endpoint == "uhid 00:1F:32:5A:10:2B"
    peer.open()
    try:
        identity = fake.identity
        assert (identity.name, identity.serial) == ("Nintendo RVL-CNT-01", "00:1f:32:5a:10:2b")
        assert (identity.bus, identity.vendor_id, identity.product_id) == (
            BUS_BLUETOOTH, 0x057E, 0x0306,
        )  # fmt: skip
        assert identity.descriptor == report_descriptor()
        fake.give(Output(OUTPUT_REPORT, encode_output(Leds(8))))
        fake.give(Output(OUTPUT_REPORT, encode_output(DataMode(0x31))))
        step_until(peer, lambda: sum(report[0] == 0x31 for report in fake.sent) > 5)
        assert peer.device.leds == 8
        get, taken = GetReport(1, 0x20, 2), SetReport(2, 0x11, 1, encode_output(Leds(1)))
        fake.give(get)
        fake.give(taken)
        step_until(peer, lambda: len(fake.replies) == 2)
        assert fake.replies == [(get, errno.EIO), (taken, 0)]
        assert peer.device.leds == 1
    finally:
        peer.close()


def test_uhid_device_of_a_tr_remote():
    peer, fake = uhid_peer(tr=True)
    peer.open()
    try:
        assert fake.identity.product_id == 0x0330
        request = SetReport(2, 0x11, 1, encode_output(Leds(1)))
        fake.give(request)
        step_until(peer, lambda: fake.replies)
        assert fake.replies == [(request, errno.EIO)]
    finally:
        peer.close()


def test_uhid_device_goes_and_comes_back(monkeypatch):
    monkeypatch.setattr(peer_module, "RECONNECT_S", 0.05)
    peer, fake = uhid_peer(faults={"close-interrupt": 0.05, "power-off": 0.3, "power-on": 0.4})
    peer.open()
    try:
        step_until(peer, lambda: fake.plugged == 3)
        assert fake.unplugged == 2
        assert peer.device.connected
    finally:
        peer.close()


def test_uhid_that_is_not_there(monkeypatch):
    peer = WiimotePeer(WiimotePeerOptions(uhid=True))
    peer.backend.device._path = "/nonexistent/uhid"
    with pytest.raises(DeviceAccessError, match="modprobe uhid"):
        peer.open()


# -- judged by a third-party library ---------------------------------------------------------------


CWIID_PATIENCE_S = 20.0
"""Longer than all timeouts of the client. On a busy computer libcwiid has hung once in some
thousand runs, apparently by a deadlock of its threads."""


def use_cwiid(place: Path, what: str, script: str, **settings: object) -> tuple[dict, WiimotePeer]:
    """Return libcwiid's readings, and the remote's state when libcwiid was done."""
    library = ctypes.util.find_library("cwiid")
    if library is None:
        pytest.skip("libcwiid is not installed (Debian package libcwiid1)")
    file = place.with_name("script")
    file.write_text(script)
    for attempt in range(2):
        # With noise, because libcwiid requests reports on change only, and may miss the first one.
        directory = place.with_name(f"{place.name}{attempt}")
        with in_a_thread(served(directory, script=str(file), **settings)) as peer:
            command = [sys.executable, str(CLIENT), library, str(directory), what]
            with cwiid_client(command) as process:
                if (seen := seen_by(process, peer)) is None:
                    # A hang of libcwiid itself if it has received all answers.
                    assert peer.device.connected, peer.device.log
                    assert not peer.backend.lost
                    continue
                _, errors = process.communicate("done\n", timeout=10.0)
            assert process.returncode == 0, errors
            wait_until(lambda: not peer.device.connected)
            assert peer.device.log[-2].what == "rumble off"
            assert peer.device.ignored_outputs == 0
        return seen, peer
    pytest.fail("libcwiid waits for ever")


@contextlib.contextmanager
def cwiid_client(command: list[str]) -> Iterator[subprocess.Popen[str]]:
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()


def seen_by(process: subprocess.Popen[str], peer: WiimotePeer) -> dict | None:
    """Return the client's output and the remote's state; None without output in time."""
    assert process.stdout is not None
    if not select.select([process.stdout], (), (), CWIID_PATIENCE_S)[0]:
        return None
    line = process.stdout.readline()
    return {
        **(json.loads(line) if line else {}),
        "remote-leds": peer.device.leds,
        "remote-rumble": peer.device.rumble,
        "remote-mode": peer.device.mode,
    }


OPTION_SETS = [
    {},
    {"extension": "nunchuk"},
    {"motion_plus": True},
    {"extension": "nunchuk", "motion_plus": True},
    {"faults": {"bad-checksum": 1.0}},
]


def check_common(seen: dict) -> None:
    assert seen["battery-told"]
    assert seen["battery"] == 0xC0
    assert seen["calibration-status"] == seen["read-status"] == seen["error"] == 0
    # the upper eight of the ten bits
    assert (seen["zero"], seen["one"]) == ([132, 130, 134], [159, 157, 159])
    assert (seen["remote-leds"], seen["remote-rumble"]) == (0b1010, True)
    assert seen["buttons"] == 0x08  # A


@pytest.mark.judged(device="Wiimote", transport="seqpacket sockets", by="Debian libcwiid")
@pytest.mark.parametrize("settings", OPTION_SETS, ids=str)
def test_libcwiid_uses_the_remote(place, settings):
    seen, _ = use_cwiid(place, "remote", "0 press a\n0 tilt 30 0 0\n0 dots 300 200\n", **settings)
    check_common(seen)
    assert seen["eeprom"].endswith("848286309f9d9f02402e")
    assert seen["mode-status"] == 0
    assert seen["tilted"]
    # 0.5 g of roll: (531 + 0.5 * 105) / 4 along x.
    assert seen["accelerometer"] == pytest.approx([146, 130, 156], abs=1)
    assert seen["dot"] == [300, 200]
    assert seen["remote-mode"] in (0x33, 0x37)


@pytest.mark.real
@pytest.mark.judged(device="Wiimote", transport="Nunchuk", by="Debian libcwiid")
def test_libcwiid_uses_the_nunchuk(place):
    script = "0 press a\n0 press c\n0 stick 0 1\n"
    seen, _ = use_cwiid(place, "nunchuk", script, extension="nunchuk")
    check_common(seen)
    assert seen["found"]
    assert seen["nunchuk-status"] == 0
    assert seen["nunchuk-zero"] == [127, 128, 129]
    assert seen["moved"]
    assert (seen["stick"], seen["nunchuk-buttons"]) == ([128, 220], 2)
    assert seen["nunchuk-accelerometer"] == [127, 128, 180]
    assert seen["remote-mode"] == 0x35


@pytest.mark.judged(device="Wiimote", transport="MotionPlus", by="Debian libcwiid")
def test_libcwiid_uses_the_motion_plus(place):
    script = "0 press a\n0 tilt 0 0 720 over 72\n"  # 10 degrees a second to the left
    seen, _ = use_cwiid(place, "motion-plus", script, motion_plus=True)
    check_common(seen)
    assert seen["enable-status"] == 0
    assert seen["found"]
    assert seen["turning"]
    # Pitch, roll, yaw: the first two at rest, the third above its rest of 7634.
    pitch, roll, yaw = seen["rates"]
    assert (pitch, roll) == pytest.approx((29594 / 4, 30116 / 4), abs=5)
    assert yaw == pytest.approx(7634 + (30537 - 13650) / 270 * 10 / 4, abs=6)
    assert seen["slow"] == [1, 1, 1]
