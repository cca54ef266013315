"""Cache of shapes fitted to meshes, by content, in the user's cache folder."""

from __future__ import annotations

from pathlib import Path

from cardan.common.cache import cache_text, cached_text, content_key
from cardan.errors import about
from cardan.robots.arm_table import made_from, plain_text
from cardan.robots.fitting import METHOD, Fit, How, fit
from cardan.robots.mesh_files import read_mesh
from cardan.robots.meshes import UNSCALED, points_in
from cardan.types import Vector3

KIND = "fits"


def fit_mesh(path: Path, how: How, scale: Vector3 = UNSCALED) -> Fit:
    """Fit shapes to the convex hull of the mesh at `path` by :func:`cardan.robots.fitting.fit`, or
    take them from the cache if the same bytes were fitted before. Raises ConfigurationError."""
    data = read_mesh(path)
    key = content_key((data, plain_text((METHOD, how, *scale, path.suffix.lower()))))
    text = cached_text(KIND, key)
    if text is not None and (stored := made_from(Fit, text)) is not None:
        return stored
    points = points_in(data, path, scale)
    with about(f"mesh {path}"):
        found = fit(points, how)
    cache_text(KIND, key, plain_text(found))
    return found
