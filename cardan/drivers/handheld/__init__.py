"""Hands that a page of the console shows: phones, headsets."""

from cardan.drivers.handheld.device import Phone as Phone, Xr as Xr
from cardan.drivers.handheld.options import (
    HandheldOptions as HandheldOptions,
    PhoneOptions as PhoneOptions,
    XrOptions as XrOptions,
)
