"""A PC in virtual time: runs a simulated controller's cycles and answers its datagrams."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable

from cardan.protocols.egm.decode import decode_robot
from cardan.protocols.egm.encode import encode_path_corr, encode_sensor
from cardan.protocols.egm.messages import (
    EgmHeader,
    EgmMessageType,
    EgmMotion,
    EgmPose,
    EgmRobot,
    EgmSensor,
    EgmSensorPathCorr,
    EgmSpeedRef,
)
from cardan.sim_peers.egm_controller import EgmController, EgmControllerOptions
from cardan.types import Quaternion, Vector3

START_DEG = (0.0, 0.0, 0.0, 0.0, 30.0, 0.0)
TS = 0.004032

Reply = Callable[[EgmRobot], "EgmSensor | EgmSensorPathCorr | bytes | None"]


class Pc:
    """Simulated PC that owns the controller's core; `run` advances both."""

    def __init__(self, steps: str = "", **options: object) -> None:
        """`steps`: text of a script, in place of the option `script`."""
        with tempfile.NamedTemporaryFile("w", suffix=".txt") as file:
            if steps:
                file.write(steps)
                file.flush()
                options["script"] = file.name
            self.core = EgmController(EgmControllerOptions(**options))  # type: ignore[arg-type]
        self.cycles = 0
        self.received: list[EgmRobot] = []
        self.raw: list[bytes] = []
        self.times: list[float] = []
        self.seqno = 0

    @property
    def now_s(self) -> float:
        return self.cycles * self.core.options.period_s

    @property
    def last(self) -> EgmRobot:
        return self.received[-1]

    def step(self, reply: Reply | None = None) -> EgmRobot | None:
        now_s = self.now_s
        data = self.core.cycle(now_s)
        self.cycles += 1
        if data is None:
            return None
        message = decode_robot(data)
        assert isinstance(message, EgmRobot), message
        self.raw.append(data)
        self.received.append(message)
        self.times.append(now_s)
        answer = reply(message) if reply is not None else None
        if answer is not None:
            self.send(answer)
        return message

    def send(self, answer: EgmSensor | EgmSensorPathCorr | bytes) -> None:
        if isinstance(answer, EgmSensor):
            answer = encode_sensor(answer)
        elif isinstance(answer, EgmSensorPathCorr):
            answer = encode_path_corr(answer)
        self.core.receive(answer)

    def run(self, seconds: float, reply: Reply | None = None) -> list[EgmRobot]:
        """Return the messages of the next `seconds`."""
        before = len(self.received)
        for _ in range(round(seconds / self.core.options.period_s)):
            self.step(reply)
        return self.received[before:]

    def header(self, mtype: int = EgmMessageType.CORRECTION) -> EgmHeader:
        self.seqno += 1
        return EgmHeader(self.seqno, round(self.now_s * 1e3), mtype)

    def joints(self, *deg: float, speeds_deg_s: tuple[float, ...] | None = None) -> Reply:
        """Answer always with these joints."""
        position = tuple(map(math.radians, deg)) or None
        speeds = tuple(map(math.radians, speeds_deg_s)) if speeds_deg_s else None
        return lambda _message: EgmSensor(
            self.header(),
            EgmMotion(joints=position) if position else None,
            EgmSpeedRef(joints=speeds) if speeds else None,
        )

    def pose(
        self,
        position: Vector3 | None = None,
        orientation: Quaternion | None = None,
        euler: Vector3 | None = None,
        speeds: tuple[float, ...] | None = None,
    ) -> Reply:
        """Answer always with this pose."""
        pose = EgmPose(position, orientation, euler)
        return lambda _message: EgmSensor(
            self.header(),
            EgmMotion(cartesian=pose) if pose != EgmPose(None, None) else None,
            EgmSpeedRef(cartesians=speeds) if speeds else None,
        )

    @property
    def joints_deg(self) -> tuple[float, ...]:
        """Return the true joint positions of the arm."""
        return tuple(map(math.degrees, self.core.joints_rad))

    @property
    def codes(self) -> list[int]:
        """Return the numbers of the event log's entries."""
        return [event.code for event in self.core.events]


def echo(message: EgmRobot) -> EgmSensor:
    """Answer with the measured position, which holds still."""
    assert message.feed_back is not None
    assert message.header is not None
    return EgmSensor(
        EgmHeader(message.header.seqno, message.header.tm_ms, EgmMessageType.CORRECTION),
        EgmMotion(
            joints=message.feed_back.joints,
            cartesian=message.feed_back.cartesian._replace(euler=None)
            if message.feed_back.cartesian
            else None,
        ),
    )
