"""The udev rules grant access to the devices that the drivers open, and to no others."""

import pytest

from cardan.drivers.udev import udev_rules

RULES = [line for line in udev_rules().splitlines() if line and not line.startswith("#")]


@pytest.mark.parametrize("subsystem", ["hidraw", "usb"])
@pytest.mark.parametrize("vendor", ["046d", "256f"])
def test_3dconnexion_by_hidraw_and_by_raw_usb(subsystem, vendor):
    assert any(f'"{subsystem}"' in rule and f'"{vendor}"' in rule for rule in RULES)


@pytest.mark.parametrize("product", ["0306", "0330"])
def test_both_generations_of_wii_remotes(product):
    for bus in ("0005", "0003"):  # Bluetooth; USB through a DolphinBar
        assert any(f'KERNELS=="{bus}:057E:{product}.*"' in rule for rule in RULES)


def test_gamepads_but_no_keyboards():
    inputs = [rule for rule in RULES if 'SUBSYSTEM=="input"' in rule]
    assert inputs
    assert all('ENV{ID_INPUT_JOYSTICK}=="1"' in rule for rule in inputs)


def test_every_rule_is_for_the_user_at_the_console():
    assert all(rule.endswith('MODE="0660", TAG+="uaccess"') for rule in RULES)
