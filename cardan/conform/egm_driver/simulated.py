"""Our own driver, with the defects it is told to have, and a scenario in virtual time."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.conform.egm_driver.faults import FAULTS
from cardan.conform.egm_driver.scenario import FIRST, SECOND
from cardan.conform.rigs import DriverRig
from cardan.conform.runner import Exchange
from cardan.drivers.abb_egm.options import AbbEgmOptions
from cardan.drivers.abb_egm.session import EgmSession
from cardan.protocols import egm
from cardan.types import HoldCommand, Quaternion, Vector3

_PORTS = {FIRST: 49_152, SECOND: 49_153}
_CHANNELS = {port: channel for channel, port in _PORTS.items()}


class EgmDriverRig(DriverRig):
    """Gives the driver's core what the scenario sends, and the scenario what it answers."""

    def __init__(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        super().__init__(exchange, faults, FAULTS)
        self._session = EgmSession(AbbEgmOptions(comm_timeout_s=5.0), 0.0)
        self._asked = self._answered = 0
        self._seqno = 0
        self._reference: egm.EgmMotion | None = None
        self._heard_s = 0.0
        self._chatter_s = 0.0
        self._ended = False

    def _take(self, data: bytes, channel: str) -> None:
        faults = self._faults
        message = egm.decode_robot(data)
        is_robot = isinstance(message, egm.EgmRobot)
        if self._ended or faults.get("mute"):
            return
        if faults.get("gives-up") and not is_robot:
            self._ended = True
            return
        if faults.get("one-port") and channel != FIRST:
            return
        self._heard_s = self._now_s
        state = self._session.receive(data, ("127.0.0.1", _PORTS[channel]), self._now_s)
        if self._session.handover is not None:
            words, (_, port) = self._session.handover
            self._session.handover = None
            self._send(words, _CHANNELS[port])
        self._session.tick(self._now_s)
        if state is None:
            if faults.get("answers-old") and is_robot and self._reference is not None:
                header = egm.EgmHeader(self._next_seqno(), None, 3)
                self._send(egm.encode_sensor(egm.EgmSensor(header, self._reference)), channel)
            return
        answer = self._session.reply(HoldCommand(), self._now_s)
        self._session.answered(self._now_s)
        self._asked += 1
        if self._every("lazy", self._asked, most=True):
            return
        self._answered += 1
        self._send(self._spoilt(answer, message), channel)
        if self._every("twice", self._answered):
            self._send(self._spoilt(answer, message), channel)

    def _next_seqno(self) -> int:
        self._seqno += int(self._faults.get("step-2", 1.0))
        return self._seqno

    def _spoilt(self, answer: bytes, message: object) -> bytes:
        """`answer` as a driver with these defects would give it."""
        faults = self._faults
        if not faults:
            return answer
        sensor = egm.decode_from_pc(answer)
        assert isinstance(sensor, egm.EgmSensor)
        assert sensor.header is not None
        assert isinstance(message, egm.EgmRobot)
        planned = sensor.planned
        mtype = int(faults.get("mtype", sensor.header.mtype))
        header = egm.EgmHeader(self._next_seqno(), sensor.header.tm_ms, mtype)
        if faults.get("stale") and self._reference is not None:
            planned = self._reference
        self._reference = self._reference or planned
        speed = sensor.speed_ref
        if planned is not None and planned.cartesian is not None and planned.cartesian.pos:
            pose = planned.cartesian
            assert pose.pos is not None
            x, y, z = pose.pos
            if "leap" in faults and self._answered % 100 == 0:
                z += 1e-3 * faults["leap"]
            if "obstinate" in faults and message.mci_state != 3:
                z += 1e-3 * faults["obstinate"]
            if faults.get("stale") and message.header and message.header.seqno == 0:
                z += 0.01
            orient = pose.orient
            if orient is not None and "quaternion" in faults:
                orient = Quaternion(*(faults["quaternion"] * u for u in orient))
            planned = planned._replace(cartesian=pose._replace(pos=Vector3(x, y, z), orient=orient))
        if self._every("empty", self._answered):
            planned = speed = None
        data = egm.encode_sensor(egm.EgmSensor(header, planned, speed, sensor.rapid_to_robot))
        return data[:-7] if self._every("truncated", self._answered) else data

    def _send(self, data: bytes, channel: str) -> None:
        self._later(1e-3 * self._faults.get("late", 0.2), lambda: self._hear(channel, data))

    def _turn(self) -> None:
        every_s = 1e-3 * self._faults.get("chatters", 0.0)
        silent = self._now_s - self._heard_s > 0.05
        if every_s and silent and self._reference and self._now_s >= self._chatter_s:
            self._chatter_s = self._now_s + every_s
            header = egm.EgmHeader(self._next_seqno(), None, 3)
            self._send(egm.encode_sensor(egm.EgmSensor(header, self._reference)), FIRST)

    def _by_hand(self, what: str) -> None:
        """The driver's program ends, with a last message where it owes one."""
        words = self._session.final_command(self._now_s)
        if "leaves-moving" in self._faults:
            speed = egm.EgmSpeedRef(
                cartesians=(1e-3 * self._faults["leaves-moving"], 0, 0, 0, 0, 0)
            )
            header = egm.EgmHeader(self._next_seqno(), None, 3)
            words = egm.encode_sensor(egm.EgmSensor(header, self._reference, speed))
        if words is not None:
            self._send(words, SECOND)
        self._ended = True
