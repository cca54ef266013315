"""Output of `cardan devices drivers NAME` about a driver's options."""

from __future__ import annotations

import dataclasses
import shlex

import pytest

from cardan.cli.driver_options import driver_options
from cardan.drivers.sim_arm import SimArmOptions
from tests.command_line import the_command_line
from tests.docs_tables import DRIVERS


def test_the_command_prints_each_option(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    the_command_line()(shlex.split("devices drivers sim_arm"), standalone_mode=False)
    printed = capsys.readouterr().out
    assert [
        each.name for each in dataclasses.fields(SimArmOptions) if each.name not in printed
    ] == []
    assert '"in-process", "udp"' in printed


def test_choices_ranges_and_defaults_are_as_a_configuration_has_them():
    rows = {each.name: each for each in driver_options(SimArmOptions)}
    assert rows["transport"][1:3] == ('"in-process"', '"in-process", "udp"')
    assert rows["period_s"][1:3] == ("0.002", "0.0005 to 0.1")
    assert rows["planes"].default == "[]"
    assert rows["gravity_feedforward"].default == "false"


@pytest.mark.parametrize("name", DRIVERS)
def test_each_option_of_each_driver_has_a_meaning(name):
    rows = driver_options(DRIVERS[name].Options)
    assert [each.name for each in rows if not each.meaning] == []
