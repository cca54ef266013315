"""Filters are found by name, also in other packages."""

from importlib.metadata import EntryPoint

import pytest

from cardan.errors import ConfigurationError
from cardan.gateway.operator.filters import TwistFilter, registry
from cardan.gateway.session.assembly import make_filters
from cardan.gateway.session.config import parse_config
from tests.test_docs import blocks, text


def test_filters_of_other_packages_are_found_by_their_entry_point(monkeypatch):
    points = [
        EntryPoint(
            "theirs", "tests.gateway.arm.test_controller_device:Rule", registry.ENTRY_POINT_GROUP
        ),
        EntryPoint("wrong", "cardan.types:Twist", registry.ENTRY_POINT_GROUP),
    ]
    monkeypatch.setattr(registry.FINDER, "_installed", lambda: points)
    assert registry.load("theirs").__name__ == "Rule"
    assert registry.names() == ("theirs", "wrong")
    with pytest.raises(ConfigurationError, match="is not a cardan filter"):
        registry.load("wrong")


def test_the_options_of_a_table_are_those_of_its_filter(monkeypatch):
    monkeypatch.setattr(registry.FINDER, "options_of", {"theirs": "options"}.get)
    assert registry.FilterTable.kind_of_others({"filter": "theirs"}) == "options"


def test_an_unknown_name_is_answered_with_those_there_are():
    with pytest.raises(ConfigurationError, match="'proximty'; allowed: camera, proximity"):
        registry.load("proximty")


TABLES = {
    "device": {"driver": "spacemouse"},
    "robot": {"driver": "abb_egm"},
    "filters": [{"filter": "proximity", "alert_high": 700}],
}


@pytest.fixture
def nothing_installed(monkeypatch):
    monkeypatch.setattr(registry.FINDER, "_installed", list)


@pytest.mark.usefixtures("nothing_installed")
def test_a_filter_of_a_plug_in_that_is_not_installed_says_what_installs_it():
    with pytest.raises(ConfigurationError) as error:
        make_filters(parse_config(TABLES))
    reported = str(error.value)
    assert reported.startswith(
        "filters.0.filter: 'proximity' is in the folder plugins/cardan-filters of Cardan's source "
    )
    assert "`pip install ./plugins/cardan-filters`" in reported
    assert "\n" not in reported


@pytest.mark.usefixtures("nothing_installed")
def test_where_no_filter_is_installed_an_unknown_name_is_answered_with_one_that_can_be():
    words = "'proximty'; allowed: none, because none is installed; did you mean 'proximity'"
    with pytest.raises(ConfigurationError, match=words):
        registry.load("proximty")


def test_the_filter_shown_is_one():
    (code,) = (b for b in blocks(text("adding-a-driver.md"), "python") if "TwistFilter" in b)
    names = {"__name__": "page"}
    exec(code, names)
    made = names["SlowDownLow"]()
    assert isinstance(made, TwistFilter)
    assert made.status() == ""
