"""A hand of a WebXR session: headset controllers, phones with AR, by a page of the console."""

from cardan.drivers.handheld import XrOptions as XrOptions
from cardan.drivers.xr.device import Xr as Xr
