"""Endpoints in the options of the bus."""

import pytest

from cardan.bus.options import BusOptions
from cardan.errors import OptionError


@pytest.mark.parametrize(
    "endpoint", ["tcp/127.0.0.1:99999", "tls/[::1]:65536", "udp/a:123456?rel=1", "ws/a:70000#b=c"]
)
@pytest.mark.parametrize("key", ["router", "listen"])
def test_a_port_out_of_range_is_refused(key, endpoint):
    with pytest.raises(OptionError, match=f"{key}.*a port from 0 to 65535"):
        BusOptions(**{key: endpoint if key == "router" else (endpoint,)})


@pytest.mark.parametrize(
    "endpoint", ["tcp/[::1]:65535", "tcp/a:7447#so_rcvbuf=99999", "vsock/2:99999", "tcp/[fe80::99]"]
)
def test_other_endpoints_are_left_to_zenoh(endpoint):
    assert BusOptions(router=endpoint, listen=(endpoint,)).router == endpoint
