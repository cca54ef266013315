"""What other packages' drivers raise against their interface, told by the driver's name."""

from __future__ import annotations

import logging
from types import TracebackType

from cardan.common.openable import Openable
from cardan.common.plugins import reason
from cardan.common.shortage import shortage
from cardan.drivers.base import RobotDriver
from cardan.errors import CardanError, DriverError

_log = logging.getLogger(__name__)


class RobotCalls:
    """``with`` it, calls of a robot's driver raise errors of Cardan only: what else one raises is
    a DriverError that names the driver."""

    def __init__(self, robot: RobotDriver) -> None:
        self._name = type(robot).__name__

    def __enter__(self) -> None:
        pass

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if not isinstance(error, Exception) or isinstance(error, CardanError) or shortage(error):
            return
        _log.debug("it failed here", exc_info=error)
        raise self.failed(reason(error)) from error

    def failed(self, problem: str) -> DriverError:
        """The error for a driver that breaks its interface."""
        return DriverError(f"the robot's driver {self._name} failed: {problem}")


def close_in_order(opened: Openable) -> None:
    """Close a driver or a filter. One that raises is named in the log: what else is open is closed
    after it."""
    try:
        opened.close()
    except Exception:
        _log.exception("%s was not closed in good order", type(opened).__name__)
