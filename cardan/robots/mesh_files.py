"""Search for the meshes and packages that a URDF names, and reading of meshes."""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

from cardan.common.files import MESH_BYTES, open_file, read_text, read_up_to
from cardan.errors import ConfigurationError, shown
from cardan.robots.arm_file import ArmFile
from cardan.robots.urdf import Mesh, Tree, mesh_in


class FoundMesh(NamedTuple):
    """A mesh of a link, and its file."""

    link: str
    mesh: Mesh
    path: Path | None = None
    """Path; None: missing or ignored."""
    missing: str = ""
    """Places searched in vain."""


def meshes_of(tree: Tree, file: ArmFile, urdf: Path | None) -> dict[ET.Element, FoundMesh]:
    """Return the meshes of collision elements of the URDF at `urdf`, except of links that have a
    shape in the arm's file. Raises ConfigurationError, also for any mesh if there is no file."""
    table, found = file.collision, {}
    given = {shape.link for shape in table.shape}
    folders = [] if urdf is None else package_folders(file, urdf)
    for link, element in tree.links.items():
        for collision in element.iterfind("collision") if link not in given else ():
            mesh = mesh_in(collision, link)
            if mesh is None:
                continue
            found[collision] = FoundMesh(link, mesh)
            if table.meshes == "fit":
                if urdf is None:
                    raise ConfigurationError(
                        "",
                        f"the collision geometry of link {link!r} is a mesh; allowed without "
                        "a file: sphere, cylinder, capsule, box. In the .toml of a file set "
                        'collision.meshes = "ignore" to go without',
                    )
                found[collision] = FoundMesh(link, mesh, *find_mesh(mesh.uri, urdf, folders))
    return found


def find_mesh(uri: str, urdf: Path, folders: Sequence[Path] = ()) -> tuple[Path | None, str]:
    """Find the file for `uri` in a URDF at `urdf`; return None and all searched places if there is
    none.

    ``package://NAME/FILE`` is searched in `folders`, from the URDF's folder upward, in
    ROS_PACKAGE_PATH and in AMENT_PREFIX_PATH; relative paths beside the URDF and in `folders`;
    ``file://`` and absolute paths are used unchanged. Raises ConfigurationError for any other form.
    """
    looked: dict[str, None] = {}
    for place in _places(uri, urdf, folders):
        if os.path.isfile(place):
            return place, ""
        looked[f"{place} (not a file)" if os.path.exists(place) else str(place)] = None
    where = ", ".join(looked) or f"in no package of that name from {urdf.parent} upward"
    remedy = "; name the folder of its package in ROS_PACKAGE_PATH" if uri[:8] == "package:" else ""
    return None, f"mesh {shown(uri)} is not there; looked for: {where}{remedy}"


def package_folders(file: ArmFile, urdf: Path) -> list[Path]:
    """Return the package folders that the arm's file names."""
    return [urdf.parent / folder for folder in file.package_dirs]


def find_package(name: str, urdf: Path, folders: Sequence[Path]) -> Path:
    """Return the folder of a ROS package, searched like `find_mesh`; a folder with only its name if
    none has a package.xml. Raises ConfigurationError."""
    found = [folder for folder in _packages(name, urdf, folders) if os.path.isdir(folder)]
    if not found:
        raise ConfigurationError(
            "",
            f"there is no package {shown(name)} from {urdf.parent} upward: name its folder in "
            "ROS_PACKAGE_PATH, or in package_dirs of the arm's .toml",
        )
    return next((each for each in found if os.path.isfile(each / "package.xml")), found[0])


def _places(uri: str, urdf: Path, folders: Sequence[Path]) -> Iterator[Path]:
    scheme, separator, rest = uri.partition("://")
    if not separator:
        yield from (folder / uri for folder in (urdf.parent, *folders))
    elif scheme == "package":
        name, _, file = rest.partition("/")
        yield from (folder / file for folder in _packages(name, urdf, folders))
    elif scheme == "file":
        yield _local(uri)
    else:
        raise ConfigurationError(
            "", f"mesh {shown(uri)} must be a path, or begin with package:// or file://"
        )


def _local(uri: str) -> Path:
    try:
        parts = urlsplit(uri)
    except ValueError:
        parts = urlsplit("file://?")
    if parts.netloc not in ("", "localhost") or not parts.path:
        raise ConfigurationError("", f"mesh {shown(uri)} must have three slashes: file:///folder/…")
    return Path(unquote(parts.path))


def _packages(name: str, urdf: Path, folders: Sequence[Path]) -> Iterator[Path]:
    """Yield folders that may be the package's."""
    ros = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    for folder in (*folders, *urdf.absolute().parents, *map(Path, filter(None, ros))):
        if folder.name == name or _package_name(folder) == name:
            yield folder
        if os.path.isdir(folder / name):
            yield folder / name
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        yield Path(prefix, "share", name)


def _package_name(folder: Path) -> str:
    """Return the name in its package.xml; empty without one."""
    try:
        text = read_text(folder / "package.xml")
    except (OSError, ValueError):
        return ""
    found = re.search(r"<name>\s*([^<\s]*)\s*</name>", text)
    return found[1] if found else ""


def read_mesh(path: Path) -> bytes:
    """Read the bytes of a mesh's file. Raises ConfigurationError."""
    try:
        with open_file(path) as file:
            data = read_up_to(file, MESH_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ConfigurationError("", f"mesh {path} cannot be read: {reason}") from None
    if len(data) > MESH_BYTES:
        raise ConfigurationError("", f"mesh {path} is longer than {MESH_BYTES >> 20} MiB")
    return data
