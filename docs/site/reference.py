"""The reference of the programming interface: which names it has, and a page for each part.

What is on a page is found in the package: a part's public names are those that its module gives and
that were made in it. The text is that of the docstrings.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

from cardan.drivers import registry as drivers
from cardan.sim_peers import registry as peers

FOLDER = Path(__file__).parents[1] / "api"
"""Made anew by each build, and in no repository."""

PARTS = {
    "Open and find": ("cardan.api",),
    "Values: states, commands, poses": ("cardan.types", "cardan.common.value_json"),
    "Errors": ("cardan.errors",),
    "The Cartesian device": (
        "cardan.gateway.arm.device",
        "cardan.gateway.arm.remote_arm",
        "cardan.gateway.session.remote",
        "cardan.gateway.bus.remote",
    ),
    "Rotations and transforms": ("cardan.spatial",),
    "Arms": ("cardan.robots",),
    "Write a driver": (
        "cardan.drivers.base",
        "cardan.drivers.core",
        "cardan.drivers.reader_thread",
        "cardan.drivers.robot_core",
        "cardan.drivers.datagram_robot",
        "cardan.drivers.haptic",
        "cardan.common.options",
        "cardan.common.bounds",
        "cardan.common.plugins",
    ),
    "Write a simulated peer": (
        "cardan.sim_peers.base",
        "cardan.sim_peers.command",
        "cardan.sim_peers.device_peer",
        "cardan.sim_peers.scripted",
    ),
}
"""By title: the modules of each page that is no driver's, peer's or protocol's."""

PROTOCOLS = (
    "connexion",
    "egm",
    "evdev",
    "handheld",
    "joint_stream",
    "rosbridge",
    "simple_message",
    "spnav",
)


def public(module: ModuleType) -> Iterator[tuple[str, Any]]:
    """Classes and functions that this module, or one inside it, made."""
    for name, value in vars(module).items():
        made_in = getattr(value, "__module__", "") or ""
        inside = made_in == module.__name__ or made_in.startswith(f"{module.__name__}.")
        if name.startswith("_") or not inside or not getattr(value, "__doc__", None):
            continue
        if inspect.isclass(value) or inspect.isfunction(value):
            yield name, value


def directive(name: str, value: object) -> str:
    kind = (
        "autofunction"
        if inspect.isfunction(value)
        else "autoexception"
        if inspect.isclass(value) and issubclass(value, BaseException)
        else "autoclass"
    )
    return f".. {kind}:: {name}\n"


def heading(title: str, line: str = "=") -> str:
    return f"{title}\n{line * len(title)}\n\n"


def page_of_modules(title: str, modules: tuple[str, ...]) -> str:
    text = heading(title)
    for name in modules:
        module = importlib.import_module(name)
        if len(modules) > 1:
            text += heading(name, "-")
        text += f".. currentmodule:: {name}\n\n{inspect.getdoc(module)}\n\n"
        text += "\n".join(directive(f"{name}.{each}", value) for each, value in public(module))
        text += "\n"
    return text


def protocol_modules(name: str) -> tuple[str, ...]:
    """The package of a protocol where it gives names itself, else it and the modules in it."""
    package = importlib.import_module(name)
    if any(public(package)):
        return (name,)
    return (name, *(each.name for each in pkgutil.iter_modules(package.__path__, f"{name}.")))


def page_of_classes(title: str, kind: type[Any]) -> str:
    """Of a driver or a simulated peer: its class, and that of its options."""
    options: type[Any] = kind.Options
    return heading(title) + "".join(
        directive(f"{each.__module__}.{each.__qualname__}", each)
        + "   :inherited-members: tuple\n\n"
        for each in (kind, options)
    )


def pages() -> dict[str, dict[str, str]]:
    """By section and name: the text of each page."""
    return {
        "Programming interface": {
            title.split(":")[0].lower().replace(" ", "-"): page_of_modules(title, modules)
            for title, modules in PARTS.items()
        },
        "Drivers": {
            f"driver-{name}": page_of_classes(
                f"{name}: {drivers.load(name).summary}", drivers.load(name)
            )
            for name in drivers.BUILT_IN
        },
        "Simulated peers": {
            f"peer-{name}": page_of_classes(f"cardan sim {name}", peers.load(name))
            for name in peers.BUILT_IN
        },
        "Protocols": {
            f"protocol-{name}": page_of_modules(
                f"cardan.protocols.{name}", protocol_modules(f"cardan.protocols.{name}")
            )
            for name in PROTOCOLS
        },
    }


def write(folder: Path = FOLDER) -> None:
    """Write all pages, and the one that lists them."""
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.rst"):
        old.unlink()
    index = heading("Reference of the programming interface")
    for section, made in pages().items():
        index += heading(section, "-") + ".. toctree::\n   :maxdepth: 1\n\n"
        for name, text in made.items():
            (folder / f"{name}.rst").write_text(text, encoding="utf-8")
            index += f"   {name}\n"
        index += "\n"
    (folder / "index.rst").write_text(index, encoding="utf-8")
