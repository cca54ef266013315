"""``cardan robots``: lists known arms, and makes the file of a new one."""

from __future__ import annotations

import math
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cardan.cli import completion
from cardan.cli.bus import Router, Session, bus_options
from cardan.cli.common import AsJson, print_json, print_table
from cardan.cli.installed import CommandGroup
from cardan.common.text_sanitizer import printable
from cardan.errors import ConfigurationError, ExtraMissingError

if TYPE_CHECKING:
    from cardan.robots import ArmJoint

robots = typer.Typer(
    name="robots",
    cls=CommandGroup,
    help="List and show arms, and make the file of your own.",
    no_args_is_help=True,
)

POSTURES = 3
"""Postures that are drawn beside home."""


@robots.command()
def add(
    file: Annotated[
        str,
        typer.Argument(
            metavar="FILE|TOPIC",
            help="A robot's URDF, .xacro or MJCF (.xml): a path, or PACKAGE:FILE in an installed "
            "package; with --from-topic the topic, by default /robot_description.",
            show_default=False,
        ),
    ] = "",
    tcp: Annotated[
        str,
        typer.Option(
            metavar="LINK",
            help="Last link of the arm; default: the tree's end, if it has only one.",
        ),
    ] = "",
    base: Annotated[
        str,
        typer.Option(
            metavar="LINK",
            help="Link with the arm's base frame; default: the root, or the first joint's parent.",
        ),
    ] = "",
    limit: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY.JOINT=NUMBER",
            help="Limit missing in the URDF, in the TOML's form: velocity_deg_s.elbow=90; "
            "repeatable.",
        ),
    ] = None,
    xacro: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="An argument for the .xacro; repeatable."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="TOML",
            help="The file to write; default: FILE's name with .toml, beside it; of a topic, its "
            "name with .toml, here.",
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Overwrite existing files.")
    ] = False,
    from_topic: Annotated[
        bool,
        typer.Option(
            "--from-topic",
            help="Take the URDF from the bus, as robot_state_publisher of ROS 2 publishes it, and "
            "keep it as a file beside the TOML.",
        ),
    ] = False,
    session: Session = None,
    router: Router = "",
) -> None:
    """Add the arm of a robot's URDF: write its TOML and a picture beside it, print the source of
    each value, try its inverse, and print a session that moves it simulated."""
    from cardan.bus.description import describe, topic_of
    from cardan.own_arm.added import (
        Published,
        add as made,
        parse_arguments,
        parse_limits,
        session_text,
        toml_beside,
    )
    from cardan.own_arm.pictures import draw, posed, side_views
    from cardan.own_arm.tried import POSES, postures, reach_of, try_inverse

    if output is not None and output.suffix != ".toml":
        raise ConfigurationError("--output", f"{output} must end in .toml")
    topic = ""
    if from_topic:
        topic = topic_of(file)
        words = topic[1:].replace("/", "_")
        path = output or Path(f"{words}.toml")
        name = words if path.stem == words else f"{path.stem}-{words}"
        file = str(path.with_name(f"{name}.urdf"))
    elif session is not None or router:
        raise ConfigurationError("--session, --router", "go with --from-topic")
    elif not file:
        raise ConfigurationError("FILE", "give a URDF, or --from-topic")
    else:
        beside = toml_beside(file)
        path = output or beside
    picture = path.with_suffix(".png")
    if not overwrite:
        for each in (path, picture, *([Path(file)] if from_topic else ())):
            if each.exists():
                raise ConfigurationError(
                    "--overwrite", f"{each} exists: give this, or another --output"
                )
    published = None
    if from_topic:
        taken = describe(topic, bus_options(session, router))
        published = Published(taken.text, topic, taken.origin)
    limits, arguments = parse_limits(limit or ()), parse_arguments(xacro or ())
    added = made(file, path, tcp, base, limits, arguments, published)
    arm = added.write()
    print(f"{printable(str(path))}: written")
    _print_parts(added.report())
    poses = [posed(arm, arm.home, "home")]
    poses += [
        posed(arm, q, f"posture {number}")
        for number, q in enumerate(postures(arm, POSTURES), start=1)
    ]
    print()
    for line in side_views(arm, poses):
        print(line)
    try:
        draw(arm, poses, picture)
        print(f"{printable(str(picture))}: the same with all bodies")
    except ExtraMissingError as error:
        print(f"no picture: {printable(str(error))}")
    print()

    def progress(done: int) -> None:
        if sys.stderr.isatty():
            end = "\r" if done < POSES else "\n"
            print(f"inverse: {done} of {POSES} poses tried", end=end, file=sys.stderr, flush=True)

    _print_parts(
        [("reach", reach_of(arm).words()), ("inverse", try_inverse(arm, progress, POSES).words())]
    )
    to_try = path.with_name(f"{path.stem}-session.toml")
    print(f"\nTo try it on a simulated arm, save as {printable(str(to_try))}:\n")
    print(session_text(path.name))
    print("and run it, with the page that moves it:\n")
    print(f"cardan run {printable(shlex.quote(str(to_try)))} --console")


def _print_parts(parts: list[tuple[str, str]]) -> None:
    for part, words in parts:
        print(f"  {part:<8} {printable(words)}")


@robots.command("list")
def list_(as_json: AsJson = False) -> None:
    """List the arms: Cardan's, then your own files in this folder."""
    from cardan.robots import arm_names, load_arm

    rows = []
    for name in arm_names():
        arm = load_arm(name)
        rows.append((name, str(len(arm.joints)), arm.home_words(), "Cardan"))
    rows += [(path, "", "", f"its URDF: {urdf}") for path, urdf in _beside()]
    print_table(("arm", "joints", "home", "from"), rows, as_json)


def _beside() -> list[tuple[str, str]]:
    """Return the files of arms in this folder, and their URDFs."""
    from cardan.common.tables import read_toml

    found = []
    for path in sorted(Path().glob("*.toml")):
        try:
            urdf = read_toml(path).get("urdf")
        except ConfigurationError:
            continue
        if isinstance(urdf, str):
            found.append((str(path), urdf))
    return found


@robots.command()
def show(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME|FILE",
            help="One of Cardan's arms, or the .toml, .urdf, .xacro or .xml of your own.",
            autocompletion=completion.robots,
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Show an arm: its joints with their limits, its reach, home and TCP, its bodies, and
    warnings."""
    from cardan.gateway.session.cautions import arm_cautions
    from cardan.own_arm.tried import pairs_watched, reach_of
    from cardan.robots import load_arm

    arm = load_arm(name)
    reach = reach_of(arm)
    cautions = arm_cautions(arm)
    pairs = pairs_watched(arm)
    if as_json:
        print_json(
            {
                "arm": name,
                "joints": [_joint_values(each) for each in arm.joints],
                "home": arm.home,
                "home_tcp": arm.home_tcp,
                "reach_m": reach.ranges,
                "bodies": [each.name for each in arm.shapes],
                "pairs": pairs,
                "cautions": cautions,
            }
        )
        return
    print_table(
        ("joint", "kind", "from", "to", "speed", "acceleration", "effort"),
        [_joint_cells(each) for each in arm.joints],
    )
    place = ", ".join(f"{value:.3f}" for value in arm.home_tcp.position)
    bodies = ", ".join(dict.fromkeys(each.name for each in arm.shapes)) or "none"
    _print_parts(
        [
            ("home", f"{arm.home_words()}; the TCP is at {place} m"),
            ("reach", reach.words()),
            ("bodies", f"{len(arm.shapes)} shapes, {pairs} pairs kept apart: {bodies}"),
            *(("WARNING", words) for words in cautions),
        ]
    )


def _joint_values(joint: ArmJoint) -> dict[str, Any]:
    values = joint._asdict()
    return {key: values[key] for key in values if key not in ("placement", "axis")}


def _joint_cells(joint: ArmJoint) -> tuple[str, ...]:
    from cardan.robots import JointKind

    slides = joint.kind is JointKind.PRISMATIC
    unit, factor = ("m", 1.0) if slides else ("°", 180.0 / math.pi)

    def cell(value: float, per: str = "") -> str:
        return f"{value * factor:.4g} {unit}{per}" if math.isfinite(value) else "–"

    effort = f"{joint.effort:g} {'N' if slides else 'N·m'}" if math.isfinite(joint.effort) else "–"
    return (
        joint.name,
        joint.kind.value,
        cell(joint.lower),
        cell(joint.upper),
        cell(joint.velocity, "/s"),
        cell(joint.acceleration, "/s²"),
        effort,
    )
