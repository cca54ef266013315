"""Universal Robots arms: RTDE for states and commands, and a program that the driver sends."""

from cardan.drivers.ur_rtde.driver import UrRtde as UrRtde
from cardan.drivers.ur_rtde.options import UrRtdeOptions as UrRtdeOptions
