"""Effects of the simulated Omni's imperfections on the tick, the mapping and the TCP."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from cardan import spatial
from cardan.common.haptics import HapticCommand
from cardan.drivers import registry
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.session import make_session
from cardan.types import ZERO3, Vector3
from cardan_omni.driver.limits import TickLimits
from cardan_omni.peer import OmniSettings
from omni_virtual import LibHD, needs_library
from studies.haptics.loop import Bench
from test_omni_session import TABLE, VirtualOmni

pytestmark = [needs_library, pytest.mark.matrix]

PRESSED_S, SECONDS = 0.2, 3.2
TURN_RAD = 0.3


class Followed(NamedTuple):
    trips: int
    hand_rad: npt.NDArray[np.float64]
    """Rotation of the device's pose relative to its first one, a row per cycle."""
    tcp_rad: npt.NDArray[np.float64]
    """The same for the commanded pose of the TCP."""
    moved_m: float
    """Largest commanded displacement of the TCP."""


def follow(monkeypatch: pytest.MonkeyPatch, noise_lsb: float, turn_rad: float) -> Followed:
    """Clutch in with a still hand, and after 1 s turn the stylus within 0.5 s about the vertical
    axis, with `orientation = "follow-base"`."""
    monkeypatch.setitem(
        registry.BUILT_IN, "fake_haptic", f"{VirtualOmni.__module__}:{VirtualOmni.__name__}"
    )
    mapping = {**TABLE["mapping"], "orientation": "follow-base"}
    s = make_session(parse_config({**TABLE, "mapping": mapping}))
    states = s.robot.cycles
    hands, tcps, presses = [], [], [PRESSED_S]
    with Bench(TickLimits(), OmniSettings(gimbal_noise_lsb=noise_lsb)) as bench:
        s.device.bench = bench

        def cycles():
            for state in states():
                now_s = state.stamp_s
                turned = turn_rad * np.clip((now_s - 1.2) / 0.5, 0.0, 1.0)
                bench.sim.hand(ZERO3, (0.0, 0.0, float(turned)))
                if now_s > bench.now_s:
                    bench.run(now_s - bench.now_s, None)
                s.device.now_s = now_s
                if presses and now_s >= presses[0]:
                    presses.pop()
                    s.device.press("button_2")
                if now_s >= PRESSED_S + 0.1 and s.controller.reference.pose is not None:
                    hands.append(bench.tick.snapshot().pose)
                    tcps.append(s.controller.reference.pose)
                if now_s >= SECONDS:
                    s.stop("enough")
                yield state

        s.robot.cycles = cycles
        last = s.run()

    def turned_rad(poses):
        first = poses[0].orientation
        return np.array(
            [spatial.norm(spatial.rotation_between(first, pose.orientation)) for pose in poses]
        )

    return Followed(
        last.arm.trips,
        turned_rad(hands),
        turned_rad(tcps),
        max(math.dist(tcps[0].position, pose.position) for pose in tcps),
    )


def test_a_tcp_that_follows_a_noisy_gimbal_trembles_a_little_and_trips_nothing(monkeypatch):
    still = follow(monkeypatch, 5.0, 0.0)
    assert still.trips == 0
    assert 0.003 < np.ptp(still.hand_rad) < 0.02
    # The command is no rougher than the device's pose, and most of the noise is removed.
    assert 0.0 < np.ptp(still.tcp_rad) < np.ptp(still.hand_rad)
    assert still.moved_m < 1e-4  # about its own center
    assert follow(monkeypatch, 0.0, 0.0).tcp_rad.max() < 1e-9


def test_a_turn_of_a_noisy_gimbal_is_followed(monkeypatch):
    turned = follow(monkeypatch, 5.0, TURN_RAD)
    assert turned.trips == 0
    assert turned.tcp_rad[-100:].mean() == pytest.approx(TURN_RAD, abs=0.01)


@pytest.mark.parametrize("end", ["disable", "pause"])
@pytest.mark.parametrize(
    "limits",
    [
        TickLimits(engage_ramp_s=0.1),
        # The most that libHD's own clamp passes, and that the release needs.
        TickLimits(
            clamp_n=3.3,
            slew_rise_n_s=400.0,
            slew_fall_n_s=660.0,
            engage_ramp_s=0.1,
            continuous_n=1.5,
            passivity=False,
        ),
    ],
)
def test_no_release_of_the_tick_is_an_impulse_to_the_device(limits: TickLimits, end: str) -> None:
    stiff = OmniSettings(hand_stiffness_n_m=3000.0, hand_damping_n_s_m=40.0)
    with Bench(limits, stiff) as bench:

        def push(force_n):
            def each(now_s):
                bench.tick.command(
                    HapticCommand(bench.sim.truth().ticks, now_s, True, force=force_n)
                )

            return each

        bench.tick.enable()
        bench.run(0.1, push(ZERO3))
        bench.run(0.5, push(Vector3(0.0, limits.clamp_n, 0.0)))
        assert bench.sim.truth().delivered_n.y > 0.9 * limits.clamp_n
        getattr(bench.tick, end)()
        bench.run(0.02, None)
        assert bench.sim.truth().delivered_n == ZERO3
        assert LibHD().errors() == []
