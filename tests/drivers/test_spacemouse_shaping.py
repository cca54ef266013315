"""Dead zone, curve, locks and dominance."""

import itertools
import math

import pytest
from hypothesis import given, strategies as st

from cardan.drivers.shaping import Shaper
from cardan.drivers.spacemouse import SpaceMouseOptions
from cardan.types import NEUTRAL

unit = st.floats(-1.0, 1.0)
six = st.tuples(*[unit] * 6)
options = st.builds(
    SpaceMouseOptions,
    dead_zone=st.floats(0.0, 0.9),
    dead_zone_shape=st.sampled_from(["axis", "radial"]),
    curve=st.floats(0.0, 1.0),
    translation=st.booleans(),
    rotation=st.booleans(),
    dominant_axis=st.booleans(),
)


def shaped(axes, **settings):
    return Shaper(SpaceMouseOptions(**settings))(axes)


def one(u):
    return (u, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("shape", ["axis", "radial"])
@pytest.mark.parametrize(
    ("u", "curve", "expected"),
    [
        (0.0, 0.0, 0.0),
        (0.2, 0.0, 0.0),
        (0.6, 0.0, 0.5),
        (-0.6, 0.0, -0.5),
        (0.6, 1.0, 0.125),
        (-0.6, 0.5, -0.3125),
        (1.0, 0.7, 1.0),
    ],
)
def test_dead_zone_then_curve(shape, u, curve, expected):
    result = shaped(one(u), dead_zone=0.2, dead_zone_shape=shape, curve=curve)
    assert result == pytest.approx(one(expected))


def test_radial_dead_zone_keeps_the_direction():
    u = (0.12, 0.16, 0.0, 0.3, 0.0, -0.4)
    x, y, z, rx, ry, rz = shaped(u, dead_zone=0.25, dead_zone_shape="radial", curve=0.4)
    assert (x, y, z) == (0.0, 0.0, 0.0)
    assert ry == 0.0
    assert math.atan2(rz, rx) == pytest.approx(math.atan2(-0.4, 0.3))
    length = (0.5 - 0.25) / 0.75
    assert math.hypot(rx, rz) == pytest.approx(length * (0.6 + 0.4 * length**2))


def test_locks():
    u = (0.5, 0.5, 0.5, -0.5, -0.5, -0.5)
    assert shaped(u, dead_zone=0.0, translation=False) == (0, 0, 0, -0.5, -0.5, -0.5)
    assert shaped(u, dead_zone=0.0, rotation=False) == (0.5, 0.5, 0.5, 0, 0, 0)


def test_dominant_axis_has_hysteresis():
    shaper = Shaper(SpaceMouseOptions(dead_zone=0.0, dominant_axis=True))
    assert shaper((0.2, 0.3, 0.0, 0.0, 0.0, 0.0)) == (0.0, 0.3, 0.0, 0.0, 0.0, 0.0)
    assert shaper((0.32, 0.3, 0.0, 0.0, 0.0, 0.0)) == (0.0, 0.3, 0.0, 0.0, 0.0, 0.0)
    assert shaper((0.34, 0.3, 0.0, 0.0, 0.0, 0.0)) == (0.34, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert shaper(NEUTRAL) == NEUTRAL
    assert shaper((0.0, 0.0, 0.0, 0.0, 0.0, -0.1)) == (0.0, 0.0, 0.0, 0.0, 0.0, -0.1)


@given(options, six)
def test_result_is_bounded_and_keeps_signs(settings, axes):
    result = Shaper(settings)(axes)
    assert len(result) == 6
    for u, v in zip(axes, result, strict=True):
        assert -1.0 <= v <= 1.0
        assert u * v >= 0.0
        assert abs(v) <= abs(u) + 1e-12


@given(st.floats(0.0, 0.9), st.floats(0.0, 1.0), st.sampled_from(["axis", "radial"]))
def test_continuous_and_monotonic(dead_zone, curve, shape):
    shaper = Shaper(SpaceMouseOptions(dead_zone=dead_zone, curve=curve, dead_zone_shape=shape))
    values = [shaper(one(i / 200))[0] for i in range(-200, 201)]
    steepest = (1.0 + 2.0 * curve) / (1.0 - dead_zone) / 200
    for a, b in itertools.pairwise(values):
        assert -1e-12 <= b - a <= steepest + 1e-9
    assert values[0] == pytest.approx(-1.0)
    assert values[-1] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"dead_zone": 1.0}, r"dead_zone: 1\.0 is not allowed; it must be 0 to below 1"),
        ({"dead_zone": float("nan")}, "dead_zone: nan is not allowed"),
        ({"curve": 1.5}, r"curve: 1\.5 is not allowed"),
        ({"full_scale": 0.0}, r"full_scale: 0\.0 is not allowed"),
        ({"full_scale": math.inf}, "full_scale: inf is not allowed"),
        (
            {"transport": "bus"},
            "transport: 'bus' is not allowed; it must be one of auto, hidraw, libusb, usb, socket",
        ),
        (
            {"dead_zone_shape": "box"},
            "dead_zone_shape: 'box' is not allowed; it must be one of axis, radial",
        ),
        ({"led": "blink"}, "led: 'blink' is not allowed; it must be one of keep, on, off"),
        ({"model": "spaceship"}, "model: 'spaceship' is not allowed; it must be .*spacenavigator"),
        ({"transport": "socket"}, "path: '' is not allowed; it must be the path"),
    ],
)
def test_bad_options_name_the_field(settings, words):
    with pytest.raises(ValueError, match=words):
        SpaceMouseOptions(**settings)
