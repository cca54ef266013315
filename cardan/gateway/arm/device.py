"""A robot arm with the verbs of the Cartesian interface: a driver, a controller and one thread."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import TracebackType

from cardan.drivers.base import OperatorDevice, RobotDriver
from cardan.errors import CommandError, DriverError, MotionLoopError, MotionRefusedError
from cardan.gateway.arm.authority import VERBS
from cardan.gateway.arm.checks import Target
from cardan.gateway.arm.codes import Action, Parameter, State
from cardan.gateway.arm.loop import ArmLoop
from cardan.gateway.arm.motion import ControllerStatus, Motion, Outcome, Stat
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.arm.parameters import Key, Value
from cardan.gateway.arm.verbs import ArmVerbs
from cardan.gateway.hand.mapping import MappingOptions
from cardan.gateway.kinematics.collision import Obstacle
from cardan.robots import ArmModel, BodyShape, load_arm

POLL_S = 0.05
"""Longest time between two looks at whether the loop still runs."""

START_TIMEOUT_S = 5.0
"""For which open() waits until the robot is heard, and close() until the loop has ended."""

REST_TIMEOUT_S = 10.0
"""Robot time within which any motion has braked to rest."""


def digital_output_gripper(robot: RobotDriver) -> Callable[[Action], None]:
    """A gripper that closes while the controller's digital output is set; it cannot stop half way.

    Raises CommandError, when used, for a stop and for a robot without such an output.
    """

    def act(action: Action) -> None:
        if action is Action.STOP:
            raise CommandError("a gripper on a digital output cannot stop half way")
        robot.set_outputs(digital=action is Action.CLOSE)

    return act


class _Bell:
    """Rung after every tick; costs nothing while nobody listens."""

    def __init__(self) -> None:
        self._condition = threading.Condition()
        self._listeners = 0

    def ring(self) -> None:
        """Wake up who listens."""
        if self._listeners:
            with self._condition:
                self._condition.notify_all()

    def wait(self, timeout_s: float) -> None:
        """Until it rings, or the time is over."""
        self._listeners += 1
        try:
            with self._condition:
                self._condition.wait(timeout_s)
        finally:
            self._listeners -= 1

    def wait_for(self, done: Callable[[], bool], timeout_s: float) -> None:
        """Until `done` after a ring, or the time is over."""
        self._listeners += 1
        try:
            with self._condition:
                self._condition.wait_for(done, timeout_s)
        finally:
            self._listeners -= 1


class CartesianDevice:
    """An arm with the verbs movj, movl, ... of the Cartesian interface, for any thread.

    ::

        with CartesianDevice(SimArm(), arm="ur5") as arm:
            arm.movj([0.4, 0.1, 0.4, 3.14, 0.0, 0.0])
            arm.wait()

    A verb that is refused raises MotionRefusedError and changes nothing. One that takes over from
    a motion under way blocks until that one is braked to rest; if from there it turns out
    impossible, it is refused and the arm stays at rest. All raise MotionLoopError once the loop
    has ended.
    """

    def __init__(
        self,
        robot: RobotDriver,
        arm: str | ArmModel,
        options: ControllerOptions | None = None,
        *,
        obstacles: Iterable[Obstacle] = (),
        tool_shapes: Iterable[BodyShape] = (),
        gripper: Callable[[Action], None] | None = None,
        device: OperatorDevice | None = None,
        mapping: MappingOptions | None = None,
    ) -> None:
        """`arm`: a model, its name or its file. `gripper` is called in the loop's thread. An
        operator `device` moves the arm as `mapping` says, and takes it from the verbs.

        Raises ConfigurationError.
        """
        self.robot = robot
        model = load_arm(arm) if isinstance(arm, str) else arm
        self._act = gripper
        self.device = device
        self.verbs = ArmVerbs.alone(
            model,
            robot.capabilities,
            options,
            obstacles=obstacles,
            tool_shapes=tool_shapes,
            gripper=None if gripper is None else self._act_in_loop,
            mapping=None if device is None else mapping or MappingOptions(),
        )
        self._actions: deque[tuple[Action, list[Exception | None]]] = deque()
        self._ticked = _Bell()
        self._requests = threading.RLock()
        """One request that may wait for the arm to rest at a time."""
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()
        self._failure: BaseException | None = None

    # -- open and close --------------------------------------------------------------------------

    def open(self) -> None:
        """Open the driver and start the loop; returns when the robot's first state is there.

        A robot that stays silent is no error: `stat` and all motions say so. Raises DriverError.
        """
        if self._thread is not None:
            return
        if self.device is not None:
            self.device.open()
        try:
            self.robot.open()
        except BaseException:
            if self.device is not None:
                self.device.close()
            raise
        self._closing.clear()
        self._failure = None
        self._thread = threading.Thread(target=self._loop, name="cartesian", daemon=True)
        self._thread.start()
        self._ticked.wait_for(
            lambda: self.verbs.stamp_s > -math.inf or not self._running, START_TIMEOUT_S
        )

    def close(self) -> None:
        """Brake to rest, end the loop and close the driver. Never raises; twice is fine."""
        thread = self._thread
        if thread is None:
            return
        self.verbs.stop()
        self._ticked.wait_for(lambda: self.verbs.at_rest or not self._running, START_TIMEOUT_S)
        self._closing.set()
        thread.join(START_TIMEOUT_S)
        self.robot.close()
        if self.device is not None:
            self.device.close()
        self._thread = None

    def __enter__(self) -> CartesianDevice:
        self.open()
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    # -- requests --------------------------------------------------------------------------------

    def stat(self) -> Stat:
        """Measured pose of the TCP in the base, state code, time of the measurement."""
        self._require_loop()
        return self.verbs.stat()

    def inv(self, xd: Target) -> tuple[float, ...]:
        """Joint positions (rad, m) with the TCP at `xd`, nearest to now."""
        self._require_loop()
        return self.verbs.inv(xd)

    def movj(self, xd: Target) -> Motion:
        """Start moving all joints to the pose `xd`; they arrive together."""
        return self._start(lambda: self.verbs.movj(xd))

    def relj(self, xd: Target) -> Motion:
        """Start the same to a pose relative to where the TCP is."""
        return self._start(lambda: self.verbs.relj(xd))

    def movl(self, xd: Target) -> Motion:
        """Start moving the TCP along a straight line to the pose `xd`."""
        return self._start(lambda: self.verbs.movl(xd))

    def movv(self, xdot: Sequence[float]) -> Motion:
        """Start moving the TCP with a constant twist, until something ends it."""
        return self._start(lambda: self.verbs.movv(xdot))

    def gcmp(self) -> Motion:
        """Carry the arm's own weight; it can be led by hand."""
        return self._start(self.verbs.gcmp)

    def forc(self, fd: Sequence[float]) -> Motion:
        """Exert a constant wrench on the world."""
        return self._start(lambda: self.verbs.forc(fd))

    def wait(self, timeout_s: float = 0.0) -> bool:
        """Block until the last movj, relj or movl has ended; True when it arrived.

        True at once where the last motion is none of these. After `timeout_s` (of the robot's
        time; 0: for ever) the motion is stopped and the answer is False.
        """
        if not 0.0 <= timeout_s < math.inf:
            raise MotionRefusedError(f"wait: a timeout is a number >= 0, not {timeout_s}")
        verbs = self.verbs
        motion = verbs.waited_for
        if motion is None or not motion.ends:
            return True
        began_s = verbs.stamp_s
        period_s = 1e-3 * verbs.get_parameter(Parameter.WAIT_PERIOD)
        while not motion.over:
            self._require_loop()
            if timeout_s > 0.0 and verbs.stamp_s - began_s > timeout_s:
                verbs.stop()
                return False
            self._ticked.wait(period_s)
        return motion.outcome is Outcome.DONE

    def stop(self) -> None:
        """Brake along the path, then hold. Always works."""
        self.verbs.stop()

    def tool(self, x: Target) -> None:
        """Fix a link to the arm's own TCP, in place of the one before; zeros take it off."""
        with self._requests:
            self._settle()
            self.verbs.tool(x)

    def act(self, code: Action | int | str) -> None:
        """Close, open or stop the gripper."""
        self._require_loop()
        self.verbs.act(code)

    # -- streams ---------------------------------------------------------------------------------

    def pose(self, x: Target, *, owner: str = "", sequence: int | None = None) -> str:
        """Go to the pose `x` now. Answers why not, or ""."""
        self._require_loop()
        return self.verbs.pose(x, owner=owner, sequence=sequence)

    def jog(self, dx: Target, *, owner: str = "", sequence: int | None = None) -> str:
        """Move the pose that is gone to by `dx`. Answers why not, or ""."""
        self._require_loop()
        return self.verbs.jog(dx, owner=owner, sequence=sequence)

    def twist(self, xdot: Sequence[float], *, owner: str = "", sequence: int | None = None) -> str:
        """Move with the twist `xdot` now. Answers why not, or ""."""
        self._require_loop()
        return self.verbs.twist(xdot, owner=owner, sequence=sequence)

    def wrench(self, w: Sequence[float], *, owner: str = "", sequence: int | None = None) -> str:
        """Exert the wrench `w` now. Answers why not, or ""."""
        self._require_loop()
        return self.verbs.wrench(w, owner=owner, sequence=sequence)

    def joints(
        self, rates: Sequence[float], *, owner: str = "", sequence: int | None = None
    ) -> str:
        """Move the joints at `rates` (rad/s or m/s) now. Answers why not, or ""."""
        self._require_loop()
        return self.verbs.joints(rates, owner=owner, sequence=sequence)

    # -- authority -------------------------------------------------------------------------------

    def acknowledge(self) -> None:
        """The deliberate act after measured joints were not believed, or the command did not come
        together with its robot. Raises MotionRefusedError while it is too early."""
        self._require_loop()
        self.verbs.acknowledge()

    def hand_over(self, to: str) -> None:
        """Pass the authority over the arm on to the source `to`: "hand", or who streams.

        Raises MotionRefusedError where it is not ours.
        """
        self.verbs.hand_over(to)

    def release(self, owner: str = "") -> None:
        """Give up the authority of whoever streams as `owner`, or, nameless, of the verbs."""
        self.verbs.release(owner or VERBS)

    # -- parameters and status -------------------------------------------------------------------

    def get_parameter(self, key: Key) -> float:
        """A parameter by its code or name."""
        return self.verbs.get_parameter(key)

    def get_parameters(self) -> dict[str, float]:
        """All parameters by name."""
        return self.verbs.get_parameters()

    def set_parameter(self, key: Key, value: Value) -> None:
        """Set a parameter; waits for an arm that is coming to rest."""
        self.set_parameters({key: value})

    def set_parameters(self, values: Mapping[Key, Value]) -> None:
        """Set all of `values`, or none where one is refused."""
        with self._requests:
            self._settle()
            self.verbs.set_parameters(values)

    def status(self) -> ControllerStatus:
        """Flags and numbers of now."""
        return self.verbs.status()

    # -- the loop --------------------------------------------------------------------------------

    @property
    def _running(self) -> bool:
        return self._thread is not None and self._thread.is_alive()

    def _loop(self) -> None:
        ticked = self._ticked
        try:
            for _ in ArmLoop(self.robot, self.verbs.controller, self.device).cycles():
                while self._actions:
                    self._do(*self._actions.popleft())
                ticked.ring()
                if self._closing.is_set():
                    break
        except Exception as error:
            self._failure = error
        finally:
            # Nobody drives any more, so nothing may seem to be under way.
            self.verbs.stop()
            while self._actions:
                self._actions.popleft()[1].append(DriverError("the loop has ended"))
            ticked.ring()

    def _do(self, action: Action, answer: list[Exception | None]) -> None:
        assert self._act is not None
        try:
            self._act(action)
        except Exception as error:
            answer.append(error)
        else:
            answer.append(None)

    def _act_in_loop(self, action: Action) -> None:
        answer: list[Exception | None] = []
        self._actions.append((action, answer))
        while not answer:
            self._require_loop()
            self._ticked.wait(POLL_S)
        if answer[0] is not None:
            raise answer[0]

    def _require_loop(self) -> None:
        if self._running:
            return
        if self._thread is None:
            raise MotionLoopError("the arm is not open")
        why = f": {self._failure}" if self._failure is not None else ""
        raise MotionLoopError(f"the loop that drives the arm has ended{why}")

    def _start(self, verb: Callable[[], Motion]) -> Motion:
        """Start a motion, after the one before has come to rest."""
        with self._requests:
            self._require_loop()
            motion = verb()
            while motion.outcome is Outcome.WAITING:
                self._require_loop()
                if self.verbs.start_pending() is None:
                    self._ticked.wait(POLL_S)
            if motion.error is not None:
                raise motion.error
            return motion

    def _settle(self) -> None:
        """Wait for an arm that is on its way to rest, so that what needs rest is not refused."""
        self._require_loop()
        verbs = self.verbs
        began_s = verbs.stamp_s
        while (
            verbs.status().braking
            and verbs.state is State.NOT_CONTROLLING
            and verbs.stamp_s - began_s < REST_TIMEOUT_S
        ):
            self._require_loop()
            self._ticked.wait(POLL_S)
