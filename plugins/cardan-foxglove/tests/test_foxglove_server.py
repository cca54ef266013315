"""Integration of the Foxglove server in Cardan: command, daemon files, and doctor."""

from __future__ import annotations

from cardan.doctor.base import Subject
from cardan.doctor.files import read_files
from cardan.doctor.installation import needed_extras
from cardan.doctor.ports import Wanted, wanted_ports
from cardan.gateway.servers import registry
from cardan_foxglove.server import Foxglove
from tests import test_server_command as shared


def test_it_is_found_by_its_entry_point():
    assert registry.load("foxglove") is Foxglove


def test_the_server_tells_what_it_does_and_what_its_options_mean():
    shared.test_every_server_tells_what_it_does_and_what_its_options_mean("foxglove")


def test_the_doctor_knows_its_extra_and_its_port(tmp_path):
    file = tmp_path / "lab.toml"
    file.write_text('[servers.view]\nserver = "foxglove"\nport = 9191\n[servers.foxglove]\n')
    config, wrong = read_files([file])
    assert not wrong
    subject = Subject((file,), config)
    assert needed_extras(subject) == {"foxglove": "server view"}
    assert list(wanted_ports(subject)) == [
        Wanted("tcp", "127.0.0.1", 9191, "server view"),
        Wanted("tcp", "127.0.0.1", 8765, "server foxglove"),
    ]


def test_the_doctor_asks_no_bus_of_a_domain_that_cannot_be(tmp_path):
    file = tmp_path / "lab.toml"
    file.write_text("[servers.foxglove]\ndomain = 999\n")
    config, wrong = read_files([file])
    assert not wrong
    assert Subject((file,), config).buses() == {}
