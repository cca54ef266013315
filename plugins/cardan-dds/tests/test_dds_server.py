"""The server and the transport's nodes, as Cardan finds them by their entry points."""

from cardan.bus import transports
from cardan.gateway.servers import registry
from cardan_dds.node import DdsNode
from cardan_dds.server import Dds
from tests.test_server_command import said


def test_cardan_finds_both():
    assert registry.load("dds") is Dds
    assert transports.load("dds") is DdsNode
    assert transports.load_all().refused == {}


def test_the_server_tells_what_it_does_and_what_its_options_mean():
    assert " ".join(Dds.__doc__.split()) in " ".join(said("--list").split())
    reported = said("dds", "--help")
    for words in ("--seconds", "--dds-domain", "--dds-config", "--topics", Dds.epilog):
        assert words in reported
