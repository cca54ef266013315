"""Released files (`make dist`) in clean environments outside of the checkout: small without the
extra for arm models, complete, and working."""

from __future__ import annotations

import os
import re
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

import cardan
from cardan.drivers import registry
from cardan.gateway.servers.console.site import FOLDER as PAGE
from tests.released import ROOT, run
from tests.serving import free_udp_port

pytestmark = [pytest.mark.matrix, pytest.mark.timeout(400)]

LARGEST_BYTES = 60_000_000
"""Limit on the package with its dependencies, without extras, including bytecode."""

EVERY_DRIVER = """
import importlib.util, sys
import cardan
from cardan.drivers import registry
from cardan.gateway.servers.console.site import FOLDER as PAGE
loaded = registry.load_all()
assert not loaded.refused, loaded.refused
print(*loaded.classes)
for name in ("numpy", "pinocchio", "coal", "eigenpy", "daqp"):
    assert importlib.util.find_spec(name) is None, name
print(cardan.__file__)
"""


def occupied_bytes(folder: Path) -> int:
    """Return the bytes that a folder occupies on the disk."""
    return sum(os.lstat(file).st_blocks * 512 for file in folder.rglob("*"))


class Installation:
    """Clean environment with a released file installed."""

    def __init__(self, folder: Path, released: Path) -> None:
        self.folder = folder
        self._environment = folder / "environment"
        run(sys.executable, "-m", "venv", "--without-pip", self._environment)
        bare_bytes = occupied_bytes(self._environment)
        pip = (sys.executable, "-m", "pip", "--python", self._environment)
        run(*pip, "install", "--quiet", released)
        self.added_bytes = occupied_bytes(self._environment) - bare_bytes

    def python(self, program: str) -> str:
        return run(self._environment / "bin/python", "-c", program, folder=self.folder)

    def cardan(self, *words: object, codes: tuple[int, ...] = (0,)) -> str:
        return run(self._environment / "bin/cardan", *words, codes=codes, folder=self.folder)

    def demo(self) -> None:
        """Run a demo whose session needs no arm model; a busy computer may miss cycles."""
        said = self.cardan("demo", "gofa", "--seconds", "5", codes=(0, 4))
        assert "followed throughout" in said or "cycles were missed" in said, said


@pytest.fixture(scope="module")
def light(tmp_path_factory: pytest.TempPathFactory, wheel: Path) -> Installation:
    return Installation(tmp_path_factory.mktemp("light"), wheel)


def test_one_wheel_serves_every_python(wheel: Path) -> None:
    # An older name of the same glibc may precede it.
    tags = r"py3-none-(?:manylinux\w+\.)?manylinux_2_\d+_\w+"
    assert re.fullmatch(rf"cardan-{re.escape(cardan.__version__)}-{tags}\.whl", wheel.name)


def test_neither_knows_the_machine_it_was_made_on(wheel: Path, sdist: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        contents = {name: archive.read(name) for name in archive.namelist()}
    assert {
        "cardan/gateway/servo/libcardan_servo.so",
        "cardan/drivers/ur_rtde/libcardan_ur.so",
        "cardan/examples/verbs.py",
    } <= contents.keys()
    with tarfile.open(sdist) as archive_:
        for member in archive_:
            if (file := archive_.extractfile(member)) is not None:
                contents[member.name] = file.read()
            assert not member.uname, f"{member.name} has the owner {member.uname}"
    for place in {str(ROOT), str(Path.home()), sys.prefix, sys.base_prefix}:
        assert [name for name, data in contents.items() if f"{place}/".encode() in data] == []


def test_both_have_the_consoles_page_and_its_sources_are_in_the_archive_alone(
    wheel: Path, sdist: Path
) -> None:
    here = {f"{PAGE.relative_to(ROOT)}/{path.name}": path.read_bytes() for path in PAGE.iterdir()}
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        assert {name: archive.read(name) for name in names if re.search(r"/page/.", name)} == here
        assert not [name for name in names if name.startswith("console/")]
    with tarfile.open(sdist) as archive_:
        inside = {member.name.partition("/")[2] for member in archive_}
    assert inside >= {*here, "console/src/main.ts", "console/package-lock.json", "tools/console"}
    assert not [name for name in inside if "node_modules" in name]


def test_the_plug_ins_are_in_the_archive_alone(wheel: Path, sdist: Path) -> None:
    sources = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "plugins").rglob("*")
        if path.suffix in (".py", ".toml")
    }
    assert "plugins/cardan-serial-mice/pyproject.toml" in sources
    assert "plugins/lerobot_robot_cardan/pyproject.toml" in sources
    with zipfile.ZipFile(wheel) as archive:
        assert not [name for name in archive.namelist() if "plugins/" in name]
        assert "cardan/examples/lerobot/three_episodes.py" in archive.namelist()
    with tarfile.open(sdist) as archive_:
        assert {member.name.partition("/")[2] for member in archive_} >= sources


def test_the_studies_are_in_the_archive_alone(wheel: Path, sdist: Path) -> None:
    sources = {str(path.relative_to(ROOT)) for path in (ROOT / "studies").rglob("*.py")}
    sources |= {"studies/pyproject.toml", "studies/haptics/probe.c", "conftest.py"}
    with zipfile.ZipFile(wheel) as archive:
        assert not [name for name in archive.namelist() if name.startswith("studies/")]
    with tarfile.open(sdist) as archive_:
        assert {member.name.partition("/")[2] for member in archive_} >= sources


def test_a_command_of_the_source_tree_says_where_it_is(light: Installation) -> None:
    assert "pip install ./studies" in light.cardan("evaluate", "--quick", codes=(2,))


def test_its_page_needs_nothing_of_the_checkout(light: Installation) -> None:
    program = (
        "from cardan.gateway.servers.console.site import Site;"
        "print(b'console.js' in Site().answer('/').body)"
    )
    assert light.python(program).strip() == "True"


def test_without_extras_it_is_small(light: Installation) -> None:
    assert light.added_bytes < LARGEST_BYTES


def test_every_driver_is_imported_without_an_arms_model(light: Installation) -> None:
    names, place = light.python(EVERY_DRIVER).splitlines()
    assert set(names.split()) == set(registry.BUILT_IN)
    assert Path(place).is_relative_to(light.folder)


@pytest.mark.parametrize(
    "words",
    [
        ("abb-gofa", "--to", "127.0.0.1:{port}"),
        ("gamepad", "--events", "gamepad.sock"),
        ("keyboard", "--events", "keyboard.sock"),
        ("motoman-gp8", "--base-port", "{port}"),
        ("spacemouse", "--hid", "spacemouse.sock"),
    ],
    ids=" ".join,
)
def test_simulated_peers_serve_without_an_arms_model(
    light: Installation, words: tuple[str, ...]
) -> None:
    words = tuple(word.format(port=free_udp_port()) for word in words)
    assert "READY" in light.cardan("sim", *words, "--seconds", "0.5")


def test_a_session_without_an_arms_model_runs(light: Installation) -> None:
    light.demo()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("devices", "drivers"), "sim_arm"),
        (("devices",), ""),
        (("sim", "--list"), "motoman-gp8"),
        (("demo", "--list"), "spacemouse-ur5"),
        (("check", ROOT / "examples/spacemouse-gofa.toml"), "fine"),
    ],
)
def test_the_lists_need_no_arms_model(
    light: Installation, words: tuple[object, ...], said: str
) -> None:
    text = light.cardan(*words)
    assert said in text
    assert "cannot be loaded" not in text


@pytest.mark.parametrize(
    "words",
    [
        ("check", ROOT / "examples/spacemouse-gp8.toml"),
        ("run", ROOT / "examples/verbs-ur5-simulated.toml"),
        ("demo", "spacemouse-ur5", "--seconds", "5"),
        ("sim", "arm"),
    ],
    ids=lambda words: f"{words[0]} {Path(words[1]).stem}",
)
def test_what_needs_an_arms_model_says_what_to_install(
    light: Installation, words: tuple[object, ...]
) -> None:
    lines = [line for line in light.cardan(*words, codes=(3,)).splitlines() if "cardan: " in line]
    (line,) = lines
    assert "an arm's model needs numpy, pin, coal" in line
    assert line.endswith('pip install "cardan[arm]" [S007]')


def test_the_source_archive_is_whole(tmp_path_factory: pytest.TempPathFactory, sdist: Path) -> None:
    installed = Installation(tmp_path_factory.mktemp("source"), sdist)
    installed.demo()
    assert "True" in installed.python(
        "from cardan.drivers.abb_egm import compiled; from cardan.gateway.servo import native;"
        "print(bool(compiled.egm_library() and native.kernel_library()))"
    )
