"""Filters are found by name, ours and those of other packages."""

from importlib.metadata import EntryPoint

import pytest

from cardan.errors import ConfigurationError
from cardan.gateway.operator.filters import TwistFilter, registry


@pytest.mark.parametrize("name", registry.BUILT_IN)
def test_ours_are_complete(name):
    made = registry.load(name)()
    assert isinstance(made, TwistFilter)
    assert made.describe()
    assert made.diagnosis() == ()


def test_filters_of_other_packages_are_found_by_their_entry_point(monkeypatch):
    points = [
        EntryPoint(
            "theirs", "tests.gateway.arm.test_controller_hand:Rule", registry.ENTRY_POINT_GROUP
        ),
        EntryPoint("wrong", "cardan.types:Twist", registry.ENTRY_POINT_GROUP),
    ]
    monkeypatch.setattr(registry.FINDER, "_installed", lambda: points)
    assert registry.load("theirs").__name__ == "Rule"
    assert registry.names() == ("camera", "proximity", "theirs", "wrong")
    with pytest.raises(ConfigurationError, match="is not a cardan filter"):
        registry.load("wrong")


def test_an_unknown_name_is_answered_with_those_there_are():
    with pytest.raises(ConfigurationError, match="'proximty'; allowed: camera, proximity"):
        registry.load("proximty")
