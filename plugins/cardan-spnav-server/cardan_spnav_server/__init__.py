"""Serves any operator device to the programs that know spacenavd."""

from cardan.gateway.spnav.core import (
    SpnavServerCore as SpnavServerCore,
)
from cardan.gateway.spnav.identity import (
    DeviceIdentity as DeviceIdentity,
    identity_of as identity_of,
)
from cardan.gateway.spnav.options import (
    SpnavServerOptions as SpnavServerOptions,
)
from cardan.gateway.spnav.server import (
    SpnavServer as SpnavServer,
    SpnavService as SpnavService,
    serve_device as serve_device,
)
