"""Transports to a remote: hidapi, two sockets, raw socket addresses."""

import errno
import os
import socket
import sys
import types

import pytest

from cardan.errors import DeviceAccessError, DriverError
from cardan_wiimote.address import BLUETOOTH_ADDRESS
from cardan_wiimote.driver import transports
from cardan_wiimote.driver.transports import (
    AF_BLUETOOTH,
    Found,
    HidrawTransport,
    L2capTransport,
    SocketTransport,
    connect_by_bytes,
    kernel_driver_bound,
    l2cap_address,
)

NEVER = bool
"""Function that never requests a stop: called without arguments it returns False."""


class Host:
    """Listens on psm11 and psm13 of a folder, like a simulated remote."""

    def __init__(self, folder):
        self.listeners = {}
        for name in ("psm11", "psm13"):
            listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            listener.bind(str(folder / name))
            listener.listen(1)
            self.listeners[name] = listener

    def accept(self):
        return [listener.accept()[0] for listener in self.listeners.values()]

    def close(self):
        for listener in self.listeners.values():
            listener.close()


@pytest.fixture
def host(tmp_path):
    host = Host(tmp_path)
    yield host
    host.close()


@pytest.fixture
def ends(host, tmp_path):
    """The driver's link, and the remote's two channels."""
    transport = SocketTransport(str(tmp_path))
    (found,) = transport.find()
    link = transport.open(found, NEVER)
    control, interrupt = host.accept()
    yield link, control, interrupt
    link.close()
    control.close()
    interrupt.close()


def test_reports_go_over_the_interrupt_channel(ends):
    link, _, interrupt = ends
    link.write(bytes.fromhex("120431"))
    assert interrupt.recv(64) == bytes.fromhex("a2120431")
    interrupt.send(bytes.fromhex("a131604c84829f"))
    interrupt.send(bytes.fromhex("a1300000"))
    assert link.read(1.0) == bytes.fromhex("31604c84829f")
    assert link.read(0.0) == bytes.fromhex("300000")
    assert link.read(0.0) is None
    assert link.read(0.01) is None


def test_what_is_no_input_report_is_empty(ends):
    link, _, interrupt = ends
    interrupt.send(bytes.fromhex("a2300000"))
    assert link.read(1.0) == b""


def test_handshakes_are_no_reports(ends):
    link, control, interrupt = ends
    control.send(b"\x00")
    assert link.read(1.0) is None
    interrupt.send(bytes.fromhex("a1300000"))
    assert link.read(1.0) == bytes.fromhex("300000")


@pytest.mark.parametrize("which", ["control", "interrupt"])
def test_a_closed_channel_is_the_end(ends, which):
    link, control, interrupt = ends
    (control if which == "control" else interrupt).close()
    with pytest.raises(OSError, match=which):
        link.read(1.0)
    link.close()
    link.close()


def test_a_remote_that_takes_nothing_is_gone(ends):
    link, _, _ = ends
    link._interrupt.settimeout(0.01)

    def fill():
        for _ in range(10_000):
            link.write(bytes(21))

    with pytest.raises(OSError):  # noqa: PT011 - what it says is the system's
        fill()


def test_no_sockets_no_remote(tmp_path):
    assert SocketTransport(str(tmp_path)).find() == []


def test_a_refused_channel_is_an_error(host, tmp_path):
    transport = SocketTransport(str(tmp_path))
    (found,) = transport.find()
    host.listeners["psm13"].close()
    with pytest.raises(DeviceAccessError, match="is it running"):
        transport.open(found, NEVER)


# -- raw addresses --------------------------------------------------------------------------------


@pytest.mark.judged(device="Wiimote", transport="L2CAP addresses", by="worked bytes")
def test_the_bluetooth_address():
    # sockaddr_l2: family 31, psm little endian, address last byte first, cid 0, type 0.
    little = sys.byteorder == "little"
    assert l2cap_address("00:1F:32:AA:BB:CC", 0x13).hex() == (
        ("1f00" if little else "001f") + "1300" + "ccbbaa321f00" + "0000" + "00" * 2
    )
    assert AF_BLUETOOTH == 31


def unix_address(path):
    return socket.AF_UNIX.to_bytes(2, sys.byteorder) + os.fsencode(path) + b"\0"


def test_connecting_by_bytes(host, tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as channel:
        connect_by_bytes(channel, unix_address(tmp_path / "psm11"), 1.0, NEVER)
        accepted, _ = host.listeners["psm11"].accept()
        accepted.send(b"hello")
        assert channel.recv(64) == b"hello"
        accepted.close()


def test_connecting_by_bytes_to_nobody(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as channel:
        with pytest.raises(OSError) as refused:  # noqa: PT011
            connect_by_bytes(channel, unix_address(tmp_path / "nobody"), 1.0, NEVER)
        assert refused.value.errno == errno.ENOENT


def blackhole():
    """A TCP listener with a full queue: clients that connect have to wait."""
    listener = socket.socket()
    listener.bind(("127.0.0.1", 0))
    listener.listen(0)
    waiting = []
    for _ in range(2):
        client = socket.socket()
        client.setblocking(False)
        client.connect_ex(listener.getsockname())
        waiting.append(client)
    return listener, waiting


@pytest.mark.parametrize(
    ("given_up", "number"), [(lambda: True, errno.ECANCELED), (NEVER, errno.ETIMEDOUT)]
)
def test_connecting_can_be_given_up(given_up, number):
    listener, waiting = blackhole()
    port = listener.getsockname()[1]
    address = (
        socket.AF_INET.to_bytes(2, sys.byteorder) + port.to_bytes(2, "big") + b"\x7f\0\0\1"
    ).ljust(16, b"\0")
    with socket.socket() as channel, pytest.raises(OSError) as refused:  # noqa: PT011
        connect_by_bytes(channel, address, 0.1, given_up)
    assert refused.value.errno == number
    for each in (listener, *waiting):
        each.close()


def test_l2cap_says_what_to_do(monkeypatch):
    def refuse(*_):
        raise OSError(errno.EHOSTDOWN, "Host is down")

    monkeypatch.setattr(transports, "connect_by_bytes", refuse)
    monkeypatch.setattr(transports, "AF_BLUETOOTH", socket.AF_UNIX)
    transport = L2capTransport("00:1f:32:aa:bb:cc")
    (found,) = transport.find()
    assert found.address == "00:1F:32:AA:BB:CC"
    with pytest.raises(DeviceAccessError, match="Host is down; press a button"):
        transport.open(found, NEVER)


def test_no_bluetooth_at_all(monkeypatch):
    monkeypatch.setattr(transports, "AF_BLUETOOTH", 4711)
    (found,) = L2capTransport("00:1F:32:AA:BB:CC").find()
    with pytest.raises(DeviceAccessError, match="not supported"):
        L2capTransport("00:1F:32:AA:BB:CC").open(found, NEVER)


# -- hidapi ---------------------------------------------------------------------------------------


def info(name, product_id, path, serial="00:1f:32:5a:10:2b"):
    return {
        "path": path, "vendor_id": 0x057E, "product_id": product_id, "serial_number": serial,
        "product_string": name,
    }  # fmt: skip


class Handle:
    """hidapi's device."""

    def __init__(self):
        self.inputs, self.outputs, self.broken = [], [], False

    def open_path(self, path):
        if path != b"/dev/hidraw3":
            raise OSError("open failed")

    def set_nonblocking(self, on):
        return 0

    def read(self, room, timeout_ms=0):
        if self.broken:
            raise OSError("read error")
        return list(self.inputs.pop(0)) if self.inputs else []

    def write(self, report):
        if self.broken:
            return -1
        self.outputs.append(bytes(report))
        return len(report)

    def error(self):
        return "broken"

    def close(self):
        self.inputs = None


@pytest.fixture
def hid(monkeypatch):
    module = types.ModuleType("hidraw")
    module.handle = Handle()
    module.device = lambda: module.handle
    module.found = [
        info("Nintendo RVL-CNT-01", 0x0306, b"/dev/hidraw3"),
        info("Nintendo RVL-WBC-01", 0x0306, b"/dev/hidraw4"),
        info("Nintendo RVL-CNT-01-TR", 0x0330, b"/dev/hidraw5", ""),
        info("Nintendo RVL-CNT-01-UC", 0x0330, b"/dev/hidraw6"),
        info("Pro Controller", 0x2009, b"/dev/hidraw7"),
        info("", 0x0306, b"/dev/hidraw8"),
    ]
    module.enumerate = lambda vendor_id, product_id: module.found
    monkeypatch.setitem(sys.modules, "hidraw", module)
    return module


def test_remotes_are_found_and_nothing_else(hid, tmp_path):
    driver = tmp_path / "sys/class/hidraw/hidraw3/device/driver"
    driver.parent.mkdir(parents=True)
    driver.symlink_to("/sys/bus/hid/drivers/wiimote")
    found = HidrawTransport(root=tmp_path).find()
    assert [(r.name, r.path, r.address, r.late_model, r.kernel_driver) for r in found] == [
        ("Nintendo RVL-CNT-01", "/dev/hidraw3", "00:1F:32:5A:10:2B", False, True),
        ("Nintendo RVL-CNT-01-TR", "/dev/hidraw5", "", True, False),
        ("Nintendo RVL-CNT-01", "/dev/hidraw8", "00:1F:32:5A:10:2B", False, False),
    ]
    assert all(remote.obstacle for remote in found)


def test_the_kernels_driver(tmp_path):
    driver = tmp_path / "sys/class/hidraw/hidraw0/device/driver"
    driver.parent.mkdir(parents=True)
    driver.symlink_to("../../bus/hid/drivers/hid-generic")
    assert not kernel_driver_bound("/dev/hidraw0", root=tmp_path)
    assert not kernel_driver_bound("/dev/hidraw1", root=tmp_path)
    driver.unlink()
    driver.symlink_to("../../bus/hid/drivers/wiimote")
    assert kernel_driver_bound("/dev/hidraw0", root=tmp_path)


def test_hidapi_reads_and_writes(hid):
    link = HidrawTransport().open(Found("remote", "hidraw", "/dev/hidraw3"), NEVER)
    hid.handle.inputs.append(bytes.fromhex("31604c84829f"))
    assert link.read(0.01) == bytes.fromhex("31604c84829f")
    assert link.read(0.0) is None
    link.write(bytes.fromhex("1001"))
    assert hid.handle.outputs == [b"\x10\x01"]
    hid.handle.broken = True
    with pytest.raises(OSError, match="read error"):
        link.read(0.0)
    with pytest.raises(OSError, match="broken"):
        link.write(b"\x10\x00")
    link.close()


@pytest.mark.skipif(sys.platform != "linux", reason="nodes are claimed on Linux only")
def test_one_session_per_remote(hid, tmp_path):
    hid.handle.open_path = lambda path: None
    node = tmp_path / "hidraw3"
    node.touch()
    remote = Found("remote", "hidraw", str(node))
    link = HidrawTransport().open(remote, NEVER)
    with pytest.raises(
        DeviceAccessError, match=r"another session has .*hidraw3; .*address or path"
    ):
        HidrawTransport().open(remote, NEVER)
    link.close()
    link.close()
    HidrawTransport().open(remote, NEVER).close()


@pytest.mark.skipif(sys.platform != "linux", reason="nodes are claimed on Linux only")
def test_a_remote_that_was_not_opened_is_not_claimed(hid, tmp_path):
    node = tmp_path / "hidraw3"
    node.touch()
    remote = Found("remote", "hidraw", str(node))
    with pytest.raises(DeviceAccessError, match="open failed"):
        HidrawTransport().open(remote, NEVER)
    hid.handle.open_path = lambda path: None
    HidrawTransport().open(remote, NEVER).close()


def test_a_remote_that_cannot_be_opened(hid):
    with pytest.raises(DeviceAccessError, match="cannot open remote: /dev/hidraw99"):
        HidrawTransport().open(Found("remote", "hidraw", "/dev/hidraw99"), NEVER)


def test_another_build_of_hidapi(monkeypatch):
    module = types.ModuleType("hid")
    module.device, module.enumerate = Handle, lambda vendor_id, product_id: []
    monkeypatch.setitem(sys.modules, "hidraw", None)
    monkeypatch.setitem(sys.modules, "hid", module)
    assert HidrawTransport().find() == []
    monkeypatch.setitem(sys.modules, "hid", None)
    with pytest.raises(DriverError, match=r"module 'hidraw' .*pip install hidapi"):
        HidrawTransport().find()


def test_the_form_of_an_address():
    assert "00:1F:32:aa:bb:cc" in BLUETOOTH_ADDRESS
    for bad in ("", "00:1F:32:aa:bb", "0:1:2:3:4:5", None):
        assert bad not in BLUETOOTH_ADDRESS
