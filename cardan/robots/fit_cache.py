"""Fits meshes once: what was found is kept by content in the user's cache folder."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from cardan.common.files import cache_folder, read_text
from cardan.errors import about
from cardan.robots.arm_model import Box, Capsule, Shape
from cardan.robots.fitting import METHOD, Fit, How, fit
from cardan.robots.meshes import UNSCALED, points_in, read_mesh
from cardan.types import Pose, Quaternion, Vector3

FOLDER: Final = "fits"
"""In the cache folder; whoever wants the room deletes it."""


def fit_mesh(path: Path, how: How, scale: Vector3 = UNSCALED) -> Fit:
    """What covers the convex hull of the mesh at `path`, as :func:`cardan.robots.fitting.fit` has
    it; from the cache where these bytes were fitted before. Raises ConfigurationError."""
    data = read_mesh(path)
    how_read = json.dumps([METHOD, how, *map(float, scale), path.suffix.lower()])
    key = hashlib.sha256(how_read.encode() + b"\0" + data).hexdigest()
    folder = cache_folder()
    file = folder / FOLDER / f"{key}.json" if folder else None
    if file and (found := _read(file, key)):
        return found
    points = points_in(data, path, scale)
    with about(f"mesh {path}"):
        found = fit(points, how)
    if file:
        # Without a cache the next start takes longer, and nothing else.
        with contextlib.suppress(OSError):
            _write(file, key, found)
    return found


def _read(file: Path, key: str) -> Fit | None:
    """None where it is missing, damaged, or of something else."""
    try:
        table = json.loads(read_text(file))
        if table["sum"] != _sum(key, table["fit"]):
            return None
        return _from_table(table["fit"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return None


def _write(file: Path, key: str, found: Fit) -> None:
    table = _to_table(found)
    file.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=file.parent, prefix=".", suffix=".tmp")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as new:
            json.dump({"sum": _sum(key, table), "fit": table}, new)
        os.replace(name, file)
    except OSError:
        os.unlink(name)
        raise


def _sum(key: str, table: Mapping[str, Any]) -> str:
    """Over the numbers and what they are of: a digit that changed would be a body elsewhere."""
    text = json.dumps([key, table], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _to_table(found: Fit) -> dict[str, Any]:
    shapes = [*map(_shape_to_table, found.shapes)]
    return {"shapes": shapes, "over_share": found.over_share, "over_m": found.over_m}


def _shape_to_table(shape: Shape) -> dict[str, Any]:
    if isinstance(shape, Capsule):
        return shape._asdict()
    position, orientation, _ = shape.pose
    return {"position": position, "orientation": orientation, "size_m": shape.size_m}


def _from_table(table: Mapping[str, Any]) -> Fit:
    shapes = tuple(map(_shape_from_table, table["shapes"]))
    return Fit(shapes, table["over_share"], table["over_m"])


def _shape_from_table(table: Mapping[str, Any]) -> Shape:
    if "radius_m" in table:
        return Capsule(Vector3(*table["start"]), Vector3(*table["end"]), table["radius_m"])
    pose = Pose(Vector3(*table["position"]), Quaternion(*table["orientation"]))
    return Box(pose, Vector3(*table["size_m"]))
