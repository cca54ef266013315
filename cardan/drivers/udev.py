"""udev rules that let the user at the console open the devices that drivers declare."""

from __future__ import annotations

from cardan.drivers import registry
from cardan.drivers.base import OperatorDevice

_HEAD = """\
# Hand-held devices for Cardan. Save as /etc/udev/rules.d/70-cardan.rules: the number must be below
# 73 for uaccess. Then, as root: udevadm control --reload, and plug the devices in again.
# For users who are not at the console (ssh, services) add GROUP="plugdev", or another group of
# theirs, to each rule. Serial devices need no rule but the group dialout.
"""
_ACCESS = ', MODE="0660", TAG+="uaccess"'


def udev_rules() -> str:
    """Return the rules as text: one file for the devices of all drivers."""
    text = _HEAD
    found = registry.load_all()
    for name, why in found.refused.items():
        text += f"\n# driver {name} {why}\n"
    for driver in found.classes.values():
        if issubclass(driver, OperatorDevice) and driver.udev_matches:
            text += f"\n# {driver.summary}\n"
            for match in map(str, driver.udev_matches):
                text += f"{match}{'' if match.startswith('#') else _ACCESS}\n"
    return text
