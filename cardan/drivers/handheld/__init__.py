"""What hands mean that a page of the console shows: phones, headsets. Their drivers are in
:mod:`cardan.drivers.bus_devices`."""

from cardan.drivers.handheld.options import (
    HandheldOptions as HandheldOptions,
    PhoneOptions as PhoneOptions,
    XrOptions as XrOptions,
)
