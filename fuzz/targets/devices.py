"""Operator devices' protocols, and the cores that believe them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from cardan.drivers.core import DeviceCore
from cardan.drivers.evdev.nodes import EvdevState
from cardan.drivers.gamepad import GamepadCore, GamepadOptions
from cardan.drivers.keyboard import KeyboardCore, KeyboardOptions
from cardan.drivers.spacemouse import SpaceMouseCore, SpaceMouseOptions
from cardan.drivers.spnav import SpnavCore, SpnavOptions
from cardan.protocols import uevent
from cardan.protocols.connexion import descriptors, devices, reports as connexion_reports
from cardan.protocols.evdev import events as evdev_events, requests as evdev_requests, uinput
from cardan.protocols.handheld import frames as handheld_frames, teleop
from cardan.protocols.hid import MalformedReport
from cardan.protocols.spnav import codes as spnav_codes, records, streams, strings
from cardan.sim_peers.evdev import MODELS as EVDEV_MODELS
from cardan.types import DeviceLink, DeviceState
from cardan_jr3 import protocol as jr3_can
from cardan_jr3.driver import Jr3Core, Jr3Options
from cardan_jr3.driver.core import ZERO_LOST_REASON
from cardan_leap import protocol as leap
from cardan_leap.driver import LeapCore, LeapOptions
from cardan_serial_mice import protocol as cs
from cardan_serial_mice.driver.session import SerialSession
from cardan_serial_mice.protocol import models as serial_models
from cardan_spnav_server import protocol as spnav_server
from cardan_wiimote import protocol as wm
from cardan_wiimote.driver import WiimoteCore, WiimoteOptions
from fuzz.target import Form, Packets, Target
from fuzz.targets.common import (
    all_finite,
    joined_streams,
    kinds,
    near,
    pieces_of,
    same,
    text_of,
)
from tests.drivers import evdev_bench
from tests.plugin_benches import jr3_bench, leap_frames, wiimote_bench
from tests.protocols import worked

_HANDHELD = Path(__file__).parents[2] / "tests/protocols/handheld_vectors.json"


def checked_state(state: DeviceState) -> DeviceState:
    """A device's state is sane whatever it was told."""
    assert all(-1.0 <= each <= 1.0 for each in state.axes), state
    assert state.battery is None or 0.0 <= state.battery <= 1.0, state
    for part in (state.pose, state.wrench, state.inertia):
        all_finite(part)
    return state


def reported(core: DeviceCore, now_s: float) -> tuple[str, ...]:
    """Check a core's state, events and metrics; return its diagnosis."""
    checked_state(core.state(now_s))
    core.events()
    core.metrics(now_s)
    return tuple(core.diagnosis(now_s))


# -- HID of 3Dconnexion -----------------------------------------------------------------------


def _connexion(data: bytes) -> object:
    found = connexion_reports.decode_input(data)
    descriptors.full_scale_of(data)
    out = connexion_reports.decode_output(data)
    if isinstance(out, connexion_reports.LedOutput):
        same(connexion_reports.decode_output(connexion_reports.encode_led(out.on)), out)
    encoders: dict[type, Callable[..., bytes]] = {
        connexion_reports.Translation: connexion_reports.encode_translation,
        connexion_reports.Rotation: connexion_reports.encode_rotation,
        connexion_reports.MotionReport: connexion_reports.encode_motion,
        connexion_reports.Battery: connexion_reports.encode_battery,
    }
    if type(found) in encoders:
        same(connexion_reports.decode_input(encoders[type(found)](*found)), found)
    return found


def _connexion_reports() -> Iterator[bytes]:
    names = ("TRANSLATION", "ROTATION", "MOTION", "BUTTONS_PRO", "BUTTONS_TWO", "KEYS_DOWN")
    for name in (*names, "BATTERY", "LED", "CALIBRATE"):
        yield getattr(worked, name)
    yield connexion_reports.encode_long_press((103, 104))
    for model in devices.MODELS[:6]:
        yield descriptors.descriptor_for(model)


def _spacemouse(packets: Packets) -> object:
    """After garbage and a pause a device that is at rest is live."""
    results: list[object] = []
    for key in ("spacenavigator", "spacemouse-pro-wireless-receiver"):
        model = devices.model_by_key(key)
        core = SpaceMouseCore(SpaceMouseOptions(), model)
        now_s = 1000.0
        core.on_opened(now_s, model)
        for number, data in enumerate(packets):
            now_s += 0.008 if number % 7 else 0.2
            core.on_report(data, now_s)
            checked_state(core.state(now_s))
        results += reported(core, now_s)
        now_s += 5.0
        core.on_lost("unplugged", now_s)
        core.on_opened(now_s, model)
        now_s += 1.0
        for _ in range(4):
            now_s += 0.016
            if model.family is devices.Family.SPLIT:
                core.on_report(connexion_reports.encode_translation(0, 0, 0), now_s)
                core.on_report(connexion_reports.encode_rotation(0, 0, 0), now_s)
            else:
                core.on_report(connexion_reports.encode_motion(0, 0, 0, 0, 0, 0), now_s)
        assert core.state(now_s).link is DeviceLink.LIVE, core.diagnosis(now_s)
    return tuple(results[:8])


def _spacemouse_packets() -> Iterator[Packets]:
    rest = connexion_reports.encode_motion(0, 0, 0, 0, 0, 0)
    yield (rest, worked.MOTION, worked.BUTTONS_PRO, worked.BATTERY, worked.KEYS_DOWN, rest)
    yield (worked.TRANSLATION, worked.ROTATION, worked.BUTTONS_TWO, b"\x03", b"")


# -- serial ---------------------------------------------------------------------------------------

_MAGELLAN = (
    cs.encode_magellan_motion((1, -2, 300, 4, -5, 600)),
    cs.encode_magellan_motion((1, -2, 300, 4, -5, 600), compressed=True),
    cs.encode_magellan_keys(0x21, extended=True),
    cs.encode_magellan_keys(0x21, extended=False),
    b"vMAGELLAN  Version 6.70  3D-Controller\r",
    b"m3\r",
    b"e1\r",
)
_SPACEBALL = (
    cs.encode_spaceball_motion(cs.SpaceballMotion(60, 1, -2, 0x0D, 0x11, 0x13, 6)),
    cs.encode_spaceball_keys(cs.SpaceballKeys(1, 4)),
    cs.encode_spaceball_keys(cs.SpaceballAdvancedKeys(0x21, 5)),
    b"@1 Spaceball alive and well after a power reset.\r",
    b"@2 Firmware version 2.35 created on 06-Sep-1995.\r",
    b"EParity\r",
    b"%\r",
)
_ORB = (
    cs.encode_orb_motion(0x80, (1, -2, 300, 4, -5, 100)),
    cs.encode_orb_keys(100, 0x81),
    cs.encode_orb_reset("SpaceOrb Version 1.0"),
    cs.encode_orb_error(0x80),
    cs.encode_orb_text("?", b"hello"),
)
_SERIAL = {"magellan": _MAGELLAN, "spaceball": _SPACEBALL, "spaceorb": _ORB}


def _serial(reader: Any, decode: Any) -> Callable[[bytes], object]:
    def read(data: bytes) -> object:
        decode(data[:200])
        return kinds(joined_streams(lambda: reader().feed, data))

    return read


def _streams_of(name: str) -> Callable[[], Iterable[bytes]]:
    def seeds() -> Iterator[bytes]:
        yield b"".join(_SERIAL[name])
        yield from _SERIAL[name]

    return seeds


def _serial_commands(data: bytes) -> object:
    text = data[:160].decode("latin-1")
    serial_models.model_of_version(text)
    model = serial_models.model_of_firmware(text)
    return model is None, kinds(joined_streams(lambda: cs.CommandReader().feed, data))


def _serial_session(data: bytes) -> object:
    """Bytes of any device, from the moment of opening on."""
    now_s = 1000.0
    session = SerialSession(None, now_s)
    results: list[object] = []
    for piece in pieces_of(data):
        now_s += 0.05
        results += session.receive(piece, now_s)
        results += session.notices(now_s)
        session.send(now_s)
        session.failure(now_s)
    assert len(results) <= 4 * len(data) + 16
    model = session.model
    return kinds(results), None if model is None else model.key, session.running


# -- spacenavd -------------------------------------------------------------------------------------


def _spnav_server(data: bytes) -> object:
    return kinds(joined_streams(lambda: streams.ServerReader().feed, data))


def _spnav_records() -> Iterator[bytes]:
    yield records.encode_handshake(1) + spnav_server.encode_motion((0, 0, 175, 0, 0, 0), 16)
    yield spnav_server.encode_motion((0, 0, 175, 0, 0, 0), 16) + spnav_server.encode_button(1, True)
    yield spnav_server.encode_device(records.DeviceChange(True, 0, 0x206, 0x46D, 0xC626))
    yield spnav_server.encode_config(records.ConfigChange(3, (1, 2, 3, 4, 5, 6)))
    yield records.encode_reply(int(spnav_codes.Code.DEV_NAXES), (6,))
    yield b"".join(strings.encode_string(int(spnav_codes.Code.DEV_NAME), "SpaceNavigator " * 4))


def _spnav_client(data: bytes) -> object:
    for newest in (0, 1):
        found = joined_streams(lambda newest=newest: spnav_server.ClientReader(newest).feed, data)
    return kinds(found)


def _spnav_requests() -> Iterator[bytes]:
    yield records.encode_handshake(1) + b"".join(
        records.encode_request(int(code), (1,)) for code in spnav_codes.Code
    )
    yield records.encode_sensitivity(0.5) * 3
    yield records.encode_handshake(1) + b"".join(
        strings.encode_string(int(spnav_codes.Code.SET_NAME), "a program " * 9)
    )


_DATA = (records.ServerReply, spnav_server.ClientRequest)


def _spnav_strings(packets: Packets) -> object:
    assembler = spnav_server.StringAssembler()
    found: list[object] = []
    for packet in packets:
        record = records.decode_server_record(packet[:32].ljust(32, b"\0"))
        request = spnav_server.decode_request(packet[:32].ljust(32, b"\0"))
        asked = (each for each in (record, request) if isinstance(each, _DATA))
        found += [assembler.take(each.data) for each in asked]
    return kinds(found)


def _spnav_string_packets() -> Iterator[Packets]:
    yield tuple(
        strings.encode_string(int(spnav_codes.Code.DEV_NAME), "SpaceNavigator for Notebooks " * 3)
    )


def _spnav_core(packets: Packets) -> object:
    """After garbage the daemon comes back and is understood."""
    core = SpnavCore(SpnavOptions())
    now_s = 50.0
    core.on_opened(now_s)
    for data in packets:
        now_s += 0.016
        core.outgoing()
        core.on_bytes(data, now_s)
        core.on_time(now_s)
        checked_state(core.state(now_s))
    words = reported(core, now_s)
    core.on_lost("closed", now_s)
    now_s += 5.0
    core.on_opened(now_s)
    reader = spnav_server.ClientReader()
    for _ in range(60):
        now_s += 0.01
        for piece in core.outgoing():
            for value in reader.feed(piece):
                if isinstance(value, streams.Handshake):
                    core.on_bytes(records.encode_handshake(value.version), now_s)
                elif isinstance(value, spnav_server.ClientRequest):
                    core.on_bytes(records.encode_reply(value.word, (), records.FAILED), now_s)
        core.on_time(now_s)
    core.on_bytes(spnav_server.encode_motion((0,) * 6, 16), now_s)
    now_s += 0.01
    assert core.state(now_s).link in (DeviceLink.LIVE, DeviceLink.NEEDS_NEUTRAL), core.diagnosis(
        now_s
    )
    return words


def _spnav_core_packets() -> Iterator[Packets]:
    yield tuple(_spnav_records())
    yield (
        records.encode_handshake(1),
        *(records.encode_reply(int(code), (2, 0, 0)) for code in spnav_codes.Code),
        spnav_server.encode_motion((0, 0, 175, 0, 0, 0), 16),
    )


# -- Wii Remote ------------------------------------------------------------------------------------


def _wiimote(data: bytes) -> object:
    found = wm.decode_input(data)
    if isinstance(found, wm.Data):
        again = wm.decode_input(wm.encode_data(found))
        assert isinstance(again, wm.Data)
        assert again.buttons == found.buttons
        layout = wm.DATA_LAYOUTS[found.mode]
        if layout.ir_format is not None:
            wm.decode_dots(found.ir, layout.ir_format)
        for part in (wm.decode_nunchuk, wm.decode_nunchuk_pass_through, wm.decode_motion_plus):
            part(found.extension)
    elif isinstance(found, wm.Status):
        same(wm.decode_input(wm.encode_status(found)), found)
    elif isinstance(found, wm.ReadData):
        same(wm.decode_input(wm.encode_read_data(found)), found)
    elif isinstance(found, wm.Ack):
        same(wm.decode_input(wm.encode_ack(found)), found)
    elif isinstance(found, wm.Interleaved):
        second = found._replace(mode=wm.SECOND_HALF_ID)
        wm.decode_dots(
            wm.join_halves(found._replace(mode=wm.FIRST_HALF_ID), second).ir, wm.IrFormat.FULL
        )
    return found


def _wiimote_out(data: bytes) -> object:
    found = wm.decode_output(data)
    wm.rumble_of(data)
    if not isinstance(found, MalformedReport):
        same(wm.decode_output(wm.encode_output(found)), found)
        same(wm.rumble_of(wm.with_rumble(wm.encode_output(found), True)), True)
    return found


def _wiimote_memory(data: bytes) -> object:
    """Calibrations and identities, as they are read."""
    calibration, source = wm.read_accelerometer_calibration(data)
    wm.to_g((512, 512, 512), calibration.zero, calibration.one_g)
    nunchuk = wm.decode_nunchuk_calibration(data)
    if nunchuk is not None:
        same(wm.decode_nunchuk_calibration(wm.encode_nunchuk_calibration(nunchuk)), nunchuk)
        wm.to_g((512, 512, 512), nunchuk.zero, nunchuk.one_g)
        for value in (0, 128, 255):
            assert -1.0 <= wm.stick_deflection(value, nunchuk.stick_x) <= 1.0
    plus = wm.decode_motion_plus_calibration(data)
    if plus is not None:
        encoded = wm.encode_motion_plus_calibration(plus)
        same(wm.decode_motion_plus_calibration(encoded), plus)
        frame = wm.decode_motion_plus(b"\x12\x34\x56\x7b\x7c\x7e")
        assert frame is not None
        wm.to_rad_s(frame, plus)
    return source, nunchuk, plus, wm.extension_of(data[:6])


def _wiimote_blocks() -> Iterator[bytes]:
    block = wm.encode_accelerometer_calibration(wm.DEFAULT_ACCELEROMETER)
    yield block + block
    yield wm.encode_nunchuk_calibration(wm.DEFAULT_NUNCHUK)
    yield wm.encode_motion_plus_calibration(wm.DEFAULT_MOTION_PLUS)
    yield from wm.EXTENSION_IDS.values()


@cache
def _wiimote_said() -> tuple[Packets, Packets]:
    """Packets between a simulated remote and the driver."""
    reports: list[bytes] = []
    outputs: list[bytes] = []
    for plus in (False, True):
        bench = wiimote_bench.Bench(extension="nunchuk", motion_plus=plus)
        taken = bench.core.on_report

        def on_report(report: bytes, now_s: float, taken: Any = taken) -> None:
            if not reports or reports[-1][:3] != report[:3] or len(reports) % 4 == 0:
                reports.append(report)
            taken(report, now_s)

        bench.core.on_report = on_report
        bench.ready(8.0)
        outputs += [report for _, report in bench.sent]
    return tuple(reports[:60]), tuple(outputs[:60])


def _wiimote_core(packets: Packets) -> object:
    core = WiimoteCore(WiimoteOptions())
    now_s = 10.0
    core.on_opened(now_s)
    for data in packets:
        now_s += 0.01
        core.outgoing(now_s)
        core.on_report(data, now_s)
        checked_state(core.state(now_s))
    words = reported(core, now_s)
    bench = wiimote_bench.Bench()
    bench.core, bench.now_s = core, now_s + 3.0
    core.on_lost("gone", now_s)
    assert bench.ready(8.0).link is DeviceLink.LIVE
    return words


# -- Leap -----------------------------------------------------------------------------------------

_HAND = leap_frames.hand()


def _handheld(data: bytes) -> object:
    found = handheld_frames.decode_frame(data)
    if isinstance(found, handheld_frames.OperatorFrame):
        again = handheld_frames.decode_frame(handheld_frames.encode_frame(found))
        assert isinstance(again, handheld_frames.OperatorFrame), again
        if isinstance(found.body, handheld_frames.XrFrame):
            # It is of length 1 in doubles, and rounded to floats again.
            turn = found.body.orientation
            again = again._replace(body=again.body._replace(orientation=turn))
        near(again, found)
    return found


def _handheld_frames() -> Iterator[bytes]:
    for each in json.loads(_HANDHELD.read_text(encoding="utf-8"))["frames"]:
        yield bytes.fromhex(each["bytes"])


def _teleop(data: bytes) -> object:
    found = teleop.decode_teleop(text_of(data))
    if isinstance(found, teleop.TeleopPose):
        all_finite(found)
        again = handheld_frames.decode_frame(handheld_frames.encode_frame(found.frame(7, 1000, 2)))
        assert isinstance(again, handheld_frames.OperatorFrame), again
    return found


def _teleop_messages() -> Iterator[bytes]:
    yield b'{"type": "log", "data": "hello"}'
    yield (
        b'{"type": "pose", "data": {"position": {"x": 0.1, "y": 1.2, "z": -0.3}, "orientation": '
        b'{"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}, "move": true, "scale": 0.5, '
        b'"reservedButtonA": false, "reservedButtonB": true}}'
    )


def _leap(data: bytes) -> object:
    found, options = leap.decode_service(data), leap.decode_options(data)
    if not isinstance(found, leap.Ignored):
        all_finite(found)
    if isinstance(found, leap.Version) and abs(found.version) < 100:
        leap.encode_version(found)
    if isinstance(found, leap.DeviceEvent):
        leap.encode_device_event(found, 6)
    if isinstance(options, leap.ClientOptions):
        leap.encode_options(options)
    return found, options


def _leap_messages() -> Iterator[bytes]:
    yield b'{"serviceVersion": "2.3.1+31549", "version": 6}'
    yield leap.encode_device_event(leap_frames.PLUGGED, 6).encode()
    yield leap.encode_device_event(leap_frames.PLUGGED, 4).encode()
    yield (
        b'{"currentFrameRate":110.1,"devices":[],"gestures":[],"hands":[{"armBasis":[[1,0,0],'
        b'[0,1,0],[0,0,1]],"confidence":0.9,"direction":[0.1,0.2,-0.97],"grabStrength":0.1,'
        b'"id":57,"palmNormal":[0.01,-0.99,0.1],"palmPosition":[1.5,200.1,3.2],'
        b'"pinchStrength":0.2,"timeVisible":12.5,"type":"right"}],"id":1001,"interactionBox":{},'
        b'"pointables":[],"timestamp":4711000}'
    )
    yield b'{"hands":[],"id":1002,"timestamp":4712000,"currentFrameRate":60}'
    for text in leap.encode_options(leap.ClientOptions(focused=True, background=False)):
        yield text.encode()


def _leap_core(packets: Packets) -> object:
    core = LeapCore(LeapOptions())
    now_s = 100.0
    core.on_opened(now_s)
    for data in packets:
        now_s += 0.009
        core.on_message(leap.decode_service(data), now_s)
        checked_state(core.state(now_s))
        core.failure(now_s)
    words = reported(core, now_s)
    bench = leap_frames.Bench()
    bench.core, bench.now_s = core, now_s + 3.0
    core.on_lost("gone", bench.now_s)
    core.on_opened(bench.now_s)
    bench.tell(leap.Version(6, "2.3.1"), leap_frames.PLUGGED)
    state = bench.frame(_HAND)
    assert state.link is not DeviceLink.CLOSED
    return words


# -- JR3 ------------------------------------------------------------------------------------------


def _jr3(data: bytes) -> object:
    """Two bytes of identifier, then the payload."""
    identifier, payload = int.from_bytes(data[:2], "little") & 0x7FF, data[2:]
    board = jr3_can.decode_from_board(identifier, payload)
    host = jr3_can.decode_from_host(identifier, payload)
    node = identifier & 0x7F
    if board is not None and not isinstance(board, jr3_can.Malformed):
        frame = jr3_can.encode_from_board(board, node)
        same(jr3_can.decode_from_board(*frame), board)
    if host is not None:
        frame = jr3_can.encode_from_host(host, node)
        same(jr3_can.decode_from_host(*frame), host)
    return board, host


@cache
def _jr3_said() -> tuple[Packets, Packets]:
    bench = jr3_bench.Bench()
    frames: list[jr3_can.CanFrame] = []
    bench.mangle = lambda frame: frames.append(frame) or frame  # type: ignore[func-returns-value]
    bench.open()
    bench.run(0.4)

    def packets(frames: Iterable[jr3_can.CanFrame]) -> Packets:
        return tuple(each.arbitration_id.to_bytes(2, "little") + each.data for each in frames)

    return packets(frames[:60]), packets(bench.sent[:60])


def _jr3_frames() -> Iterator[bytes]:
    for side in _jr3_said():
        yield from dict.fromkeys(side)
    for message in (jr3_can.StartAsync(1000, 2000), jr3_can.GripperPwm(50.0), jr3_can.Sync()):
        frame = jr3_can.encode_from_host(message, 33)
        yield frame.arbitration_id.to_bytes(2, "little") + frame.data


def _jr3_core(packets: Packets) -> object:
    core = Jr3Core(Jr3Options())
    now_s = 10.0
    core.on_opened(now_s)
    for data in packets:
        now_s += 0.005
        core.poll(now_s)
        core.on_frame(int.from_bytes(data[:2], "little") & 0x7FF, data[2:10], now_s)
        checked_state(core.state(now_s))
    words = reported(core, now_s)
    bench = jr3_bench.Bench()
    bench.run(0.01)
    core.on_lost("gone", now_s)
    bench.core, bench.now_s = core, now_s + 5.0
    bench.open()
    state = bench.run(1.0)
    if state.link is DeviceLink.NEEDS_NEUTRAL and ZERO_LOST_REASON in core.diagnosis(bench.now_s):
        # It was zeroed, by what the garbage said: another board's zero is not taken by itself.
        core.ask_zero(bench.now_s)
        state = bench.run(1.0)
    assert state.link is DeviceLink.LIVE, core.diagnosis(bench.now_s)
    return words


# -- evdev ----------------------------------------------------------------------------------------


def _evdev(data: bytes) -> object:
    events = evdev_events.decode_events(data)
    if isinstance(events, list):
        same(evdev_events.decode_events(evdev_events.encode_events(events)), events)
        return len(events) > 0
    rumble = evdev_requests.decode_rumble(data)
    if isinstance(rumble, evdev_requests.Rumble):
        same(evdev_requests.decode_rumble(evdev_requests.encode_rumble(rumble)), rumble)
    call = evdev_requests.decode_call(data)
    if isinstance(call, evdev_requests.IoctlCall):
        same(evdev_requests.decode_call(evdev_requests.encode_call(call)), call)
    evdev_requests.decode_id(data)
    evdev_requests.decode_absinfo(data)
    evdev_requests.decode_int(data)
    evdev_requests.decode_bits(data[:96])
    if len(data) >= 104:  # The kernel fills the whole argument.
        uinput.decode_upload(data)
        uinput.decode_erase(data)
    return rumble, call


def _evdev_packets() -> Iterator[bytes]:
    event = evdev_events.InputEvent
    yield evdev_events.encode_events(
        [
            event(1, 2, evdev_events.EV_ABS, 0, 1000),
            event(1, 2, evdev_events.EV_KEY, 304, 1),
            event(1, 2, 0, 0, 0),
        ]
    )
    yield evdev_requests.encode_rumble(evdev_requests.Rumble(3, 0x8000, 0x4000, 250))
    yield evdev_requests.encode_call(
        evdev_requests.IoctlCall(evdev_requests.EVIOCGKEY, 0, b"\x01" * 96)
    )
    yield evdev_requests.encode_id(evdev_requests.InputId(3, 0x45E, 0x28E, 0x110))
    yield uinput.begin_upload(7) + evdev_requests.encode_rumble(evdev_requests.Rumble(3, 1, 2, 3))
    yield evdev_requests.encode_absinfo(evdev_requests.AbsInfo(0, -32768, 32767, 16, 128, 0))


def _evdev_core(packets: Packets) -> object:
    """After garbage and a look at what it holds, it takes events again."""
    words: list[str] = []
    for key in ("xbox-360", "keyboard"):
        model = evdev_bench.BY_KEY[key]
        core: Any = (
            GamepadCore(GamepadOptions()) if model.is_gamepad else KeyboardCore(KeyboardOptions())
        )
        now_s = 10.0
        held = EvdevState(frozenset(), {code: info.value for code, info in model.axes.items()})
        core.on_opened(evdev_bench.describe(model), held, now_s)
        for data in packets:
            now_s += 0.004
            core.on_packet(data, now_s)
            core.on_checked(now_s)
            if core.needs_snapshot:
                core.on_snapshot(held, now_s)
            checked_state(core.state(now_s))
        words += reported(core, now_s)
        core.on_lost("gone", now_s)
        now_s += 1.0
        core.on_opened(evdev_bench.describe(model), held, now_s)
        code = next(iter(model.codes.values()))
        for value in (1, 0):
            now_s += 0.01
            pressed = [evdev_events.InputEvent(0, 0, evdev_events.EV_KEY, code, value)]
            core.on_packet(
                evdev_events.encode_events([*pressed, evdev_events.InputEvent(0, 0, 0, 0, 0)]),
                now_s,
            )
        core.on_checked(now_s)
        assert core.state(now_s).link is DeviceLink.LIVE, core.diagnosis(now_s)
    return tuple(words[:8])


def _evdev_core_packets() -> Iterator[Packets]:
    event = evdev_events.InputEvent
    end = event(1, 2, 0, 0, 0)
    for model in EVDEV_MODELS[:2]:
        codes = list(model.codes.values())[:4]
        yield tuple(
            evdev_events.encode_events([event(1, 2, evdev_events.EV_KEY, code, value), end])
            for code in codes
            for value in (1, 0)
        ) + tuple(
            evdev_events.encode_events([event(1, 2, evdev_events.EV_ABS, code, info.maximum), end])
            for code, info in list(model.axes.items())[:4]
        )


def _uevent(data: bytes) -> object:
    found = uevent.decode_uevent(data)
    return None if found is None else (found.action, found.subsystem)


def _uevents() -> Iterator[bytes]:
    texts = (
        b"add@/devices/pci0000:00/usb1/1-1/0003:256F:C635.0001/hidraw/hidraw0\0ACTION=add\0"
        b"DEVPATH=/devices/x/hidraw/hidraw0\0SUBSYSTEM=hidraw\0MAJOR=241\0MINOR=0\0"
        b"DEVNAME=hidraw0\0SEQNUM=4711\0"
    )
    yield texts
    head = b"libudev\0" + bytes.fromhex("feedcafe") + bytes(28)
    properties = texts.split(b"\0", 1)[1]
    header = (
        b"libudev\0"
        + bytes.fromhex("feedcafe")
        + (40).to_bytes(4, "little") * 2
        + len(properties).to_bytes(4, "little")
        + bytes(16)
    )
    yield header + properties
    yield head + properties


TARGETS = (
    Target("connexion.reports", Form.BYTES, _connexion, _connexion_reports, longest=4096),
    Target("connexion.core", Form.PACKETS, _spacemouse, _spacemouse_packets, longest=4096),
    Target(
        "connexion_serial.magellan",
        Form.BYTES,
        _serial(cs.MagellanReader, cs.decode_magellan),
        _streams_of("magellan"),
        words=(b"\r", b"d", b"k", b"v", b"m"),
    ),
    Target(
        "connexion_serial.spaceball",
        Form.BYTES,
        _serial(cs.SpaceballReader, cs.decode_spaceball),
        _streams_of("spaceball"),
        words=(b"\r", b"^", b"D", b"K", b".", b"@"),
    ),
    Target(
        "connexion_serial.spaceorb",
        Form.BYTES,
        _serial(cs.OrbReader, cs.decode_orb),
        _streams_of("spaceorb"),
        words=(b"\r", b"D", b"K", b"R", b"E"),
    ),
    Target(
        "connexion_serial.commands",
        Form.BYTES,
        _serial_commands,
        lambda: (b"\r@RESET\r", b"vQ\r", b"@2 Firmware version 2.35\r", b"SPACEBALL 5000\r"),
    ),
    Target(
        "connexion_serial.session",
        Form.BYTES,
        _serial_session,
        lambda: (b"".join(each) for each in _SERIAL.values()),
        words=(b"\r", *_MAGELLAN[:3], *_SPACEBALL[:3], *_ORB[:3]),
        longest=4096,
    ),
    Target("spnav.server_stream", Form.BYTES, _spnav_server, _spnav_records),
    Target("spnav.client_stream", Form.BYTES, _spnav_client, _spnav_requests),
    Target("spnav.strings", Form.PACKETS, _spnav_strings, _spnav_string_packets, longest=2048),
    Target("spnav.core", Form.PACKETS, _spnav_core, _spnav_core_packets, longest=4096),
    Target("wiimote.input", Form.BYTES, _wiimote, lambda: _wiimote_said()[0], longest=256),
    Target("wiimote.output", Form.BYTES, _wiimote_out, lambda: _wiimote_said()[1], longest=256),
    Target("wiimote.memory", Form.BYTES, _wiimote_memory, _wiimote_blocks, longest=256),
    Target(
        "wiimote.core",
        Form.PACKETS,
        _wiimote_core,
        lambda: (_wiimote_said()[0],),
        longest=4096,
        slow_s=0.5,
    ),
    Target("handheld.frames", Form.BYTES, _handheld, _handheld_frames, longest=256),
    Target("handheld.teleop", Form.JSON, _teleop, _teleop_messages, longest=4096),
    Target("leap.messages", Form.JSON, _leap, _leap_messages, longest=200_000),
    Target(
        "leap.core", Form.JSON_PACKETS, _leap_core, lambda: (tuple(_leap_messages()),), slow_s=0.2
    ),
    Target("jr3_can.frames", Form.BYTES, _jr3, _jr3_frames, longest=64),
    Target("jr3_can.core", Form.PACKETS, _jr3_core, lambda: (_jr3_said()[0],), slow_s=0.5),
    Target("evdev.messages", Form.BYTES, _evdev, _evdev_packets, longest=4096),
    Target("evdev.core", Form.PACKETS, _evdev_core, _evdev_core_packets, longest=8192),
    Target(
        "uevent",
        Form.BYTES,
        _uevent,
        _uevents,
        words=(b"\0", b"@", b"=", b"ACTION=", b"SUBSYSTEM=", b"libudev\0"),
        longest=8192,
    ),
)
