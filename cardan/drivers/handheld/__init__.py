"""Interpreters of devices on a page of the console: phones, headsets. Their drivers are in
:mod:`cardan.drivers.bus_devices`."""

from cardan.drivers.handheld.options import (
    HandheldOptions as HandheldOptions,
    PhoneOptions as PhoneOptions,
    XrOptions as XrOptions,
)
