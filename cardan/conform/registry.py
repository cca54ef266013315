"""Finds suites by name."""

from __future__ import annotations

import importlib
from typing import Any

from cardan.conform.suite import Suite
from cardan.errors import ConfigurationError

SUITES = {
    "3dconnexion": "cardan.conform.connexion.suite:Connexion",
    "egm": "cardan.conform.egm.suite:Egm",
    "egm-driver": "cardan.conform.egm_driver.suite:EgmDriver",
    "hdapi": "cardan.conform.hdapi.suite:Hdapi",
    "jr3": "cardan.conform.jr3.suite:Jr3",
    "joint-stream": "cardan.conform.joint_stream.suite:JointStream",
    "joint-stream-driver": "cardan.conform.joint_stream_driver.suite:JointStreamDriver",
    "leap": "cardan.conform.leap.suite:Leap",
    "magellan": "cardan.conform.magellan.suite:Magellan",
    "motoros": "cardan.conform.motoros.suite:Motoros",
    "motoros-driver": "cardan.conform.motoros_driver.suite:MotorosDriver",
    "ros2-arm": "cardan.conform.ros2_arm.suite:Ros2Arm",
    "spaceball": "cardan.conform.spaceball.suite:Spaceball",
    "spaceorb": "cardan.conform.spaceorb.suite:SpaceOrb",
    "spnav": "cardan.conform.spnav.suite:SpnavDaemon",
    "ur-rtde": "cardan.conform.ur_rtde.suite:UrRtde",
    "wiimote": "cardan.conform.wiimote.suite:Wiimote",
}
"""Module and class of each. Imported when it is asked for: each brings its simulated peer along."""


def names() -> tuple[str, ...]:
    """The names of all suites, sorted."""
    return tuple(sorted(SUITES))


def load(name: str) -> Suite[Any]:
    """The suite of that name; ConfigurationError names those there are."""
    if name not in SUITES:
        raise ConfigurationError(
            "PROTOCOL", f"there is no {name!r}; there are: {', '.join(names())}"
        )
    module, _, attribute = SUITES[name].partition(":")
    suite: Suite[Any] = getattr(importlib.import_module(module), attribute)()
    return suite
