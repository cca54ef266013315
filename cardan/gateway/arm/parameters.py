"""The parameters of the interface: keys, names, units, defaults, and accepted values."""

from __future__ import annotations

import contextlib
import enum
import numbers
from collections.abc import Mapping
from typing import Any, NamedTuple

from cardan.common.bounds import (
    ANGULAR_ACCELERATION_RAD_S2,
    ANGULAR_JERK_RAD_S3,
    ANGULAR_SPEED_RAD_S,
    BLIND_S,
    LINEAR_ACCELERATION_M_S2,
    LINEAR_JERK_M_S3,
    LINEAR_SPEED_M_S,
    SHARE,
    Range,
)
from cardan.errors import ConfigurationError, OptionError
from cardan.gateway.arm.vocab import (
    FrameCode,
    Parameter,
    PolicyCode,
    ProfileCode,
    Stream,
    vocab,
    vocab_text,
)

Key = int | str
Value = float | int | str | enum.IntEnum


GAIN = Range(0.0, 10.0, "", "with cmcPeriodMs = 50 that is 200 1/s: no robot's own loop is stiffer")
DURATION_S = Range(0.0, 3600.0, "s", "no motion takes longer", zero="from speed and acceleration")
PERIOD_MS = Range(0.1, 10_000.0, "ms", "the end of a motion is seen by then")
DAMPING = Range(0.1, 1.0, "", "at less the arm hardly follows")


class ParameterRule(NamedTuple):
    """Name, default and accepted values of a parameter."""

    key: Parameter
    name: str
    """Name in configuration files."""
    default: float
    """For a parameter whose value is a code: the code's integer."""
    accepted: Range | type[enum.IntEnum]

    @property
    def unit(self) -> str:
        """Unit of its value; "code" for a code."""
        return self.accepted.unit if isinstance(self.accepted, Range) else "code"

    @property
    def allowed(self) -> str:
        """Accepted values, for messages."""
        if isinstance(self.accepted, Range):
            return f"{self.accepted}: {self.accepted.reason}"
        return ", ".join(map(vocab_text, self.accepted))


RULES = (
    ParameterRule(Parameter.GAIN, "controllerGain", 0.05, GAIN),
    ParameterRule(Parameter.TRAJECTORY_DURATION, "trajectoryDuration", 0.0, DURATION_S),
    ParameterRule(Parameter.TRAJECTORY_SPEED, "trajectoryRefSpeed", 0.05, LINEAR_SPEED_M_S),
    ParameterRule(
        Parameter.TRAJECTORY_ACCELERATION, "trajectoryRefAccel", 0.02, LINEAR_ACCELERATION_M_S2
    ),
    ParameterRule(Parameter.CONTROL_PERIOD, "cmcPeriodMs", 50.0, PERIOD_MS),
    ParameterRule(Parameter.WAIT_PERIOD, "waitPeriodMs", 30.0, PERIOD_MS),
    ParameterRule(Parameter.FRAME, "referenceFrame", FrameCode.BASE, FrameCode),
    ParameterRule(Parameter.STREAM, "streamingCommand", Stream.NONE, Stream),
    ParameterRule(Parameter.ROTATION_SPEED, "rotationRefSpeed", 0.25, ANGULAR_SPEED_RAD_S),
    ParameterRule(
        Parameter.ROTATION_ACCELERATION, "rotationRefAccel", 0.25, ANGULAR_ACCELERATION_RAD_S2
    ),
    ParameterRule(Parameter.TRAJECTORY_JERK, "trajectoryRefJerk", 0.2, LINEAR_JERK_M_S3),
    ParameterRule(Parameter.ROTATION_JERK, "rotationRefJerk", 2.5, ANGULAR_JERK_RAD_S3),
    ParameterRule(Parameter.PROFILE, "trajectoryProfile", ProfileCode.TRAPEZOID, ProfileCode),
    ParameterRule(Parameter.POLICY, "servoPolicy", PolicyCode.PATH, PolicyCode),
    ParameterRule(Parameter.STREAM_TIMEOUT, "streamTimeout", 0.1, BLIND_S),
    ParameterRule(Parameter.JOINT_SPEED, "jointSpeedShare", 0.25, SHARE),
    ParameterRule(Parameter.JOINT_ACCELERATION, "jointAccelShare", 0.5, SHARE),
    ParameterRule(Parameter.DAMPING, "poseDamping", 1.0, DAMPING),
)
"""All parameters, in the order in which they are listed."""

_BY_KEY = {rule.key: rule for rule in RULES}
_BY_NAME = {rule.name: rule for rule in RULES}


def find_rule(key: Key) -> ParameterRule:
    """Return the parameter with this code (integer or its characters) or name. Raises
    ConfigurationError that lists all parameters."""
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
    """Return `value` as the transmitted double. Raises OptionError if it is not accepted."""
    accepted = rule.accepted
    if isinstance(accepted, Range):
        plain: Any = getattr(value, "item", None)  # Numbers of numpy's have it.
        number = plain() if plain and isinstance(value, numbers.Number) else value
        if number in accepted:
            return float(number)
    else:
        with contextlib.suppress(ValueError, TypeError, OverflowError):
            code = vocab(value) if isinstance(value, str) else int(value)
            if isinstance(value, str) or code == value:
                return float(accepted(code))
    raise OptionError(rule.name, value, rule.allowed)


def checked_group(values: Mapping[Key, Value]) -> dict[Parameter, float]:
    """Check all of `values` before any is used. Raises ConfigurationError for the first wrong one,
    or if two keys mean one parameter."""
    found: dict[Parameter, float] = {}
    for key, value in values.items():
        rule = find_rule(key)
        if rule.key in found:
            raise ConfigurationError(rule.name, "is given twice")
        found[rule.key] = checked_value(rule, value)
    return found


def feedback_gain_1_s(gain: float, period_ms: float) -> float:
    """Return the gain from position error to velocity, from cpcg and cpcp, 1/s."""
    return gain * 1000.0 / period_ms


def defaults() -> dict[Parameter, float]:
    """Return every parameter at its default."""
    return {rule.key: float(rule.default) for rule in RULES}
