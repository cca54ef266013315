"""The udev rules that let the user at the console open every device Cardan has a driver for."""

from __future__ import annotations

_RULES = """\
# Hand-held devices for Cardan. Save as /etc/udev/rules.d/70-cardan.rules: the number must be below
# 73 for uaccess. Then, as root: udevadm control --reload, and plug the devices in again.
# For users who are not at the console (ssh, services) add GROUP="plugdev", or another group of
# theirs, to each rule. Serial devices need no rule but the group dialout.

# 3Dconnexion six-axis devices: hidraw, raw USB, and Bluetooth, where there is no idVendor.
SUBSYSTEM=="hidraw", ATTRS{idVendor}=="256f", MODE="0660", TAG+="uaccess"
SUBSYSTEM=="hidraw", ATTRS{idVendor}=="046d", ATTRS{idProduct}=="c6[0-4]?", MODE="0660", TAG+="uaccess"
SUBSYSTEM=="usb", ENV{DEVTYPE}=="usb_device", ATTR{idVendor}=="256f", MODE="0660", TAG+="uaccess"
SUBSYSTEM=="usb", ENV{DEVTYPE}=="usb_device", ATTR{idVendor}=="046d", ATTR{idProduct}=="c6[0-4]?", MODE="0660", TAG+="uaccess"
SUBSYSTEM=="hidraw", KERNELS=="0005:256F:*", MODE="0660", TAG+="uaccess"

# Nintendo Wii Remotes, both generations.
SUBSYSTEM=="hidraw", KERNELS=="0005:057E:0306.*", MODE="0660", TAG+="uaccess"
SUBSYSTEM=="hidraw", KERNELS=="0005:057E:0330.*", MODE="0660", TAG+="uaccess"

# Haptic devices: 3D Systems Touch, whose older ones are serial ports (the vendor's driver reads them).
SUBSYSTEM=="tty", ATTRS{idVendor}=="2988", ATTRS{idProduct}=="0302", MODE="0660", TAG+="uaccess"
SUBSYSTEM=="tty", ATTRS{idVendor}=="0301", ATTRS{idProduct}=="2988", MODE="0660", TAG+="uaccess"
SUBSYSTEM=="hidraw", ATTRS{idVendor}=="2988", ATTRS{idProduct}=="0304", MODE="0660", TAG+="uaccess"

# Gamepads, as the system knows them.
SUBSYSTEM=="input", KERNEL=="event*", ENV{ID_INPUT_JOYSTICK}=="1", MODE="0660", TAG+="uaccess"
# A keyboard as an operator device: whoever may read it can read every password typed on it, so this
# rule is off. Take the comment sign away for the one keyboard you mean, by its ids.
#SUBSYSTEM=="input", KERNEL=="event*", ATTRS{idVendor}=="1234", ATTRS{idProduct}=="5678", MODE="0660", TAG+="uaccess"
"""  # noqa: E501


def udev_rules() -> str:
    """The rules as text: one file for all devices."""
    return _RULES
