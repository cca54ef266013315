"""Visual meshes of an arm's description, for programs that draw it.

A mesh is read once and cached in the user's cache folder by its content, in the format of
`Surface.packed`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from cardan.common.cache import cache_bytes, cached_bytes, content_key
from cardan.errors import ConfigurationError, about, shown
from cardan.robots.arm_loader import ArmTexts, arm_names, located
from cardan.robots.mesh_files import find_mesh, package_folders, read_mesh
from cardan.robots.urdf import Tree, read_tree

KIND: Final = "visuals"
METHOD: Final = "1"
"""Version of the cache format."""

MOST_BYTES: Final = 2 * 2**20
"""Largest mesh, bytes: 100,000 triangles, more than a small computer draws well."""
MOST_BYTES_OF_ARM: Final = 16 * 2**20


class Visuals(NamedTuple):
    """Visual meshes of an arm."""

    keys: dict[str, str]
    """Cache key of each mesh, by its name in the URDF."""
    left_out: tuple[str, ...] = ()
    """Meshes that are not shown, with reasons."""

    def in_words(self) -> str:
        """Report the meshes that are not shown; empty if all are."""
        if not self.left_out:
            return ""
        count = len(self.keys) + len(self.left_out)
        return "; ".join(
            (
                f"{len(self.left_out)} of {count} visual meshes are not shown, "
                "bodies stand in for them",
                *self.left_out,
            )
        )


def keep_visuals(name_or_file: str) -> Visuals:
    """Cache the visual meshes of an arm (argument of `load_arm`) for `stored_visual`.

    A missing, damaged or too large mesh is left out. Raises ConfigurationError like `load_arm`.
    """
    if name_or_file in arm_names():  # Built-in arms have none.
        return Visuals({})
    texts = ArmTexts(located(name_or_file, Path()))
    folders = package_folders(texts.file, texts.urdf_path)
    keys: dict[str, str] = {}
    left_out: list[str] = []
    sizes: dict[str, int] = {}
    for uri in _visual_meshes(read_tree(texts.urdf)):
        try:
            key, size = _keep(uri, texts.urdf_path, folders)
            if sum((sizes | {key: size}).values()) > MOST_BYTES_OF_ARM:
                raise ConfigurationError(
                    "",
                    f"mesh {shown(uri)} is beyond the {MOST_BYTES_OF_ARM >> 20} MiB of an arm",
                )
        except ConfigurationError as error:
            left_out.append(str(error))
        else:
            keys[uri], sizes[key] = key, size
    return Visuals(keys, tuple(left_out))


def stored_visual(key: str) -> bytes | None:
    """Return the cached mesh of a key; None if there is none."""
    return cached_bytes(KIND, key) or None


def _visual_meshes(tree: Tree) -> list[str]:
    """Return each visual mesh once."""
    found: dict[str, None] = {}
    for link in tree.links.values():
        for mesh in link.iterfind("visual/geometry/mesh"):
            found[mesh.get("filename", "")] = None
    return list(found)


def _keep(uri: str, urdf: Path, folders: Sequence[Path]) -> tuple[str, int]:
    """Cache a mesh; return its key, and its size in bytes."""
    path, missing = find_mesh(uri, urdf, folders)
    if path is None:
        raise ConfigurationError("", missing)
    data = read_mesh(path)
    key = content_key((METHOD, path.suffix.lower(), data))
    drawn = cached_bytes(KIND, key)
    if drawn is None:
        # An extra that programs which only show cached meshes do not need.
        from cardan.robots.meshes import surface_in

        surface = surface_in(data, path)
        with about(f"mesh {path}"):
            drawn = surface.packed()
        if len(drawn) > MOST_BYTES:
            drawn = b""  # Cached, too, so that it is not read again.
        if not cache_bytes(KIND, key, drawn):
            raise ConfigurationError("", f"mesh {path}: no cache folder can be written to")
    if not drawn:
        raise ConfigurationError(
            "", f"mesh {path} takes more than {MOST_BYTES >> 20} MiB: give it fewer triangles"
        )
    return key, len(drawn)
