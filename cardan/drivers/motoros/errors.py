"""Errors of reading and writing a controller's inputs and outputs, besides CommandError."""

from __future__ import annotations

from cardan.errors import DriverError


class IoConnectionError(DriverError):
    """A controller's port for inputs and outputs was not reached, fell silent, or answered
    something else; whether a write had its effect is open."""


class IoRefusedError(DriverError):
    """A controller refused to read or write; the connection stays.

    `result` is its answer: of MotoROS an IoResult, or the subcode of a message it did not know.
    """

    def __init__(self, message: str, result: int) -> None:
        super().__init__(message)
        self.result = result
