"""Serves any operator device to the programs that know spacenavd."""

from cardan.gateway.spnav.core import DeviceIdentity, SpnavServerCore
from cardan.gateway.spnav.options import SpnavServerOptions
from cardan.gateway.spnav.server import SpnavServer, SpnavService, serve_device

__all__ = [
    "DeviceIdentity",
    "SpnavServer",
    "SpnavServerCore",
    "SpnavServerOptions",
    "SpnavService",
    "serve_device",
]
