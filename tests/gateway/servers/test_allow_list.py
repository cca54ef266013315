"""Allow list of a server: names that its clients may use."""

import pytest

from cardan.gateway.servers.allow_list import Allowed

ONE_OF_EACH = Allowed(["/arm/*", "/joy"], ["/arm/sto?"], ["/arm:speed", "/hand:*"])


@pytest.mark.parametrize(
    ("kind", "names", "others"),
    [
        ("topic", ["/arm/state", "/joy"], ["/arm", "/joy2", "/arm:speed"]),
        ("service", ["/arm/stop"], ["/arm/sto", "/arm/stopped", "/joy"]),
        ("parameter", ["/arm:speed", "/hand:gain"], ["/arm:speeds", "/arm:gain", "/joy"]),
    ],
)
def test_names_that_fit_a_pattern_of_their_kind(kind, names, others):
    may = getattr(ONE_OF_EACH, kind)
    assert [may(name) for name in names] == [True] * len(names)
    assert [may(name) for name in others] == [False] * len(others)


def test_nothing_without_patterns():
    nothing = Allowed([], [], [])
    assert not nothing.topic("/a")
    assert not nothing.service("/a")
    assert not nothing.parameter("/a:b")


@pytest.mark.parametrize("parameters", [(), ("/arm:*",)])
def test_nodes_own_services_go_round_no_restriction(parameters):
    some = Allowed(["*"], ["*"], parameters)
    assert not some.all_parameters
    assert not some.call("rcl_interfaces/srv/SetParameters")
    assert some.call("std_srvs/srv/Trigger")


def test_where_none_is_restricted_they_may_be_called():
    every = Allowed([], [], ["/a:b", "*"])
    assert every.all_parameters
    assert every.call("rcl_interfaces/srv/SetParameters")
    assert every.call("std_srvs/srv/Trigger")
