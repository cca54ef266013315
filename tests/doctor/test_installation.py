"""Findings about packages, extras and plug-ins."""

import pytest

from cardan.common.plugins import Loaded
from cardan.doctor.base import Subject
from cardan.doctor.files import read_files
from cardan.doctor.installation import (
    PackageRequirement,
    Packages,
    PlugIns,
    check_packages,
    check_plug_ins,
    lacking,
    needed_extras,
    own_requirements,
    read_requirements,
)
from tests.doctor.levels_and_codes import levels_and_codes

METADATA = [
    "hidapi>=0.14",
    "typer<0.29,>=0.12",
    "tomli>=2.0; python_version < '3.11'",
    'coal>=3.0; extra == "arm"',
    'eclipse-zenoh>=1.2; extra == "network"',
    'cardan[network]; extra == "record"',
    "mcap>=1.6 ; extra == 'record'",
    'plain; extra == "can"',
    "name @ https://example.org/x.whl",
]
VERSIONS = {
    "hidapi": "0.14.0.post4",
    "typer": "0.28.0",
    "coal": "3.0",
    "eclipse-zenoh": "1.2.0",
    "mcap": "1.6.1",
}


def requirements(python=(3, 12)):
    return read_requirements(METADATA, python)


def test_requirements_as_metadata_have_them():
    assert requirements() == [
        PackageRequirement("hidapi", (), ""),
        PackageRequirement("typer", (), ""),
        PackageRequirement("coal", (), "arm"),
        PackageRequirement("eclipse-zenoh", (), "network"),
        PackageRequirement("cardan", ("network",), "record"),
        PackageRequirement("mcap", (), "record"),
        PackageRequirement("plain", (), "can"),
    ]
    assert PackageRequirement("tomli", (), "") in requirements((3, 10))


def test_our_own_metadata_is_understood():
    own = own_requirements()
    assert {"hidapi", "typer", "rich"} <= {each.name for each in own if not each.extra}
    assert {"arm", "network", "can"} <= {each.extra for each in own}


@pytest.mark.parametrize(
    ("extra", "versions", "missing"),
    [
        ("", VERSIONS, []),
        ("", {"typer": "0.12"}, ["hidapi is missing"]),
        ("arm", {}, ["coal is missing"]),
        ("record", {"mcap": "1.10"}, ["eclipse-zenoh is missing"]),
        ("record", {"mcap": "1.10", "eclipse-zenoh": "1.10"}, []),
        ("can", {"plain": "any"}, []),
        ("foxglove", {}, []),
    ],
)
def test_what_an_extra_lacks(extra, versions, missing):
    assert lacking(requirements(), extra, versions.get) == missing


def test_all_that_is_needed_is_there():
    found = list(check_packages(requirements(), {"arm": "[arm] of x"}, VERSIONS.get))
    assert levels_and_codes(Packages, found) == [("good", "package"), ("good", "extra")]
    assert found[1].what.endswith("; without can, which nothing here needs")


def test_an_extra_that_a_file_needs():
    found = list(check_packages(requirements(), {"can": "device 'jr3_can' of x"}, {}.get))
    assert levels_and_codes(Packages, found) == [
        ("failure", "package"),
        ("failure", "extra"),
        ("good", "extra"),
    ]
    assert found[0].mend == "pip install --upgrade cardan"
    assert found[1].why == "device 'jr3_can' of x needs it"
    assert found[1].mend == 'pip install "cardan[can]"'


def test_extras_by_what_files_say(tmp_path):
    file = tmp_path / "lab.toml"
    file.write_text(
        """
[[sessions]]
name = "one"
robot = { driver = "sim_arm", robot = "ur5" }
[sessions.arm]
model = "ur5"
[sessions.network]
[[sessions]]
name = "two"
device = { driver = "jr3_can", channel = "can0" }
robot = { driver = "abb_egm" }
"""
    )
    config, _ = read_files([file])
    needed = needed_extras(Subject((file,), config))
    assert needed["arm"] == "[arm] of one"
    assert needed["network"] == "[network] of one"


def test_plug_ins():
    loaded = Loaded({}, {"lever": "cannot be loaded: no lever"}, ["driver 'a' is b; c is not used"])
    found = list(check_plug_ins([("driver", loaded)]))
    assert levels_and_codes(PlugIns, found) == [("failure", "plug-in"), ("caution", "plug-in")]
    assert found[0].what == "driver 'lever' cannot be loaded: no lever"
    assert levels_and_codes(PlugIns, check_plug_ins([("server", Loaded({}, {}, []))])) == [
        ("good", "plug-in")
    ]


def test_what_an_extra_brings_is_no_failure_without_it():
    loaded = Loaded({}, {"rosbridge": "cannot be loaded: ..."}, [], {"rosbridge": "network"})
    found = list(check_plug_ins([("server", loaded)]))
    assert levels_and_codes(PlugIns, found) == [("good", "plug-in"), ("good", "plug-in")]
    assert found[0].what == "not installed: pip install \"cardan[network]\" for server 'rosbridge'"


def test_here():
    for check in (Packages, PlugIns):
        assert {level for level, _ in levels_and_codes(check, check.look(Subject()))} <= {
            "good",
            "caution",
        }
