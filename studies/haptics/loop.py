"""The closed loop in virtual time: simulated Omni, its libHD, the compiled tick, an environment.

Only the device and the time are simulated: the tick's callback is called by libHD's scheduler, in
each tick, through the function table; the scheduler is stepped.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import NamedTuple

from cardan.common.arm_libraries import np, npt
from cardan.common.haptics import OperatingState
from cardan.types import ZERO3, Vector3
from cardan_omni.driver import library as libhd
from cardan_omni.driver.limits import TickLimits
from cardan_omni.driver.native import kinematics
from cardan_omni.driver.servo import Servo
from cardan_omni.driver.tick import Tick
from cardan_omni.peer.library import SimulatedOmni
from cardan_omni.peer.settings import OmniSettings
from cardan_omni.protocol.constants import Capability

Array = npt.NDArray[np.float64]

TICK_S = 0.001
JOINT_QUANTUM_RAD = 2.0 * np.pi / 15000


def _misplaced_m() -> float:
    """Return the tip's largest encoder error in the middle of the workspace: each joint is at most
    half a quantum off, and the worst of the eight corners counts."""
    jacobian = np.array(kinematics(Vector3(0.0, 0.7420, 0.5531))[1]).reshape(3, 3)
    corners = [
        jacobian @ (0.5 * JOINT_QUANTUM_RAD * np.array(signs))
        for signs in itertools.product((-1.0, 1.0), repeat=3)
    ]
    return max(float(np.linalg.norm(corner)) for corner in corners)


MISPLACED_M = _misplaced_m()


class Trace(NamedTuple):
    """Record of a run, a row per tick; hand frame, true values."""

    times_s: Array
    position_m: Array
    velocity_m_s: Array
    sent_n: Array
    """Force set in the last complete frame."""
    rendered_n: Array
    """Force of the motors."""
    measured_m: Array
    """The position as the tick received it."""
    given_j: Array
    """Work of the motors on the stylus so far, by the simulation."""
    believed_j: Array
    """The same work in the tick's own energy account."""
    surplus_j: Array
    """Energy in the tick's account that it may still give; below 0: energy given beyond."""
    damping_n_s_m: Array
    """Damping of the passivity controller."""
    states: list[tuple[OperatingState, str]]
    """State, and the reason for a force other than commanded."""


class Bench:
    """A simulated Omni whose force is computed by the tick. Time advances in `run` only."""

    def __init__(
        self,
        limits: TickLimits,
        settings: OmniSettings | None = None,
        replace: Mapping[str, int] | None = None,
    ) -> None:
        """`replace`: addresses that replace libHD's functions of those names."""
        chosen = settings if settings is not None else OmniSettings()
        self.sim = SimulatedOmni(dataclasses.replace(chosen, virtual=True))
        self.tick = Tick(limits)
        self._replace = dict(replace or {})
        self._servo: Servo | None = None
        self._rows: list[tuple[float, ...]] = []
        self._states: list[tuple[OperatingState, str]] = []

    def __enter__(self) -> Bench:
        self._hd = libhd.load(str(self.sim.path))
        self._handle = self._hd.init_device("")
        self._hd.enable(self._handle, Capability.FORCE_OUTPUT, True)
        self._servo = Servo(
            self.tick,
            {**self._hd.functions, **self._replace},
            self._handle,
            clock=self.sim.address("simNow"),
            realtime=False,
        )
        self._scheduled = self._hd.schedule(self._servo.callback, self._servo.user, self._handle)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        assert self._servo is not None
        self._hd.unschedule(self._scheduled, self._handle)
        self._hd.disable_device(self._handle)
        self._servo.close()
        self.tick.close()

    @property
    def now_s(self) -> float:
        """Virtual time."""
        return self.sim.now_s

    @property
    def position(self) -> Vector3:
        """Position of the stylus, as the tick knows it."""
        pose = self.tick.snapshot().pose
        return pose.position if pose is not None else ZERO3

    def run(self, seconds: float, each: Callable[[float], None] | None, every: int = 4) -> None:
        """Run for this time; `each` is called with the time before every `every` ticks."""
        step, truth, tick, add = self.sim.step, self.sim.truth, self.tick, self._rows.append
        for count in range(round(seconds / TICK_S)):
            if each is not None and count % every == 0:
                each(self.sim.now_s)
            step(1)
            now, state = truth(), tick.snapshot()
            self._states.append((state.state, state.reason))
            add(
                (
                    now.time_s,
                    *now.position_m,
                    *now.velocity_m_s,
                    *now.commanded_n,
                    *now.delivered_n,
                    *(state.pose.position if state.pose is not None else ZERO3),
                    now.delivered_j,
                    state.delivered_j,
                    state.energy_j,
                    state.passivity_damping_n_s_m,
                )
            )

    @property
    def trace(self) -> Trace:
        """Return the record so far."""
        rows = np.array(self._rows)
        parts = (rows[:, k : k + 3] for k in (1, 4, 7, 10, 13))
        position, velocity, sent, rendered, measured = parts
        return Trace(
            rows[:, 0],
            position,
            velocity,
            sent,
            rendered,
            measured,
            rows[:, 16],
            rows[:, 17],
            rows[:, 18],
            rows[:, 19],
            self._states,
        )
