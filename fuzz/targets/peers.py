"""Simulated peers: they are servers, too, and hear what other people's programs send."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import Any

from cardan.errors import ScriptError
from cardan.protocols.connexion import devices as connexion_devices
from cardan.protocols.evdev import requests as evdev_requests
from cardan.protocols.joint_stream import codec as js
from cardan.protocols.spnav import records
from cardan.sim_peers.arm.controller import SimulatedArm
from cardan.sim_peers.backends import uhid, usbip
from cardan.sim_peers.base import parse_script
from cardan.sim_peers.egm_controller import EgmController, scripts as egm_scripts
from cardan.sim_peers.evdev import (
    MODELS as EVDEV_MODELS,
    SimulatedInput,
    motion_script as evdev_motion,
)
from cardan.sim_peers.motoros_controller import (
    CONNECTIONS,
    MotorosController,
    MotorosControllerOptions,
    MotorosServers,
)
from cardan.sim_peers.spacemouse import motion_script as mouse_motion
from cardan.sim_peers.spacemouse.core import SimulatedSpaceMouse
from cardan.sim_peers.spacemouse.usb import SpaceMouseUsb
from cardan_jr3.peer import SimulatedJr3, motion_script as jr3_motion, socketcand
from cardan_jr3.protocol import TEO_SENSORS
from cardan_leap.peer import hand as leap_hand
from cardan_leap.peer.core import SimulatedLeapService
from cardan_omni.peer import hand as omni_hand
from cardan_omni.peer.settings import parse_omni_faults
from cardan_serial_mice.peer.core import simulated_serial_puck
from cardan_serial_mice.protocol import models
from cardan_spnav_server.core import SpnavServerCore
from cardan_wiimote.peer import SimulatedWiimote, motion_script as remote_motion
from fuzz.target import Form, Packets, Target
from fuzz.targets import devices, robots
from fuzz.targets.common import Clients, all_finite, text_of
from tests.protocols import worked


def _egm(packets: Packets) -> object:
    controller = EgmController()
    now_s = 0.0
    for data in packets:
        now_s += 0.004
        controller.receive(data)
        controller.cycle(now_s)
    all_finite(controller.joints_rad)
    all_finite(controller.tcp)
    assert controller.cycle(now_s + 0.004) is not None or controller.state is not None
    return controller.state, len(packets) > 4


def _motoros(packets: Packets) -> object:
    """Each packet after a byte for its port; afterwards a client is answered."""
    options = MotorosControllerOptions(servo_on=True)
    controller = MotorosController(options)
    servers = MotorosServers(controller, options)
    clients = Clients(servers, 0.004)
    clients.feed(packets)
    now_s = clients.now_s + 5.0
    servers.advance(now_s)
    clients.heard()
    all_finite(controller.command_rad(0))
    fresh = servers.accepted("motion", now_s)
    if fresh is None:
        return "moves"
    servers.data(fresh, worked.PING_REQUEST, now_s)
    said = b""
    for _ in range(200):
        now_s += 0.002
        servers.advance(now_s)
        said += clients.heard()
    assert said, servers.events
    return controller.moving_data, len(packets) > 4


@cache
def _motoros_packets() -> tuple[Packets, ...]:
    kinds = tuple(CONNECTIONS)
    motion, io = bytes([kinds.index("motion")]), bytes([kinds.index("io")])
    found = [
        (motion + worked.START_TRAJ_MODE, motion + worked.TRAJECTORY_POINT, motion + b"\0" * 9),
        (motion + worked.JOINT_VELOCITY, motion + worked.RT_COMMAND),
    ]
    found += [(motion + each, io + each) for each in robots._messages()]
    return tuple(found)


def _arm(packets: Packets) -> object:
    controller = SimulatedArm()
    now_s = 0.0
    for number, data in enumerate(packets):
        now_s += 0.004
        controller.receive(data, now_s, number % 7 == 6)
        controller.cycle(now_s)
    state = controller.state()
    all_finite(state)
    now_s += 10.0
    controller.cycle(now_s)
    hello = js.encode_command(js.ArmCommand(0, 1, 0.0, js.ControlMode.HOLD), 6)
    controller.receive(hello, now_s, "a good one")
    assert controller.cycle(now_s + 0.004), controller.counters
    return controller.hold_reason, controller.counters.ignored.keys() and True


def _arm_packets() -> Iterator[Packets]:
    modes = js.ControlMode
    hello = js.encode_command(js.ArmCommand(0, 1, 0.0, modes.HOLD), 6)
    yield (
        hello,
        *(
            js.encode_command(js.ArmCommand(1, n, 0.1, modes.POSITION, (0.0,) * 6, (0.0,) * 6), 6)
            for n in range(2, 6)
        ),
        js.encode_command(js.ArmCommand(1, 7, 0.1, modes.VELOCITY, (0.1,) * 6), 6),
        js.encode_command(js.ArmCommand(1, 8, 0.1, modes.TORQUE, (0.1,) * 6), 6),
    )


def _wiimote(packets: Packets) -> object:
    remote = SimulatedWiimote(extension="nunchuk", motion_plus=True)
    now_s = 1.0
    remote.connect(now_s)
    found = []
    for number, data in enumerate(packets):
        now_s += 0.01
        if number % 5 == 4:
            remote.interrupt(data, now_s)
            remote.control(data, now_s)
        else:
            remote.output(data, now_s)
        found.append(len(remote.reports(now_s)) > 0)
    return tuple(found[-4:])


def _jr3(packets: Packets) -> object:
    board = SimulatedJr3(33, TEO_SENSORS["right-hand"], boot_s=0.0)
    now_s, count = 0.0, 0
    for data in packets:
        now_s += 0.003
        board.receive(int.from_bytes(data[:2], "little") & 0x7FF, data[2:10], now_s)
        count += len(board.reports(now_s))
        assert count <= 4000 * len(packets)
    return count > 0, count > 10


def _leap(packets: Packets) -> object:
    service = SimulatedLeapService()
    now_s = 1.0
    for number, version in enumerate((6, 3)):
        service.connect(number, version)
    for data in packets:
        now_s += 0.01
        for number in (0, 1, 2):
            service.receive(number, data, now_s)
        service.outgoing()
        service.reports(now_s)
    return service.focused, service.gets_frames(1, now_s)


def _serial(data: bytes) -> object:
    found: list[object] = []
    for key in ("magellan", "spaceball-2003", "spaceball-4000", "spaceorb-360"):
        try:
            model = models.serial_model_by_key(key)
        except KeyError:
            continue
        mouse = simulated_serial_puck(model, boot_s=0.0)
        mouse.power(True)
        now_s = 0.1
        mouse.reports(now_s)
        for at in range(0, min(len(data), 400), 8):
            now_s += 0.02
            mouse.receive(data[at : at + 8])
            mouse.reports(now_s)
        found.append(mouse.refused_commands > 0)
    return tuple(found)


def _evdev(packets: Packets) -> object:
    device = SimulatedInput(EVDEV_MODELS[0])
    now_s, found = 0.0, []
    for data in packets:
        now_s += 0.01
        call = evdev_requests.decode_call(data)
        if isinstance(call, evdev_requests.IoctlCall):
            answer = device.call("a client", call.request, call.argument, now_s)
            found.append(answer.result >= 0)
        else:
            device.write("a client", data, now_s)
        device.reports(now_s)
        all_finite(device.rumble(now_s))
    device.gone("a client")
    return tuple(found[:6])


def _evdev_calls() -> Iterator[Packets]:
    code = evdev_requests
    call = code.IoctlCall
    rumble = code.encode_rumble(code.Rumble(-1, 0x8000, 0x4000, 250))
    yield (
        code.encode_call(call(code.EVIOCGKEY, 0, bytes(96))),
        code.encode_call(call(code.eviocgabs(0), 0, bytes(24))),
        *(each for each in devices._evdev_packets()),
        *(
            code.encode_call(call(getattr(code, name), 0, rumble))
            for name in ("EVIOCSFF", "EVIOCRMFF")
            if hasattr(code, name)
        ),
    )


def _mouse(packets: Packets) -> object:
    mouse = SimulatedSpaceMouse(connexion_devices.MODELS[0])
    now_s = 0.0
    for data in packets:
        now_s += 0.01
        mouse.output(data, now_s)
        mouse.reports(now_s)
    return mouse.led, mouse.refused_outputs > 0


def _usbip(data: bytes) -> object:
    outputs: list[bytes] = []
    session = usbip.UsbipSession(SpaceMouseUsb(connexion_devices.MODELS[0], outputs.append))
    for at in range(0, len(data), 97):
        session.receive(data[at : at + 97])
        session.push(1, b"\x01\x02")
        assert len(session.take_output()) < 1 << 20
    return session.imported, session.failed, session.polled


def _uhid(data: bytes) -> object:
    return uhid.decode_event(data)


def _socketcand(data: bytes) -> object:
    session, frames = socketcand.Session(), 0
    for at in range(0, len(data), 50):
        replies, found = session.feed(data[at : at + 50])
        assert len(replies) <= 40 * (len(data) + 50)
        frames += len(found)
        if session.broken:
            break
    return session.raw, frames > 0, session.broken


def _spnav_server(packets: Packets) -> object:
    """Programs that send anything; the next one is served."""
    core = SpnavServerCore(("left", "right"))
    now_s = 10.0
    found: list[object] = []
    for data in packets:
        now_s += 0.01
        number = core.connect(now_s)
        assert number is not None
        core.receive(number, data, now_s)
        core.advance(now_s)
        while record := core.outgoing(number, now_s):
            core.sent(number, len(record))
        found.append(len(core.given_up()) > 0)
        core.disconnect(number)
    number = core.connect(now_s)
    assert number is not None
    core.receive(number, records.encode_handshake(1), now_s)
    assert core.outgoing(number, now_s) == records.encode_handshake(1)
    core.metrics()
    core.diagnosis()
    return tuple(found[:4])


# -- scripts --------------------------------------------------------------------------------------


def _mouse_motion(steps: Any) -> object:
    return mouse_motion.ScriptedPuck(steps, connexion_devices.MODELS[0])


def _evdev_motion(steps: Any) -> object:
    return evdev_motion.ScriptedInput(steps, SimulatedInput(EVDEV_MODELS[0]))


_SCRIPTED: tuple[tuple[Mapping[str, str], Mapping[str, str], Callable[[Any], object]], ...] = (
    (
        remote_motion.SCRIPTS,
        remote_motion.SCRIPT_VERBS,
        lambda s: remote_motion.ScriptedWiimote(s, ""),
    ),
    (leap_hand.SCRIPTS, leap_hand.SCRIPT_VERBS, leap_hand.ScriptedHands),
    (mouse_motion.SCRIPTS, mouse_motion.SCRIPT_VERBS, _mouse_motion),
    (jr3_motion.SCRIPTS, jr3_motion.SCRIPT_VERBS, jr3_motion.ScriptedJr3),
    (evdev_motion.GAMEPAD_SCRIPTS, evdev_motion.SCRIPT_VERBS, _evdev_motion),
    (omni_hand.SCRIPTS, omni_hand.SCRIPT_VERBS, omni_hand.compile_script),
    (egm_scripts.SCRIPTS, egm_scripts.SCRIPT_VERBS, egm_scripts.compile_script),
)


def _script(data: bytes) -> object:
    text = text_of(data)
    results: list[object] = []
    for _built_in, verbs, compiled in _SCRIPTED:
        try:
            compiled(parse_script(text, verbs))
            results.append(True)
        except ScriptError as error:
            results.append(str(error)[8:24])
    return tuple(results)


def _scripts() -> Iterator[bytes]:
    for built_in, verbs, _compiled in _SCRIPTED:
        for text in built_in.values():
            yield text.encode()
        yield "\n".join(f"1 {usage}" for usage in verbs.values()).encode()


def _faults(data: bytes) -> object:
    return len(parse_omni_faults(text_of(data).split()))


TARGETS = (
    Target("egm_controller", Form.PACKETS, _egm, lambda: (tuple(robots._sensors()),), slow_s=0.5),
    Target("motoros_controller", Form.PACKETS, _motoros, _motoros_packets, slow_s=1.0),
    Target("arm_controller", Form.PACKETS, _arm, _arm_packets, slow_s=0.5),
    Target("wiimote.peer", Form.PACKETS, _wiimote, lambda: (devices._wiimote_said()[1],)),
    Target("jr3_can.peer", Form.PACKETS, _jr3, lambda: (devices._jr3_said()[1],), slow_s=0.5),
    Target("leap.peer", Form.JSON_PACKETS, _leap, lambda: (tuple(devices._leap_messages()),)),
    Target(
        "connexion_serial.peer",
        Form.BYTES,
        _serial,
        lambda: (b"\rvQ\rm3\rc30\rz\r", b"\r@RESET\rCB\rNT\rMSSV\rK\r", b"pAA\rqAA\rkQ\rb9\r"),
        slow_s=0.3,
    ),
    Target("evdev.peer", Form.PACKETS, _evdev, _evdev_calls),
    Target("connexion.peer", Form.PACKETS, _mouse, lambda: ((worked.LED, worked.CALIBRATE, b""),)),
    Target(
        "usbip",
        Form.BYTES,
        _usbip,
        lambda: (
            bytes.fromhex("0111800500000000"),
            bytes.fromhex("0111800300000000")
            + b"1-1".ljust(32, b"\0")
            + bytes.fromhex("00000001000000010001000200000001000000000000000000000012")
            + bytes.fromhex("00000000000000000000000080060001000012000000")[:20],
        ),
        memory=8 << 20,
    ),
    Target(
        "uhid",
        Form.BYTES,
        _uhid,
        lambda: (
            b"\x02\0\0\0" + bytes(8),
            b"\x06\0\0\0" + b"\x04\x01".ljust(4096, b"\0") + b"\x02\0\x01",
            b"\x09\0\0\0" + b"\x01\0\0\0\x05\x01",
            b"\x0d\0\0\0" + b"\x01\0\0\0\x05\x01\x02\0ab",
        ),
    ),
    Target(
        "socketcand",
        Form.TEXT,
        _socketcand,
        lambda: (b"< open can0 >< rawmode >< send 121 2 01 02 >< echo >",),
        words=(b"<", b">", b"< open can0 >", b"< rawmode >", b"< send 7FF 8 "),
    ),
    Target(
        "spnav.daemon", Form.PACKETS, _spnav_server, lambda: (tuple(devices._spnav_requests()),)
    ),
    Target("scripts", Form.TEXT, _script, _scripts, longest=4096, slow_s=0.3),
    Target(
        "omni.faults",
        Form.TEXT,
        _faults,
        lambda: (b"disconnect=3 warm=1", b"slow-tick=2:5"),
        raises=(ScriptError,),
        longest=2048,
    ),
)
