"""Interpreters of devices that the console's web page reads: phones and headsets. Their drivers are
in :mod:`cardan.drivers.bus_devices`."""

from cardan.drivers.handheld.options import (
    HandheldOptions as HandheldOptions,
    PhoneOptions as PhoneOptions,
    XrOptions as XrOptions,
)
