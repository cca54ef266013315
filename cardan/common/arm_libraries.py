"""The one place that imports numpy and the libraries of an arm's model: an optional extra.

They take half a gigabyte, which a program with one driver need not install. Modules that need an
arm's model import them from here, so that the error for a missing one is the same everywhere.
"""

from __future__ import annotations

from cardan.common.extras import missing_extra

try:
    import coal as coal
    import daqp as daqp
    import eigenpy as eigenpy
    import numpy as np
    import numpy.typing as npt
    import pinocchio as pin
except ImportError as error:
    raise missing_extra(
        "an arm's model", "numpy, pin, coal, eigenpy and daqp", "arm", error
    ) from error

__all__ = ["coal", "daqp", "eigenpy", "np", "npt", "pin"]
