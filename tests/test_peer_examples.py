"""Programs of examples/peers print the output that they announce."""

from __future__ import annotations

import ast
import runpy
import textwrap

import pytest

from tests.docs_tables import ROOT

PROGRAMS = sorted((ROOT / "examples" / "peers").glob("*.py"))


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda path: path.stem)
def test_it_prints_what_it_says(program, capsys):
    about = ast.get_docstring(ast.parse(program.read_text("utf-8")), clean=False)
    runpy.run_path(str(program))
    printed = textwrap.indent(capsys.readouterr().out, "    ")
    assert printed
    assert f"It prints:\n\n{printed}" in f"{about}"
