"""The face, and the nodes of the transport, as Cardan finds them by their entry points."""

from cardan.bus import transports
from cardan.gateway.servers import registry
from cardan_dds.face import Dds
from cardan_dds.node import DdsNode
from tests.test_face_command import said


def test_cardan_finds_both():
    assert registry.load("dds") is Dds
    assert transports.load("dds") is DdsNode
    assert transports.load_all().refused == {}


def test_the_face_tells_what_it_does_and_what_its_options_mean():
    assert " ".join(Dds.__doc__.split()) in " ".join(said("--list").split())
    told = said("dds", "--help")
    for words in ("--seconds", "--dds-domain", "--dds-config", "--topics", Dds.epilog):
        assert words in told
