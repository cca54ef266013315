"""Filter between a client of EGM and its port that alters its answers and hides received datagrams
as a client with these defects would."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from cardan.protocols.egm.decode import decode_from_pc
from cardan.protocols.egm.encode import encode_sensor
from cardan.protocols.egm.messages import (
    EgmHeader,
    EgmMessageType,
    EgmMotion,
    EgmPose,
    EgmRobot,
    EgmSensor,
    EgmSpeedRef,
    MCIState,
)
from cardan.sim_peers.base import strikes
from cardan.types import Quaternion, Vector3

JUMP_EVERY = 100
SILENT_S = 0.05
STALE_M = 0.01
"""How far an old target lies away in a new session."""


class EgmClientDefects:
    """Defects of one client. Times that it gets, s, never go back."""

    def __init__(self, faults: Mapping[str, float]) -> None:
        """`faults`: values of `FAULTS`, by their names."""
        self._faults = faults
        self._asked = self._answered = 0
        self._seqno = 0
        self._reference: EgmMotion | None = None
        self._heard_s = 0.0
        self._chatter_s = 0.0
        self._ended = False

    def hears(self, message: object, on_first_port: bool, now_s: float) -> bool:
        """Return True if the client accepts the datagram, from the first port or another."""
        faults = self._faults
        if self._ended or faults.get("mute"):
            return False
        if faults.get("gives-up") and not isinstance(message, EgmRobot):
            self._ended = True
            return False
        if faults.get("one-port") and not on_first_port:
            return False
        self._heard_s = now_s
        return True

    def ignored(self, message: object) -> Iterator[bytes]:
        """Yield the answers to a message that a client without defects does not answer."""
        if self._faults.get("answers-old") and isinstance(message, EgmRobot):
            yield from self._as_before()

    def said(self, answer: bytes, message: object) -> Iterator[bytes]:
        """Yield the datagrams sent in place of `answer` to `message`."""
        self._asked += 1
        if "lazy" in self._faults and not strikes(self._faults, "lazy", self._asked):
            return
        self._answered += 1
        yield self._spoilt(answer, message)
        if strikes(self._faults, "twice", self._answered):
            yield self._spoilt(answer, message)

    def unasked(self, now_s: float) -> Iterator[bytes]:
        """Yield the datagrams sent while the controller is silent."""
        every_s = 1e-3 * self._faults.get("chatters", 0.0)
        if every_s and now_s - self._heard_s > SILENT_S and now_s >= self._chatter_s:
            for data in self._as_before():
                self._chatter_s = now_s + every_s
                yield data

    def last(self, words: bytes | None) -> bytes | None:
        """Return the datagram sent in place of the last message; None: nothing."""
        self._ended = True
        if "leaves-moving" not in self._faults:
            return words
        speed = (1e-3 * self._faults["leaves-moving"], 0, 0, 0, 0, 0)
        return self._message(self._reference, EgmSpeedRef(cartesians=speed))

    def _as_before(self) -> Iterator[bytes]:
        """Repeat the first reference, if there was one."""
        if self._reference is not None:
            yield self._message(self._reference)

    def _message(self, planned: EgmMotion | None, speed: EgmSpeedRef | None = None) -> bytes:
        header = EgmHeader(self._next_seqno(), None, EgmMessageType.CORRECTION)
        return encode_sensor(EgmSensor(header, planned, speed))

    def _next_seqno(self) -> int:
        self._seqno += int(self._faults.get("step-2", 1.0))
        return self._seqno

    def _spoilt(self, answer: bytes, message: object) -> bytes:
        """Return `answer` altered by these defects."""
        faults = self._faults
        if not faults:
            return answer
        sensor = decode_from_pc(answer)
        assert isinstance(sensor, EgmSensor)
        assert sensor.header is not None
        assert isinstance(message, EgmRobot)
        planned = sensor.planned
        mtype = int(faults.get("mtype", sensor.header.mtype))
        header = EgmHeader(self._next_seqno(), sensor.header.tm_ms, mtype)
        if faults.get("stale") and self._reference is not None:
            planned = self._reference
        self._reference = self._reference or planned
        speed = sensor.speed_ref
        if planned is not None and planned.cartesian is not None and planned.cartesian.pos:
            planned = planned._replace(cartesian=self._moved(planned.cartesian, message))
        if strikes(faults, "empty", self._answered):
            planned = speed = None
        data = encode_sensor(EgmSensor(header, planned, speed, sensor.rapid_to_robot))
        return data[:-7] if strikes(faults, "truncated", self._answered) else data

    def _moved(self, pose: EgmPose, message: EgmRobot) -> EgmPose:
        faults = self._faults
        assert pose.pos is not None
        x, y, z = pose.pos
        if "jump" in faults and self._answered % JUMP_EVERY == 0:
            z += 1e-3 * faults["jump"]
        if "obstinate" in faults and message.mci_state != MCIState.RUNNING:
            z += 1e-3 * faults["obstinate"]
        if faults.get("stale") and message.header and message.header.seqno == 0:
            z += STALE_M
        orient = pose.orient
        if orient is not None and "quaternion" in faults:
            orient = Quaternion(*(faults["quaternion"] * u for u in orient))
        return pose._replace(pos=Vector3(x, y, z), orient=orient)
