"""The Cartesian interface for users, whatever process runs the arm's loop."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

from cardan.common.context import enter, leave
from cardan.errors import MotionRefusedError
from cardan.gateway.arm.parameters import Key, Value
from cardan.gateway.arm.status import VERBS
from cardan.gateway.arm.validation import Target
from cardan.gateway.arm.verb_results import ControllerStatus, Motion, Rehearsal, Stat
from cardan.gateway.arm.vocab import Action


class CartesianArm(ABC):
    """An arm with the verbs movj, movl, ... of the Cartesian interface, for any thread.

    A verb that is refused raises MotionRefusedError and changes nothing. A verb that takes over
    from a motion under way blocks until that motion is braked to rest; if the new motion is
    impossible from there, it is refused and the arm stays at rest. All raise MotionLoopError once
    the loop has ended.
    """

    source = VERBS
    """Name of this client as a source of motion."""

    @abstractmethod
    def open(self) -> None:
        """Start the loop; returns when the robot's first state is there."""

    @abstractmethod
    def close(self) -> None:
        """Brake to rest and end the loop. Never raises; idempotent."""

    __enter__ = enter
    __exit__ = leave

    @abstractmethod
    def _ask(
        self, verb: str, value: Any = None, *, source: str = "", sequence: int | None = None
    ) -> Any:
        """Have `verb` carried out by the arm's :class:`VerbServer` for `source`, or for this
        client; raises the verb's errors."""

    # -- requests --------------------------------------------------------------------------------

    def stat(self) -> Stat:
        """Return the measured pose of the TCP in the base, the state code, the time of measurement,
        the measured joints, and the commanded pose of the TCP."""
        stat: Stat = self._ask("stat")
        return stat

    def inv(self, xd: Target) -> tuple[float, ...]:
        """Return the joint positions (rad, m) for the TCP at `xd`, nearest to the present ones."""
        positions: tuple[float, ...] = self._ask("inv", xd)
        return positions

    def rehearse_line(self, xd: Target) -> Rehearsal:
        """Rehearse the straight line from here to the pose `xd`, without moving."""
        found: Rehearsal = self._ask("rehearse_line", xd)
        return found

    def rehearse_joints(self, q: Sequence[float]) -> Rehearsal:
        """Rehearse the straight motion of all joints to the positions `q`, rad or m."""
        found: Rehearsal = self._ask("rehearse_joints", q)
        return found

    def movj(self, xd: Target) -> Motion:
        """Start moving all joints to the pose `xd`; they arrive together."""
        return self._start("movj", xd)

    def relj(self, xd: Target) -> Motion:
        """Start moving all joints to a pose relative to the present one of the TCP."""
        return self._start("relj", xd)

    def movl(self, xd: Target) -> Motion:
        """Start moving the TCP along a straight line to the pose `xd`."""
        return self._start("movl", xd)

    def retract(self, distance_m: float) -> Motion:
        """Start moving the TCP back by `distance_m` along the tool's own z axis."""
        return self._start("retract", distance_m)

    def movv(self, xdot: Sequence[float]) -> Motion:
        """Start moving the TCP with a constant twist, until something ends it."""
        return self._start("movv", xdot)

    def gcmp(self) -> Motion:
        """Hold the arm's own weight only; a person can lead it."""
        return self._start("gcmp", None)

    def forc(self, fd: Sequence[float]) -> Motion:
        """Exert a constant wrench on the world."""
        return self._start("forc", fd)

    def _start(self, verb: str, value: Any) -> Motion:
        motion: Motion = self._ask(verb, value)
        return motion

    def wait(self, timeout_s: float = 0.0) -> bool:
        """Block until the last movj, relj, movl or retract has ended; return whether it arrived.
        True at once if the last motion is none of these. After `timeout_s` (of the robot's time; 0:
        no limit) stop the motion and return False."""
        arrived: bool = self._ask("wait", timeout_s)
        return arrived

    def stop(self) -> None:
        """Brake along the path, then hold. Needs no authority."""
        self._ask("stop")

    def tool(self, x: Target) -> None:
        """Fix a link to the arm's own TCP in place of the one before; zeros remove it."""
        self._ask("tool", x)

    def act(self, code: Action | int | str) -> None:
        """Close, open or stop the gripper."""
        self._ask("act", code)

    # -- streams ---------------------------------------------------------------------------------

    def pose(self, x: Target, *, owner: str = "", sequence: int | None = None) -> str:
        """Go to the pose `x` now. Return why not, or ""."""
        return self._stream("pose", x, owner, sequence)

    def jog(self, dx: Target, *, owner: str = "", sequence: int | None = None) -> str:
        """Move the target pose by `dx`. Return why not, or ""."""
        return self._stream("jog", dx, owner, sequence)

    def twist(self, xdot: Sequence[float], *, owner: str = "", sequence: int | None = None) -> str:
        """Move with the twist `xdot` now. Return why not, or ""."""
        return self._stream("twist", xdot, owner, sequence)

    def wrench(self, w: Sequence[float], *, owner: str = "", sequence: int | None = None) -> str:
        """Exert the wrench `w` now. Return why not, or ""."""
        return self._stream("wrench", w, owner, sequence)

    def joints(
        self, rates: Sequence[float], *, owner: str = "", sequence: int | None = None
    ) -> str:
        """Move the joints at `rates` (rad/s or m/s) now. Return why not, or ""."""
        return self._stream("joints", rates, owner, sequence)

    def _stream(self, verb: str, value: Any, owner: str, sequence: int | None) -> str:
        try:
            why_not: str = self._ask(verb, value, source=owner, sequence=sequence)
        except MotionRefusedError as error:
            return str(error)
        return why_not

    # -- authority -------------------------------------------------------------------------------

    def acknowledge(self) -> None:
        """Confirm that the arm may move again, after implausible measured joints or a recovery that
        did not bring the command to its robot. Raises MotionRefusedError while it is too early."""
        self._ask("acknowledge")

    def acquire(self, owner: str = "") -> None:
        """Take or renew the authority for the stream `owner`, or, without a name, for this client,
        without moving anything. Raises MotionRefusedError if another source has it."""
        self._ask("acquire", source=owner)

    def hand_over(self, to: str) -> None:
        """Pass the authority over the arm to the source `to`: "device", or a stream's owner. Raises
        MotionRefusedError if this client has none."""
        self._ask("hand_over", to)

    def release(self, owner: str = "") -> None:
        """Give up the authority of the stream `owner`, or, without a name, of this client."""
        self._ask("release", source=owner)

    # -- parameters and status -------------------------------------------------------------------

    def get_parameter(self, key: Key) -> float:
        """A parameter by its code or name."""
        value: float = self._ask("get_parameter", key)
        return value

    def get_parameters(self) -> dict[str, float]:
        """All parameters by name."""
        values: dict[str, float] = self._ask("get_parameters")
        return values

    def set_parameter(self, key: Key, value: Value) -> None:
        """Set a parameter; waits for an arm that is coming to rest."""
        self.set_parameters({key: value})

    def set_parameters(self, values: Mapping[Key, Value]) -> None:
        """Set all of `values`, or none if one is refused."""
        self._ask("set_parameters", values)

    def status(self) -> ControllerStatus:
        """Return the present flags and numbers."""
        status: ControllerStatus = self._ask("status")
        return status
