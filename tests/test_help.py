"""Output of `--help` at 80 columns: complete, in sections, each command on its own line."""

import inspect
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cardan.cli import app
from cardan.cli.examples import EXAMPLES
from cardan.cli.installed import SECTIONS, TOP
from cardan.cli.moved import MOVED, now_called
from cardan.cli.options_from_dataclass import all_given, collected, made
from cardan.cli.server import check_words
from cardan.errors import ConfigurationError
from cardan.gateway.servers import registry as servers
from cardan.sim_peers import registry as peers
from cardan.sim_peers.base import parse_faults
from tests.command_line import the_command_line

COLUMNS = {"COLUMNS": "80", "NO_COLOR": "1", "TERM": "dumb"}
ROOT = Path(__file__).parent.parent


def found(words):
    """Return the command with these words."""
    command = the_command_line()
    for word in words:
        command = command.get_command(None, word)
    return command


def all_commands(command, *words):
    yield words
    if hasattr(command, "list_commands"):
        for name in command.list_commands(None):
            yield from all_commands(command.get_command(None, name), *words, name)


COMMANDS = list(all_commands(the_command_line()))


def shown(*words):
    """Return the help of a command."""
    result = CliRunner().invoke(app, [*words, "--help"], env=COLUMNS, prog_name="cardan")
    assert result.exit_code == 0, result.output
    return result.output


def listed_in(group):
    """Return the subcommands that its help should list."""
    return [name for name in group.list_commands(None) if not group.get_command(None, name).hidden]


def test_the_top_is_one_screen_of_twelve_commands():
    text = shown()
    assert len(listed_in(the_command_line())) <= 12
    assert "`cardan explain CODE`" in plain(text)
    assert len(text.splitlines()) <= 30


@pytest.mark.parametrize("group", SECTIONS)
def test_each_command_is_on_a_line_of_its_own_in_its_section(group):
    words = () if group == TOP else (group,)
    section, listed = "", {}
    for line in shown(*words).splitlines():
        assert len(line) <= 80
        if re.fullmatch(r"\S.*:", line):
            section = line.removesuffix(":")
        elif section not in ("", "Options") and line.strip():
            name, _, said = line.removeprefix("  ").partition(" ")
            assert name, f"continued on another line: {line}"
            assert said.strip(), f"continued on another line: {line}"
            listed[name] = section
    assert list(listed) == listed_in(found(words))
    assert list(dict.fromkeys(listed.values())) == list(SECTIONS[group])
    for each, names in SECTIONS[group].items():
        assert [name for name in listed if listed[name] == each] == names.split()


def plain(text):
    """Reduce whitespace to single blanks."""
    return " ".join(text.split())


def in_lines_of(text, width):
    """Remove all blanks: a word longer than a line is broken."""
    assert max(map(len, text.splitlines())) <= width
    return "".join(text.split())


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_the_help_of_a_command_has_all_that_is_written_of_it(words):
    command = found(words)
    text = shown(*words)
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        assert plain(paragraph) in plain(text)
    rest = in_lines_of(text, 80)
    parameters = command.get_params(command.make_context("", [], resilient_parsing=True))
    # Arguments are in a section above the options.
    for parameter in sorted(parameters, key=lambda each: each.param_type_name == "option"):
        if not getattr(parameter, "hidden", False):
            for name in (*parameter.opts, *parameter.secondary_opts):
                assert parameter.param_type_name == "argument" or name in rest
            said = "".join((getattr(parameter, "help", None) or "").split())
            assert said, f"{parameter.opts} has no help text"
            _, is_there, rest = rest.partition(said)
            assert is_there, f"{parameter.opts}: {parameter.help}"


def is_of_a_registry(words):
    return words[:-1] in (("sim",), ("net", "server"))


def is_ours(words):
    """Return whether a command is Cardan's own: commands of a missing package have other texts."""
    module = getattr(found(words).callback, "__module__", "")
    return module.startswith("cardan.cli") and module != "cardan.cli.options_from_dataclass"


SINGLE = [words for words in COMMANDS if not hasattr(found(words), "list_commands")]
OURS = [words for words in SINGLE if is_ours(words) or " ".join((TOP, *words)[-2:]) in EXAMPLES]


def example_of(words):
    if words[0] == "sim":
        return f"cardan sim {words[-1]} {peers.load(words[-1]).example}".strip()
    if is_of_a_registry(words):
        return f"cardan net server {words[-1]} {servers.load(words[-1]).example}".strip()
    return EXAMPLES[" ".join((TOP, *words)[-2:])]


@pytest.mark.parametrize("words", OURS, ids=" ".join)
def test_the_help_of_a_command_ends_with_an_example_that_it_takes(words):
    example = example_of(words)
    assert f"Example: {example} Exit codes: 0 success;" in plain(shown(*words))
    typed = shlex.split(example.removeprefix("sudo ").partition(" | ")[0])
    assert typed[: len(words) + 1] == ["cardan", *words]
    typed = typed[len(words) + 1 :]
    assert typed or not is_of_a_registry(words)
    if is_of_a_registry(words) and words[0] != "sim":
        check_words(words[-1], typed)
        return
    with found(words).make_context(words[-1], typed) as context:
        given = context.params
    if words[0] == "sim":
        peer = peers.load(words[-1])
        own = {each.field.name: each for each in all_given(peer.Options)}
        made(peer.Options, collected(own, {name: given[name] for name in own}))
        parse_faults(given.get("faults") or (), peer.faults)
        assert given.get("script") in (None, *peer.scripts)


def test_no_example_is_left_over():
    assert {" ".join((TOP, *words)[-2:]) for words in OURS} >= EXAMPLES.keys()


@pytest.mark.parametrize("old", MOVED)
def test_an_old_name_is_answered_by_the_new_one(old):
    for words in ((old,), (old, "--help"), (old, "x", "-v")):
        with pytest.raises(ConfigurationError) as raised:
            the_command_line()([*words], standalone_mode=False)
        typed = " ".join((MOVED[old], *words[1:]))
        said = f"command: `cardan {old}` is now `cardan {MOVED[old]}`: type `cardan {typed}`"
        assert str(raised.value).startswith(said), raised.value
    assert found(MOVED[old].split()) is not None
    assert old not in the_command_line().list_commands(None)


def test_of_a_unit_that_has_the_old_name_it_says_what_to_do():
    assert "`cardan daemon service install FILE...`" in now_called(["serve"])
    assert now_called(["run"]) == ""


def test_an_old_name_below_a_group_is_answered_too():
    with pytest.raises(ConfigurationError, match="type `cardan net server rosbridge`"):
        the_command_line()(["net", "face", "rosbridge"], standalone_mode=False)
    assert now_called(["serve"], "devices") == ""


OLD = "|".join(sorted(MOVED, key=len, reverse=True))
TYPED = re.compile(
    # Commands after `cardan`, across line ends and string ends, and as lists of words.
    rf"""(?<![\w./@-])cardan(?:\ +|\ ?"?\n[ #*>]*f?"?)({OLD})(?![\w/=(]|-\w|\.\w)"""
    rf"""|(?:"cardan",|\*CARDAN,|parent_death",\ "","""
    rf"""|\b(?:CardanSubprocess|Program|cardan_subprocess|served)\()"""
    rf"""\s*"({OLD})\"""",
    re.VERBOSE,
)
TEXTS = "**/*.py", "**/*.md", "**/*.toml", "**/*.ts", "**/*.svg", "**/*.sh", "**/*.yml", "Makefile"
OF_NO_TEXT = {"CHANGELOG.md", "tests/test_help.py"}
OF_OLD_UNITS = {"tests/doctor/test_daemon.py"}


def texts():
    """Yield the files of the source tree that users read or that start the command."""
    folders = (
        "cardan",
        "docs",
        "examples",
        "plugins",
        "tests",
        "bench",
        "studies",
        "console",
        "tools",
    )
    paths = [path for of in folders for each in TEXTS for path in (ROOT / of).glob(each)]
    paths += [path for each in TEXTS for path in ROOT.glob(each.removeprefix("**/"))]
    for path in paths:
        name = path.relative_to(ROOT).as_posix()
        if name not in OF_NO_TEXT and not re.search("node_modules|/(build|dist|site)/", name):
            yield name, path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "has"),
    [
        ("run `cardan serve lab.toml`", True),
        ("run `cardan\n    serve lab.toml`", True),
        ('"run `cardan "\n    "serve lab.toml`"', True),
        ('["cardan", "serve"]', True),
        ('CardanSubprocess(\n    "serve", file)', True),
        ('[*CARDAN, "face", *words]', True),
        ("`cardan daemon run`, `cardan daemon log`, cardan.log, cardan.record(", False),
    ],
)
def test_old_names_are_found(text, has):
    assert bool(TYPED.search(text)) is has


def test_no_text_has_an_old_name():
    seen, old = 0, []
    for name, text in texts():
        seen += 1
        found = [each[0] for each in TYPED.finditer(text)]
        if name in OF_OLD_UNITS:
            found.remove("cardan serve")
        old += [f"{name}: {each!r}" for each in found]
    assert seen > 500
    assert old == []
