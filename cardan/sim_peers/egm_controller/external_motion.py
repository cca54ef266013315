"""The External Motion Interface: streaming, guided runs, and stops after them.

Source: ABB Application manual, Externally Guided Motion (3HAC073318-001), EGM state transitions.
"""

from __future__ import annotations

import enum
from collections import Counter
from collections.abc import Sequence

from cardan.protocols.egm.messages import MCIState
from cardan.sim_peers.egm_controller.arguments import StopMode
from cardan.sim_peers.egm_controller.events import ControllerEventLog
from cardan.sim_peers.egm_controller.guided_run import Ending, GuidedRun, RunRequest
from cardan.sim_peers.egm_controller.motion import ServoAxes
from cardan.sim_peers.egm_controller.movements import Movements
from cardan.sim_peers.egm_controller.options import EgmControllerOptions
from cardan.sim_peers.egm_controller.settings import EgmSettings


class EgmState(enum.IntEnum):
    """RAPID's egmstate; ordered."""

    DISCONNECTED = 0
    CONNECTED = 1
    RUNNING = 2


class ExternalMotion:
    """The one EGM identity of the controller, and the motion of the arm.

    A session lasts from the first datagram until streaming and guidance have ended and the `tail`,
    during which the arm comes to rest, has been sent.
    """

    def __init__(
        self,
        options: EgmControllerOptions,
        servo: ServoAxes,
        flaws: Counter[str],
        log: ControllerEventLog,
    ) -> None:
        self.settings = EgmSettings(options)
        self.order: RunRequest | None = None
        """The last EGMRun or EGMMoveL."""
        self.run: GuidedRun | None = None
        """The run under way."""
        self.session = 0
        """Number of times that sending began."""
        self.connections = 0
        """Number of times that the UdpUc device was opened."""
        self.move_index = 0
        self.connected = False
        """True from EGMGetId to EGMReset."""
        self.streaming = False
        self.failed = False
        """True after an error, until the program or EGM starts again."""
        self.interrupted = False
        """True after an interrupted run that can continue with the program."""
        self.movements = Movements(servo)
        self._options = options
        self._servo = servo
        self._flaws = flaws
        self._log = log
        self._tail_until_s: float | None = None

    # ------------------------------------------------------------------------------------
    # State sent to the PC

    @property
    def state(self) -> EgmState:
        """RAPID's egmstate."""
        if not self.connected:
            return EgmState.DISCONNECTED
        return EgmState.RUNNING if self.streaming or self.run else EgmState.CONNECTED

    @property
    def mci_state(self) -> MCIState:
        """State of the motion correction interface."""
        if self.run is not None:
            return MCIState.RUNNING
        return MCIState.ERROR if self.failed else MCIState.STOPPED

    @property
    def converged(self) -> bool:
        """True while a run is inside its convergence window."""
        return self.run is not None and self.run.converged

    @property
    def sending(self) -> bool:
        """True while datagrams go out: streaming, guided, or coming to rest after that."""
        return self.streaming or self.run is not None or self.tail

    @property
    def tail(self) -> bool:
        """True while the end of a session is being sent."""
        return self._tail_until_s is not None

    @property
    def guided_at_level_0(self) -> bool:
        """True during a run at Level 0, when torqueRef is filled."""
        return self.run is not None and self.settings.level == 0

    # ------------------------------------------------------------------------------------
    # Beginning and ending

    def connect(self) -> None:
        """Open the UdpUc device, unless it is open."""
        if not self.connected:
            self.connected = True
            self.connections += 1

    def start_streaming(self) -> None:
        """Send datagrams without guidance."""
        if not self.streaming:
            self._new_session()
            self.streaming = True
            self.failed = False

    def begin(self) -> None:
        """Run the last EGMRun or EGMMoveL, if there is one. Raises MotionError if it cannot run."""
        act = self.settings.act
        if act is None or self.order is None:
            return
        run = GuidedRun(self.settings, act, self.order, self._servo, self._flaws, self._log.now_s)
        self._new_session()
        self.failed = False
        self.run = run
        self.move_index += 1

    def end(self, run: GuidedRun, ending: Ending) -> None:
        """End `run`, which is under way, as planned: convergence, EGMStop, end of the path."""
        self.movements.clear()
        self.run = None
        self.streaming = False
        self.movements.brake(ending.brake_s)
        returns = ending.stop_mode is StopMode.RAMP_DOWN
        if returns:
            self.go(run.order.start_joints, ending.return_s)
        if ending.brake_s > 0.0 or returns:
            self._tail_until_s = self._log.now_s

    def interrupt(self, ramp_s: float) -> None:
        """Interrupt an active run, to continue with the program."""
        if self.run is None:
            return
        self.interrupted = True
        self._break_off(ramp_s)

    def fail(self, ramp_s: float) -> None:
        """End all motion and streaming with an error."""
        self.interrupted = self.run is not None
        self.streaming = False
        self.failed = True
        self._break_off(ramp_s)

    def reset(self) -> None:
        """Discard the identity and its settings; streaming and an active run end at once."""
        self.streaming = False
        if self.run is not None:
            self.interrupt(0.0)
            self.interrupted = False
            self._tail_until_s = None
        self.connected = False
        self.settings.setup = self.settings.act = None
        self.order = None

    def power_cycle(self) -> None:
        """Restart the controller; the arm keeps its position."""
        self.reset()
        self.movements.clear()
        self._servo.place(self._servo.actual)
        self._tail_until_s = None
        self.failed = self.interrupted = False

    def go(self, joints: Sequence[float], at_least_s: float = 0.0) -> None:
        """Queue a movement to `joints`, rad."""
        self.move_index += 1
        self.movements.go(joints, at_least_s)

    def tick(self) -> bool:
        """Run a cycle without guidance: brake, or do queued movements. True when the arm stands."""
        if not self.movements.tick():
            return False
        if self._tail_until_s is not None and self._log.now_s >= self._tail_until_s:
            self._tail_until_s = None
        return True

    def _new_session(self) -> None:
        if not self.streaming and self.run is None:
            self.session += 1
            self._tail_until_s = None

    def _break_off(self, ramp_s: float) -> None:
        self.movements.clear()
        self.run = None
        self.movements.brake(ramp_s)
        self._tail_until_s = self._log.now_s + self._options.ramp_time_s
