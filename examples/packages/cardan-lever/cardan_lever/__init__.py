"""Driver of a three-axis lever with a trigger at a serial port."""

from cardan_lever.driver import Lever as Lever
from cardan_lever.driver import LeverOptions as LeverOptions
