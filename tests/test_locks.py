"""locks/ has all packages that make installs, by version and hash, and all that pyproject.toml
requires."""

from __future__ import annotations

import importlib.metadata
import os
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from cardan.demos.examples import find_demos

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PYTHONS = ("3.10", "3.11", "3.12", "3.13")
LOCKS = {path.stem: path.read_text(encoding="utf-8") for path in ROOT.glob("locks/*.txt")}
OF_TOOLS = {"make", "uv", "published", "descriptions"}
"""Locks that are not extras: tools of the environment, and files that tests read."""

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
EXTRAS = PROJECT["project"]["optional-dependencies"]
PLUGINS = {
    path.parent.name: tomllib.loads(path.read_text(encoding="utf-8"))["project"]["dependencies"]
    for path in ROOT.glob("plugins/cardan-*/pyproject.toml")
}
"""Dependencies of each plug-in of this repository."""

WRITE = "run `make lock`"


def entries(lock: str) -> Iterator[tuple[Requirement, list[str]]]:
    """Return each package of a lock with its hashes."""
    for entry in re.sub(r"\\\n|^#.*\n", "", LOCKS[lock], flags=re.MULTILINE).splitlines():
        requirement, *hashes = entry.split(" --hash=")
        yield Requirement(requirement), [each.strip() for each in hashes]


def environment(python: str) -> dict[str, str]:
    """Return marker values of a Python version on Linux."""
    return {
        **default_environment(),
        "python_version": python,
        "python_full_version": f"{python}.9",
        "sys_platform": "linux",
        "platform_machine": "x86_64",
    }


def versions(lock: str, variables: dict[str, str]) -> dict[str, str]:
    """Return the packages that a lock installs in such an environment: versions by name."""
    found: dict[str, str] = {}
    for requirement, _ in entries(lock):
        if requirement.marker is None or requirement.marker.evaluate(variables):
            (pin,) = requirement.specifier
            assert pin.operator == "=="
            assert found.setdefault(requirement.name, pin.version) == pin.version, requirement
    return found


def asked_for(extra: str) -> Iterator[Requirement]:
    """Yield the requirements of an extra in pyproject.toml, including those of extras and plug-ins
    that it names."""
    yield from needed_by(EXTRAS[extra])


def needed_by(texts: Iterable[str]) -> Iterator[Requirement]:
    """Yield requirements with extras and plug-ins replaced by their own requirements."""
    for text in texts:
        requirement = Requirement(text)
        if requirement.name == "cardan":
            for other in requirement.extras:
                yield from asked_for(other)
        elif requirement.name in PLUGINS:
            yield from needed_by(PLUGINS[requirement.name])
        else:
            yield requirement


@pytest.mark.parametrize("lock", LOCKS)
def test_each_package_has_hashes_and_no_address(lock):
    assert "://" not in LOCKS[lock]
    assert not re.search(r"^-", LOCKS[lock], re.MULTILINE), "an option of pip"
    for requirement, hashes in entries(lock):
        assert hashes, requirement
        assert requirement.name not in {"cardan", *PLUGINS}, "not on an index"
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", each) for each in hashes), requirement


@pytest.mark.parametrize("python", PYTHONS)
def test_a_package_has_one_version_in_all_locks(python):
    together: dict[str, str] = {}
    for lock in sorted(LOCKS):
        for name, version in versions(lock, environment(python)).items():
            assert together.setdefault(name, version) == version, f"{name} in {lock}: {WRITE}"


@pytest.mark.parametrize("python", PYTHONS)
@pytest.mark.parametrize("extra", sorted(LOCKS.keys() - OF_TOOLS))
def test_a_lock_has_what_its_extra_asks_for(extra, python):
    variables = environment(python)
    locked = versions(extra, variables)
    base = map(Requirement, PROJECT["project"]["dependencies"])
    for requirement in (*base, *asked_for(extra)):
        if requirement.marker is None or requirement.marker.evaluate(variables):
            version = locked.get(canonicalize_name(requirement.name))
            assert version is not None, f"{requirement} is not in locks/{extra}.txt: {WRITE}"
            assert requirement.specifier.contains(version, prereleases=True), (
                f"locks/{extra}.txt has {version}, and {requirement} is asked for: {WRITE}"
            )


def test_what_builds_cardan_is_locked():
    locked = versions("make", environment("3.10"))
    for requirement in map(Requirement, PROJECT["build-system"]["requires"]):
        assert requirement.specifier.contains(locked[requirement.name]), WRITE


def test_what_demos_need_is_locked():
    needed = {extra for demo in find_demos().values() for extra in demo.extras}
    assert needed <= LOCKS.keys()
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    (listed,) = re.findall(r"^DEMO_LOCKS := (.*)$", makefile, re.MULTILINE)
    assert needed == set(listed.split())


def test_this_environment_is_the_locked_one():
    made = Path(sys.prefix)
    if not (made / ".cardan-dev").exists():
        pytest.skip("this environment is not one that make test made")
    if (made / ".newest").exists():
        pytest.skip("NEWEST=1 made this environment")
    variables = {**default_environment(), "extra": ""}
    locked = {
        name: version for lock in LOCKS for name, version in versions(lock, variables).items()
    }
    here = {
        canonicalize_name(each.name): each.version for each in importlib.metadata.distributions()
    }
    needed = versions("arm", variables) | versions("dev", variables) | versions("make", variables)
    assert here.items() >= needed.items()
    differ = {name for name in here.keys() & locked.keys() if here[name] != locked[name]}
    assert not differ


@pytest.mark.parametrize("installer", ["uv", "pip"])
def test_what_is_installed_is_said_with_its_size_before_and_progress_is_shown(tmp_path, installer):
    """Downloads take most of `make demo`'s time."""
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in ("python", "uv"):
        program = programs / name
        program.write_text(f'#!/bin/sh\necho "{name} $*"\n', "utf-8")
        program.chmod(0o755)
    said = subprocess.run(
        [ROOT / "tools/install", tmp_path, "--editable", "arm", "network"],
        cwd=ROOT,
        env={"PATH": os.defpath, "INSTALLER": installer},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    table = (ROOT / "docs/installing.md").read_text(encoding="utf-8")
    (size,) = re.findall(r"^\| `cardan\[arm\]` \| (\d+ MB) \|", table, re.MULTILINE)
    arm, network, packages, cardan, _ = said
    assert arm == f"installing into {tmp_path} what is for 'arm', {size}, as locks/arm.txt has it"
    assert network.startswith(f"installing into {tmp_path} what is for 'network'")
    assert "-r locks/arm.txt -r locks/network.txt" in packages
    assert "--quiet" not in packages
    assert cardan == f"installing Cardan, its studies and plug-ins into {tmp_path}"
    assert {packages.split()[0]} == {"uv" if installer == "uv" else "python"}
