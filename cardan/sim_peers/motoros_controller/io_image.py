"""Inputs, outputs and registers of the simulated controller, as clients read and write them.

Sans-I/O. Ranges, checks and result codes are those of MotoROS's IoServer.c for a YRC1000.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from cardan.errors import ScriptError
from cardan.protocols.simple_message.codes import IoResult, MessageType, ReplyCode
from cardan.protocols.simple_message.io_addresses import (
    ADDRESS_RANGES,
    READABLE_REGISTERS,
    WRITABLE_REGISTERS,
    AddressRange,
)
from cardan.protocols.simple_message.messages import (
    Body,
    Message,
    ReadIo,
    ReadIoReply,
    ReadRegister,
    ReadRegisterReply,
    WriteIo,
    WriteIoReply,
    WriteRegister,
    WriteRegisterReply,
    reply,
)

FIRST_REGISTER = 1_000_000
"""Added to the number of a register that is below it."""
LARGEST_REGISTER_VALUE = 0xFFFF
LARGEST_GROUP_VALUE = 0xFF
LAST_BIT = 7
"""Bit addresses end in 0 to 7: the next group of eight begins ten higher."""

BIT_AND_GROUP_TYPES = frozenset(
    (
        MessageType.MOTO_READ_IO_BIT,
        MessageType.MOTO_WRITE_IO_BIT,
        MessageType.MOTO_READ_IO_GROUP,
        MessageType.MOTO_WRITE_IO_GROUP,
    )
)
REGISTER_TYPES = frozenset((MessageType.MOTO_READ_MREGISTER, MessageType.MOTO_WRITE_MREGISTER))


class IoImage:
    """State of all bits and registers; initially bits are off and registers 0.

    `signals` returns the bits that the controller itself drives, by address; they override values
    written by clients.
    """

    def __init__(self, signals: Callable[[], Mapping[int, bool]]) -> None:
        self._signals = signals
        self._on: set[int] = set()
        self._registers: dict[int, int] = {}

    def set_input(self, address: int, value: bool) -> None:
        """Set a bit as the cell's wiring would, even one that clients may not write. Raises
        ScriptError for a wrong address."""
        if not _readable(address):
            raise ScriptError(
                f"input {address}: there is no such bit; the last digit is 0 to 7, and there are "
                + ", ".join(f"{r.name} {r.first} to {r.last}" for r in ADDRESS_RANGES)
            )
        self._set(address, value)

    def read_bit(self, address: int) -> ReadIoReply:
        """Read a bit: 0 or 1, and a result."""
        if not _readable(address):
            return ReadIoReply(0, IoResult.READ_ADDRESS_INVALID)
        return ReadIoReply(int(self._bit(address, self._signals())), IoResult.OK)

    def read_group(self, group: int) -> ReadIoReply:
        """Read eight bits from address 10 * `group` on, the lowest first, and a result."""
        first = 10 * group
        if not _readable(first):
            return ReadIoReply(0, IoResult.READ_ADDRESS_INVALID)
        signals = self._signals()
        bits = (self._bit(first + bit, signals) << bit for bit in range(LAST_BIT + 1))
        return ReadIoReply(sum(bits), IoResult.OK)

    def write_bit(self, address: int, value: int) -> WriteIoReply:
        """Write 0 or 1."""
        if not _writable(address):
            return WriteIoReply(IoResult.WRITE_ADDRESS_INVALID)
        if value not in (0, 1):
            return WriteIoReply(IoResult.WRITE_VALUE_INVALID)
        self._set(address, bool(value))
        return WriteIoReply(IoResult.OK)

    def write_group(self, group: int, value: int) -> WriteIoReply:
        """Write eight bits, 0 to 255."""
        first = 10 * group
        if not _writable(first):
            return WriteIoReply(IoResult.WRITE_ADDRESS_INVALID)
        if not 0 <= value <= LARGEST_GROUP_VALUE:
            return WriteIoReply(IoResult.WRITE_VALUE_INVALID)
        for bit in range(LAST_BIT + 1):
            self._set(first + bit, bool(value >> bit & 1))
        return WriteIoReply(IoResult.OK)

    def read_register(self, register: int) -> ReadRegisterReply:
        """Read an M register, by its number or by its address."""
        number = _register(register)
        if not 0 <= number < READABLE_REGISTERS:
            return ReadRegisterReply(0, IoResult.READ_ADDRESS_INVALID)
        return ReadRegisterReply(self._registers.get(number, 0), IoResult.OK)

    def write_register(self, register: int, value: int) -> WriteRegisterReply:
        """Write 0 to 65535."""
        number = _register(register)
        if not 0 <= number < WRITABLE_REGISTERS:
            return WriteRegisterReply(IoResult.WRITE_ADDRESS_INVALID)
        if not 0 <= value <= LARGEST_REGISTER_VALUE:
            return WriteRegisterReply(IoResult.WRITE_VALUE_INVALID)
        self._registers[number] = value
        return WriteRegisterReply(IoResult.OK)

    def answer(self, message: Message) -> Message | None:
        """Return the reply to a message about inputs, outputs or registers; None for others."""
        body, msg_type = message.body, message.msg_type
        found: Body
        if isinstance(body, ReadIo):
            bit = msg_type == MessageType.MOTO_READ_IO_BIT
            found = self.read_bit(body.address) if bit else self.read_group(body.address)
        elif isinstance(body, WriteIo):
            bit = msg_type == MessageType.MOTO_WRITE_IO_BIT
            write = self.write_bit if bit else self.write_group
            found = write(body.address, body.value)
        elif isinstance(body, ReadRegister):
            found = self.read_register(body.register)
            return _reply(found, found.result, msg_type)
        elif isinstance(body, WriteRegister):
            found = self.write_register(body.register, body.value)
            return _reply(found, found.result, msg_type)
        else:
            return None
        return _reply(found, found.result, msg_type + 1)

    def _bit(self, address: int, signals: Mapping[int, bool]) -> bool:
        driven = signals.get(address)
        return address in self._on if driven is None else driven

    def _set(self, address: int, value: bool) -> None:
        if value:
            self._on.add(address)
        else:
            self._on.discard(address)


def _reply(body: Body, result: int, msg_type: int) -> Message:
    good = result == IoResult.OK
    return reply(body, ReplyCode.SUCCESS if good else ReplyCode.FAILURE, msg_type)


def _range(address: int) -> AddressRange | None:
    if address % 10 <= LAST_BIT:
        for each in ADDRESS_RANGES:
            if each.first <= address <= each.last:
                return each
    return None


def _readable(address: int) -> bool:
    return _range(address) is not None


def _writable(address: int) -> bool:
    found = _range(address)
    return found is not None and found.writable


def _register(register: int) -> int:
    return register - FIRST_REGISTER if register >= FIRST_REGISTER else register
