"""Serves any operator device to the programs that know spacenavd."""

from cardan.gateway.spnav.core import SpnavServerCore
from cardan.gateway.spnav.identity import DeviceIdentity, identity_of
from cardan.gateway.spnav.options import SpnavServerOptions
from cardan.gateway.spnav.server import SpnavServer, SpnavService, serve_device

__all__ = [
    "DeviceIdentity",
    "SpnavServer",
    "SpnavServerCore",
    "SpnavServerOptions",
    "SpnavService",
    "identity_of",
    "serve_device",
]
