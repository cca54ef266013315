"""Simulated joint-controlled arm: in this process, or a served one over UDP."""

from cardan.drivers.sim_arm.driver import SimArm as SimArm
from cardan.drivers.sim_arm.options import SimArmOptions as SimArmOptions
from cardan.drivers.sim_arm.session import SimArmSession as SimArmSession
