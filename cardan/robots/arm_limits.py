"""Limits of an arm's joints: the URDF's, overridden by those of the arm's file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from cardan.common.options import suggestion
from cardan.common.tables import as_toml
from cardan.errors import ConfigurationError
from cardan.robots.arm_chain import unit_of
from cardan.robots.arm_file import ArmFile
from cardan.robots.arm_model import JointKind
from cardan.robots.urdf import WIDEST, Limits, TreeJoint, fastest

_KEYS = {
    "velocity": "velocity_deg_s",
    "lower": "lower_deg",
    "upper": "upper_deg",
    "effort": "effort",
}
LIMIT_KEYS = tuple(_KEYS.values())
"""Tables of limits in the arm's file."""
_CAREFUL_SPEED = 10.0
_CAREFUL_SPEED_M_S = 0.05
_CAREFUL_WAY = 45.0
_CAREFUL_WAY_M = 0.05
"""Proposals for unpublished limits: deg/s, m/s; deg, m to each side."""


class Proposal(NamedTuple):
    """Proposed entry of the arm's file for a missing limit."""

    key: str
    joint: str
    value: float
    remark: str
    """Unit of the value, and the URDF's text."""


def limits_of(joints: Sequence[TreeJoint], file: ArmFile) -> list[Limits]:
    """Return the limits. Raises ConfigurationError: with a key for errors of the arm's file,
    without one for errors of the URDF and for missing limits, all of them at once."""
    _check_names(joints, file)
    found, missing = _found(joints, file)
    if missing:
        silent = [
            repr(j.name) for j, each in zip(joints, found, strict=True) if math.isinf(each.effort)
        ]
        raise _asked_for(missing, found, joints, silent)
    return found


def proposals_for(joints: Sequence[TreeJoint], file: ArmFile) -> list[Proposal]:
    """Propose all missing limits. Raises ConfigurationError for wrong ones."""
    found, missing = _found(joints, file)
    return _proposals(missing, found, joints)


def limit_lines(proposals: Iterable[Proposal], file: ArmFile | None = None) -> list[str]:
    """Return the tables of the arm's file with the proposals, besides the limits that `file`
    has."""
    lines: list[str] = []
    for key in LIMIT_KEYS:
        of_key = [each for each in proposals if each.key == key]
        given: Mapping[str, float] = {} if file is None else getattr(file, key)
        lines += [f"[{key}]"] if of_key or given else []
        lines += as_toml(given).splitlines()
        for each in of_key:
            line = as_toml({each.joint: each.value}).rstrip()
            lines.append(f"{line} # {each.remark}")
    return lines


def _found(
    joints: Sequence[TreeJoint], file: ArmFile
) -> tuple[list[Limits], dict[TreeJoint, dict[str, str]]]:
    """Return the limits, and by joint the missing ones, with the URDF's text for them."""
    found, missing = [], {}
    for joint in joints:
        limits, lacks = joint.limits()
        given = _given(joint, file)
        found.append(limits._replace(**given).accelerated)
        _check(joint, found[-1], given)
        if left := {field: words for field, words in lacks.items() if field not in given}:
            missing[joint] = left
    return found, missing


def limited_by(file: ArmFile) -> set[str]:
    """Return the joints whose limits the arm's file has."""
    return {name for key in LIMIT_KEYS for name in getattr(file, key)}


def _check_names(joints: Sequence[TreeJoint], file: ArmFile) -> None:
    kinds = {joint.name: joint.kind for joint in joints}
    for key in LIMIT_KEYS:
        for name in getattr(file, key):
            if name not in kinds:
                raise ConfigurationError(
                    f"{key}.{name}",
                    f"the arm has no moving joint {name!r}; allowed: {', '.join(kinds)}"
                    + suggestion(name, kinds),
                )
            if key in ("lower_deg", "upper_deg") and kinds[name] == JointKind.CONTINUOUS.value:
                raise ConfigurationError(
                    f"{key}.{name}", "a continuous joint takes no range: leave it out"
                )


def _unit(field: str, joint: TreeJoint) -> float:
    return 1.0 if field == "effort" else unit_of(joint.kind)


def _given(joint: TreeJoint, file: ArmFile) -> dict[str, float]:
    tables = {field: getattr(file, key) for field, key in _KEYS.items()}
    return {
        field: table[joint.name] * _unit(field, joint)
        for field, table in tables.items()
        if joint.name in table
    }


def _check(joint: TreeJoint, limits: Limits, given: Mapping[str, float]) -> None:
    unit = unit_of(joint.kind)
    largest = {"velocity": fastest(joint.kind), "lower": WIDEST, "upper": WIDEST}
    for field in largest:
        if abs(given.get(field, 0.0)) > largest[field]:
            raise ConfigurationError(
                f"{_KEYS[field]}.{joint.name}",
                f"{given[field] / unit:g} is more than {largest[field] / unit:g}",
            )
    if ("lower" in given or "upper" in given) and limits.lower >= limits.upper:
        raise ConfigurationError(
            f"{_KEYS['lower' if 'lower' in given else 'upper']}.{joint.name}",
            f"lower {limits.lower / unit:g} and upper {limits.upper / unit:g} are not a range",
        )


def _asked_for(
    missing: Mapping[TreeJoint, Mapping[str, str]],
    found: Sequence[Limits],
    joints: Sequence[TreeJoint],
    silent: Sequence[str],
) -> ConfigurationError:
    lacking = {
        field: [repr(joint.name) for joint in missing if field in missing[joint]] for field in _KEYS
    }
    names = [f"{field} of {', '.join(without)}" for field, without in lacking.items() if without]
    lines = limit_lines(_proposals(missing, found, joints))
    if silent:
        lines.append(f"# [effort] (N·m, N) is not published, and no limit, of {', '.join(silent)}")
    text = "\n".join(lines)
    return ConfigurationError(
        "",
        f"limits are missing: {'; '.join(names)}: put these lines at the end of the arm's .toml, "
        'which begins with urdf = "FILE" (where it has a table of them, into that), careful '
        f"numbers until you have the maker's:\n{text}",
    )


def _proposals(
    missing: Mapping[TreeJoint, Mapping[str, str]],
    found: Sequence[Limits],
    joints: Sequence[TreeJoint],
) -> list[Proposal]:
    limits = {joint.name: each for joint, each in zip(joints, found, strict=True)}
    proposals = []
    for field, key in _KEYS.items():
        for joint in (each for each in missing if field in missing[each]):
            value = _proposal(joint, field, limits[joint.name])
            unit = "m" if joint.kind == JointKind.PRISMATIC.value else "deg"
            unit += "/s" if field == "velocity" else ""
            remark = f"{unit}; the URDF: {missing[joint][field]}"
            proposals.append(Proposal(key, joint.name, round(value, 6), remark))
    return proposals


def _proposal(joint: TreeJoint, field: str, limits: Limits) -> float:
    """Propose a limit, deg or m. The end of a range is 0 if the other end allows it, as the URDF
    specification has it for a missing one."""
    prismatic = joint.kind == JointKind.PRISMATIC.value
    if field == "velocity":
        return _CAREFUL_SPEED_M_S if prismatic else _CAREFUL_SPEED
    sign = -1.0 if field == "lower" else 1.0
    way = sign * (_CAREFUL_WAY_M if prismatic else _CAREFUL_WAY)
    other = limits.upper if field == "lower" else limits.lower
    if math.isnan(other):
        return way
    other /= unit_of(joint.kind)
    return 0.0 if sign * other < 0.0 else other + way
