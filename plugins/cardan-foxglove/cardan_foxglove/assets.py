"""Files of URDF packages, mainly meshes, for clients that show a robot."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import unquote

from cardan.common.files import open_file, read_text
from cardan.errors import ConfigurationError, shown

MAX_ASSET_BYTES = 32 * 2**20
"""Largest file that is served: meshes to look at have a few MB."""

KINDS = frozenset(
    (
        *(".stl", ".dae", ".obj", ".mtl", ".ply", ".glb", ".gltf", ".bin", ".urdf"),
        *(".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp"),
    )
)
"""Extensions of served files: those that define a robot's appearance."""

_SCHEME = "package://"


class AssetError(ValueError):
    """File that is not served, with the reason."""


class Packages:
    """Files in the folders of some packages, by ``package://NAME/PATH``."""

    def __init__(self, folders: Sequence[str]) -> None:
        """`folders` are those of packages with their ``package.xml``; without it a package has the
        folder's name. Raises ConfigurationError."""
        self._roots: dict[str, Path] = {}
        for each in folders:
            root = Path(each).resolve()
            if not root.is_dir():
                raise ConfigurationError("packages", f"{each} is not a folder")
            name = _name_of(root)
            if self._roots.setdefault(name, root) != root:
                raise ConfigurationError(
                    "packages", f"both {self._roots[name]} and {root} are the package {name}"
                )

    def read(self, uri: str) -> bytes:
        """Return the content of a file. Raises AssetError for a file outside the package's folder,
        after links are resolved, and for a file of another kind."""
        if not uri.startswith(_SCHEME):
            raise AssetError(f"{shown(uri)} is not available here: only {_SCHEME}NAME/PATH can")
        name, _, rest = unquote(uri.removeprefix(_SCHEME)).partition("/")
        root = self._roots.get(name)
        if root is None:
            raise AssetError(
                f"there is no package {shown(name)}: the option packages names folders"
            )
        if "\0" in rest:
            raise AssetError(f"{shown(uri)} is not a path")
        try:
            path = (root / rest.lstrip("/")).resolve()
            if not path.is_relative_to(root):
                raise AssetError(f"{shown(uri)} is outside its package")
            if path.suffix.lower() not in KINDS:
                raise AssetError(f"{shown(uri)} is neither a mesh nor an image")
            with open_file(path) as file:
                data = file.read(MAX_ASSET_BYTES + 1)
        except (OSError, RuntimeError) as error:  # RuntimeError: cycle of links, Python < 3.13.
            why = getattr(error, "strerror", None) or error
            raise AssetError(f"{shown(uri)} cannot be read: {why}") from None
        if len(data) > MAX_ASSET_BYTES:
            raise AssetError(f"{shown(uri)} has more than {MAX_ASSET_BYTES / 2**20:g} MiB")
        return data


def _name_of(root: Path) -> str:
    manifest = root / "package.xml"
    if not manifest.exists():
        return root.name
    try:
        name = ET.fromstring(read_text(manifest)).findtext("name", "").strip()
    except (OSError, ValueError, ET.ParseError) as error:
        raise ConfigurationError("packages", f"{manifest} cannot be read: {error}") from None
    if not name or "/" in name:
        raise ConfigurationError("packages", f"{manifest} has no name of a package")
    return name
