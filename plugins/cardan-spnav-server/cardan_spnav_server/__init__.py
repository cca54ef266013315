"""Serves any operator device to programs that support spacenavd."""

from cardan_spnav_server.core import (
    SpnavServerCore as SpnavServerCore,
)
from cardan_spnav_server.identity import (
    DeviceIdentity as DeviceIdentity,
    identity_of as identity_of,
)
from cardan_spnav_server.options import (
    SpnavServerOptions as SpnavServerOptions,
)
from cardan_spnav_server.server import (
    SpnavServer as SpnavServer,
    SpnavService as SpnavService,
    serve_device as serve_device,
    serve_until as serve_until,
)
