"""``cardan sim`` of robots: one command for each controller."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated

import typer

from cardan.cli.common import Seconds
from cardan.cli.sim import Fault, ListFaults, ListScripts, Script, Seed, listed, serve_peer, sim
from cardan.errors import ConfigurationError
from cardan.sim_peers.base import parse_faults
from cardan.types import Vector3

if TYPE_CHECKING:
    from cardan.sim_peers.egm_controller import Surface

VIRTUAL_PERIOD_S = 0.004
"""Cycle of RobotStudio's virtual controller; a real one takes 4.032 ms."""


@sim.command("abb-gofa", epilog="Prints READY and the PC's address once it sends.")
def sim_abb_gofa(
    to: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="The PC to send to, as the controller's UdpUc.")
    ] = "127.0.0.1:6510",
    robotware: Annotated[
        str, typer.Option(metavar="6|7|RELEASE", help="What its datagrams contain.")
    ] = "7",
    mode: Annotated[
        str, typer.Option(metavar="pose|joint|path", help="What its RAPID program runs.")
    ] = "pose",
    seconds: Seconds = None,
    script: Script = None,
    fault: Fault = None,
    list_faults: ListFaults = False,
    list_scripts: ListScripts = False,
    seed: Seed = 0,
    comm_timeout: Annotated[
        float | None, typer.Option(metavar="S", help="RAPID's \\CommTimeout.")
    ] = None,
    max_speed_deviation: Annotated[
        float | None, typer.Option(metavar="DEG/S", help="RAPID's \\MaxSpeedDeviation.")
    ] = None,
    lp_filter: Annotated[
        float | None, typer.Option(metavar="HZ", help="RAPID's \\LpFilter.")
    ] = None,
    gain: Annotated[
        float, typer.Option(metavar="1/S", help="Default Proportional Position Gain.")
    ] = 5.0,
    pos_corr_gain: Annotated[
        float | None, typer.Option(metavar="0..1", help="RAPID's \\PosCorrGain; 0: speed only.")
    ] = None,
    virtual: Annotated[
        bool, typer.Option("--virtual", help="4.000 ms cycle, as RobotStudio's controller.")
    ] = False,
    period: Annotated[
        float | None,
        typer.Option(metavar="S", help="Another cycle, for a computer too slow for it."),
    ] = None,
    joints: Annotated[
        str | None, typer.Option(metavar="J1,...,J6", help="Where the arm stands at first, deg.")
    ] = None,
    surface: Annotated[
        str | None,
        typer.Option(
            metavar="M[:N/M[:N.S/M[:MU]]]",
            help="A table to press on: height, stiffness, damping, friction.",
        ),
    ] = None,
    force_control: Annotated[
        bool, typer.Option("--force-control", help="Measured force is compensated, not raw.")
    ] = False,
    force_frame: Annotated[
        str, typer.Option(metavar="tool|base", help="Whose axes the measured force is along.")
    ] = "tool",
    force_sense: Annotated[
        str, typer.Option(metavar="exerted|felt", help="Force of the tool on the world, or back.")
    ] = "exerted",
) -> None:
    """An ABB GoFa CRB 15000-5 in Externally Guided Motion (protobuf on UDP, 250 Hz)."""
    from cardan.sim_peers import egm_controller as egm

    if listed(list_faults, egm.FAULTS, list_scripts, egm.SCRIPTS, egm.SCRIPT_VERBS):
        return
    host, port = _host_and_port(to)
    modes = {m.value: m for m in egm.Mode}
    if mode not in modes:
        raise ConfigurationError("--mode", f"{mode!r} is none; allowed: {', '.join(modes)}")
    for option, value, allowed in (
        ("--force-frame", force_frame, egm.FORCE_FRAMES),
        ("--force-sense", force_sense, egm.FORCE_SENSES),
    ):
        if value not in allowed:
            names = ", ".join(allowed)
            raise ConfigurationError(option, f"{value!r} is none; allowed: {names}")
    options = egm.EgmControllerOptions(
        pc_host=host,
        pc_port=port,
        robotware=robotware,
        mode=modes[mode],
        script=script or "teleop",
        faults=parse_faults(fault or (), egm.FAULTS),
        seed=seed,
        comm_timeout_s=comm_timeout,
        max_speed_deviation_deg_s=max_speed_deviation,
        lp_filter_hz=lp_filter,
        k=gain,
        pos_corr_gain=pos_corr_gain,
        surface=None if surface is None else _surface(surface),
        force_control=force_control,
        force_frame="base" if force_frame == "base" else "tool",
        force_sense="felt" if force_sense == "felt" else "exerted",
    )
    if joints is not None:
        (start,) = _points("--joints", [joints], len(options.joints_deg))
        options = dataclasses.replace(options, joints_deg=tuple(start))
    if virtual and period is not None:
        raise ConfigurationError("--period", "--virtual is a period, too: give one of them")
    if virtual:
        period = VIRTUAL_PERIOD_S
    if period is not None:
        options = dataclasses.replace(options, period_s=period)
    serve_peer(egm.EgmControllerPeer(options), seconds)


def _host_and_port(text: str) -> tuple[str, int]:
    host, colon, port = text.rpartition(":")
    if not (colon and host and port.isdecimal() and 0 < int(port) < 65536):
        raise ConfigurationError("--to", f"{text!r} is not HOST:PORT, as 127.0.0.1:6510")
    return host, int(port)


@sim.command("arm", epilog="Prints READY and the address it listens on once it serves.")
def sim_arm(
    robot: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="Which arm: a name, a .toml or a .urdf file.")
    ] = "ur5",
    listen: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="Where it takes commands; port 0: any.")
    ] = "127.0.0.1:6520",
    drive: Annotated[
        str, typer.Option(metavar="dynamic|ideal", help="ideal: exactly where commanded.")
    ] = "dynamic",
    period: Annotated[float, typer.Option(metavar="S", help="A state is sent this often.")] = 0.002,
    gravity_feedforward: Annotated[
        bool, typer.Option("--gravity-feedforward", help="Its servo knows gravity.")
    ] = False,
    plane: Annotated[
        list[str] | None,
        typer.Option(metavar="X,Y,Z,NX,NY,NZ", help="Solid below this plane, m (repeatable)."),
    ] = None,
    sphere: Annotated[
        list[str] | None, typer.Option(metavar="X,Y,Z,R", help="A solid sphere, m (repeatable).")
    ] = None,
    payload: Annotated[float, typer.Option(metavar="KG", help="A mass at the TCP.")] = 0.0,
    seconds: Seconds = None,
    fault: Fault = None,
    list_faults: ListFaults = False,
    seed: Seed = 0,
) -> None:
    """An arm with rigid-body dynamics and joint control (joint stream on UDP, 500 Hz)."""
    from cardan.sim_peers import arm

    if listed(list_faults, arm.FAULTS, False, {}, {}):
        return
    host, colon, port = listen.rpartition(":")
    if not (colon and host and port.isdecimal() and int(port) < 65536):
        raise ConfigurationError("--listen", f"{listen!r} is not HOST:PORT, as 127.0.0.1:6520")
    planes, balls = [], []
    for x, y, z, *normal in _points("--plane", plane, 6):
        planes.append(arm.Plane(Vector3(x, y, z), Vector3(*normal)))
    for x, y, z, radius_m in _points("--sphere", sphere, 4):
        balls.append(arm.Ball(Vector3(x, y, z), radius_m))
    if drive not in arm.DRIVES:
        raise ConfigurationError("--drive", f"{drive!r} is none; allowed: {', '.join(arm.DRIVES)}")
    options = arm.SimulatedArmOptions(
        robot=robot,
        plant=arm.PlantOptions(
            drive="ideal" if drive == "ideal" else "dynamic",
            gravity_feedforward=gravity_feedforward,
            payload_kg=payload,
            planes=tuple(planes),
            balls=tuple(balls),
        ),
        host=host,
        port=int(port),
        period_s=period,
        faults=parse_faults(fault or (), arm.FAULTS),
        seed=seed,
    )
    serve_peer(arm.SimulatedArmPeer(options), seconds)


@sim.command("motoman-gp8", epilog="Prints READY and the address of motion once it serves.")
def sim_motoman_gp8(
    host: Annotated[
        str, typer.Option(metavar="HOST", help="The address it listens on.")
    ] = "127.0.0.1",
    base_port: Annotated[
        int,
        typer.Option(
            min=0, max=65533, help="Motion; state and I/O are the two after it. 0: any three."
        ),
    ] = 50240,
    big_endian: Annotated[
        bool, typer.Option("--big-endian", help="As an FS100; others are little-endian.")
    ] = False,
    no_velocity_mode: Annotated[
        bool, typer.Option("--no-velocity-mode", help="As MotoROS is, with trajectories only.")
    ] = False,
    plant: Annotated[
        str,
        typer.Option(metavar="ideal|paper", help="paper: the arm lags as in Baklouti et al. 2021."),
    ] = "ideal",
    servo_on: Annotated[
        bool, typer.Option("--servo-on", help="Its drives have power from the start.")
    ] = False,
    groups: Annotated[
        int, typer.Option(min=1, max=4, help="Control groups, each with such an arm.")
    ] = 1,
    seconds: Seconds = None,
    fault: Fault = None,
    list_faults: ListFaults = False,
    seed: Seed = 0,
    log: Annotated[
        str, typer.Option(metavar="FILE", help="A CSV row for each interpolation cycle.")
    ] = "",
) -> None:
    """A Yaskawa Motoman GP8 that runs MotoROS (simple message on three TCP ports)."""
    from cardan.sim_peers import motoros_controller as motoros

    if listed(list_faults, motoros.FAULTS, False, {}, {}):
        return
    if plant not in motoros.PLANTS:
        allowed = ", ".join(motoros.PLANTS)
        raise ConfigurationError("--plant", f"{plant!r} is none; allowed: {allowed}")
    options = motoros.MotorosControllerOptions(
        host=host,
        base_port=base_port,
        big_endian=big_endian,
        velocity_mode=not no_velocity_mode,
        plant="paper" if plant == "paper" else "ideal",
        servo_on=servo_on,
        groups=groups,
        faults=parse_faults(fault or (), motoros.FAULTS),
        seed=seed,
        log=log,
    )
    serve_peer(motoros.MotorosControllerPeer(options), seconds)


def _surface(text: str) -> Surface:
    """HEIGHT[:STIFFNESS[:DAMPING[:FRICTION]]], SI units."""
    from cardan.sim_peers.egm_controller import Surface

    try:
        height_m, *others = [float(word) for word in text.split(":")]
        return Surface(height_m, *others)
    except (ValueError, TypeError):
        raise ConfigurationError(
            "--surface", f"{text!r} is not HEIGHT[:STIFFNESS[:DAMPING[:FRICTION]]], as 0.28:500"
        ) from None


def _points(option: str, texts: list[str] | None, count: int) -> list[list[float]]:
    """Comma-separated numbers, so many in each text."""
    found = []
    for text in texts or ():
        try:
            numbers = [float(word) for word in text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) != count:
            raise ConfigurationError(option, f"{text!r} is not {count} numbers with commas")
        found.append(numbers)
    return found
