"""Dependencies point one way; protocols keep no clock and open nothing."""

import ast
import graphlib
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "cardan"
LEAVES = {
    "arm_libraries",
    "bounds",
    "openable",
    "options",
    "types",
    "errors",
    "spatial",
    "tables",
    "braking",
    "histogram",
    "realtime",
    "robots",
    "haptics",
    "plugins",
    "sockets",
    "files",
    "printable",
    "shortage",
    "signals",
    "output",
    "logs",
    "__init__",
}

MAY_IMPORT = {
    "protocols": {"protocols", *LEAVES},
    "drivers": {"drivers", "protocols", *LEAVES},
    "gateway": {"gateway", "drivers", *LEAVES},
    "sim_peers": {"sim_peers", "protocols", *LEAVES},
    "dissect": {"dissect", *LEAVES},
    "api": {"drivers", "gateway", *LEAVES},
    **dict.fromkeys(LEAVES, LEAVES),
    "__init__": {"api"},
}
EXCEPTIONS = {
    "drivers/sim_arm": ("cardan.sim_peers", "cardan.sim_peers.arm", "cardan.sim_peers.base"),
    "gateway/spnav": ("cardan.protocols", "cardan.protocols.spnav"),
}
"""The simulated arm's driver has the simulated arm for its hardware, in the same process; and the
gateway serves spacenavd's protocol itself, to programs instead of a robot."""
IMPURE = {"socket", "select", "selectors", "threading", "asyncio", "time", "subprocess", "pathlib"}
MODULES = sorted(PACKAGE.rglob("*.py"))
FREE_OF_CIRCLES = ("drivers", "protocols", "sim_peers", "dissect", "gateway")

GATEWAY_ROOMS = {
    "common": set(),
    "motion": set(),
    "kinematics": set(),
    "servo": {"kinematics"},
    "hand": {"motion"},
    "force": {"common"},
    "spnav": {"common"},
    "arm": {"hand", "motion", "kinematics", "servo"},
    "session": {"arm", "hand", "force", "spnav", "motion", "kinematics", "servo", "common"},
}
"""What each room of the gateway may import, besides itself."""

ARM_LIBRARIES = {"numpy", "pinocchio", "coal", "eigenpy", "daqp"}
ARM_MODEL = (
    "cardan.arm_libraries",
    "cardan.gateway.arm.activities.",
    "cardan.gateway.arm.arm_body",
    "cardan.gateway.arm.device",
    "cardan.gateway.arm.options",
    "cardan.gateway.arm.planner",
    "cardan.gateway.arm.plans",
    "cardan.gateway.arm.streams",
    "cardan.gateway.arm.verbs",
    "cardan.gateway.kinematics.",
    "cardan.gateway.motion.paths",
    "cardan.gateway.servo.",
    "cardan.robots.counterbalance",
    "cardan.sim_peers.arm.controller",
    "cardan.sim_peers.arm.plant",
    "cardan.sim_peers.arm.udp",
)
"""Modules that need the extra cardan[arm]; all others are imported without it."""

IMPORT_WITHOUT = """
import importlib, sys
sys.modules.update(dict.fromkeys({without!r}))
from cardan.errors import ArmExtraMissingError
for name in {names!r}:
    try:
        importlib.import_module(name)
    except ArmExtraMissingError as error:
        print(name, error, sep=": ")
"""
"""What is None in sys.modules cannot be imported."""


def imported(path):
    """Absolute names of everything a module imports, wherever in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module
            if node.module == "cardan":
                yield from (f"cardan.{alias.name}" for alias in node.names)


def module_name(path):
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_modules(path, modules):
    """The modules of `modules` that one imports by name, under TYPE_CHECKING and in functions too.

    ``from package import module`` imports the module; the package only for names of its own.
    """
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            submodules = names & modules
            found |= submodules
            if names - submodules:
                found.add(node.module)
    return found & modules


def room(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_one_way(path):
    allowed = MAY_IMPORT.get(room(path))
    for name in imported(path):
        parts = name.split(".")
        if name in EXCEPTIONS.get(str(path.relative_to(PACKAGE).parent), ()):
            continue
        if parts[0] == "cardan" and len(parts) > 1 and allowed is not None:
            assert parts[1] in allowed, f"{path.relative_to(PACKAGE)} imports {name}"


@pytest.mark.parametrize(
    "path", sorted((PACKAGE / "protocols").rglob("*.py")), ids=lambda p: p.stem
)
def test_protocols_do_no_io_and_keep_no_clock(path):
    assert not {name.split(".")[0] for name in imported(path)} & IMPURE


def test_only_the_command_line_knows_everything():
    unknown = {room(path) for path in MODULES} - MAY_IMPORT.keys()
    assert unknown == {"cli", "__main__"}


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_the_libraries_of_an_arms_model_are_imported_in_one_place(path):
    found = {name.split(".")[0] for name in imported(path)} & ARM_LIBRARIES
    assert found == (ARM_LIBRARIES if path.stem == "arm_libraries" else set())


def test_only_what_needs_an_arms_model_needs_the_extra():
    names = [module_name(path) for path in MODULES if path.stem != "__main__"]
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_WITHOUT.format(without=sorted(ARM_LIBRARIES), names=names)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    said = dict(line.split(": ", 1) for line in done.stdout.splitlines())
    assert [name for name in said if not name.startswith(ARM_MODEL)] == []
    assert "cardan.gateway.arm.device" in said
    assert len(set(said.values())) == 1
    assert said["cardan.gateway.arm.device"].endswith('pip install "cardan[arm]"')


@pytest.mark.parametrize("name", FREE_OF_CIRCLES)
def test_no_import_circles(name):
    paths = {module_name(path): path for path in (PACKAGE / name).rglob("*.py")}
    graph = {module: imported_modules(path, set(paths)) for module, path in paths.items()}
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


def test_the_rooms_of_the_gateway_stand_on_each_other():
    found = {}
    for path in (PACKAGE / "gateway").rglob("*.py"):
        parts = path.relative_to(PACKAGE / "gateway").parts
        if len(parts) == 1:
            continue
        for name in imported(path):
            other = name.split(".")[2] if name.startswith("cardan.gateway.") else parts[0]
            found.setdefault(parts[0], set()).add(other)
    assert found.keys() == GATEWAY_ROOMS.keys()
    for room_, others in found.items():
        assert others - {room_} <= GATEWAY_ROOMS[room_], room_
