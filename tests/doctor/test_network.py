"""Findings about the bus that the files name: its nodes, and ROS 2 settings of this shell."""

import pytest

from cardan.bus.discovery import Discovery
from cardan.bus.options import BusOptions
from cardan.doctor import network
from cardan.doctor.base import Subject
from cardan.doctor.files import read_files
from cardan.doctor.network import Bus, RosEnvironment, check_bus, check_environment
from cardan.errors import DriverError
from tests.doctor.levels_and_codes import levels_and_codes

HERE = BusOptions()
THERE = BusOptions(router="tcp/192.168.7.7:7447", mode="client")
ALONE = Discovery([], {}, {}, 0, 0)


def yes(_address):
    return True


def no(_address):
    return False


@pytest.mark.parametrize(
    ("options", "served", "found", "level"),
    [
        (HERE, yes, ALONE._replace(nodes=["/a"]), "good"),
        (HERE, yes, ALONE._replace(routers=1), "caution"),
        (THERE, no, ALONE, "caution"),
        (THERE, no, ALONE._replace(nodes=["/a"]), "good"),
        (BusOptions(router=""), no, ALONE, "caution"),
    ],
)
def test_who_is_met(options, served, found, level):
    assert levels_and_codes(Bus, check_bus(options, "session a", lambda _: found, served)) == [
        (level, "bus")
    ]


def test_a_bus_without_a_router_is_not_joined():
    def never(_options):
        raise AssertionError("it was joined")

    found = check_bus(HERE, "session a", never, no)
    assert levels_and_codes(Bus, found) == [("good", "bus")]
    assert "a session with [network] starts it" in found.what


def test_a_bus_that_cannot_be_joined():
    def fails(_options):
        raise DriverError("no zenoh")

    assert levels_and_codes(Bus, check_bus(HERE, "session a", fails, yes)) == [("failure", "bus")]


@pytest.mark.parametrize(
    ("environment", "levels"),
    [
        ({}, ["good", "good"]),
        ({"RMW_IMPLEMENTATION": "rmw_zenoh_cpp", "ROS_DOMAIN_ID": "0"}, ["good", "good"]),
        ({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}, ["caution", "good"]),
        ({"ROS_DISTRO": "jazzy"}, ["caution", "good"]),
        ({"ROS_DOMAIN_ID": "7"}, ["good", "caution"]),
    ],
)
def test_the_environment(environment, levels):
    found = list(check_environment(environment, {HERE: "session a"}))
    assert levels_and_codes(RosEnvironment, found) == list(
        zip(levels, ("rmw", "domain"), strict=True)
    )


def test_each_bus_is_looked_at_once(tmp_path, monkeypatch):
    file = tmp_path / "lab.toml"
    file.write_text(
        "".join(
            f'[[sessions]]\nname = "{name}"\nrobot = {{ driver = "abb_egm", listen_port = 0 }}\n'
            f"[sessions.network]\n{more}\n"
            for name, more in (("a", ""), ("b", "rate_hz = 20.0"), ("c", "domain = 3"))
        )
    )
    config, wrong = read_files([file])
    assert not wrong
    looked = []

    def check(options, who):
        looked.append((options.domain, who))
        return check_bus(options, who, lambda _: ALONE, no)

    monkeypatch.setattr(network, "check_bus", check)
    subject = Subject((file,), config, environment={"ROS_DOMAIN_ID": "3"})
    assert levels_and_codes(Bus, Bus.look(subject)) == [("good", "bus")] * 2
    assert looked == [(0, "session a"), (3, "session c")]
    assert levels_and_codes(RosEnvironment, RosEnvironment.look(subject)) == [
        ("good", "rmw"),
        ("good", "domain"),
    ]


def test_servers_join_the_bus_too(tmp_path):
    file = tmp_path / "servers.toml"
    file.write_text(
        '[servers.rosbridge]\nrouter = "tcp/192.168.7.7:7447"\nmode = "client"\ndomain = 4\n'
        '[servers.router]\n[servers.far]\nserver = "rosbridge"\ndomain = 999\n'
    )
    config, wrong = read_files([file])
    assert not wrong
    router = "tcp/192.168.7.7:7447"
    assert Subject((file,), config).buses() == {
        BusOptions(router=router, mode="client", domain=4): "server rosbridge"
    }


def test_without_a_bus_the_environment_does_not_matter():
    assert (
        levels_and_codes(
            RosEnvironment, RosEnvironment.look(Subject(environment={"ROS_DISTRO": "x"}))
        )
        == []
    )
