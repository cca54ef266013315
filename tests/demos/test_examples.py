"""Example files: each one that needs no hardware states its commands, and these work."""

import re
import shlex
import socket
from pathlib import Path

import pytest
import typer.main

from cardan.common.tables import as_table, as_toml, read_toml
from cardan.demos import examples
from cardan.demos.examples import (
    example_files,
    find_demos,
    free_ports,
    read_demo,
)
from cardan.errors import ConfigurationError
from cardan.gateway.daemon.config import read_daemon_config
from cardan.gateway.session.config import parse_config
from tests.command_line import the_command_line

EXAMPLES = Path(__file__).parents[2] / "examples"
DEMOS = find_demos()
RUNS = re.compile(r"(?:daemon )?run (examples/|\S+-simulated\.toml)")
NO_DEMO = {
    # Needs a client that simulates nothing: a program that commands the arm.
    "verbs-ur5-simulated.toml",
}


def test_every_example_without_hardware_is_a_demo():
    files = [file.name for file in EXAMPLES.glob("*-simulated.toml")]
    assert {file for file in files if read_demo(EXAMPLES / file) is None} == NO_DEMO
    assert {"gofa", "gp8", "ur5e"} <= set(DEMOS)
    ours = {file for file in example_files() if file.parent == EXAMPLES}
    assert ours == set(EXAMPLES.glob("*.toml"))


@pytest.mark.parametrize("name", DEMOS)
def test_a_demo_is_a_configuration_and_commands_that_are_allowed(name, tmp_path):
    demo = DEMOS[name]
    tables, launches = demo.prepare(tmp_path)
    if demo.is_lab:
        file = tmp_path / "lab.toml"
        file.write_text(as_toml(tables), encoding="utf-8")
        assert read_toml(file) == tables
        assert len(read_daemon_config([file]).sessions) == 4
    else:
        config = parse_config(tables)
        assert config == parse_config(as_table(config))
    if demo.launcher:
        launches.append([*shlex.split(demo.launcher), "--seconds", "1", "--", "program"])
    for words in launches:
        command = the_command_line()
        while hasattr(command, "commands"):
            command = command.get_command(typer.Context(command), words.pop(0))
        command.make_context(name, words)


@pytest.mark.parametrize("name", DEMOS)
def test_the_head_of_a_demo_says_the_same_commands(name):
    demo = DEMOS[name]
    text = demo.file.read_text(encoding="utf-8")
    assert f": cardan demo {name}\n" in text
    head = re.findall(r"^#   cardan (.*)$", text, re.MULTILINE)
    head = head[: next(at for at, line in enumerate(head) if RUNS.search(line)) + 1]
    by_hand = [shlex.split(line.partition(" -- ")[0]) for line in head if not RUNS.match(line)]
    launched = [shlex.split(line) for line in (*demo.launch, demo.launcher) if line]
    assert sorted(map(called, by_hand)) == sorted(map(called, launched))
    for words in by_hand:
        given = [flags(each) for each in launched if called(each) == called(words)]
        for flag, value in flags(words).items():
            if flag != "--keyboard":  # a person's input, in place of a script
                assert any("{" in each[flag] or each[flag] == value for each in given)


def called(words):
    """Return the command without its options."""
    return words[: 1 if words[0] == "run" else 2]


def flags(words):
    """Return the options of a command with the word after each; empty if that is an option."""
    return {
        word: "" if after.startswith("--") else after
        for word, after in zip(words, [*words[1:], "--"], strict=True)
        if word.startswith("--")
    }


def demo_file(folder, block, name="toaster-simulated.toml"):
    file = folder / name
    lines = "".join(f"# {line}\n" for line in block.splitlines())
    file.write_text(
        f'# A toaster.\n\n# /// demo\n{lines}# ///\n\n[device]\ndriver = "toaster"\npath = "slot"\n'
        "slots = 2\n"
    )
    return file


SAID = 'description = "bread"\nsuccess_message = "toast"\n'


def test_a_demo_is_named_as_its_file(tmp_path):
    demo = read_demo(demo_file(tmp_path, SAID))
    assert (demo.name, demo.launch, demo.shortest_s) == ("toaster", (), 3.0)
    assert read_demo(demo_file(tmp_path, SAID + 'name = "hot"')).name == "hot"


def test_keys_become_files_and_ports_of_the_demos_own(tmp_path):
    block = SAID + (
        'launch = ["sim toaster --at {device.path}:{device.port} --bread {examples}/bread"]\n'
        'files = ["device.path"]\nports = ["device.port", "device.other_port"]'
    )
    tables, (words,) = read_demo(demo_file(tmp_path, block)).prepare(tmp_path / "own")
    port = tables["device"]["port"]
    assert tables["device"]["path"] == str(tmp_path / "own" / "slot")
    assert tables["device"]["other_port"] == port + 1
    assert words == [
        *("sim", "toaster", "--at", f"{tmp_path}/own/slot:{port}"),
        *("--bread", f"{tmp_path}/bread"),
    ]


def test_the_port_of_an_endpoint_becomes_one_of_the_demos_own(tmp_path):
    block = SAID + 'launch = ["sim toaster {network.router}"]\nports = ["network.router"]'
    file = demo_file(tmp_path, block)
    with file.open("a", encoding="utf-8") as tables:
        tables.write('\n[network]\nrouter = "tcp/127.0.0.1:7447"\n')
    tables, (words,) = read_demo(file).prepare(tmp_path)
    assert re.fullmatch(r"tcp/127\.0\.0\.1:\d{4,5}", tables["network"]["router"])
    assert tables["network"]["router"] != "tcp/127.0.0.1:7447"
    assert words[-1] == tables["network"]["router"]


@pytest.mark.parametrize(
    ("block", "words"),
    [
        (SAID + 'servers = ["page"]', "demo.servers: .*page.* is not allowed; .*rosbridge"),
        ("description = bread", "toaster-simulated.toml: demo:1:15: is not TOML"),
        (
            SAID + 'lunch = ["sim toaster"]',
            "demo.lunch: there is no such key; .*did you mean 'launch'",
        ),
        ('description = "bread"', "demo.success_message: is missing"),
        (SAID + 'launch = "sim toaster"', "demo.launch: .*must be several values"),
        (SAID + 'ports = ["robot.port"]', r"demo: 'robot.port': there is no \[robot\]"),
        (SAID + 'launch = ["sim {device.plug}"]', "demo.launch: no key 'device.plug'"),
        (SAID + 'launch = ["sim \'arm"]', "demo.launch: .* words as in a shell"),
        (SAID + 'launch = [""]', "demo.launch: '' is not allowed"),
        (SAID + 'launcher = "sim \'arm"', "demo.launcher: .* words as in a shell"),
        (SAID + 'files = ["device"]', "demo.files: device is .*; it must be a path"),
        (SAID + 'files = ["device.slots"]', "demo.files: device.slots is 2; it must be a path"),
        (SAID + 'ports = ["device"]', "demo.ports: device is .*; it must be a port"),
        (SAID + 'ports = ["device.path"]', "demo.ports: device.path is 'slot'; it must be a port"),
    ],
)
def test_a_wrong_block_is_refused_with_its_key(tmp_path, block, words):
    file = demo_file(tmp_path, block)
    with pytest.raises(ConfigurationError, match=words):
        read_demo(file).prepare(tmp_path)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match=r"cannot read .*none\.toml"):
        read_demo(tmp_path / "none.toml")


def test_free_ports_are_free():
    first = free_ports(3)
    for port in range(first, first + 3):
        for kind in (socket.SOCK_STREAM, socket.SOCK_DGRAM):
            with socket.socket(socket.AF_INET, kind) as probe:
                probe.bind(("127.0.0.1", port))


def test_a_broken_example_leaves_the_others(tmp_path, monkeypatch, caplog):
    good = demo_file(tmp_path, SAID)
    broken = tmp_path / "broken.toml"
    broken.write_bytes(b"\xff\xfe")
    monkeypatch.setattr(examples, "example_files", lambda: [broken, good])
    assert list(find_demos()) == ["toaster"]
    assert f"example left out: cannot read {broken}" in caplog.text


@pytest.mark.parametrize("source_tree", [True, False])
def test_only_a_source_tree_has_examples_beside_the_package(tmp_path, monkeypatch, source_tree):
    site = tmp_path / "site-packages"
    for folder in ("bread_package", "examples"):
        (site / folder).mkdir(parents=True)
    (site / "bread_package" / "__init__.py").touch()
    file = demo_file(site / "examples", SAID)
    if source_tree:
        (site / "pyproject.toml").touch()
    monkeypatch.syspath_prepend(site)
    monkeypatch.setattr(examples.registry, "packages", lambda: ("bread_package",))
    assert example_files() == ([file] if source_tree else [])
