"""User documentation compared with the code: complete, with right defaults and without dead
links."""

from __future__ import annotations

import ast
import dataclasses
import functools
import re
import sys
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints
from xml.etree import ElementTree

import pytest

from cardan import cli
from cardan.cli.common import page_path
from cardan.common.bounds import Range
from cardan.common.options import hints
from cardan.common.tables import keys_of, read_table
from cardan.common.troubles import coded
from cardan.demos.examples import Demo
from cardan.drivers import registry
from cardan.drivers.abb_egm import AbbEgmOptions, EgmSession
from cardan.drivers.base import OperatorDevice
from cardan.drivers.spacemouse import SpaceMouseCore, SpaceMouseOptions
from cardan.errors import ConfigurationError
from cardan.gateway.daemon.config import read_daemon_config
from cardan.gateway.session import assembly, config
from cardan.gateway.session.driver_assembly import make_device
from cardan.protocols.connexion import devices as connexion_devices, reports
from cardan.protocols.egm import decode, encode, replies
from cardan.protocols.egm.decode import decode_robot
from cardan.protocols.egm.messages import Fault, MCIState
from cardan.protocols.egm.replies import encode_pose_reply
from cardan.protocols.simple_message.codec import wire
from cardan.protocols.simple_message.codes import (
    InvalidSubcode,
    IoResult,
    MessageType,
    MotionCommand,
    NotReadySubcode,
)
from cardan.protocols.simple_message.messages import (
    ZEROS,
    JointVelocity,
    MotionCtrl,
    MotionReply,
    joints10,
    reply,
    request,
    topic,
)
from cardan.sim_peers import registry as peers
from cardan.types import Pose, Quaternion, Vector3
from cardan_filters.camera import CameraOptions
from cardan_filters.proximity import ProximityOptions
from cardan_serial_mice.peer import SERIAL_FAULTS
from tests import site_tables
from tests.command_line import the_command_line
from tests.docs_tables import ours
from tests.ranges import ranges
from tests.tutorials import steps

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *ROOT.glob("plugins/*/README.md")]
)


def kinds(hint: Any) -> list[type[Any]]:
    """Return the tables behind an annotation: one, or the variants of a tagged union."""
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return [hint]
    return [kind for each in get_args(hint) for kind in kinds(each)]


TABLES = {
    name: kinds(hint)
    for name, hint in hints(config.SessionConfig).items()
    if name not in ("RENAMED", "device", "robot", "filters")
}


@functools.cache
def text(name: str) -> str:
    """Return the text of a page, relative to docs/, with the site's tables."""
    return site_tables.read(page_path(name))


def section(page: str, heading: str) -> str:
    """Return the text under `heading`, including its subsections."""
    found = re.search(rf"^(#+) {re.escape(heading)}\n", page, re.MULTILINE)
    assert found, f"there is no heading {heading!r}"
    rest = page[found.end() :]
    end = re.search(rf"^#{{1,{len(found[1])}}} ", rest, re.MULTILINE)
    return rest[: end.start()] if end else rest


def rows(markdown: str) -> dict[str, list[str]]:
    """Return table rows by the first code word of their first cell, as lists of the other cells."""
    found = {}
    for line in markdown.splitlines():
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        for word in re.findall(r"`([^`]+)`", cells[0]) if cells else ():
            found[word.replace("\\|", "|")] = cells[1:]
    return found


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"^ *```{language}\n(.*?)^ *```$", page, re.MULTILINE | re.DOTALL)


def written(default: Any) -> str:
    """Return a default in the tables' form."""
    if default is None:
        return "none"
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, dict):
        return f"`{default}`"
    if isinstance(default, (tuple, list)):
        items = (f'"{i}"' if isinstance(i, str) else str(i) for i in default)
        return f"`[{', '.join(items)}]`"
    if isinstance(default, float):
        return str(round(default, 12))
    return f'`"{default}"`' if isinstance(default, str) else str(default)


TAGS = {"force": "source", "fixtures": "shape"}
SEVERAL_DEFAULTS = {"force": {"sense"}, "fixtures": {"point_m", "damping_n_s_m"}}
"""Keys whose default depends on the source or shape: the pages name each."""


def default_of(field: dataclasses.Field[Any]) -> str:
    """Return the default of a key in the tables' form."""
    if field.default_factory is not dataclasses.MISSING:
        return written(field.default_factory())
    if field.default is dataclasses.MISSING:
        return "must be given"
    return written(getattr(field.default, "value", field.default))


DRIVER_PAGES = [
    pytest.param(driver.page, driver.Options, id=name) for name, driver in ours(registry).items()
]


OPTIONS_OF = {driver.Options: name for name, driver in ours(registry).items()}


def options_table(page, options):
    """Return the table of a driver's options; on a page that drivers share, with the driver's own
    section."""
    reported = section(text(page), "Options")
    own = f"Options of `{OPTIONS_OF.get(options)}`"
    shared, *_ = re.split(r"^### Options of ", reported, flags=re.MULTILINE)
    return rows(shared) | (rows(section(reported, own)) if f"# {own}\n" in reported else {})


@pytest.mark.parametrize(("page", "options"), DRIVER_PAGES)
def test_every_driver_option_is_there_with_its_default(page, options):
    table = options_table(page, options)
    defaults = {field.name: written(field.default) for field in dataclasses.fields(options)}
    assert {name: table[name][0] for name in defaults} == defaults
    assert set(table) >= set(defaults)


@pytest.mark.parametrize("name", TABLES)
def test_every_configuration_key_is_there_with_its_default(name):
    page = text("configuration.md")
    heading = f"`[{name}]`" if f"## `[{name}]`" in page else f"`[[{name}]]`"
    table = rows(section(page, heading))
    reported = {key: cells[0] for key, cells in table.items()}
    defaults: dict[str, set[str]] = {}
    for kind in TABLES[name]:
        for key, field in keys_of(kind).items():
            defaults.setdefault(key, set()).add(default_of(field))
    if len(TABLES[name]) > 1:
        assert reported.pop(TAGS[name]) in {"must be given", *defaults.pop(TAGS[name])}
    assert {key for key, found in defaults.items() if len(found) > 1} == SEVERAL_DEFAULTS.get(
        name, set()
    )
    assert reported.keys() == defaults.keys()
    for key, found in defaults.items():
        assert (
            reported[key] in found
            if len(found) == 1
            else all(each in reported[key] for each in found)
        )


@pytest.mark.parametrize(
    "tables",
    [
        {"watchdogs": {"device_ag_s": 0.1}},
        {"limits": {"linear_speed_m_s": -1}},
        {"limits": {"workspace_x_m": [0.7, 0.3]}},
        {"mapping": {"axes": ["x", "y", "z", "rx", "ry", "rw"]}},
        {"mapping": {"frame": "tol"}},
        {"fixtures": [{"shape": "viscous", "damping_n_s_m": 2.0, "at": "start"}]},
        {"force": {"source": "remote"}},
        {"device": {"driver": "spacemouse", "dead_zone": 1.5}},
        {"filters": [{"filter": "camera"}, {"filter": "proximity", "alert_low": 900}]},
    ],
)
def test_errors_are_as_the_page_shows_them(tables):
    drivers = {"device": {"driver": "spacemouse"}, "robot": {"driver": "abb_egm"}}

    def make() -> None:
        parsed = config.parse_config({**drivers, **tables})
        make_device(parsed)
        assembly.make_filters(parsed)

    with pytest.raises(ConfigurationError) as caught:
        make()
    shown = re.sub(r"^cardan: cell\.toml:\d+:1: ", "cardan: ", text("configuration.md"), flags=re.M)
    assert coded(f"cardan: {caught.value}") in shown.splitlines()


@pytest.mark.parametrize(("page", "options"), DRIVER_PAGES)
def test_every_choice_of_an_option_is_there(page, options):
    table = options_table(page, options)
    choices = {
        name: [choice for each in (hint, *get_args(hint)) for choice in literals(each)]
        for name, hint in get_type_hints(options).items()
    }
    missing = {
        name: choice
        for name, allowed in choices.items()
        for choice in allowed
        if written(choice).strip("`") not in " | ".join(table[name])
    }
    assert missing == {}


def literals(hint: Any) -> tuple[Any, ...]:
    """Return the values of a Literal; empty for other types."""
    return get_args(hint) if get_origin(hint) is Literal else ()


def said(bounds: Range) -> str:
    """Return a range in the pages' form, without the unit and the meaning of 0, which are elsewhere
    in the row."""
    return str(dataclasses.replace(bounds, zero="", unit=""))


@pytest.mark.parametrize(
    ("page", "options"),
    [
        *DRIVER_PAGES,
        ("../plugins/cardan-filters/README.md", ProximityOptions),
        ("../plugins/cardan-filters/README.md", CameraOptions),
    ],
)
def test_every_range_of_an_option_is_there(page, options):
    heading = {ProximityOptions: "Proximity", CameraOptions: "Camera"}.get(options)
    table = rows(section(text(page), heading)) if heading else options_table(page, options)
    missing = {
        name: str(bounds)
        for name, bounds in ranges(options).items()
        if said(bounds) not in " | ".join(table[name])
    }
    assert missing == {}


@pytest.mark.parametrize("name", TABLES)
def test_every_range_of_a_configuration_key_is_there(name):
    page = text("configuration.md")
    heading = f"`[{name}]`" if f"## `[{name}]`" in page else f"`[[{name}]]`"
    table = rows(section(page, heading))
    missing = {
        key: str(bounds)
        for kind in TABLES[name]
        for key, bounds in ranges(kind).items()
        if key in keys_of(kind)
        if said(bounds) not in " | ".join(table[key])
    }
    assert missing == {}


def test_every_table_of_the_configuration_has_its_section():
    named = set(
        re.findall(r"`\[+(\w+)\]+`", "".join(re.findall(r"^## .*", text("configuration.md"), re.M)))
    )
    assert named == set(keys_of(config.SessionConfig))
    assert set(TABLES) == named - {"device", "robot", "filters"}


def test_every_key_of_a_demo_is_there_with_its_default():
    table = rows(section(text("adding-a-driver.md"), "Keys of a demo"))
    defaults = {
        name: "must be given" if field.default is dataclasses.MISSING else written(field.default)
        for name, field in keys_of(Demo).items()
    }
    defaults["name"] = "the file's, without `-simulated`"
    assert {name: cells[0] for name, cells in table.items()} == defaults


def test_the_first_of_the_allowed_drivers_are_named():
    reported = re.search(
        r"there is no driver 'spacemous'; allowed: (.*) \[", text("configuration.md")
    )
    assert reported
    *first, more = reported[1].split(", ")
    assert more == "...; did you mean 'spacemouse'?"
    devices = (
        name for name in registry.BUILT_IN if issubclass(registry.load(name), OperatorDevice)
    )
    assert first == sorted(devices)[: len(first)]


def test_every_model_is_there_as_it_is():
    lines = section(text("spacemouse.md"), "Devices").splitlines()
    assert [line for line in lines if line.startswith("|")][2:] == [
        f"| {model.name} | {model.vendor_id:04x}:{model.product_id:04x} | `{model.key}` "
        f"| {model.family.value} | {len(model.buttons) or '–'} "
        f"| {'yes' if model.led else '–'} | {'yes' if model.battery else '–'} |"
        for model in connexion_devices.MODELS
    ]


def test_every_button_name_is_there():
    listed = section(text("spacemouse.md"), "Buttons")
    labels = {label for model in connexion_devices.MODELS for label in model.buttons.values()}
    assert [label for label in labels if not label.isdecimal() and f"`{label}`" not in listed] == []


PEERS = [
    pytest.param(name, peer, id=name)
    for name, peer in ours(peers).items()
    if name != "spacemouse-serial"  # its section is that of the SpaceMouse
]


def peer_section(name: str) -> str:
    """Return the page of a simulated peer from the heading that names its command."""
    page = text(peers.load(name).page)
    heading = re.search(rf"^## (.*`cardan sim {name}`.*)$", page, re.MULTILINE)
    assert heading, f"no heading names `cardan sim {name}`"
    return section(page, heading[1])


@pytest.mark.parametrize(("name", "peer"), PEERS)
def test_every_fault_of_a_peer_is_there_with_its_default(name, peer):
    reported = peer_section(name)
    table = rows(
        section(reported, "Its faults" if "# Its faults\n" in reported else "Their faults")
    )
    switches = {switch.name: f"{switch.default:g}" for switch in peer.faults}
    assert {name: table[name][0] for name in switches} == switches
    assert set(table) >= set(switches)


def test_every_fault_of_a_serial_device_is_there_with_its_default():
    table = rows(section(peer_section("spacemouse"), "Faults of the serial ones"))
    assert {name: cells[0] for name, cells in table.items()} == {
        switch.name: f"{switch.default:g}" for switch in SERIAL_FAULTS
    }


@pytest.mark.parametrize(("name", "peer"), [each for each in PEERS if each.values[1].scripts])
def test_every_script_and_verb_of_a_peer_is_there(name, peer):
    reported = peer_section(name)
    usages = {re.sub(r" \(.*", "", usage) for usage in peer.verbs.values()}
    devices = section(text("simulated-peers.md"), "Scripts of devices")
    shared = set(rows(devices)) if f"`{name}`" in devices.partition("\n|")[0] else {"loop"} & usages
    if "# Its scripts\n" in reported:
        own = set(rows(section(reported, "Its scripts")))
        assert own | shared == {*peer.scripts, *usages}
    else:
        listed = set(rows(section(reported, f"Scripts of the {name}")))
        assert listed - usages == set(peer.scripts)
        assert usages <= set(rows(reported)) | shared


@pytest.mark.parametrize(("name", "peer"), PEERS)
def test_every_option_of_a_peer_is_there(name, peer):
    reported = section(text("simulated-peers.md"), "Options of every peer") + peer_section(name)
    if not peer.scripts:
        reported = re.sub(r"--(list-scripts|script)\b", "", reported)
    commands = the_command_line().commands["sim"].commands
    offered = {
        option
        for each in peers.names()
        if peer_section(each) == peer_section(name)
        for parameter in commands[each].params
        for option in parameter.opts
        if option.startswith("--")
    }
    assert set(re.findall(r"--[a-z][a-z0-9]*(?:-[a-z]+)*", reported)) == offered - {"--help"}


def test_every_metric_is_there():
    table = rows(section(text("abb-egm.md"), "Metrics"))
    assert set(EgmSession(AbbEgmOptions(), 0.0).metrics()) <= set(table)
    page = text("spacemouse.md")
    metrics = SpaceMouseCore(SpaceMouseOptions()).metrics(0.0)
    assert [name for name in metrics if f"`{name}`" not in page] == []


def test_every_exit_code_is_there():
    table = section(text("troubleshooting.md"), "Exit codes")
    codes = [value for name, value in vars(cli).items() if name.startswith("EXIT_")]
    assert [code for code in codes if f"\n| {code} | " not in table] == []


@pytest.mark.parametrize(
    ("page", "protocol"),
    [
        ("abb-egm.md", decode),
        ("abb-egm.md", encode),
        ("abb-egm.md", replies),
        ("spacemouse.md", reports),
    ],
)
def test_every_function_of_a_codec_is_there(page, protocol):
    functions = [name for name in vars(protocol) if re.match(r"(de|en)code_", name)]
    reported = section(text(page), "Functions")
    assert [name for name in functions if f"\n{name}(" not in reported] == []


def test_every_fault_of_a_datagram_is_there():
    assert set(rows(section(text("abb-egm.md"), "Malformed"))) == set(Fault.__members__)


def test_worked_reports_are_what_the_codec_says():
    table = rows(section(text("spacemouse.md"), "Worked bytes"))
    assert len(table) >= 10
    for line in section(text("spacemouse.md"), "Worked bytes").splitlines():
        if found := re.match(r"\| `([0-9a-f ]+)` \| `(.*?)`", line):
            report, value = bytes.fromhex(found[1]), found[2].replace("\\|", "|")
            decode = reports.decode_output if report[0] == 4 else reports.decode_input
            expected = eval(value, vars(reports))
            assert (type(decode(report)), decode(report)) == (type(expected), expected)


def test_worked_datagrams_are_what_the_codec_says():
    page = section(text("abb-egm.md"), "Worked bytes")
    pairs = re.findall(r"^ *((?:[0-9a-f]{2}(?: |$))+)", blocks(page, "")[0], re.MULTILINE)
    answer = bytes.fromhex("".join(pairs))
    pose = Pose(Vector3(0.5975, 0.001, 0.83775), Quaternion(0.5, 0.0, 0.8660254037844386, 0.0))
    assert len(answer) == 81
    assert encode_pose_reply(301, 1214, pose, None) == answer
    names: dict[str, Any] = {}
    exec(blocks(page, "python")[1], names)
    robot = decode_robot(names["data"])
    assert len(names["data"]) == 80
    assert robot.feed_back.joints == (0.0, 0.0, 0.0, 0.0, 0.5235987755982988, 0.0)
    assert robot.mci_state is MCIState.STOPPED
    assert decode_robot(names["data"][:40]).fault is Fault.TRUNCATED


def test_every_number_of_simple_message_is_there():
    page = text("protocols/simple-message.md")
    for codes in (MessageType, MotionCommand, InvalidSubcode, NotReadySubcode):
        missing = [
            code.name
            for code in codes
            if not re.search(rf"\b{code}\b", page) or not re.search(rf"\b{code.name}\b", page)
        ]
        assert set(missing) <= UNSERVED, missing
    for code in IoResult:
        assert f"{code:d} {code.name}" in page


UNSERVED = {
    "JOINT_TRAJ",
    "READ_INPUT",
    "WRITE_OUTPUT",
    "OLD_JOINT_TRAJ_PT_FULL_EX",
    "OLD_JOINT_FEEDBACK_EX",
    "START_RT",
    "STOP_RT",
    "CHECK_TIMEOUT_CNT",
}
"""Values that are defined, but that no message here uses."""


def test_worked_messages_are_what_the_codec_says():
    page = text("protocols/simple-message.md")
    messages = (
        request(MotionCtrl(0, 2, MotionCommand.START_TRAJ_MODE)),
        reply(MotionReply(0, 2, MotionCommand.START_TRAJ_MODE, 0, 0)),
        topic(JointVelocity(0, 5, 5, 1.25, ZEROS, joints10((0.25, -0.1, 0, 0, 0, 0.5)), ZEROS)),
    )
    words = "".join(blocks(section(page, "Worked bytes"), ""))
    assert bytes.fromhex(words) == b"".join(map(wire().encode, messages))
    names: dict[str, Any] = {}
    exec(blocks(page, "python")[0], names)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_snippets_are_programs_and_settings(page, tmp_path, monkeypatch):
    content = page.read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for step in steps(content):  # A setting may name a file on the page.
        if step.file:
            (tmp_path / step.file).write_text(step.text, encoding="utf-8")
    for block in blocks(content, "python"):
        ast.parse(block)
    for block in blocks(content, "toml"):
        table = tomllib.loads(block)
        if "robot" in table:
            options = {key: value for key, value in table["robot"].items() if key != "driver"}
            read_table(registry.load(table["robot"]["driver"]).Options, options, "robot")


@pytest.mark.parametrize(
    "example",
    sorted([*ROOT.glob("examples/*.toml"), *ROOT.glob("plugins/*/*/examples/*.toml")]),
    ids=lambda p: p.name,
)
def test_examples_are_fine(example):
    if "[[sessions]]" in example.read_text("utf-8"):
        read_daemon_config([example])
    else:
        assembly.load_config(example)


def anchors(page: Path) -> set[str]:
    """Return GitHub's anchors of a page's headings."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)]+)\)", site_tables.read(page.relative_to(ROOT).as_posix())):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), target
        if anchor:
            assert anchor in anchors(there), target


@pytest.mark.parametrize(
    "image", sorted((ROOT / "docs" / "images").glob("*.svg")), ids=lambda p: p.name
)
def test_images_are_well_formed_and_named(image):
    root = ElementTree.parse(image).getroot()
    assert root.find("{http://www.w3.org/2000/svg}title").text
