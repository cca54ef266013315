"""Simulated SpaceMouse in virtual time, for its tests."""

from __future__ import annotations

from cardan.protocols.connexion.devices import model_by_key
from cardan.sim_peers.base import parse_script
from cardan.sim_peers.spacemouse.core import SimulatedSpaceMouse
from cardan.sim_peers.spacemouse.motion_script import SCRIPT_VERBS, ScriptedPuck

Stamped = list[tuple[float, bytes]]

DEFLECTED = (0.5, 0.0, 0.0, 0.0, 0.0, 0.2)
NEUTRAL = (0.0,) * 6


def make(model: str = "spacenavigator", **settings: object) -> SimulatedSpaceMouse:
    return SimulatedSpaceMouse(model_by_key(model), **settings)  # type: ignore[arg-type]


def run(device: SimulatedSpaceMouse, until_s: float) -> Stamped:
    """Return every report until `until_s`, with its time."""
    reports: Stamped = []
    while (due_s := device.next_due_s) <= until_s:
        reports += [(due_s, report) for report in device.reports(due_s)]
    assert device.reports(until_s) == []
    return reports


def perform(device: SimulatedSpaceMouse, script: str, until_s: float) -> Stamped:
    """Return every report of `device` during `script`, with its time."""
    motion = ScriptedPuck(parse_script(script, SCRIPT_VERBS), device.model)
    reports: Stamped = []
    while (due_s := min(device.next_due_s, motion.next_due_s)) <= until_s:
        device.skip_to(due_s)
        motion.advance(due_s, device)
        reports += [(due_s, report) for report in device.reports(due_s)]
    return reports


def motions(reports: Stamped) -> list[bytes]:
    return [report for _, report in reports if report[0] in (1, 2)]
