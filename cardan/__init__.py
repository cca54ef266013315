"""Teleoperation of robot arms from any hand-held device.

:func:`open_device` and :func:`open_robot` open a driver by its name, :func:`devices` tells what is
plugged in, and the driver classes are here by theirs (:class:`SpaceMouse`, :class:`AbbEgm`), beside
the types and errors that they use: all of :mod:`cardan.api`. Nothing is imported before it is asked
for. :mod:`cardan.gateway` joins a device to a robot; :mod:`cardan.sim_peers` stands in for every
piece of hardware at the level of the wire.
"""

__version__ = "0.1.0"

TYPE_CHECKING = False  # typing's own costs an import
if TYPE_CHECKING:
    from cardan.api import *  # noqa: F403
else:

    def __getattr__(name):
        from importlib import import_module
        from importlib.util import find_spec

        if not name.startswith("_"):
            if find_spec(f"cardan.{name}") is not None:
                return import_module(f"cardan.{name}")
            api = import_module("cardan.api")
            if name in api._names():
                found = globals()[name] = getattr(api, name)
                return found
        raise AttributeError(f"module 'cardan' has no attribute {name!r}")

    def __dir__():
        from cardan import api

        return sorted({*globals(), *api._names()} - {"TYPE_CHECKING"})
