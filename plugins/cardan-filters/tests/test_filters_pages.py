"""Registration of the filters, and comparison of the page on shared control with them."""

import dataclasses
from pathlib import Path

import pytest

import cardan_filters
from cardan.gateway.operator.filters import TwistFilter, registry
from cardan.gateway.session.assembly import load_config, make_filters
from cardan_filters.readings import decode_proximity
from tests.test_docs import blocks, rows, section, text, written

EXAMPLE = Path(cardan_filters.__file__).parent / "examples" / "shared-control-simulated.toml"
PAGE = "../plugins/cardan-filters/README.md"
NAMES = "camera", "proximity"


@pytest.mark.parametrize("name", NAMES)
def test_ours_are_complete(name):
    made = registry.load(name)()
    assert isinstance(made, TwistFilter)
    assert type(made).__module__ == f"cardan_filters.{name}"
    assert made.describe()
    assert made.diagnosis() == ()


@pytest.mark.parametrize("name", NAMES)
def test_every_option_is_there_with_its_default(name):
    table = rows(section(text(PAGE), name.capitalize()))
    fields = dataclasses.fields(registry.load(name).Options)
    assert {key: cells[0] for key, cells in table.items()} == {
        field.name: written(field.default) for field in fields
    }


def test_every_filter_is_named_in_the_configuration_page():
    page = section(text("configuration.md"), "`[[filters]]`")
    assert [name for name in NAMES if f"#{name}" not in page] == []


def test_the_example_has_every_filter():
    made = make_filters(load_config(EXAMPLE))
    assert {each.name for each in made} == set(NAMES)


def test_the_skin_text_shown_is_one():
    shown = section(text(PAGE), "Proximity")
    board = blocks(shown, "")[0].replace("...\n", "").split("J")[0]
    data = "".join(board.replace("I", name) for name in "IJK").encode()
    assert decode_proximity(data) == (16.0,) * 48
