"""A robot arm with the verbs of the Cartesian interface: a driver, a controller and one thread."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterable
from typing import Any

from cardan.common.forks import give_up_in_children
from cardan.common.resource_errors import shortage
from cardan.drivers.base import OperatorDevice, RobotDriver
from cardan.drivers.foreign import RobotCalls, close_in_order
from cardan.errors import CommandError
from cardan.gateway.arm.interface import CartesianArm
from cardan.gateway.arm.loop import ArmLoop
from cardan.gateway.arm.loop_link import NOT_OPEN, LoopLink
from cardan.gateway.arm.options import ControllerOptions
from cardan.gateway.arm.verb_methods import ArmVerbs
from cardan.gateway.arm.verb_server import VerbServer
from cardan.gateway.arm.vocab import Action
from cardan.gateway.kinematics.collision import Obstacle
from cardan.gateway.operator.mapping import MappingOptions
from cardan.robots import ArmModel, BodyShape, load_arm, require_same_arm

START_TIMEOUT_S = 5.0
"""How long open() waits for the robot's first state, and close() for the end of the loop."""


def digital_output_gripper(robot: RobotDriver) -> Callable[[Action], None]:
    """A gripper that closes while the controller's digital output is set; it cannot stop half way.

    Raises CommandError, when used, for a stop and for a robot without such an output.
    """

    def carry_out(action: Action) -> None:
        if action is Action.STOP:
            raise CommandError("a gripper on a digital output cannot stop half way")
        with RobotCalls(robot):
            robot.set_outputs(digital=action is Action.CLOSE)

    return carry_out


class CartesianDevice(CartesianArm):
    """The Cartesian interface of an arm whose loop runs in a thread of this process.

    ::

        with CartesianDevice(SimArm(), arm="ur5") as arm:
            arm.movj([0.4, 0.1, 0.4, 3.14, 0.0, 0.0])
            arm.wait()

    The same for a loop in another process is :class:`cardan.gateway.arm.remote_arm.RemoteArm`.
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
        operator `device` moves the arm by `mapping`, and takes precedence over the verbs.

        Raises ConfigurationError.
        """
        self.robot = robot
        model = load_arm(arm) if isinstance(arm, str) else arm
        if isinstance(arm, str):
            require_same_arm("arm", arm, robot.capabilities.robot)
        self.device = device
        self._link = link = LoopLink()
        self.verbs = ArmVerbs.alone(
            model,
            robot.capabilities,
            options,
            obstacles=obstacles,
            tool_shapes=tool_shapes,
            gripper=None if gripper is None else lambda action: link.do(lambda: gripper(action)),
            mapping=None if device is None else mapping or MappingOptions(),
        )
        self._verb_server = VerbServer(self.verbs, link)
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()

    # -- open and close --------------------------------------------------------------------------

    def open(self) -> None:
        """Open the driver and start the loop; returns when the robot's first state is there.

        A silent robot is no error here: `stat` and all motions report it. Raises DriverError.
        """
        if self._thread is not None:
            return
        if self.device is not None:
            self.device.open()
        try:
            self.robot.open()
        except BaseException:
            if self.device is not None:
                close_in_order(self.device)
            raise
        self._closing.clear()
        self._link.begin()
        give_up_in_children(self)
        self._thread = threading.Thread(target=self._loop, name="cartesian", daemon=True)
        self._thread.start()
        self._link.wait_for(
            lambda: self.verbs.stamp_s > -math.inf or not self._link.running, START_TIMEOUT_S
        )

    def close(self) -> None:
        """Brake to rest, give up the authority, end the loop and close the driver. Never raises;
        idempotent."""
        thread = self._thread
        if thread is None:
            return
        self.verbs.stop()
        self.verbs.release(self.source)
        self._link.wait_for(lambda: self.verbs.at_rest or not self._link.running, START_TIMEOUT_S)
        self._closing.set()
        thread.join(START_TIMEOUT_S)
        close_in_order(self.robot)
        if self.device is not None:
            close_in_order(self.device)
        self._thread = None
        self._link.end(NOT_OPEN)

    def after_fork(self) -> None:
        """Give up robot, device and loop in a forked child: the arm stays the parent's."""
        self._thread = None

    def _ask(
        self, verb: str, value: Any = None, *, source: str = "", sequence: int | None = None
    ) -> Any:
        return self._verb_server.perform(verb, source or self.source, value, sequence)

    def _loop(self) -> None:
        link, why = self._link, "the loop that drives the arm has ended"
        try:
            for _ in ArmLoop(self.robot, self.verbs.controller, self.device).cycles():
                link.run_due()
                if self._closing.is_set():
                    break
        except Exception as error:
            why = f"{why}: {shortage(error) or error}"
        finally:
            # The loop has ended: no motion may seem to be under way.
            self.verbs.stop()
            link.end(why)
