"""The one place that imports numpy and the libraries of an arm's model: an optional extra.

They take half a gigabyte, which a program that uses one driver does without. What needs an arm's
model imports them from here, so that it says the same wherever they are missing.
"""

from __future__ import annotations

from cardan.errors import ArmExtraMissingError

try:
    import coal as coal
    import daqp as daqp
    import eigenpy as eigenpy
    import numpy as np
    import numpy.typing as npt
    import pinocchio as pin
except ImportError as error:
    raise ArmExtraMissingError(
        f"this needs the libraries of an arm's model, which cannot be imported ({error}): "
        'pip install "cardan[arm]"'
    ) from error

__all__ = ["coal", "daqp", "eigenpy", "np", "npt", "pin"]
