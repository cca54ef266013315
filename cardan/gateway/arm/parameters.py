"""The parameters of the interface: keys, names, units, defaults, and what is accepted."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from cardan.errors import ConfigurationError
from cardan.gateway.arm.codes import (
    FrameCode,
    Parameter,
    PolicyCode,
    ProfileCode,
    Stream,
    vocab,
)

Key = int | str
Value = float | int | str | enum.IntEnum


class _Bound(enum.Enum):
    NOT_NEGATIVE = "a number >= 0"
    POSITIVE = "a number > 0"
    SHARE = "a number > 0 and <= 1"
    DAMPING = "a number >= 0.1 and <= 1"


class ParameterRule(NamedTuple):
    """One parameter."""

    key: Parameter
    name: str
    """As in configuration files."""
    unit: str
    default: float
    """For a parameter whose value is a code: the code's integer."""
    accepted: _Bound | type[enum.IntEnum]

    @property
    def allowed(self) -> str:
        """What is accepted, in words."""
        if isinstance(self.accepted, _Bound):
            return self.accepted.value
        return ", ".join(
            code.to_bytes(4, "little").rstrip(b"\0").decode() for code in self.accepted
        )


_B = _Bound
RULES: tuple[ParameterRule, ...] = (
    ParameterRule(Parameter.GAIN, "controllerGain", "", 0.05, _B.NOT_NEGATIVE),
    ParameterRule(Parameter.TRAJECTORY_DURATION, "trajectoryDuration", "s", 0.0, _B.NOT_NEGATIVE),
    ParameterRule(Parameter.TRAJECTORY_SPEED, "trajectoryRefSpeed", "m/s", 0.05, _B.POSITIVE),
    ParameterRule(
        Parameter.TRAJECTORY_ACCELERATION, "trajectoryRefAccel", "m/s²", 0.02, _B.POSITIVE
    ),
    ParameterRule(Parameter.CONTROL_PERIOD, "cmcPeriodMs", "ms", 50.0, _B.POSITIVE),
    ParameterRule(Parameter.WAIT_PERIOD, "waitPeriodMs", "ms", 30.0, _B.POSITIVE),
    ParameterRule(Parameter.FRAME, "referenceFrame", "code", float(FrameCode.BASE), FrameCode),
    ParameterRule(Parameter.STREAM, "streamingCommand", "code", float(Stream.NONE), Stream),
    ParameterRule(Parameter.ROTATION_SPEED, "rotationRefSpeed", "rad/s", 0.25, _B.POSITIVE),
    ParameterRule(Parameter.ROTATION_ACCELERATION, "rotationRefAccel", "rad/s²", 0.25, _B.POSITIVE),
    ParameterRule(Parameter.TRAJECTORY_JERK, "trajectoryRefJerk", "m/s³", 0.2, _B.POSITIVE),
    ParameterRule(Parameter.ROTATION_JERK, "rotationRefJerk", "rad/s³", 2.5, _B.POSITIVE),
    ParameterRule(
        Parameter.PROFILE, "trajectoryProfile", "code", float(ProfileCode.TRAPEZOID), ProfileCode
    ),
    ParameterRule(Parameter.POLICY, "servoPolicy", "code", float(PolicyCode.PATH), PolicyCode),
    ParameterRule(Parameter.STREAM_TIMEOUT, "streamTimeout", "s", 0.1, _B.POSITIVE),
    ParameterRule(Parameter.JOINT_SPEED, "jointSpeedShare", "", 0.25, _B.SHARE),
    ParameterRule(Parameter.JOINT_ACCELERATION, "jointAccelShare", "", 0.5, _B.SHARE),
    ParameterRule(Parameter.DAMPING, "poseDamping", "", 1.0, _B.DAMPING),
)
"""All parameters, in the order in which they are listed."""

_BY_KEY = {rule.key: rule for rule in RULES}
_BY_NAME = {rule.name: rule for rule in RULES}


def find_rule(key: Key) -> ParameterRule:
    """The parameter with this code (integer or its characters) or name.

    Raises ConfigurationError that lists what there is.
    """
    if isinstance(key, str) and key in _BY_NAME:
        return _BY_NAME[key]
    try:
        return _BY_KEY[Parameter(vocab(key) if isinstance(key, str) else key)]
    except (ValueError, KeyError):
        names = ", ".join(_BY_NAME)
        raise ConfigurationError(
            str(key), f"there is no such parameter; allowed: {names}"
        ) from None


def checked_value(rule: ParameterRule, value: Value) -> float:
    """`value` as the double that travels. Raises ConfigurationError where it is not accepted."""
    error = ConfigurationError(rule.name, f"accepts {rule.allowed}, not {value!r}")
    if not isinstance(rule.accepted, _Bound):
        try:
            code = vocab(value) if isinstance(value, str) else int(value)
            if not isinstance(value, str) and code != value:
                raise error
            return float(rule.accepted(code))
        except (ValueError, TypeError, OverflowError):
            raise error from None
    if isinstance(value, (bool, str)) or not isinstance(value, (int, float, np.number)):
        raise error
    try:
        number = float(value)
    except OverflowError:
        raise error from None
    if not math.isfinite(number) or number < 0.0:
        raise error
    if rule.accepted is not _B.NOT_NEGATIVE and number == 0.0:
        raise error
    if rule.accepted in (_B.SHARE, _B.DAMPING) and number > 1.0:
        raise error
    if rule.accepted is _B.DAMPING and number < 0.1:
        raise error
    return number


def checked_group(values: Mapping[Key, Value]) -> dict[Parameter, float]:
    """All of `values`, checked before any is used.

    Raises ConfigurationError for the first wrong one, and where two keys mean one parameter.
    """
    found: dict[Parameter, float] = {}
    for key, value in values.items():
        rule = find_rule(key)
        if rule.key in found:
            raise ConfigurationError(rule.name, "is given twice")
        found[rule.key] = checked_value(rule, value)
    return found


def feedback_gain_1_s(gain: float, period_ms: float) -> float:
    """What a position error is multiplied with to give a velocity, from cpcg and cpcp, 1/s."""
    return gain * 1000.0 / period_ms


def defaults() -> dict[Parameter, float]:
    """Every parameter at its default."""
    return {rule.key: rule.default for rule in RULES}
