"""What `--help` shows at 80 columns: all of it, in groups, each command on a line of its own."""

import inspect
import re

import pytest
from typer.testing import CliRunner

from cardan.cli import app
from cardan.cli.installed import GROUPS
from tests.command_line import the_command_line

COLUMNS = {"COLUMNS": "80", "TERMINAL_WIDTH": "80", "NO_COLOR": "1", "TERM": "dumb"}


def shown(*words):
    """The help of a command."""
    result = CliRunner().invoke(app, [*words, "--help"], env=COLUMNS)
    assert result.exit_code == 0, result.output
    return result.output


def test_each_command_is_on_a_line_of_its_own_in_its_group():
    group, found = "", {}
    for line in shown().splitlines():
        assert len(line) <= 80
        if line.startswith("╭─"):
            group = line.strip("╭─╮ ")
        elif group not in ("", "Options") and line.startswith("│ "):
            name, _, said = line.strip("│ ").partition(" ")
            assert said.strip(), f"it goes on in another line: {line}"
            found[name] = group
    assert list(found) == the_command_line().list_commands(None)
    assert list(dict.fromkeys(found.values())) == list(GROUPS)
    for each, names in GROUPS.items():
        assert [name for name in found if found[name] == each] == names.split()


def plain(text):
    """Without frames, and with one blank between words."""
    return " ".join(re.sub(r"[│╭╮╰╯─]", " ", text).split())


@pytest.mark.parametrize("name", the_command_line().list_commands(None))
def test_the_help_of_a_command_has_all_that_is_written_of_it(name):
    command = the_command_line().get_command(None, name)
    text = plain(shown(name))
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        assert plain(re.sub(r"\\(\[)", r"\1", paragraph)) in text
    for parameter in command.params:
        if parameter.param_type_name == "option" and not parameter.hidden:
            # A very long one is broken at the column's width.
            assert any(each[:18] in text for each in (*parameter.opts, *parameter.secondary_opts))
