"""The uniform Cartesian interface: the verbs of the field's ICartesianControl, for any arm."""

from cardan.gateway.arm.codes import Action, FrameCode, Parameter, State, Stream
from cardan.gateway.arm.controller import (
    CartesianController,
    ControllerOptions,
    ControllerStatus,
    Motion,
    Outcome,
    Stat,
)
from cardan.gateway.arm.device import CartesianDevice, digital_output_gripper

__all__ = [
    "Action",
    "CartesianController",
    "CartesianDevice",
    "ControllerOptions",
    "ControllerStatus",
    "FrameCode",
    "Motion",
    "Outcome",
    "Parameter",
    "Stat",
    "State",
    "Stream",
    "digital_output_gripper",
]
