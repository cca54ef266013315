"""The form of a Bluetooth address."""

from cardan.common.bounds import Text

BLUETOOTH_ADDRESS = Text(
    "([0-9A-Fa-f]{2}:){5}[0-9A-Fa-f]{2}", 'six bytes such as "00:1F:32:AA:BB:CC"'
)
