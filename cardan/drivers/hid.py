"""hidapi's modules, which another package of the same name may hide."""

from __future__ import annotations

import importlib
from types import ModuleType

from cardan.errors import DriverError


def load_hid(module_name: str) -> ModuleType:
    """hidapi's module. DriverError when it, or another package of the same name, is not it."""
    try:
        module = importlib.import_module(module_name)
    except ImportError as error:
        raise DriverError(
            f"module {module_name!r} of the package hidapi cannot be imported ({error}): "
            "pip install hidapi"
        ) from None
    if not hasattr(module, "device") or not hasattr(module, "enumerate"):
        other = " (the package `hid`, a different one)" if hasattr(module, "Device") else ""
        raise DriverError(
            f"module {module_name!r} is not that of the package hidapi{other}: "
            "pip uninstall hid, then pip install --force-reinstall hidapi"
        )
    return module
