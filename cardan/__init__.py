"""Teleoperation of robot arms from any hand-held device.

:func:`open_device` and :func:`open_robot` open a driver by its name; :func:`devices` lists the
operator devices that are plugged in. The driver classes (:class:`SpaceMouse`, :class:`AbbEgm`) and
the types and errors that they use are attributes of this package, imported on first use;
:mod:`cardan.api` lists them. :mod:`cardan.gateway` connects a device to a robot;
:mod:`cardan.sim_peers` simulates each piece of hardware at the level of its protocol.
"""

__version__ = "0.2.0"

TYPE_CHECKING = False  # typing's own costs an import
if TYPE_CHECKING:
    from cardan.api import *  # noqa: F403
else:

    def __getattr__(name):
        from importlib import import_module
        from importlib.util import find_spec

        if name == "__all__":
            return sorted(import_module("cardan.api")._there())
        if not name.startswith("_"):
            if find_spec(f"cardan.{name}") is not None:
                return import_module(f"cardan.{name}")
            api = import_module("cardan.api")
            if name in api._names():
                try:
                    found = globals()[name] = getattr(api, name)
                except api.ExtraMissingError as error:
                    import sys

                    # The import system tries hasattr first, and would report only that the name
                    # cannot be imported.
                    if sys._getframe(1).f_globals.get("__name__") == "importlib._bootstrap":
                        raise
                    raise error.of_name() from error
                return found
        raise AttributeError(f"module 'cardan' has no attribute {name!r}")

    def __dir__():
        from cardan import api

        return sorted({*globals(), *api._there()} - {"TYPE_CHECKING"})
