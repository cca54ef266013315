"""A live session, and the servers next to it."""

import pytest

from cardan.bus.options import BusOptions
from tests.serving import served
from tests.sweep.plan import wanted_rows


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    """A session with all of its interfaces in the graph."""
    pytest.importorskip(
        "zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]"
    )
    from tests.sweep.world import world

    with world(tmp_path_factory.mktemp("sweep")) as found:
        found.wait(wanted_rows())
        yield found


@pytest.fixture
def running(session):
    """A rosbridge server for the session."""
    pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")
    from cardan.bus.zenoh_network import BusNetwork
    from tests.gateway.servers.bench import rosbridge

    options = BusOptions(router=session.endpoint, listen=())
    with BusNetwork(options, "rosbridge") as network, rosbridge(network) as found:
        yield found


@pytest.fixture(scope="module")
def domain(session):
    """DDS domain of the session, bridged by a DDS server in a separate process."""
    pytest.importorskip("cyclonedds", reason="cyclonedds is not installed: pip install cardan[dds]")
    from tests.dds_network import OPTIONS

    number = str(OPTIONS.number)
    server = ("net", "server", "dds", "--router", session.endpoint, "--dds-domain", number)
    with served(*server, "--services", "*"):
        yield OPTIONS.number
