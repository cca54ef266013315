"""The simulated joint-controlled arm: in this process, or a served one over UDP."""

from cardan.drivers.sim_arm.driver import SimArm
from cardan.drivers.sim_arm.options import SimArmOptions
from cardan.drivers.sim_arm.session import SimArmSession

__all__ = ["SimArm", "SimArmOptions", "SimArmSession"]
