"""Settings by EGMSetupUC and EGMAct, with the system parameters as defaults."""

from __future__ import annotations

import math

from cardan.sim_peers.egm_controller.arguments import EgmAct, EgmMode, EgmSetup
from cardan.sim_peers.egm_controller.options import EgmControllerOptions

PATH_LEVEL = 2
"""Level of the External Motion Interface for path correction alone."""

_STREAM_RATE_MS = 4
_PATH_RATE_MS = 48


class EgmSettings:
    """Settings of one EGM identity; a run under way follows them when the program changes them."""

    def __init__(self, options: EgmControllerOptions) -> None:
        self.options = options
        self.setup: EgmSetup | None = None
        """None before EGMSetupUC."""
        self.act: EgmAct | None = None
        """None before EGMAct, and again after another EGMSetupUC."""

    @property
    def sample_rate_ms(self) -> int:
        """Nominal time between datagrams."""
        act = self.act
        if act is None:
            return _STREAM_RATE_MS
        if act.sample_rate_ms is not None:
            return act.sample_rate_ms
        return _PATH_RATE_MS if act.mode is EgmMode.PATH else _STREAM_RATE_MS

    @property
    def level(self) -> int:
        """Level of the External Motion Interface, 0 to 2."""
        if self.options.level is not None:
            return self.options.level
        return PATH_LEVEL if self.act is not None and self.act.mode is EgmMode.PATH else 1

    @property
    def comm_timeout_s(self) -> float:
        """Longest silence of the PC during guidance; path correction has no limit."""
        if self.setup is None or self.setup.mode is EgmMode.PATH:
            return math.inf
        return self.setup.comm_timeout_s
