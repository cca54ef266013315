"""Requests to the remote, one at a time: memory, camera switches and status, with answers.

A remote accepts a memory operation only after the reply to the previous one, and the camera ends in
a random state if its start-up does not wait.
"""

from __future__ import annotations

from typing import NamedTuple

from cardan.types import NEVER_S
from cardan_wiimote.protocol import (
    READ_MEMORY_ID,
    WRITE_MEMORY_ID,
    Ack,
    ErrorCode,
    ReadData,
    ReadMemory,
    Status,
    StatusRequest,
    Switch,
    WriteMemory,
    encode_output,
)

TIMEOUT_S = 1.0
"""Allows for a remote that was just woken."""

TRIES = 3
"""Number of attempts of a request without an answer."""

BUSY_TRIES, BUSY_PAUSE_S = 20, 0.05
"""Number of attempts with a busy remote, and the pause between."""

WiimoteRequest = ReadMemory | WriteMemory | Switch | StatusRequest


class Answer(NamedTuple):
    """Result of a request."""

    error: int | None = None
    """An `ErrorCode`; None: no answer to any attempt."""
    data: bytes = b""
    """Data read."""

    @property
    def ok(self) -> bool:
        """True if the remote executed it."""
        return self.error == ErrorCode.SUCCESS


NO_ANSWER = Answer()


class Requests:
    """Present request. Times are monotonic, s."""

    def __init__(self) -> None:
        self.timeouts = 0
        self.foreign = 0
        """Number of answers to requests of another program or the kernel's driver."""
        self._request: WiimoteRequest | None = None
        self._report = b""
        self._data = bytearray()
        self._tries = self._busy = 0
        self._send_s = NEVER_S
        """Time of sending, past or future."""
        self._sent = False

    def ask(self, request: WiimoteRequest) -> None:
        """Make `request` in place of any earlier one."""
        self._request = request
        self._report = encode_output(request)
        self._data.clear()
        self._tries = self._busy = 0
        self._sent = False
        self._send_s = NEVER_S

    def reset(self) -> None:
        """Discard pending requests."""
        self._request = None

    def poll(self, now_s: float) -> bytes | Answer | None:
        """Return a report to send now, or `NO_ANSWER` if the request has failed, or None."""
        if self._request is None:
            return None
        if not self._sent:
            if now_s < self._send_s:
                return None
        elif now_s - self._send_s < TIMEOUT_S:
            return None
        else:
            self.timeouts += 1
        if self._tries >= TRIES:
            self._request = None
            return NO_ANSWER
        self._tries += 1
        self._sent = True
        self._send_s = now_s
        self._data.clear()
        return self._report

    def on_input(self, value: ReadData | Ack | Status, now_s: float) -> Answer | None:
        """Return the result of the request if `value` completes it."""
        request = self._request
        if isinstance(value, Status):
            if isinstance(request, StatusRequest) and self._sent:
                return self._end(Answer(ErrorCode.SUCCESS))
            return None
        if request is None or not self._sent or not self._answers(request, value):
            self.foreign += 1
            return None
        if value.error == ErrorCode.BUSY:
            self._busy += 1
            if self._busy >= BUSY_TRIES:
                return self._end(Answer(value.error))
            self._sent = False
            self._tries = 0
            self._send_s = now_s + BUSY_PAUSE_S
            return None
        if value.error:
            return self._end(Answer(value.error))
        if isinstance(value, Ack):
            # The acknowledgment of a read without an error announces its data.
            return None if isinstance(request, ReadMemory) else self._end(Answer(value.error))
        assert isinstance(request, ReadMemory)
        self._data += value.data
        if len(self._data) < request.size:
            return None
        return self._end(Answer(value.error, bytes(self._data[: request.size])))

    def _answers(self, request: WiimoteRequest, value: ReadData | Ack) -> bool:
        if isinstance(value, ReadData):
            return (
                isinstance(request, ReadMemory)
                and value.address == request.address + len(self._data) & 0xFFFF
            )
        if isinstance(request, ReadMemory):
            return value.report_id == READ_MEMORY_ID
        if isinstance(request, WriteMemory):
            return value.report_id == WRITE_MEMORY_ID
        return isinstance(request, Switch) and value.report_id == request.report_id

    def _end(self, answer: Answer) -> Answer:
        self._request = None
        return answer
