"""Creation of an arm's TOML from a URDF, with a report of the origin of each value."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from cardan.common.arm_libraries import np
from cardan.common.tables import as_toml, parse_toml, read_table
from cardan.common.text_sanitizer import printable
from cardan.errors import ConfigurationError, about, shown
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.session.cautions import arm_cautions
from cardan.own_arm.ends import finger_joints, which_end
from cardan.robots import ArmModel, arm_names, load_arm
from cardan.robots.arm_chain import chain_of
from cardan.robots.arm_file import ArmFile
from cardan.robots.arm_limits import LIMIT_KEYS, Proposal, limit_lines, limited_by, proposals_for
from cardan.robots.arm_loader import located
from cardan.robots.arm_reader import build_arm, published_home
from cardan.robots.fit_cache import fit_mesh
from cardan.robots.fitting import Fit
from cardan.robots.mesh_files import FoundMesh, meshes_of
from cardan.robots.urdf import Tree, read_tree
from cardan.robots.xacro_file import DESCRIPTIONS, is_xacro, read_description

FEW_JOINTS_TASK = (1.0, 1.0, 1.0, 0.05, 0.05, 0.05)
"""Task weights of an arm with too few joints for all six directions: ASIBOT's."""


class Published(NamedTuple):
    """URDF text that is not yet a file."""

    text: str
    name: str
    """Name of the description in error messages."""
    origin: str
    """Origin of the description, for the report."""


class Covered(NamedTuple):
    """A link's mesh and its collision shapes."""

    link: str
    fit: Fit


class Added(NamedTuple):
    """Text of an arm's file before it is written, and its inputs."""

    path: Path
    text: str
    arm: ArmModel
    proposals: tuple[Proposal, ...]
    covered: tuple[Covered, ...]
    stored: tuple[Path, Published] | None = None
    """File to save a URDF text in, and the text."""
    has_home: bool = False
    """True if the home posture is the description's own."""
    given: tuple[str, ...] = ()
    """Joints whose limits the caller gave."""
    fingers: tuple[str, ...] = ()
    """Joints of fingers, behind the end that was chosen."""

    def report(self) -> list[tuple[str, str]]:
        """Return the parts of the arm and the origin of each, in words."""
        arm = self.arm
        proposed = ", ".join(dict.fromkeys(each.joint for each in self.proposals))
        found = []
        if self.stored is not None:
            urdf, published = self.stored
            found.append(("URDF", f"of {published.origin}; kept as {urdf}"))
        limits = "of the URDF"
        if proposed:
            limits = (
                f"missing of {proposed}; PROPOSED: look into the file and put the maker's numbers"
            )
        if self.fingers:
            found.append(
                (
                    "tcp",
                    f"the link before {', '.join(self.fingers)}, which moves a finger and is held; "
                    "--tcp names another",
                )
            )
        found += [
            ("joints", f"{len(arm.joints)} move: {', '.join(arm.joint_names)}"),
            ("limits", limits),
        ]
        if self.given:
            found.append(("limits", f"given of {', '.join(self.given)}"))
        if silent := [joint.name for joint in arm.joints if math.isinf(joint.effort)]:
            found.append(("effort", f"not published, and no limit, of {', '.join(silent)}"))
        if _few(arm.joints):
            found.append(
                (
                    "task",
                    f"{len(arm.joints)} joints cannot keep an orientation along every line: the "
                    "position counts, and the orientation as far as it can be had; [task] says so",
                )
            )
        found.append(("home", f"{arm.home_words()}; {_home_words(arm, self.has_home)}"))
        found.append(("bodies", f"{len(arm.shapes)} shapes"))
        found += [
            (
                "mesh",
                f"of {link} is covered by {len(fit.shapes)} shapes, "
                f"{100.0 * fit.over_share:.0f} % larger than its hull and at most "
                f"{1e3 * fit.over_m:.1f} mm beyond it",
            )
            for link, fit in self.covered
        ]
        found += [("WARNING", words) for words in arm_cautions(arm)]
        return found

    def write(self) -> ArmModel:
        """Write the files, and return the arm as loaded from them. Raises ConfigurationError."""
        texts = [(self.path, self.text)]
        if self.stored is not None:
            urdf, published = self.stored
            texts.insert(0, (urdf, published.text))
        for path, text in texts:
            try:
                path.write_text(text, encoding="utf-8")
            except OSError as error:
                raise ConfigurationError("", f"cannot write {path}: {error.strerror}") from None
        load_arm.cache_clear()
        return load_arm(str(self.path))


def toml_beside(urdf: str) -> Path:
    """Return the default path of an arm's TOML. Raises ConfigurationError."""
    at = _described_at(urdf)
    return (at.with_suffix("") if is_xacro(at) else at).with_suffix(".toml")


def _described_at(urdf: str) -> Path:
    if urdf in arm_names():
        raise ConfigurationError(
            "FILE",
            f"{urdf} comes with Cardan: `cardan robots show {urdf}` shows it, and a session has it "
            f'by model = "{urdf}" in [arm]',
        )
    at = located(urdf, Path())
    if at.suffix.lower() not in DESCRIPTIONS:
        raise ConfigurationError("FILE", f"{urdf} must be a .urdf, .xacro or .xml (MJCF)")
    return at


def parse_limits(texts: Sequence[str]) -> dict[str, dict[str, float]]:
    """Parse ``KEY.JOINT=VALUE`` texts as tables of an arm's file. Raises ConfigurationError."""
    tables: dict[str, dict[str, float]] = {}
    for text in texts:
        key, _, rest = text.partition(".")
        joint, _, value = rest.rpartition("=")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if key not in LIMIT_KEYS or not joint or not math.isfinite(number):
            comma = "," in text.rpartition("=")[2]
            point = "; write the decimal point as ., not as a comma" if comma else ""
            raise ConfigurationError(
                "--limit",
                f"{shown(text)} must be KEY.JOINT=NUMBER, as velocity_deg_s.elbow=90{point}; KEY "
                f"is one of {', '.join(LIMIT_KEYS)}",
            )
        if joint in tables.setdefault(key, {}):
            raise ConfigurationError("--limit", f"{shown(f'{key}.{joint}')} is given twice")
        tables[key][joint] = number
    return tables


def parse_arguments(texts: Sequence[str]) -> dict[str, str]:
    """Parse ``NAME=VALUE`` texts. Raises ConfigurationError."""
    arguments = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name.isidentifier() and equals):
            raise ConfigurationError("--xacro", f"{shown(text)} must be NAME=VALUE")
        arguments[name] = value
    return arguments


def add(
    urdf: str,
    path: Path,
    tcp: str = "",
    base: str = "",
    limits: Mapping[str, Mapping[str, float]] | None = None,
    xacro: Mapping[str, str] | None = None,
    published: Published | None = None,
) -> Added:
    """Make the arm of a URDF file (a path or ``PACKAGE:FILE``), for a TOML at `path`. `limits` are
    by key and joint; `published` is the text to save as the URDF.

    Raises ConfigurationError, which names options of the command, and ExtraMissingError.
    """
    at = _described_at(urdf)
    name = urdf if ":" in urdf and at != Path(urdf) else _relative(at, path)
    with about(at if published is None else published.name), _of_options():
        file = read_table(
            ArmFile,
            {"urdf": name, "tcp": tcp, "base": base, "xacro": xacro or {}, **(limits or {})},
        )
        tree = read_tree(read_description(at, file) if published is None else published.text)
        if not tcp and len(tree.ends()) > 1:
            raise which_end(tree, base)
        fingers = [] if tcp else finger_joints(tree, tree.ends()[0])
        if fingers:
            file = replace(file, tcp=fingers[0].parent)
        added = _added(tree, file, at, path, published)
        return added._replace(fingers=tuple(joint.name for joint in fingers))


@contextlib.contextmanager
def _of_options() -> Iterator[None]:
    """Report errors of keys of the arm's file as errors of the command's options."""
    try:
        yield
    except ConfigurationError as error:
        key = error.key.partition(".")[0]
        if key in ("tcp", "base"):
            raise ConfigurationError(f"--{key}", error.message) from None
        if key in LIMIT_KEYS:
            raise ConfigurationError("--limit", str(error)) from None
        if key == "xacro":
            raise ConfigurationError("--xacro", str(error)) from None
        raise


def _relative(urdf: Path, toml: Path) -> str:
    """Path of the URDF relative to the TOML's folder, or its absolute path."""
    try:
        return Path(os.path.relpath(urdf.absolute(), toml.absolute().parent)).as_posix()
    except ValueError:  # On another drive.
        return urdf.absolute().as_posix()


def _added(tree: Tree, file: ArmFile, at: Path, path: Path, published: Published | None) -> Added:
    chain = chain_of(tree, file)
    proposals = proposals_for(chain.joints, file)
    head: dict[str, Any] = {"urdf": file.urdf, "tcp": chain.tcp}
    if file.xacro:
        head["xacro"] = file.xacro
    if file.base:
        head["base"] = file.base
    lines = limit_lines(proposals, file)
    given = tuple(joint.name for joint in chain.joints if joint.name in limited_by(file))
    task = _task_lines(chain.joints)
    text = "\n".join((as_toml(head), *lines, *task))
    file = read_table(ArmFile, parse_toml(text, path))
    meshes = meshes_of(tree, file, at)
    arm = build_arm(tree, file, meshes)
    has_home = bool(published_home(arm.joints, chain.tree))
    origin = "" if published is None else published.origin
    text = _text(arm, head, chain.base, lines, bool(proposals), task, origin, has_home)
    covers = tuple(_covers(file, list(meshes.values())))
    stored = None if published is None else (at, published)
    return Added(path, text, arm, tuple(proposals), covers, stored, has_home, given)


def _covers(file: ArmFile, meshes: Sequence[FoundMesh]) -> list[Covered]:
    """Fitted shapes, from the cache."""
    return [
        Covered(each.link, fit_mesh(each.path, file.collision.fit, each.mesh.scale))
        for each in meshes
        if each.path is not None
    ]


def _few(joints: Sequence[object]) -> bool:
    return len(joints) < len(FEW_JOINTS_TASK)


def _task_lines(joints: Sequence[object]) -> list[str]:
    if not _few(joints):
        return []
    return [
        "",
        f"# {len(joints)} joints cannot keep all six directions: where they cannot, x y z count.",
        "[task]",
        *as_toml({"weights": FEW_JOINTS_TASK}).splitlines(),
    ]


def _text(
    arm: ArmModel,
    head: dict[str, Any],
    base: str,
    limits: Sequence[str],
    proposed: bool,
    task: Sequence[str],
    origin: str,
    has_home: bool,
) -> str:
    """Return the TOML text. Each value of the URDF takes one line: names add none."""
    lines = [
        f"# The arm of {printable(head['urdf'])}, as `cardan robots add` took it.",
        *([f"# That file is the text of {printable(origin)}."] if origin else ()),
        "# docs/robots.md has all keys.",
        *as_toml(head).splitlines(),
        f"# {len(arm.joints)} joints move: {printable(', '.join(arm.joint_names))}",
    ]
    if "base" not in head:
        lines.append(f"# base = {printable(repr(base))}: found, the link whose frame is the arm's")
    lines += [
        "",
        f"# {printable(_home_words(arm, has_home))}",
        f"home_deg = [{', '.join(f'{value:.10g}' for value in arm.home_deg)}]",
        "# acceleration_deg_s2 = 300 # default: as the URDF has it, else full speed in 0.2 s",
    ]
    if proposed:
        lines += [
            "",
            "# PROPOSED, with the URDF's value behind: check all of these numbers.",
            "# Put the maker's in their place.",
        ]
    lines += ["", *limits] if limits and not proposed else limits
    lines += [
        *task,
        "",
        "[collision]",
        'fit = "tight" # "coarse": fewer shapes',
        "# ignore = [] # pairs of links that always touch, besides neighbors",
    ]
    lines += [
        f"# Left out, since they touch in every posture: {printable(' and '.join(pair))}"
        for pair in arm.touching_names()
    ]
    for link in arm.bare_links:
        lines += [
            "",
            f"# {printable(link)} has no body, and nothing keeps it from anything. As an example:",
            "# [[collision.shape]]",
            f"# {printable(as_toml({'link': link}).rstrip())}",
            "# capsule = [[0, 0, 0], [0, 0, 0.1], 0.05]",
        ]
    return "\n".join((*lines, ""))


def _home_words(arm: ArmModel, published: bool) -> str:
    value = ArmKinematics(arm).smallest_singular_value(np.array(arm.home), arm.task.weights)
    whose = "the file's own" if published else "chosen, of 1,000 postures: bent"
    return f"{whose}, its smallest singular value is {value:.3f}"


def session_text(arm_file: str) -> str:
    """A session's file that moves the arm of `arm_file` simulated, from the console's page."""
    return (
        "[robot]\n"
        'driver = "sim_arm"\n'
        f"{as_toml({'robot': arm_file})}"
        "\n"
        "[arm]\n"
        f"{as_toml({'model': arm_file})}"
        "\n"
        "[network]\n"
        'name = "my_arm"\n'
    )
