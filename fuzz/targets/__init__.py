"""All targets, by name."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import MappingProxyType

from fuzz.target import Target

MODULES = ("robots", "universal_robots", "devices", "peers", "captures", "texts", "ros2", "cameras")
"""Each has `TARGETS`."""


@cache
def targets() -> MappingProxyType[str, Target]:
    """All targets, in the order of their modules."""
    found: dict[str, Target] = {}
    for module in MODULES:
        for target in import_module(f"fuzz.targets.{module}").TARGETS:
            assert target.name not in found, target.name
            found[target.name] = target
    return MappingProxyType(found)


def target_named(name: str) -> Target:
    """The target called `name`. Raises KeyError."""
    return targets()[name]
