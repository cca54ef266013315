"""Reads the arm models under ``cardan/robots``: what each joint can do, from its URDF."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from functools import cache
from importlib import resources
from typing import NamedTuple

from cardan.errors import ConfigurationError

_FOLDER = resources.files("cardan").joinpath("robots")


class ArmModel(NamedTuple):
    """Joints of one arm in kinematic order: rad and rad/s, as on its data sheet."""

    name: str
    joints: tuple[str, ...]
    lower_rad: tuple[float, ...]
    upper_rad: tuple[float, ...]
    velocity_rad_s: tuple[float, ...]


def arm_names() -> tuple[str, ...]:
    """The arms there are, sorted."""
    names = (file.name for file in _FOLDER.iterdir())
    return tuple(sorted(name.removesuffix(".urdf") for name in names if name.endswith(".urdf")))


@cache
def load_arm(name: str) -> ArmModel:
    """The arm called `name`; ConfigurationError names the ones there are."""
    if name not in arm_names():
        raise ConfigurationError("", f"there is no arm {name!r}; allowed: {', '.join(arm_names())}")
    return parse_urdf(_FOLDER.joinpath(f"{name}.urdf").read_text("utf-8"))


def parse_urdf(text: str) -> ArmModel:
    """The moving joints of a serial chain described in URDF, from base to tip.

    Continuous joints have no range: theirs is infinite. Raises ConfigurationError for text that
    is not URDF, branches, or leaves a limit out.
    """
    try:
        robot = ET.fromstring(text)
    except ET.ParseError as error:
        raise ConfigurationError("", f"the arm's URDF is not XML: {error}") from None
    by_parent: dict[str, ET.Element] = {}
    children = set()
    for joint in robot.iterfind("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is None or child is None:
            raise ConfigurationError("", f"joint {joint.get('name')!r} lacks its parent or child")
        if parent.get("link", "") in by_parent:
            raise ConfigurationError("", f"link {parent.get('link')!r} branches: not one arm")
        by_parent[parent.get("link", "")] = joint
        children.add(child.get("link", ""))
    roots = set(by_parent) - children
    if len(roots) != 1:
        raise ConfigurationError("", f"an arm has one base link, not {sorted(roots)}")
    link = roots.pop()
    moving: list[tuple[str, float, float, float]] = []
    while link in by_parent:
        joint = by_parent.pop(link)
        if joint.get("type") in ("revolute", "prismatic", "continuous"):
            moving.append(_limits(joint))
        child = joint.find("child")
        link = "" if child is None else child.get("link", "")
    names, lower, upper, velocity = zip(*moving, strict=True) if moving else ((),) * 4
    return ArmModel(robot.get("name", ""), names, lower, upper, velocity)


def _limits(joint: ET.Element) -> tuple[str, float, float, float]:
    name, limit = joint.get("name", ""), joint.find("limit")
    try:
        if limit is None:
            raise ValueError("no <limit>")
        velocity = float(limit.get("velocity", ""))
        if joint.get("type") == "continuous":
            return name, -math.inf, math.inf, velocity
        return name, float(limit.get("lower", "")), float(limit.get("upper", "")), velocity
    except ValueError as error:
        raise ConfigurationError("", f"limits of joint {name!r}: {error}") from None
