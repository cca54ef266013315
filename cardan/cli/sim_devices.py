"""``cardan sim`` of what hands hold: one command for each device."""

from __future__ import annotations

from typing import Annotated

import typer

from cardan.cli.common import Seconds
from cardan.cli.sim import Fault, ListFaults, ListScripts, Script, Seed, listed, serve_peer, sim
from cardan.errors import ConfigurationError
from cardan.sim_peers.base import SimulatedPeer, parse_faults

Keyboard = Annotated[bool, typer.Option("--keyboard", help="Move it with this terminal's keys.")]


@sim.command("spacemouse", epilog="Prints READY and where it is once it can be opened.")
def sim_spacemouse(
    hid: Annotated[
        str,
        typer.Option(metavar="PATH", help="Unix seqpacket socket: each packet one raw HID report."),
    ] = "",
    serial: Annotated[
        str,
        typer.Option(metavar="LINK", help="A serial port: a link to a pseudo-terminal."),
    ] = "",
    uhid: Annotated[
        bool, typer.Option("--uhid", help="A HID device of this machine's kernel (/dev/uhid).")
    ] = False,
    usbip: Annotated[
        int | None,
        typer.Option(
            min=0, max=65535, help="A USB device by USB/IP at this port of 127.0.0.1; 0: any."
        ),
    ] = None,
    model: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Which device; see --list-models. Default: spacenavigator, magellan if serial.",
        ),
    ] = "",
    seconds: Seconds = None,
    script: Script = None,
    keyboard: Keyboard = False,
    fault: Fault = None,
    list_faults: ListFaults = False,
    list_scripts: ListScripts = False,
    list_models: Annotated[
        bool, typer.Option("--list-models", help="Print the models, then end.")
    ] = False,
    seed: Seed = 0,
) -> None:
    """A 3Dconnexion device, USB (HID reports) or serial, moved by a script or by the keyboard."""
    from cardan.protocols.connexion import MODELS
    from cardan.protocols.connexion_serial import SERIAL_MODELS
    from cardan.sim_peers import spacemouse

    if list_models:
        for known in MODELS:
            print(f"{known.key:32} {known.vendor_id:04x}:{known.product_id:04x}  {known.name}")
        for serial_model in SERIAL_MODELS:
            print(f"{serial_model.key:32} serial     {serial_model.name}")
        return
    switches = spacemouse.SERIAL_FAULTS if serial else spacemouse.FAULTS
    if listed(list_faults, switches, list_scripts, spacemouse.SCRIPTS, spacemouse.SCRIPT_VERBS):
        return
    ways = [
        name
        for name, given in (
            ("--hid", hid),
            ("--serial", serial),
            ("--uhid", uhid),
            ("--usbip", usbip is not None),
        )
        if given
    ]
    if len(ways) != 1:
        found = " and ".join(ways) if ways else "none"
        raise ConfigurationError(
            "--hid, --serial, --uhid, --usbip", f"give one way to open the device, not {found}"
        )
    play = script or "demo"
    faults = parse_faults(fault or (), switches)
    peer: SimulatedPeer
    if serial:
        peer = spacemouse.SerialSpaceMousePeer(
            spacemouse.SerialSpaceMousePeerOptions(
                link=serial,
                model=model or "magellan",
                script=play,
                keyboard=keyboard,
                faults=faults,
                seed=seed,
            )
        )
    else:
        model = model or "spacenavigator"
        if hid:
            peer = spacemouse.SpaceMousePeer(
                spacemouse.SpaceMousePeerOptions(
                    path=hid, model=model, script=play, keyboard=keyboard, faults=faults, seed=seed
                )
            )
        elif uhid:
            peer = spacemouse.UhidSpaceMousePeer(
                spacemouse.UhidSpaceMousePeerOptions(
                    model=model, script=play, keyboard=keyboard, faults=faults, seed=seed
                )
            )
        else:
            assert usbip is not None
            peer = spacemouse.UsbipSpaceMousePeer(
                spacemouse.UsbipSpaceMousePeerOptions(
                    port=usbip,
                    model=model,
                    script=play,
                    keyboard=keyboard,
                    faults=faults,
                    seed=seed,
                )
            )
    serve_peer(peer, seconds)


@sim.command("wiimote", epilog="Prints READY and where it is once it can be connected to.")
def sim_wiimote(
    l2cap: Annotated[
        str,
        typer.Option(metavar="DIR", help="Folder for the Unix seqpacket sockets psm11 and psm13."),
    ] = "",
    bluetooth: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="Real L2CAP, on the Bluetooth adapter of this address."
        ),
    ] = "",
    uhid: Annotated[
        bool, typer.Option("--uhid", help="A HID device of this machine's kernel (/dev/uhid).")
    ] = False,
    address: Annotated[
        str, typer.Option(metavar="ADDRESS", help="The remote's own, shown with --uhid.")
    ] = "00:1F:32:5A:10:2B",
    extension: Annotated[str, typer.Option(metavar="nunchuk", help="What is plugged in.")] = "",
    motion_plus: Annotated[
        bool, typer.Option("--motion-plus", help="It has a MotionPlus.")
    ] = False,
    tr: Annotated[bool, typer.Option("--tr", help="The late model, RVL-CNT-01-TR.")] = False,
    seconds: Seconds = None,
    script: Script = None,
    fault: Fault = None,
    list_faults: ListFaults = False,
    list_scripts: ListScripts = False,
    seed: Seed = 0,
) -> None:
    """A Nintendo Wii Remote (reports over two L2CAP channels, or a HID device of the kernel's)."""
    from cardan.sim_peers import wiimote

    if listed(list_faults, wiimote.FAULTS, list_scripts, wiimote.SCRIPTS, wiimote.SCRIPT_VERBS):
        return
    options = wiimote.WiimotePeerOptions(
        l2cap=l2cap,
        bluetooth=bluetooth,
        uhid=uhid,
        address=address,
        extension=extension,
        motion_plus=motion_plus,
        tr=tr,
        script=script or "demo",
        faults=parse_faults(fault or (), wiimote.FAULTS),
        seed=seed,
    )
    serve_peer(wiimote.WiimotePeer(options), seconds)


@sim.command("leap", epilog="Prints READY and its address once it listens.")
def sim_leap(
    host: Annotated[
        str, typer.Option(metavar="HOST", help="The address it listens on.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Its port; 0: any.")] = 6437,
    rate: Annotated[
        float, typer.Option(metavar="HZ", min=1.0, max=1000.0, help="Frames a second.")
    ] = 110.0,
    seconds: Seconds = None,
    script: Script = None,
    fault: Fault = None,
    list_faults: ListFaults = False,
    list_scripts: ListScripts = False,
    seed: Seed = 0,
) -> None:
    """A Leap Motion tracking service and the hands it sees (JSON over WebSocket)."""
    from cardan.sim_peers import leap

    if listed(list_faults, leap.FAULTS, list_scripts, leap.SCRIPTS, leap.SCRIPT_VERBS):
        return
    options = leap.LeapPeerOptions(
        host=host,
        port=port,
        rate_hz=rate,
        script=script or "demo",
        faults=parse_faults(fault or (), leap.FAULTS),
        seed=seed,
    )
    serve_peer(leap.LeapPeer(options), seconds)


Events = Annotated[
    str,
    typer.Option(metavar="PATH", help="Unix seqpacket socket: packets of struct input_event."),
]
Uinput = Annotated[
    bool, typer.Option("--uinput", help="An input device of this machine's kernel (/dev/uinput).")
]


@sim.command("gamepad", epilog="Prints READY and where it is once it can be opened.")
def sim_gamepad(
    events: Events = "",
    uinput: Uinput = False,
    model: Annotated[str, typer.Option(metavar="NAME", help="Which pad; see --list-models.")] = "",
    seconds: Seconds = None,
    script: Script = None,
    fault: Fault = None,
    list_faults: ListFaults = False,
    list_scripts: ListScripts = False,
    list_models: Annotated[
        bool, typer.Option("--list-models", help="Print the models, then end.")
    ] = False,
    seed: Seed = 0,
) -> None:
    """A gamepad, as Linux gives its events to programs."""
    from cardan.sim_peers import evdev

    if list_models:
        for known in evdev.MODELS:
            if known.key != "keyboard":
                print(f"{known.key:16} {known.name}")
        return
    _input(
        "gamepad", events, uinput, model, seconds, script, fault, list_faults, list_scripts, seed
    )


@sim.command("keyboard", epilog="Prints READY and where it is once it can be opened.")
def sim_keyboard(
    events: Events = "",
    uinput: Uinput = False,
    seconds: Seconds = None,
    script: Script = None,
    fault: Fault = None,
    list_faults: ListFaults = False,
    list_scripts: ListScripts = False,
    seed: Seed = 0,
) -> None:
    """A keyboard, as Linux gives its events to programs."""
    _input("keyboard", events, uinput, "", seconds, script, fault, list_faults, list_scripts, seed)


def _input(
    kind: str,
    events: str,
    uinput: bool,
    model: str,
    seconds: float | None,
    script: str | None,
    fault: list[str] | None,
    list_faults: bool,
    list_scripts: bool,
    seed: int,
) -> None:
    from cardan.sim_peers import evdev

    scripts = evdev.SCRIPTS[kind]
    if listed(list_faults, evdev.FAULTS, list_scripts, scripts, evdev.SCRIPT_VERBS):
        return
    options = evdev.EvdevPeerOptions(
        kind=kind,
        path=events,
        uinput=uinput,
        model=model,
        script=script or "demo",
        faults=parse_faults(fault or (), evdev.FAULTS),
        seed=seed,
    )
    serve_peer(evdev.EvdevPeer(options), seconds)


@sim.command("jr3", epilog="Prints READY and the bus once it is on it.")
def sim_jr3(
    interface: Annotated[
        str, typer.Option(metavar="NAME", help="The way to the bus, as python-can calls it.")
    ] = "udp_multicast",
    channel: Annotated[
        str, typer.Option(metavar="NAME", help="The bus; default: python-can's multicast group.")
    ] = "",
    serve_socketcand: Annotated[
        bool,
        typer.Option(
            "--serve-socketcand", help="Serve a bus of its own, by socketcand's protocol."
        ),
    ] = False,
    host: Annotated[
        str, typer.Option(metavar="HOST", help="Of socketcand, served or joined.")
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Of udp_multicast or socketcand; default: theirs."),
    ] = None,
    sensor: Annotated[
        str, typer.Option(metavar="NAME", help="Whose full scales; see --list-sensors.")
    ] = "right-hand",
    node: Annotated[
        int, typer.Option(min=0, max=127, help="Node id; 0: that of the sensor on TEO.")
    ] = 0,
    boot: Annotated[
        float, typer.Option(metavar="S", min=0.0, help="From power to its first message.")
    ] = 2.0,
    seconds: Seconds = None,
    script: Script = None,
    fault: Fault = None,
    list_faults: ListFaults = False,
    list_scripts: ListScripts = False,
    list_sensors: Annotated[
        bool, typer.Option("--list-sensors", help="Print the sensors, then end.")
    ] = False,
    seed: Seed = 0,
) -> None:
    """A JR3 force-torque sensor on a CAN bus, and the loads on it."""
    from cardan.protocols.jr3_can import TEO_NODE_IDS, TEO_SENSORS
    from cardan.sim_peers import jr3

    if list_sensors:
        for name in TEO_SENSORS:
            print(f"{name:16} node {TEO_NODE_IDS[name]}")
        return
    if listed(list_faults, jr3.FAULTS, list_scripts, jr3.SCRIPTS, jr3.SCRIPT_VERBS):
        return
    options = jr3.Jr3PeerOptions(
        interface=interface,
        channel=channel or jr3.Jr3PeerOptions.channel,
        serve_socketcand=serve_socketcand,
        host=host,
        port=port,
        sensor=sensor,
        node_id=node,
        boot_s=boot,
        script=script or "demo",
        faults=parse_faults(fault or (), jr3.FAULTS),
        seed=seed,
    )
    serve_peer(jr3.Jr3Peer(options), seconds)


@sim.command(
    "omni",
    # What follows the program's name is the program's.
    context_settings={"allow_interspersed_args": False},
    epilog="The program finds it as libHD.so, whether it is linked to that or loads it itself; "
    "CARDAN_LIBHD has its path. The exit code is the program's.",
)
def sim_omni(
    program: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="PROGRAM", help="To run with the simulated device, and its arguments."
        ),
    ] = None,
    library: Annotated[
        bool, typer.Option("--library", help="Print where the simulated libHD.so is, then end.")
    ] = False,
    model: Annotated[
        str, typer.Option(metavar="omni|touch", help="Which of the two it says it is.")
    ] = "omni",
    cold: Annotated[
        bool, typer.Option("--cold", help="It needs the inkwell before it knows where it is.")
    ] = False,
    log: Annotated[
        str, typer.Option(metavar="FILE", help="Write true values there as they come (CSV).")
    ] = "",
    seconds: Seconds = None,
    script: Script = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=VALUE][@SECONDS]",
            help="A fault to have (repeatable), from so many s on; see --list-faults.",
        ),
    ] = None,
    list_faults: ListFaults = False,
    list_scripts: ListScripts = False,
    seed: Seed = 0,
) -> None:
    """A Phantom Omni (Touch) and the hand that holds it, behind the functions of libHD: run a
    program with it."""
    from cardan.sim_peers import omni

    if listed(list_faults, omni.FAULTS, list_scripts, omni.SCRIPTS, omni.SCRIPT_VERBS):
        return
    if library:
        print(omni.library_path())
        return
    if not program:
        raise ConfigurationError(
            "",
            "name the program that is to use the device, as in: cardan sim omni -- ./program; or "
            "take --library, which prints where libHD.so is",
        )
    settings = omni.OmniSettings(
        seed=seed,
        model=model,
        cold=cold,
        motion=omni.load_motion(script or "demo"),
        faults=omni.parse_omni_faults(fault or ()),
        log=log,
    )
    code = omni.run_program(program, settings, seconds)
    if missing := omni.missing_log(settings):
        typer.echo(f"warning: --log: {missing}", err=True)
    raise typer.Exit(code)
