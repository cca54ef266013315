"""The codec of /dev/uhid against its structures in linux/uhid.h, and the device on a pipe."""

from __future__ import annotations

import contextlib
import socket
import struct
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from cardan.errors import DeviceAccessError, ScriptError
from cardan.protocols.connexion.descriptors import descriptor_for
from cardan.protocols.connexion.reports import decode_input
from cardan.sim_peers.backends.uhid import (
    BUS_BLUETOOTH,
    BUS_USB,
    DATA_MAX,
    EVENT_BYTES,
    Close,
    GetReport,
    HidIdentity,
    MalformedEvent,
    Open,
    Output,
    SetReport,
    Start,
    Stop,
    UhidDevice,
    decode_event,
    encode_create,
    encode_destroy,
    encode_get_report_reply,
    encode_input,
    encode_set_report_reply,
)
from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions

PUCK = HidIdentity("puck", BUS_USB, 0x256F, 0xC635, b"\x05\x01\x09\x08", "here", "42", 0x431, 7)


def event(kind: int, body: bytes = b"") -> bytes:
    """Return an event in the kernel's form: always a whole struct uhid_event."""
    return (struct.pack("=I", kind) + body).ljust(EVENT_BYTES, b"\0")


def output(report: bytes, report_type: int = 1) -> bytes:
    return event(6, report.ljust(DATA_MAX, b"\0") + struct.pack("=HB", len(report), report_type))


def test_a_whole_event_has_the_size_of_the_kernels_structure():
    # __u32 type, then the largest member: uhid_create2_req, packed.
    assert EVENT_BYTES == 4 + 128 + 64 + 64 + 2 + 2 + 4 * 4 + 4096 == 4376


@pytest.mark.judged(device="uhid", transport="/dev/uhid", by="linux/uhid.h: sizes and offsets")
def test_create_has_every_field_at_its_place():
    data = encode_create(PUCK)
    assert data[:4] == struct.pack("=I", 11)
    assert data[4:132].rstrip(b"\0") == b"puck"
    assert data[132:196].rstrip(b"\0") == b"here"
    assert data[196:260].rstrip(b"\0") == b"42"
    assert struct.unpack_from("=HHIIII", data, 260) == (4, BUS_USB, 0x256F, 0xC635, 0x431, 7)
    assert data[280:] == b"\x05\x01\x09\x08"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"name": "ü" * 64}, "name has 128 bytes; allowed: at most 127"),
        ({"serial": "x" * 64}, "serial has 64 bytes; allowed: at most 63"),
        ({"descriptor": b""}, "descriptor has 0 bytes; allowed: 1 to 4096"),
        ({"descriptor": bytes(4097)}, "descriptor has 4097 bytes"),
    ],
)
def test_what_has_no_room_is_refused(change, words):
    with pytest.raises(ValueError, match=words):
        encode_create(PUCK._replace(**change))


def test_the_other_requests_are_packed_without_padding():
    assert encode_destroy() == struct.pack("=I", 1)
    assert encode_input(b"\x03\x01\x00") == struct.pack("=IH", 12, 3) + b"\x03\x01\x00"
    assert encode_get_report_reply(9, 5) == struct.pack("=IIHH", 10, 9, 5, 0)
    assert encode_get_report_reply(9, 0, b"ab") == struct.pack("=IIHH", 10, 9, 0, 2) + b"ab"
    assert encode_set_report_reply(9, 5) == struct.pack("=IIH", 14, 9, 5)
    with pytest.raises(ValueError, match="4097 bytes; allowed: at most 4096"):
        encode_input(bytes(4097))


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (event(2, struct.pack("=Q", 5)), Start(5)),
        (event(3), Stop()),
        (event(4), Open()),
        (event(5), Close()),
        (output(b"\x04\x01"), Output(1, b"\x04\x01")),
        (event(9, struct.pack("=IBB", 77, 7, 0)), GetReport(77, 7, 0)),
        (event(13, struct.pack("=IBBH", 78, 4, 1, 2) + b"\x04\x00"), SetReport(78, 4, 1, b"\4\0")),
    ],
)
def test_every_event_is_understood(data, expected):
    assert decode_event(data) == expected


@given(st.binary(max_size=64))
def test_no_bytes_make_it_raise(data):
    decode_event(data)


@given(st.integers(0, 2**32 - 1), st.binary(max_size=64))
def test_no_whole_event_makes_it_raise(kind, body):
    value = decode_event(event(kind, body))
    assert kind in range(15) or isinstance(value, MalformedEvent)


def test_no_size_of_an_output_report_is_believed_beyond_its_room():
    data = bytearray(output(b"\x04\x01"))
    data[4 + DATA_MAX : 6 + DATA_MAX] = b"\xff\xff"
    assert isinstance(decode_event(bytes(data)), MalformedEvent)


def test_without_the_kernels_module_the_remedy_is_named():
    with pytest.raises(DeviceAccessError, match="modprobe uhid"):
        UhidDevice("/nonexistent/uhid").open()


# --------------------------------------------------------------------------------------------- The
# SpaceMouse on it. A socket pair replaces the kernel's file.


class Kernel:
    """Other end of a stand-in for /dev/uhid."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        ours.setblocking(False)
        theirs.setblocking(False)
        self._sock = ours
        monkeypatch.setattr(
            UhidDevice, "open", lambda device: setattr(device, "_fd", theirs.detach())
        )

    def says(self, data: bytes) -> None:
        self._sock.send(data)

    def got(self) -> list[tuple[int, bytes]]:
        """Return (type, body) of each written event."""
        events = []
        with contextlib.suppress(BlockingIOError):
            while data := self._sock.recv(EVENT_BYTES):
                events.append((int.from_bytes(data[:4], "little"), data[4:]))
        return events

    def close(self) -> None:
        self._sock.close()


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Iterator[Kernel]:
    kernel = Kernel(monkeypatch)
    yield kernel
    kernel.close()


def peer(script: str = "0.0 axes 1 0 0 0 0 0", **options: object) -> SpaceMousePeer:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "script.txt"
        file.write_text(script)
        return SpaceMousePeer(
            SpaceMousePeerOptions(uhid=True, script=str(file), jitter_lsb=0, **options)
        )


def run(puck: SpaceMousePeer, seconds: float = 0.0) -> None:
    """Serve waiting requests, and `seconds` of the script in steps that are too short to count as
    stalls."""
    puck.step(time.monotonic() + 0.001)
    while seconds > 0.0:
        assert puck._start_s is not None
        puck._start_s -= 0.008
        seconds -= 0.008
        puck.step(time.monotonic() + 0.001)


def inputs(events: list[tuple[int, bytes]]) -> list[bytes]:
    return [body[2:] for kind, body in events if kind == 12]


def test_it_appears_moves_once_opened_and_takes_the_led(kernel):
    puck = peer(model="spacemouse-compact")
    puck.open()
    ((kind, body),) = kernel.got()
    assert kind == 11
    assert body[:128].rstrip(b"\0") == b"3Dconnexion SpaceMouse Compact"
    assert struct.unpack_from("=HHII", body, 256)[1:] == (BUS_USB, 0x256F, 0xC635)
    assert body[276:] == descriptor_for(puck.device.model)
    run(puck)
    assert kernel.got() == []
    kernel.says(event(4))
    run(puck)
    run(puck, 0.05)
    reports = inputs(kernel.got())
    # A full deflection forward is -350 on the raw Y axis.
    assert decode_input(reports[0]).y == -350
    assert {type(decode_input(report)).__name__ for report in reports} == {
        "Translation",
        "Rotation",
    }
    kernel.says(output(b"\x04\x01"))
    kernel.says(output(b"\x04\x00"))
    run(puck)
    assert not puck.device.led
    kernel.says(event(13, struct.pack("=IBBH", 5, 4, 1, 2) + b"\x04\x01"))
    run(puck)
    assert puck.device.led
    assert (14, struct.pack("=IH", 5, 0)) in kernel.got()
    kernel.says(event(9, struct.pack("=IBB", 6, 5, 0)))
    run(puck)
    assert (10, struct.pack("=IHH", 6, 5, 0)) in kernel.got()
    puck.close()


@pytest.mark.parametrize(
    ("model", "vendor", "product"),
    [
        # On USB, the kernel's Logitech driver would claim it.
        ("spacenavigator", 0x046D, 0xC626),
        ("spacemouse-wireless-bt", 0x256F, 0xC63A),
    ],
)
def test_old_ids_and_models_without_a_cable_come_over_bluetooth(kernel, model, vendor, product):
    puck = peer(model=model)
    puck.open()
    ((_, body),) = kernel.got()
    assert struct.unpack_from("=HHII", body, 256)[1:] == (BUS_BLUETOOTH, vendor, product)
    assert puck.endpoint == f"{vendor:04x}:{product:04x}"
    puck.close()


def test_unplugging_destroys_it_and_plugging_in_creates_it_again(kernel):
    puck = peer("0.0 axes 1 0 0 0 0 0\n0.05 unplug\n0.1 replug", start_on_connect=False)
    puck.open()
    kernel.got()
    run(puck, 0.2)
    kinds = [kind for kind, _ in kernel.got()]
    assert [kind for kind in kinds if kind != 12] == [1, 11]
    puck.close()


def test_faults_that_are_the_kernels_affair_are_refused():
    for fault in ("refuse", "newest-lost"):
        with pytest.raises(ScriptError, match=f"fault {fault}: the kernel"):
            SpaceMousePeer(SpaceMousePeerOptions(uhid=True, faults={fault: 1.0}))


def test_a_file_that_is_not_the_kernels_is_refused(tmp_path):
    with pytest.raises(DeviceAccessError, match="cannot open"):
        SpaceMousePeer(SpaceMousePeerOptions(uhid=True, uhid_path=str(tmp_path))).open()
