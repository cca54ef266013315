"""Import rules of the layers (protocols have no clock and no I/O), and rules for names and
sentences."""

import ast
import fnmatch
import functools
import graphlib
import importlib
import io
import re
import subprocess
import sys
import tokenize
from pathlib import Path

import pytest

from cardan.common.tables import read_toml
from cardan.drivers import registry
from tests.docs_tables import ours
from tests.sentences import MAYBE, NO_NOUN, begun_with_a_pronoun, comments, docstrings, strings

PACKAGE = Path(__file__).parents[1] / "cardan"
SOURCE_TREE = PACKAGE.parent
BESIDE = {
    "bench",
    "conftest",
    "fuzz",
    "studies",
    "tests",
    *(path.parent.name for path in SOURCE_TREE.glob("plugins/*/*/__init__.py")),
}
"""Packages that build on this one; absent if only the package is installed."""
PLUGINS = sorted(SOURCE_TREE.glob("plugins/cardan-*"))
OF_THE_TREE = {"cardan", *BESIDE}
DRIVERS = ours(registry)
GROUPS = {
    "cardan.buses", "cardan.captures", "cardan.checks", "cardan.commands", "cardan.conform",
    "cardan.dissect", "cardan.drivers", "cardan.filters", "cardan.second_descriptions",
    "cardan.servers", "cardan.sim_peers",
}  # fmt: skip
"""Entry-point groups through which a plug-in may reach Cardan; ``cardan.dissect`` reaches
cardan-dissect."""
KNOW_DISSECTION = {
    "cardan_jr3.capture", "cardan_jr3.dissect", "cardan_serial_mice.dissect",
    "cardan_spnav_server.dissect", "cardan_wiimote.bluetooth", "cardan_wiimote.captures",
    "cardan_wiimote.dissect",
}  # fmt: skip
"""Modules that import cardan-dissect, which is itself a plug-in: entry points of its groups name
them, and their other modules do without."""
LEAVES = {"common", "errors", "robots", "spatial", "types", "__init__", "__version__"}

MAY_IMPORT = {
    "protocols": {"protocols", *LEAVES},
    "bus": {"bus", "protocols", *LEAVES},
    "drivers": {"drivers", "bus", "protocols", *LEAVES},
    "gateway": {"gateway", "drivers", "bus", *LEAVES},
    "recording": {"recording", "gateway", "drivers", "bus", *LEAVES},
    "doctor": {"doctor", "gateway", "drivers", "bus", *LEAVES},
    "own_arm": {"own_arm", "gateway", *LEAVES},
    "demos": {"demos", "gateway", "drivers", "bus", *LEAVES},
    "sim_peers": {"sim_peers", "bus", "protocols", *LEAVES},
    "conform": {"bus", "conform", "drivers", "protocols", "recording", "sim_peers", *LEAVES},
    "api": {"drivers", "gateway", *LEAVES},
    **dict.fromkeys(LEAVES, LEAVES),
    "__init__": {"api"},
}
EXCEPTIONS = {
    "drivers/sim_arm": (
        "cardan.sim_peers",
        "cardan.sim_peers.arm.controller",
        "cardan.sim_peers.arm.faults",
        "cardan.sim_peers.arm.options",
        "cardan.sim_peers.base",
    ),
    "gateway/bus": ("cardan.protocols", "cardan.protocols.ros2.*"),
    "recording": ("cardan.protocols", "cardan.protocols.ros2.*"),
    "gateway/servers": (
        "cardan.protocols",
        "cardan.protocols.rate",
        "cardan.protocols.ros2.*",
        "cardan.protocols.rosbridge",
        "cardan.protocols.rosbridge.*",
    ),
    "gateway/servers/console": (
        "cardan.protocols",
        "cardan.protocols.handheld",
        "cardan.protocols.handheld.*",
        "cardan.protocols.mjpeg",
        "cardan.protocols.rate",
        "cardan.protocols.ros2.*",
        "cardan.protocols.rosbridge.*",
    ),
}
"""Allowed exceptions: the simulated arm is the hardware of its own driver, in the same process; the
gateway serves rosbridge itself; the console reads cameras for its pages."""
IMPURE = {"socket", "select", "selectors", "threading", "asyncio", "time", "subprocess", "pathlib"}
MODULES = sorted(PACKAGE.rglob("*.py"))
SUITES_OF_ARMS = sorted(SOURCE_TREE.glob("plugins/cardan-conform-arms/cardan_conform_arms/**/*.py"))
GONE = frozenset(
    [
        "face",
        "faces",
        "with_face",
        "activities",
        "door",
        "guessing",
        "telling",
        "outbox",
        "standstill",
        "feeds",
        "beside",
        "orders",
        "keeping",
        "lending",
        "leashed",
        "launched",
        "surroundings",
        "desk",
        "gate",
        "repeating",
        "askers",
        "taps",
        "survey",
        "glide",
        "guide",
        "book",
        "lost_time",
        "conduct",
        "wires",
        "silences",
        "seen",
        "pilot",
        "rig",
        "rigs",
        "second",
        "tongue",
        "strokes",
        "anatomy",
        "shortage",
        "printable",
        "openable",
        "unattended",
        "declared",
        "report_line",
        "judges",
        "plans",
        "joint_path",
    ]
)
"""Former names of modules, replaced by the field's words: CHANGELOG.md has both."""
GONE_WORDS = (
    "AbbGofa", "Activity", "Anatomy", "ArmBody", "Askers", "Carrier", "ConnexionPilot",
    "ConnexionRig", "CyclicRig", "DaemonArm", "Doors", "DriverRig", "EgmDriverRig", "EgmPilot",
    "EgmRig", "EgmSeen", "EngineReport", "Felt", "FeltFigures", "FeltForce", "FollowHand",
    "ForceGuard", "FoxgloveFeed", "FreeBody", "Gate", "Guidance", "HAND_PERIOD_S",
    "HandActions", "HandEnd", "HandEvents", "HandFeedback", "HandKind", "HandMapping",
    "HandPeer", "HandPilot", "HandPort", "JointGuidance", "JointStreamSeen", "KeptServer",
    "KeyboardHand", "MapGlide", "MotomanGp8", "MotorosDriverRig", "MotorosPilot", "MotorosRig",
    "MotorosSeen", "Outbox", "PlainBook", "PoseGuidance", "RemoteCartesianDevice",
    "RemotePacketArm", "RosbridgeFeed", "ScriptHand", "ScriptedHand", "SessionTaps",
    "SharedFeeds", "Surroundings", "TimedActs", "Tongue", "UrPilot", "UrSeen", "VerbDesk",
    "decode_told", "encode_told", "felt_depth_m", "felt_stiffness_n_m", "follows_hand",
    "hand_map", "hand_peer", "judge_bus", "judge_devices", "judge_ports", "kept_bytes",
    "kept_text", "leash_used", "leashed", "make_hand", "no_farewell_after_s", "off_the_wire",
    "owes_answer", "replay_engine", "tongue", "tried_with",
)  # fmt: skip
"""Former words in identifiers, likewise."""
GONE_ARGUMENTS = {"seen", "judge", "act", "acts"}
"""Former names of arguments and functions in suites; other code uses them with another meaning."""
GONE_EVERYWHERE = re.compile(
    r"_?(?:\w+_)?(?:rigs?|(?:un)?told)|_?kept|\w*Rig|_?Told|_?Kept|_?judge_\w+|_?(?:\w+_)?KEPT(?:_\w+)?"
)
"""Former identifiers and module names, likewise, in all Python files of the tree."""
MEANT_OTHERWISE = {
    ("tests/sweep/operators.py", "judge_node"): "another implementation, which judges ours",
    ("tests/fastdds/__init__.py", "judge_node"): "the same",
    ("tests/judge_node.py", "judge_node"): "the same",
}
"""Exceptions from these: file, name and reason."""
FREE_OF_CIRCLES = (
    "bus", "common", "conform", "demos", "doctor", "drivers", "gateway", "own_arm",
    "protocols", "recording", "sim_peers",
)  # fmt: skip

GATEWAY_ROOMS = {
    "kinematics": set(),
    "motion": {"kinematics"},
    "servo": {"kinematics"},
    "operator": {"motion"},
    "force": set(),
    "arm": {"operator", "motion", "kinematics", "servo"},
    "bus": {"arm", "motion", "force"},
    "servers": {"arm"},
    "daemon": {"session", "arm", "servers"},
    "session": {"bus", "arm", "operator", "force", "motion", "kinematics", "servo"},
}
"""Subpackages of the gateway, and those that each may import besides itself."""

ARM_LIBRARIES = {"numpy", "pinocchio", "coal", "eigenpy", "daqp"}
ARM_MODEL = (
    "cardan.common.arm_libraries",
    "cardan.gateway.arm.motions.",
    "cardan.gateway.arm.joint_space_arm",
    "cardan.gateway.arm.device",
    "cardan.gateway.arm.neighbors",
    "cardan.gateway.arm.options",
    "cardan.gateway.arm.streams",
    "cardan.gateway.arm.verb_methods",
    "cardan.gateway.arm.verb_plans",
    "cardan.gateway.bus.neighbors",
    "cardan.gateway.kinematics.",
    "cardan.gateway.motion.planner",
    "cardan.gateway.motion.trajectories",
    "cardan.gateway.servo.",
    "cardan.own_arm.added",
    "cardan.own_arm.pictures",
    "cardan.own_arm.tried",
    "cardan.robots.arm_bodies",
    "cardan.robots.arm_choices",
    "cardan.robots.arm_reader",
    "cardan.robots.counterbalance",
    "cardan.robots.fit_cache",
    "cardan.robots.fitting",
    "cardan.robots.meshes",
    "cardan.sim_peers.arm.controller",
    "cardan.sim_peers.arm.plant",
    "cardan.sim_peers.arm.udp",
    "cardan_conform_arms.joint_stream.simulated",
    "cardan_conform_arms.joint_stream_driver.scenario",
    "cardan_conform_arms.ros2_arm.simulated",
)
"""Modules that need the extra cardan[arm]; all others of the package, and of the plug-in with
suites of arms, must be importable without it."""

IMPORT_WITHOUT = """
import importlib, sys
sys.modules.update(dict.fromkeys({without!r}))
from cardan.errors import ExtraMissingError
for name in {names!r}:
    try:
        importlib.import_module(name)
    except ExtraMissingError as error:
        print(name, error, sep=": ")
"""
"""Import modules with others set to None in sys.modules, which makes their import fail."""


NOT_AT_ONCE = {
    "asyncio", "cardan_dissect", "getpass", "hmac", "numpy", "rich", "scapy", "secrets", "ssl",
    "websockets", "zenoh",
}  # fmt: skip
"""Modules that would delay the start of every command, although few commands need them."""


BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")
"""Fields of statements that contain statements."""


@functools.cache
def import_statements(path):
    """Yield all import statements of a module, without a walk through its expressions."""
    found, blocks = [], [ast.parse(path.read_text(encoding="utf-8")).body]
    while blocks:
        for node in blocks.pop():
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                found.append(node)
            blocks += [getattr(node, name) for name in BLOCKS if hasattr(node, name)]
    return found


def imported(path):
    """Return the absolute names of all imports in a module, including nested ones."""
    for node in import_statements(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module
            if node.module == "cardan":
                yield from (f"cardan.{alias.name}" for alias in node.names)


def module_name(path):
    parts = path.relative_to(SOURCE_TREE).with_suffix("").parts
    if parts[0] == "plugins":
        parts = parts[2:]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_modules(path, modules):
    """Return the modules of `modules` that a module imports by name, including those under
    TYPE_CHECKING and in functions.

    ``from package import module`` counts as an import of the module, and of the package only for
    its own names.
    """
    found = set()
    for node in import_statements(path):
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


@pytest.mark.parametrize("name", sorted({*map(room, MODULES)} & MAY_IMPORT.keys()))
def test_imports_point_one_way(name):
    paths = [path for path in MODULES if room(path) == name]
    assert [strange for path in paths for strange in strange_imports(path)] == []


def test_a_suite_never_imports_what_it_checks():
    """Only the simulations of suites run drivers, and are imported only to do that."""
    conform = [path for path in MODULES if room(path) == "conform"]
    assert SUITES_OF_ARMS
    strange = [
        f"{path.relative_to(SOURCE_TREE)} imports {name}"
        for path in (*conform, *SUITES_OF_ARMS)
        for name in imported(path)
        if name.endswith(".simulated")
        or (name.startswith("cardan.drivers") and not runs_a_driver(path))
    ]
    assert strange == []


def runs_a_driver(path):
    """Return whether a module of a suite is its simulation of a driver."""
    return path.name == "simulated.py" and path.parent.name.endswith("_driver")


def strange_imports(path):
    """Yield the forbidden imports of a module as text."""
    folder = str(path.relative_to(PACKAGE).parent)
    for name in imported(path):
        if any(fnmatch.fnmatchcase(name, each) for each in EXCEPTIONS.get(folder, ())):
            continue
        parts = name.split(".")
        if parts[0] == "cardan" and len(parts) > 1 and parts[1] not in MAY_IMPORT[room(path)]:
            yield f"{path.relative_to(PACKAGE)} imports {name}"


def test_the_package_imports_nothing_that_stands_on_it():
    found = {str(p): strange for p in MODULES if (strange := outside(p))}
    assert found == {}


def outside(path):
    """Return the packages in BESIDE that a module imports."""
    return {name.split(".")[0] for name in imported(path)} & BESIDE


def test_what_stands_on_the_package_is_there():
    assert {"studies", "lerobot_robot_cardan", "cardan_dds", "cardan_foxglove"} < BESIDE
    assert {"cardan_conform_arms", "cardan_dissect", "cardan_filters"} < BESIDE
    assert {"cardan_serial_mice", "cardan_spnav_server"} < BESIDE
    assert {
        "cardan_jr3",
        "cardan_leap",
        "cardan_learning",
        "cardan_omni",
        "cardan_wiimote",
    } < BESIDE
    for name in BESIDE:
        assert [*SOURCE_TREE.glob(f"{name}*"), *SOURCE_TREE.glob(f"plugins/*/{name}")], name


@pytest.mark.parametrize("folder", PLUGINS, ids=lambda folder: folder.name)
def test_a_plug_in_is_reached_by_its_entry_points_alone(folder):
    project = read_toml(folder / "pyproject.toml")["project"]
    (package,) = (path.parent for path in folder.glob("*/__init__.py"))
    assert (folder / "README.md").is_file()
    assert package.name == folder.name.replace("-", "_") == project["name"].replace("-", "_")
    assert [each for each in project["dependencies"] if each.startswith("cardan")]
    points = project.get("entry-points", {})
    assert points.keys() <= GROUPS
    for target in (target for group in points.values() for target in group.values()):
        module, _, name = target.partition(":")
        assert module.partition(".")[0] == package.name
        loaded = importlib.import_module(module)
        assert getattr(loaded, name) if name else loaded
    found = {
        (module_name(path), name.partition(".")[0])
        for path in package.rglob("*.py")
        for name in imported(path)
        if name.partition(".")[0] in BESIDE - {package.name}
    }
    known = {each for each in KNOW_DISSECTION if each.startswith(f"{package.name}.")}
    assert found == {(module, "cardan_dissect") for module in known}


def test_only_what_is_for_dissection_needs_it():
    """All other modules of these plug-ins can be imported without cardan-dissect."""
    packages = {each.partition(".")[0] for each in KNOW_DISSECTION}
    names = {
        module_name(path)
        for folder in PLUGINS
        for path in folder.glob("*/**/*.py")
        if folder.name.replace("-", "_") in packages and "tests" not in path.parts
    }
    assert names > KNOW_DISSECTION
    program = IMPORT_WITHOUT.format(
        without=["cardan_dissect"], names=sorted(names - KNOW_DISSECTION)
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


def test_a_second_description_knows_no_codec():
    """Layers are written from protocol descriptions, independent of the codecs; tools that show
    captures use the codecs."""
    package = SOURCE_TREE / "plugins/cardan-dissect/cardan_dissect"
    codecs = {
        str(path.relative_to(package).parent)
        for path in package.rglob("*.py")
        if any(name.startswith("cardan.protocols") for name in imported(path))
    }
    assert codecs == {"dissectors"}


def test_protocols_do_no_io_and_keep_no_clock():
    paths = [path for path in MODULES if room(path) == "protocols"]
    found = {
        str(path): impure
        for path in paths
        if (impure := {name.split(".")[0] for name in imported(path)} & IMPURE)
    }
    assert paths
    assert found == {}


def test_only_the_command_line_knows_everything():
    unknown = {room(path) for path in MODULES} - MAY_IMPORT.keys()
    assert unknown == {"cli", "__main__"}


def test_the_libraries_of_an_arms_model_are_imported_in_one_place():
    found = {
        str(path.relative_to(PACKAGE)): libraries
        for path in MODULES
        if (libraries := {name.split(".")[0] for name in imported(path)} & ARM_LIBRARIES)
    }
    assert found == {"common/arm_libraries.py": ARM_LIBRARIES, "types.py": {"numpy"}}


def said_without_an_arms_model(paths):
    """Return the error of each module that cannot be imported without the extra, by name."""
    names = [module_name(path) for path in paths if path.stem != "__main__"]
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_WITHOUT.format(without=sorted(ARM_LIBRARIES), names=names)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return dict(line.split(": ", 1) for line in done.stdout.splitlines())


def test_only_what_needs_an_arms_model_needs_the_extra():
    said = said_without_an_arms_model((*MODULES, *SUITES_OF_ARMS))
    assert [name for name in said if not name.startswith(ARM_MODEL)] == []
    assert {"cardan.gateway.arm.device", "cardan_conform_arms.ros2_arm.simulated"} <= said.keys()
    assert len(set(said.values())) == 1
    assert said["cardan.gateway.arm.device"].endswith('pip install "cardan[arm]"')


def test_a_command_begins_without_what_only_some_need():
    program = (
        "import sys, typer; before = {*sys.modules}; import cardan.cli;"
        "print(*sys.modules.keys() - before)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert "cardan.cli" in done.stdout.split()
    assert NOT_AT_ONCE & {*done.stdout.split()} == set()


def assert_no_circles(sources):
    """Assert that no module of `sources` imports itself through others."""
    paths = {module_name(path): path for path in sources}
    graph = {module: imported_modules(path, set(paths)) for module, path in paths.items()}
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


@pytest.mark.parametrize("name", FREE_OF_CIRCLES)
def test_no_import_circles(name):
    assert_no_circles((PACKAGE / name).rglob("*.py"))


@pytest.mark.parametrize("folder", PLUGINS, ids=lambda folder: folder.name)
def test_no_import_circles_in_a_plug_in(folder):
    assert_no_circles((folder / folder.name.replace("-", "_")).rglob("*.py"))


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


LISTED = ast.ListComp, ast.SetComp, ast.DictComp


def inner_asynchronous(source):
    """Return the lines of asynchronous comprehensions inside of others."""
    for outer in ast.walk(ast.parse(source)):
        if isinstance(outer, (*LISTED, ast.GeneratorExp)):
            for inner in ast.walk(outer):
                if isinstance(inner, LISTED) and inner is not outer:
                    waits = any(isinstance(each, ast.Await) for each in ast.walk(inner))
                    if waits or any(each.is_async for each in inner.generators):
                        yield inner.lineno


def test_python_3_10_compiles_comprehensions_that_wait():
    """Newer versions allow them, and neither ruff nor mypy reports that 3.10 does not."""
    assert [*inner_asynchronous("async def f(a): [[await b for b in c] for c in a]")] == [1]
    assert [*inner_asynchronous("async def f(a): [[b async for b in c] for c in a]")] == [1]
    assert [*inner_asynchronous("async def f(a): [[b for b in c] for c in await a]")] == []
    strange = [
        f"{path.relative_to(SOURCE_TREE)}:{line}"
        for folder in ("cardan", "plugins", "studies", "bench", "fuzz", "examples", "tests")
        for path in sorted((SOURCE_TREE / folder).rglob("*.py"))
        if re.search(r"\bawait\b|\basync for\b", text := path.read_text(encoding="utf-8"))
        for line in inner_asynchronous(text)
    ]
    assert strange == []


def test_names_that_only_we_knew_do_not_come_back():
    folders = [PACKAGE, *(folder / folder.name.replace("-", "_") for folder in PLUGINS)]
    names = {path for folder in folders for path in folder.rglob("*") if path.stem in GONE}
    assert not {path for path in names if path.suffix == ".py"}
    pattern = re.compile(rf"\b_?(?:{'|'.join(GONE_WORDS)})\b")
    strange = [
        f"{path.relative_to(SOURCE_TREE)}: {found[0]}"
        for path, text in own_sources()
        for found in [pattern.search(text)]
        if found
    ]
    assert strange == []


def test_no_part_of_the_tree_has_names_of_its_own():
    found = {
        (str(path.relative_to(SOURCE_TREE)), name)
        for path, text in [*own_sources(), (Path(__file__), Path(__file__).read_text("utf-8"))]
        if re.search(rf"\b(?:{GONE_EVERYWHERE.pattern})\b", f"{path.stem} {text}")
        for name in (path.stem, *identifiers(text))
        if GONE_EVERYWHERE.fullmatch(name)
    }
    assert found == MEANT_OTHERWISE.keys()


def identifiers(text):
    """Yield all names in a module's source, including keywords."""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.NAME:
            yield token.string


def test_arguments_of_suites_have_names_of_the_field():
    suites = SOURCE_TREE.glob("plugins/*/*/conform/**/*.py")
    conform = [path for path in MODULES if room(path) == "conform"]
    strange = [
        f"{path.relative_to(SOURCE_TREE)}:{node.lineno}: {name}"
        for path in (*conform, *SUITES_OF_ARMS, *sorted(suites))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.arg | ast.FunctionDef)
        and (name := node.arg if isinstance(node, ast.arg) else node.name) in GONE_ARGUMENTS
    ]
    assert strange == []


SENTENCES = {
    "a client, a sender, an operator": r"(?<![A-Za-z])[Ww]hoever\b",
    "likewise: no sentence begins with Who": r"(?:\"\"\"|\. |# )Who (?!may\b)[a-z]+ ",
    "reports, gets, learns": r"\b(?:is|are|was|were|be|been) told of\b",
}
"""Patterns of phrases to avoid, by the replacement."""


@pytest.mark.parametrize("instead", SENTENCES)
def test_sentences_are_as_the_field_says_them(instead):
    pattern = re.compile(SENTENCES[instead])
    found = [
        f"{path.relative_to(SOURCE_TREE)}:{number}: {line.strip()}"
        for path, text in own_sources()
        if pattern.search(text)
        for number, line in enumerate(text.splitlines(), 1)
        if pattern.search(line)
    ]
    assert found == []


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("Return a pose.\n\n    What comes late is dropped.", ["What comes late is dropped"]),
        (
            "Somebody else: one that waits. One that waits is told.",
            ["Somebody else: one that waits", "One that waits is told"],
        ),
        ("Whose turn is it? One of two. One loop at a time. What-if.", []),
    ],
)
def test_sentences_with_a_pronoun_for_a_subject_are_found(text, found):
    source = f'def f():\n    """{text}"""\n'
    assert [each for _, said in docstrings(source) for each in begun_with_a_pronoun(said)] == found


def test_the_subject_of_a_sentence_is_a_thing_of_the_field():
    """Covers docstrings and comments; tests/test_troubles.py covers messages."""
    found = [
        f"{path.relative_to(SOURCE_TREE)}:{line}: {each}"
        for path, text in own_sources()
        if MAYBE.search(text)
        for line, said in (*docstrings(text), *comments(text))
        for each in begun_with_a_pronoun(said)
    ]
    assert found == []


def begun_without_a_noun(source):
    return [f"{line}: {said[:60]}" for line, said in docstrings(source) if NO_NOUN.match(said)]


def test_a_docstring_begins_with_an_imperative_or_a_noun():
    found = {
        path.relative_to(SOURCE_TREE).as_posix(): said
        for path, text in own_sources()
        if path.relative_to(SOURCE_TREE).parts[0] in ("cardan", "plugins")
        and "tests" not in path.parts
        and path.name != "requirements.py"  # reports have separate texts
        if (said := begun_without_a_noun(text))
    }
    assert found == {}


def test_docstrings_that_begin_without_a_noun_are_found():
    source = 'def f():\n    """Of a joint."""\n\n\ndef g():\n    """Offset, where known."""\n'
    assert begun_without_a_noun(source) == ["2: Of a joint."]


def test_comments_that_begin_with_a_pronoun_are_found():
    source = "a = 1  # Whose is it?\n# What comes late\n# is dropped. Others wait.\n"
    found = [(line, begun_with_a_pronoun(said)) for line, said in comments(source)]
    assert found == [(1, []), (2, ["What comes late is dropped"])]


HUMAN_HANDS = {
    "cardan/common": "bounds.py haptics.py troubles.toml",
    "cardan/demos": "demo.py",
    "cardan/drivers": "ihaptic.py spnav/core.py",
    "cardan/gateway": "bus/haptic_server.py bus/sharing.py daemon/figures.py",
    "cardan/gateway/force": "__init__.py conditioning.py crossfade.py figures.py fixtures.py "
    "input.py link.py network.py passive.py rendering.py snapshot.py sources.py stability.py "
    "tables.py watchdog.py",
    "cardan/gateway/session": "force_assembly.py terminal_view.py",
    "cardan/robots": "amor.toml",
    "docs": "configuration.md evaluation.md force-feedback.md phone.md "
    "remote.md ros2.md stability.md tutorials/force.md",
    "examples": "phone-ur5-simulated.toml",
    "plugins/cardan-jr3": "README.md cardan_jr3/driver/core.py "
    "cardan_jr3/examples/jr3-ur5.toml cardan_jr3/examples/omni-jr3-simulated.toml",
    "plugins/cardan-wiimote": "cardan_wiimote/driver/tilt.py",
}
"""Files that say "the hand" of a person or a robot, which feels a force or holds a device."""
PLUGINS_OF_HANDS = ("plugins/cardan-leap/", "plugins/cardan-omni/")
"""Plug-ins of devices that track or push a hand; their peers simulate one."""


def says_the_hand(path):
    text = path.read_text(encoding="utf-8")
    said = strings(text) if path.suffix == ".py" else enumerate(text.splitlines(), 1)
    return [f"{line}: {each[:80]}" for line, each in said if re.search(r"\b[Tt]he hand\b", each)]


def test_an_operator_device_is_not_called_a_hand():
    """Covers strings of Cardan and its plug-ins, messages, pages and examples."""
    meant = {f"{at}/{name}" for at, names in HUMAN_HANDS.items() for name in names.split()}
    patterns = (
        "cardan/**/*.py", "cardan/**/*.toml", "docs/**/*.md", "examples/**/*.toml",
        "plugins/*/README.md", "plugins/*/*_*/**/*.py", "plugins/*/*_*/**/*.toml", "README.md",
    )  # fmt: skip
    found = {
        name: said
        for pattern in patterns
        for path in SOURCE_TREE.glob(pattern)
        if not (name := path.relative_to(SOURCE_TREE).as_posix()).startswith(PLUGINS_OF_HANDS)
        if (said := says_the_hand(path))
    }
    assert {name: said for name, said in found.items() if name not in meant} == {}
    assert meant - set(found) == set(), "exceptions that are not needed"


BRITISH = (
    "acknowledgement", "amongst", "analys(?:e[ds]?|ing)(?![a-z])", "analogue", "anticlockwise",
    "armour", "artefact", "behaviour", "cancell(?:ed|ing)", "catalogue", "centre", "centring",
    "colour", "defence", "dialogue", "endeavour", "favour", "fibre", "flavour", "grey", "harbour",
    "honour", "judgement", "labell(?:ed|ing)", "learnt", "levell(?:ed|ing)", "licence",
    "litres?(?![a-z])", "manoeuvre", "metres?(?![a-z])", "modell(?:ed|ing)", "neighbour", "offence",
    "programme(?![dr])", "rigour", "signall(?:ed|ing)", "spelt", "travell(?:ed|ing|er)", "whilst",
)  # fmt: skip
"""Patterns of British spellings, in lower case."""
ISE = re.compile("is(?:e[ds]?|ing|ations?)(?![a-z])")
WITH_S = (
    "adv", "advert", "compr", "comprom", "conc", "cru", "dev", "disgu", "enterpr", "exerc",
    "expert", "improv", "no", "pra", "prec", "prem", "prom", "ra", "rev", "r", "superv", "surpr",
    "w",
)  # fmt: skip
"""Stems that take -ise in American spelling."""
NOT_OURS = (
    ".cancelled()", "CancelledError", "aria-labelledby", '"centre_m"', '"centre_rpy_deg"',
    '"device_centre_m"', "mapping.device_centre_m", r"\.centre_m", '"neighbours"',
)  # fmt: skip
"""Names of asyncio and HTML, and keys whose error names their replacement."""
WRITTEN = (
    "", ".c", ".cpp", ".css", ".h", ".html", ".md", ".mjs", ".py", ".sh", ".svg", ".toml", ".ts",
    ".urdf",
)  # fmt: skip
SPELLED = (
    "*", "bench/**/*", "cardan/**/*", "console/src/**/*", "console/test/**/*", "docs/**/*",
    "examples/**/*", "findings/**/*", "fuzz/**/*", "plugins/**/*", "studies/**/*", "tests/**/*",
    "tools/**/*",
)  # fmt: skip


def british(text):
    """Return British spellings in a text, each with its line; of -ise only the ending."""
    for name in NOT_OURS:
        text = text.replace(name, "")
    small = text.lower()
    found = [each for word in BRITISH for each in re.finditer(word, small)]
    for each in ISE.finditer(small):
        before = small[max(each.start() - 12, 0) : each.start()]
        if re.search("[a-z]{3}$", before) and not before.endswith(WITH_S):
            found.append(each)
    return [(small.count("\n", 0, each.start()) + 1, each[0]) for each in found]


@pytest.mark.parametrize("files", SPELLED)
def test_the_spelling_is_american(files):
    """Includes file names. The changelog is exempt, because it has former names."""
    text = "Fibres\nsynchronised by modelledMetres: noise, otherwise precise, is raised."
    assert british(text) == [(1, "fibre"), (2, "metres"), (2, "modelled"), (2, "ised")]
    found = []
    for path in sorted(SOURCE_TREE.glob(files)):
        if path.suffix not in WRITTEN or not path.is_file() or path == Path(__file__):
            continue
        name = path.relative_to(SOURCE_TREE)
        if name.name in ("CHANGELOG.md", "LICENSE") or {"page", ".ruff_cache"} & {*name.parts}:
            continue
        found += [f"{name}: {word}" for _, word in british(str(name))]
        found += [f"{name}:{at}: {word}" for at, word in british(path.read_text("utf-8"))]
    assert found == []


def raised(tree):
    """Yield line and constant text of each raised exception's message."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            for given in node.exc.args:
                parts = given.values if isinstance(given, ast.JoinedStr) else [given]
                words = [each.value for each in parts if isinstance(each, ast.Constant)]
                yield node.lineno, "".join(each for each in words if isinstance(each, str))


def test_no_part_of_a_message_is_longer_than_120_characters():
    """Full stops, colons and semicolons separate cause, effect and remedy."""
    assert [*raised(ast.parse("raise ValueError(f'{a}: is {b}', 3)"))] == [(1, ": is "), (1, "")]
    strange = [
        f"{path.relative_to(SOURCE_TREE)}:{line}: {part}"
        for path, text in own_sources()
        if "tests" not in path.parts and "raise " in text
        for line, words in raised(ast.parse(text))
        for part in re.split(r"[.:;]\s", words)
        if len(part) > 120
    ]
    assert strange == []


@functools.cache
def own_sources():
    """Yield path and text of all Python files of the repository except this one."""
    folders = ("bench", "cardan", "examples", "fuzz", "plugins", "studies", "tests")
    return [
        (path, path.read_text(encoding="utf-8"))
        for folder in folders
        for path in sorted((SOURCE_TREE / folder).rglob("*.py"))
        if path != Path(__file__)
    ]


def rows_of(text):
    """Return the cells of the first table in `text`, without its header."""
    body = text.split("|---|---|---|\n", 1)[1].split("\n\n", 1)[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in body.splitlines()]


def names_in(cell):
    return {name.rstrip("/") for name in re.findall("`([^`]*)`", cell)}


def test_contributors_find_what_the_list_of_tasks_says():
    """Each file exists, and each name occurs in one of its row's files."""
    listed = (SOURCE_TREE / "CONTRIBUTING.md").read_text("utf-8").split("## Where is what\n", 1)[1]
    missing = []
    for task, files, names in rows_of(listed):
        folder, found = Path(), []
        for file in re.findall("`([^`]*)`", files):
            folder = Path(file).parent if "/" in file else folder
            paths = list(SOURCE_TREE.glob(str(folder / Path(file).name).replace("NAME", "*")))
            missing += [] if paths else [f"{task}: {file}"]
            found += [path.read_text("utf-8") for path in paths]
        for name in re.findall("`([^`]*)`", names):
            made = rf"(?m)\b(?:class|def|async) {name}\b|^ *{name}\b *[:=]"
            if not re.search(made, "\n".join(found)):
                missing.append(f"{task}: {name}")
    assert missing == []


def test_a_public_class_has_a_name_of_its_own():
    modules = {}
    for path in MODULES:
        if path.stem.endswith("_pb2"):
            continue
        for each in ast.parse(path.read_text("utf-8")).body:
            if isinstance(each, ast.ClassDef) and not each.name.startswith("_"):
                modules.setdefault(each.name, []).append(str(path.relative_to(PACKAGE)))
    assert len(modules) > 1000
    assert {name: of for name, of in modules.items() if len(of) > 1} == {}


def inheritance(kind):
    """Return the longest chain of classes of this source tree from `kind` to a root."""
    bases = (base for base in kind.__bases__ if base.__module__.partition(".")[0] in OF_THE_TREE)
    return [kind.__name__, *max(map(inheritance, bases), key=len, default=[])]


@pytest.mark.parametrize("driver", [pytest.param(kind, id=name) for name, kind in DRIVERS.items()])
def test_a_driver_stands_on_three_bases_at_most(driver):
    """Readers of a device's `open()` need to read at most these classes."""
    special = [kind for kind in driver.__subclasses__() if kind.__module__ == driver.__module__]
    chains = [inheritance(kind) for kind in (driver, *special)]
    assert [" -> ".join(chain) for chain in chains if len(chain) > 4] == []


def test_the_page_of_the_architecture_has_every_room_and_no_other():
    page = (PACKAGE.parent / "docs/architecture.md").read_text("utf-8")
    files = {each.name for each in PACKAGE.glob("[a-z]*.py")}
    rooms = {each.parent.name for each in PACKAGE.glob("*/__init__.py")}
    assert set().union(*(names_in(row[0]) for row in rows_of(page))) == files | rooms
    found = {}
    for room, _, others in rows_of(page.split("### Inside the gateway")[1]):
        words = others.removeprefix("all but")
        found[room.strip("`")] = (
            GATEWAY_ROOMS.keys() - {room.strip("`")} - names_in(words)
            if words != others
            else names_in(words)
        )
    assert found == GATEWAY_ROOMS
