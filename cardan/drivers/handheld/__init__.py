"""Hands that a page of the console shows: what the drivers of phones and headsets share."""

from cardan.drivers.handheld.core import HandheldCore as HandheldCore
from cardan.drivers.handheld.device import HandheldDevice as HandheldDevice
from cardan.drivers.handheld.options import (
    HandheldOptions as HandheldOptions,
    PhoneOptions as PhoneOptions,
    XrOptions as XrOptions,
)
