"""The page on shared control against the code."""

import dataclasses
from pathlib import Path

import pytest

from cardan.gateway.operator.filters import TwistFilter, registry
from cardan.gateway.operator.filters.readings import decode_proximity
from cardan.gateway.session.assembly import load_config, make_filters
from tests.test_docs import blocks, rows, section, text, written

EXAMPLE = Path(__file__).parents[4] / "examples" / "shared-control-simulated.toml"


@pytest.mark.parametrize("name", registry.BUILT_IN)
def test_every_option_is_there_with_its_default(name):
    table = rows(section(text("shared-control.md"), name.capitalize()))
    fields = dataclasses.fields(registry.load(name).Options)
    assert {key: cells[0] for key, cells in table.items()} == {
        field.name: written(field.default) for field in fields
    }


def test_every_filter_is_named_in_the_configuration_page():
    page = section(text("configuration.md"), "`[[filters]]`")
    assert [name for name in registry.BUILT_IN if f"#{name}" not in page] == []


def test_the_example_has_every_filter():
    made = make_filters(load_config(EXAMPLE))
    assert {each.name for each in made} == set(registry.BUILT_IN)


def test_the_skin_text_shown_is_one():
    shown = section(text("shared-control.md"), "Proximity")
    board = blocks(shown, "")[0].replace("...\n", "").split("J")[0]
    data = "".join(board.replace("I", name) for name in "IJK").encode()
    assert decode_proximity(data) == (16.0,) * 48


def test_the_filter_shown_is_one():
    (code,) = (b for b in blocks(text("adding-a-driver.md"), "python") if "TwistFilter" in b)
    names = {"__name__": "page"}
    exec(code, names)
    made = names["SlowDownLow"]()
    assert isinstance(made, TwistFilter)
    assert made.status() == ""
