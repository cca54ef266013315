"""Errors of reading and writing a controller's inputs and outputs."""

from __future__ import annotations

from cardan.errors import DriverError


class IoConnectionError(DriverError):
    """The port for inputs and outputs was not reached, fell silent, or sent another answer; it is
    unknown whether a write had its effect."""


class IoRefusedError(DriverError):
    """A controller refused to read or write; the connection stays.

    `result` is MotoROS's IoResult, or the subcode of a message that it did not know.
    """

    def __init__(self, message: str, result: int) -> None:
        super().__init__(message)
        self.result = result
