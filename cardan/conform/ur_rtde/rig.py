"""The simulated controller's servers and a pilot in virtual time."""

from __future__ import annotations

from cardan.conform.conduct import Conduct
from cardan.conform.tcp_rig import TcpRig
from cardan.sim_peers.ur_controller import UrController, UrControllerOptions, UrServers
from cardan.sim_peers.ur_controller.servers import PortKind


class UrRig(TcpRig[PortKind]):
    """The three ports of an e-Series, or of another controller by its `options`."""

    def __init__(self, conduct: Conduct, options: UrControllerOptions) -> None:
        self._controller = UrController(options)
        super().__init__(conduct, UrServers(self._controller, options))

    def _by_hand(self, what: str, now_s: float) -> None:
        controller = self._controller
        if what in ("slider-half", "slider-full"):
            controller.slider = 0.5 if what == "slider-half" else 1.0
        elif what in ("local", "remote"):
            controller.remote = what == "remote"
        elif what == "estop":
            controller.emergency_stop()
        else:
            controller.release_emergency_stop()
