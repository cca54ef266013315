"""Dependencies point one way; protocols keep no clock and open nothing."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "cardan"
LEAVES = {
    "bounds",
    "types",
    "errors",
    "spatial",
    "braking",
    "histogram",
    "realtime",
    "robots",
    "haptics",
    "plugins",
    "__init__",
}

MAY_IMPORT = {
    "protocols": {"protocols", *LEAVES},
    "drivers": {"drivers", "protocols", *LEAVES},
    "gateway": {"gateway", "drivers", *LEAVES},
    "sim_peers": {"sim_peers", "protocols", *LEAVES},
    "dissect": {"dissect", *LEAVES},
    **dict.fromkeys(LEAVES, LEAVES),
}
EXCEPTIONS = {
    "drivers/sim_arm": ("cardan.sim_peers", "cardan.sim_peers.arm", "cardan.sim_peers.base"),
    "gateway/spnav": ("cardan.protocols", "cardan.protocols.spnav"),
}
"""The simulated arm's driver has the simulated arm for its hardware, in the same process; and the
gateway serves spacenavd's protocol itself, to programs instead of a robot."""
IMPURE = {"socket", "select", "selectors", "threading", "asyncio", "time", "subprocess", "pathlib"}
MODULES = sorted(PACKAGE.rglob("*.py"))


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
