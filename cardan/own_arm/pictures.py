"""Pictures of an arm's postures: character graphics for a terminal, and PNG files."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cardan.common.arm_libraries import np, pin
from cardan.common.extras import missing_extra
from cardan.errors import ConfigurationError
from cardan.gateway.kinematics.base import FloatArray
from cardan.robots import ArmModel, Capsule, OrientedBox, Shape
from cardan.robots.arm_bodies import pinocchio_model, to_se3

COLUMNS, ROWS = 34, 14
"""Size of a view in characters; a character is twice as high as wide."""

GAP = "   "


class Posed(NamedTuple):
    """Points of an arm in one posture, in its base frame, m."""

    name: str
    line: FloatArray
    """Base, joints and TCP, a row each."""
    frames: list[Any]
    """Frames of the bodies, the base's first."""


def posed(arm: ArmModel, q: Sequence[float], name: str) -> Posed:
    """Compute the points of the arm with its joints at `q` (rad or m)."""
    model = pinocchio_model(arm)
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(q))
    frames = list(data.oMi)
    tcp = data.oMf[model.getFrameId("tcp")]
    return Posed(name, np.array([each.translation for each in (*frames, tcp)]), frames)


def side_views(arm: ArmModel, poses: Sequence[Posed]) -> list[str]:
    """Draw postures as lines of text, two side by side, at one scale.

    The view is along x or y of the base, whichever shows more: o is a joint, X the TCP, # the base.
    """
    points = np.vstack([each.line for each in poses])
    spread = np.ptp(points, axis=0)
    axis = 0 if spread[0] >= spread[1] else 1
    low, high = points.min(axis=0), points.max(axis=0)
    # Meters per column; a row is two columns high.
    scale = max((high[axis] - low[axis]) / (COLUMNS - 1), (high[2] - low[2]) / (2 * (ROWS - 1)))
    scale = max(float(scale), 1e-6)
    lines: list[str] = []
    for first in range(0, len(poses), 2):
        drawn = [_view(each, axis, low, scale) for each in poses[first : first + 2]]
        lines += [GAP.join(row).rstrip() for row in zip(*drawn, strict=True)]
        lines.append("")
    lines.append(f"along {'y' if axis == 0 else 'x'}: # base, o joints, X TCP")
    return lines


def _view(pose: Posed, axis: int, low: FloatArray, scale: float) -> list[str]:
    grid = [[" "] * COLUMNS for _ in range(ROWS)]
    places = [
        (
            (ROWS - 1) - (point[2] - low[2]) / (2.0 * scale),
            (point[axis] - low[axis]) / scale,
        )
        for point in pose.line
    ]

    def put(row: float, column: float, mark: str) -> None:
        grid[min(max(round(row), 0), ROWS - 1)][min(max(round(column), 0), COLUMNS - 1)] = mark

    for (row, column), (next_row, next_column) in itertools.pairwise(places):
        for share in np.linspace(0.0, 1.0, 3 * COLUMNS):
            put(row + share * (next_row - row), column + share * (next_column - column), ".")
    for place in places[1:-1]:
        put(*place, "o")
    put(*places[0], "#")
    put(*places[-1], "X")
    return [pose.name[:COLUMNS].ljust(COLUMNS), *("".join(row) for row in grid)]


# ---------------------------------------------------------------------------------------------
# As a picture


def draw(arm: ArmModel, poses: Sequence[Posed], picture: Path) -> None:
    """Draw the bodies from the side and from above as a PNG. Raises ExtraMissingError if matplotlib
    is missing, ConfigurationError."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise missing_extra("a picture", "matplotlib", "evaluate", error) from error
    figure = Figure(figsize=(4.0 * len(poses), 8.0), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(arm.name.replace("$", r"\$"))
    panels = figure.subplots(2, len(poses), squeeze=False, sharex="all", sharey="row")
    for column, pose in enumerate(poses):
        for row, (across, up) in enumerate(((0, 2), (0, 1))):
            axes = panels[row][column]
            for each in arm.shapes:
                frame = pose.frames[each.body]
                for outline in _outlines(each.shape, frame, across, up):
                    axes.fill(*outline.T, color=f"C{each.body % 10}", alpha=0.35, linewidth=0)
            axes.plot(pose.line[:, across], pose.line[:, up], "k.-")
            axes.plot(*pose.line[-1, [across, up]], "rX")
            axes.set_aspect("equal")
            axes.set_xlabel(f"{'xyz'[across]} (m)")
            axes.set_ylabel(f"{'xyz'[up]} (m)")
            axes.grid(visible=True, alpha=0.3)
        panels[0][column].set_title(pose.name)
    try:
        figure.savefig(picture, dpi=90)
    except OSError as error:
        raise ConfigurationError("", f"cannot write {picture}: {error.strerror}") from None


def _outlines(shape: Shape, frame: Any, across: int, up: int) -> list[FloatArray]:
    """Polygons in the plane that together are the shape's projection."""
    if isinstance(shape, OrientedBox):
        return _box_outlines(shape, frame, across, up)
    return _capsule_outlines(shape, frame, across, up)


def _box_outlines(box: OrientedBox, frame: Any, across: int, up: int) -> list[FloatArray]:
    placed = frame * to_se3(box.pose)
    half = 0.5 * np.array(box.size_m)
    outlines = []
    for axis in range(3):
        others = [each for each in range(3) if each != axis]
        for side in (-1.0, 1.0):
            corners = np.zeros((4, 3))
            corners[:, axis] = side * half[axis]
            corners[:, others] = np.array(((-1, -1), (-1, 1), (1, 1), (1, -1))) * half[others]
            seen = corners @ placed.rotation.T + placed.translation
            outlines.append(seen[:, [across, up]])
    return outlines


def _capsule_outlines(capsule: Capsule, frame: Any, across: int, up: int) -> list[FloatArray]:
    ends = [frame.act(np.array(each))[[across, up]] for each in (capsule.start, capsule.end)]
    along = ends[1] - ends[0]
    direction = np.arctan2(along[1], along[0])
    # A half circle about each end in turn outlines the whole.
    angles = direction + np.linspace(0.5, 1.5, 13) * np.pi
    around = capsule.radius_m * np.column_stack((np.cos(angles), np.sin(angles)))
    return [np.vstack((ends[0] + around, ends[1] - around))]
