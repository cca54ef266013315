"""Simulated EGM controller's datagrams, for tests of the EGM driver."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from cardan.protocols.egm.decode import decode_from_pc
from cardan.protocols.egm.encode import encode_robot
from cardan.protocols.egm.messages import (
    EgmHeader,
    EgmMessageType,
    EgmMotion,
    EgmPose,
    EgmRobot,
    EgmSensor,
    MCIState,
    MotorState,
    RapidState,
)
from cardan.types import Quaternion, Vector3

PERIOD_S = 0.004032
HOME = (0.0, 0.0, 0.0, 0.0, math.radians(30.0), 0.0)
POSITION = Vector3(0.5975, 0.0, 0.83775)
ORIENTATION = Quaternion(0.5, 0.0, math.sqrt(0.75), 0.0)


class Controller:
    """Numbers and stamps datagrams; tests can replace every part of them."""

    def __init__(self, seqno: int = 0, clock_us: int = 1_700_000_000_000_000) -> None:
        self.seqno = seqno
        self.clock_us = clock_us
        self.joints: Sequence[float] = HOME
        self.position = POSITION
        self.orientation = ORIENTATION
        self.external: Sequence[float] | None = None
        self.motors: int | None = MotorState.ON
        self.mci: int | None = MCIState.RUNNING
        self.rapid: int | None = RapidState.RUNNING
        self.fields: dict[str, Any] = {}
        """Further fields of EgmRobot, by name."""

    def message(self) -> EgmRobot:
        """Return the next message; one period passes."""
        motion = EgmMotion(
            joints=tuple(self.joints),
            cartesian=EgmPose(self.position, self.orientation),
            external_joints=None if self.external is None else tuple(self.external),
            time_us=self.clock_us,
        )
        header = EgmHeader(self.seqno, self.clock_us // 1000 & 0xFFFFFFFF, EgmMessageType.DATA)
        parts: dict[str, Any] = {
            "header": header,
            "feed_back": motion,
            "planned": motion,
            "motor_state": self.motors,
            "mci_state": self.mci,
            "mci_convergence_met": False,
            "rapid_exec_state": self.rapid,
        }
        self.seqno = (self.seqno + 1) & 0xFFFFFFFF
        self.clock_us += round(PERIOD_S * 1e6)
        return EgmRobot(**(parts | self.fields))

    def datagram(self) -> bytes:
        """Return the next message, encoded."""
        return encode_robot(self.message())

    def follow(self, answer: bytes) -> EgmSensor:
        """Move to the planned joints or pose of a command; return the command."""
        sensor = sensor_of(answer)
        if sensor.planned is not None:
            if sensor.planned.joints is not None:
                self.joints = sensor.planned.joints
            pose = sensor.planned.cartesian
            if pose is not None and pose.pos is not None and pose.orient is not None:
                self.position, self.orientation = pose.pos, pose.orient
        return sensor


def sensor_of(answer: bytes) -> EgmSensor:
    """Decode the message from the PC."""
    sensor = decode_from_pc(answer)
    assert isinstance(sensor, EgmSensor)
    return sensor


def speeds_of(answer: bytes) -> tuple[float, ...] | None:
    """Return the speed reference in the PC's message, rad/s, or m/s and rad/s."""
    speed_ref = sensor_of(answer).speed_ref
    if speed_ref is None:
        return None
    return speed_ref.joints if speed_ref.joints is not None else speed_ref.cartesians
