"""Inputs, outputs and registers of a MotoROS controller: the I/O port, 50242.

`IoExchange` converts a request to bytes and bytes to its result, without a socket; `IoClient` is
the blocking client around it. MotoROS serves one such connection: a second one replaces the first.
"""

from __future__ import annotations

import operator
import socket
import threading
import time
from contextlib import suppress
from typing import Annotated, Literal, NamedTuple

from cardan.common import bounds
from cardan.common.options import check_value, require
from cardan.common.sockets import hang_up
from cardan.drivers.motoros.diagnosis import io_result_in_words, reply_in_words
from cardan.drivers.motoros.errors import IoConnectionError, IoRefusedError
from cardan.errors import (
    CommandError,
    NotOpenError,
)
from cardan.protocols.simple_message.codec import wire
from cardan.protocols.simple_message.codes import IO_PORT, CommType, IoResult, MessageType, name_of
from cardan.protocols.simple_message.framing import (
    LONGEST_PREFIX_OF_MOTOROS,
    ByteOrder,
    FrameReader,
)
from cardan.protocols.simple_message.io_addresses import (
    ADDRESS_RANGES,
    READABLE_REGISTERS,
    WRITABLE_REGISTERS,
)
from cardan.protocols.simple_message.messages import (
    Body,
    MalformedMessage,
    Message,
    MotionReply,
    ReadIo,
    ReadIoReply,
    ReadRegister,
    ReadRegisterReply,
    WriteIo,
    WriteIoReply,
    WriteRegister,
    WriteRegisterReply,
    request,
)

TIMEOUT_S = bounds.Range(0.0, 3600.0, "s", "a later reply is of no use", above=True, below=True)
_ORDERS = {"little": ByteOrder.LITTLE, "big": ByteOrder.BIG}
_RECEIVE_BYTES = 4096


_T = MessageType
_REPLIES: dict[int, tuple[int, type[Body]]] = {
    _T.MOTO_READ_IO_BIT: (_T.MOTO_READ_IO_BIT_REPLY, ReadIoReply),
    _T.MOTO_READ_IO_GROUP: (_T.MOTO_READ_IO_GROUP_REPLY, ReadIoReply),
    _T.MOTO_READ_MREGISTER: (_T.MOTO_READ_MREGISTER, ReadRegisterReply),
    _T.MOTO_WRITE_IO_BIT: (_T.MOTO_WRITE_IO_BIT_REPLY, WriteIoReply),
    _T.MOTO_WRITE_IO_GROUP: (_T.MOTO_WRITE_IO_GROUP_REPLY, WriteIoReply),
    _T.MOTO_WRITE_MREGISTER: (_T.MOTO_WRITE_MREGISTER, WriteRegisterReply),
}
"""Reply types by request type; replies about registers have the type of their request."""


class IoRequest(NamedTuple):
    """A checked request. The functions below make them."""

    msg_type: int
    body: ReadIo | WriteIo | ReadRegister | WriteRegister
    largest: int = 0
    """Value of a reply."""

    @property
    def reply_type(self) -> int:
        """Type of the reply."""
        return _REPLIES[self.msg_type][0]

    def __str__(self) -> str:
        return f"{name_of(MessageType, self.msg_type)} {self.body[0]}"


def read_bit(address: int) -> IoRequest:
    """Make a request to read a bit. Raises CommandError for an unknown address."""
    return IoRequest(_T.MOTO_READ_IO_BIT, ReadIo(_bit(address, writing=False)), 1)


def write_bit(address: int, value: int) -> IoRequest:
    """Make a request to set a bit to 0 or 1. Raises CommandError for an address that is not
    writable."""
    body = WriteIo(_bit(address, writing=True), _number("value", value, 1))
    return IoRequest(_T.MOTO_WRITE_IO_BIT, body)


def read_group(address: int) -> IoRequest:
    """Make a request to read eight bits; `address` is the first bit's without its last digit (1001:
    10010)."""
    return IoRequest(_T.MOTO_READ_IO_GROUP, ReadIo(_group(address, writing=False)), 0xFF)


def write_group(address: int, value: int) -> IoRequest:
    """Make a request to set eight bits to 0 to 255."""
    body = WriteIo(_group(address, writing=True), _number("value", value, 0xFF))
    return IoRequest(_T.MOTO_WRITE_IO_GROUP, body)


def read_register(register: int) -> IoRequest:
    """Make a request to read an M register, 0 to 999."""
    number = _number("register", register, READABLE_REGISTERS - 1)
    return IoRequest(_T.MOTO_READ_MREGISTER, ReadRegister(number), 0xFFFF)


def write_register(register: int, value: int) -> IoRequest:
    """Make a request to set an M register, 0 to 559, to 0 to 65535."""
    number = _number("register", register, WRITABLE_REGISTERS - 1)
    body = WriteRegister(number, _number("value", value, 0xFFFF))
    return IoRequest(_T.MOTO_WRITE_MREGISTER, body)


def _index(value: int) -> int:
    """Return `value` as an integer; -1 if it is none."""
    try:
        return operator.index(value)
    except TypeError:
        return -1


def _number(what: str, value: int, largest: int) -> int:
    number = _index(value)
    if not 0 <= number <= largest:
        raise CommandError(f"{what}: {value!r} is not allowed; it must be 0 to {largest}")
    return number


def _bit(address: int, writing: bool) -> int:
    number = _index(address)
    if number >= 0 and number % 10 > 7:
        raise CommandError(f"address: {address!r} is not a bit; the last digit must be 0 to 7")
    return _within("address", address, number, 1, writing)


def _group(address: int, writing: bool) -> int:
    return _within("group", address, _index(address), 10, writing)


def _within(what: str, address: int, number: int, divisor: int, writing: bool) -> int:
    """Return `number` if it is a readable or writable address of a bit or of a group of bits."""
    allowed = [
        (each.first // divisor, each.last // divisor, each.name)
        for each in ADDRESS_RANGES
        if each.writable or not writing
    ]
    if not any(first <= number <= last for first, last, _ in allowed):
        words = ", ".join(f"{first} to {last} ({name})" for first, last, name in allowed)
        doing = "written" if writing else "read"
        raise CommandError(f"{what}: {address!r} cannot be {doing}; allowed are {words}")
    return number


class IoExchange:
    """Requests and replies of a connection, one at a time; sans-I/O.

    Make a new one for every connection: after an IoConnectionError later bytes cannot be assigned.
    """

    def __init__(self, byte_order: ByteOrder) -> None:
        self._wire = wire(byte_order)
        self._reader = FrameReader(byte_order, LONGEST_PREFIX_OF_MOTOROS)
        self._asked: IoRequest | None = None

    def ask(self, asked: IoRequest) -> bytes:
        """Return the bytes of `asked`, to be sent at once. Raises RuntimeError while a reply is
        due."""
        if self._asked is not None:
            raise RuntimeError(f"{self._asked} has not been answered yet")
        self._asked = asked
        return self._wire.encode(request(asked.body, asked.msg_type))

    def receive(self, data: bytes) -> int | None:
        """Process received bytes; return the value read (0 after a write), None while incomplete.

        Raises IoRefusedError if the controller refuses, IoConnectionError for anything but the
        reply to the request.
        """
        reader = self._reader
        reader.feed(data)
        frame = reader.take()
        if reader.failure:
            raise IoConnectionError(
                f"the I/O port sent data that is not a message: {reader.failure}; is the byte "
                "order "
                f"{reader.byte_order and reader.byte_order.name.lower()}?"
            )
        if frame is None:
            return None
        asked, self._asked = self._asked, None
        message = self._wire.decode(frame)
        if isinstance(message, MalformedMessage):
            raise IoConnectionError(f"the I/O port sent a malformed reply: {message.reason}")
        if asked is None or reader.pending_bytes:
            name = name_of(MessageType, message.msg_type)
            raise IoConnectionError(f"the I/O port sent more than was asked for: {name}")
        return _result(asked, message)


def _result(asked: IoRequest, message: Message) -> int:
    body = message.body
    if isinstance(body, MotionReply):
        # The I/O server's reply to what it does not understand: result and subcode come first.
        words = reply_in_words(asked.msg_type, body.group, body.sequence)
        raise IoRefusedError(f"{asked}: {words}", body.sequence)
    if (
        message.msg_type != asked.reply_type
        or message.comm_type != CommType.SERVICE_REPLY
        or not isinstance(body, _REPLIES[asked.msg_type][1])
    ):
        kind, comm = name_of(MessageType, message.msg_type), name_of(CommType, message.comm_type)
        raise IoConnectionError(f"{asked} was answered by a {kind} ({comm})")
    assert isinstance(body, (ReadIoReply, ReadRegisterReply, WriteIoReply, WriteRegisterReply))
    if body.result != IoResult.OK:
        raise IoRefusedError(f"{asked}: {io_result_in_words(body.result)}", body.result)
    if isinstance(body, (WriteIoReply, WriteRegisterReply)):
        return 0
    if body.value > asked.largest:
        raise IoConnectionError(
            f"{asked} was answered by {body.value}; it must be 0 to {asked.largest}"
        )
    return body.value


class IoClient:
    """Reads and writes inputs, outputs and registers; blocking, for any number of threads.

    Connects with the first call, and again with the next call after a connection was lost. A call
    raises CommandError before anything is sent, IoRefusedError if the controller refuses,
    IoConnectionError if it does not answer (a write may then have happened or not), and
    NotOpenError after `close`.
    """

    def __init__(
        self,
        host: str,
        port: int = IO_PORT,
        byte_order: Literal["little", "big"] = "little",
        timeout_s: float = 0.5,
    ) -> None:
        """`byte_order` is that of the controller's CPU: "big" on FS100, else "little".

        `timeout_s` limits connecting, and the wait for a reply. Raises OptionError for invalid
        values.
        """
        require(byte_order in _ORDERS, "byte_order", byte_order, f"one of {', '.join(_ORDERS)}")
        check_value("timeout_s", timeout_s, Annotated[float, TIMEOUT_S])
        check_value("port", port, Annotated[int, bounds.PORT])
        self._address = (host, port)
        self._order = _ORDERS[byte_order]
        self._timeout_s = timeout_s
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._exchange = IoExchange(self._order)
        self._closed = False

    def read_bit(self, address: int) -> bool:
        """Read one bit; addresses end in 0 to 7."""
        return bool(self._call(read_bit(address)))

    def write_bit(self, address: int, value: bool) -> None:
        """Set one bit: a general output, a network input or one of the interface panel."""
        self._call(write_bit(address, value))

    def read_group(self, address: int) -> int:
        """Read eight bits as 0 to 255, the lowest first; group 1001 is bits 10010 to 10017."""
        return self._call(read_group(address))

    def write_group(self, address: int, value: int) -> None:
        """Set eight bits, 0 to 255."""
        self._call(write_group(address, value))

    def read_register(self, register: int) -> int:
        """Read an M register, 0 to 999, as 0 to 65535."""
        return self._call(read_register(register))

    def write_register(self, register: int, value: int) -> None:
        """Set an M register, 0 to 559, to 0 to 65535."""
        self._call(write_register(register, value))

    def close(self) -> None:
        """Close the connection after any running call; later calls raise NotOpenError."""
        with self._lock:
            self._closed = True
            self._drop()

    def __enter__(self) -> IoClient:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _call(self, asked: IoRequest) -> int:
        with self._lock:
            if self._closed:
                raise NotOpenError("the I/O client is closed; make a new one")
            try:
                link = self._connected()
                link.sendall(self._exchange.ask(asked))
                return self._reply(link, asked)
            except IoRefusedError:
                raise
            except BaseException as error:
                self._drop()
                if isinstance(error, (OSError, UnicodeError)):
                    raise IoConnectionError(f"{self._name}: {asked}: {error}") from None
                raise

    @property
    def _name(self) -> str:
        return f"{self._address[0]}:{self._address[1]}"

    def _connected(self) -> socket.socket:
        link = self._socket
        if link is not None:
            # Nothing is due: readable bytes are the end of the connection, or stray.
            link.setblocking(False)
            try:
                link.recv(1, socket.MSG_PEEK)
            except BlockingIOError:
                link.settimeout(self._timeout_s)
                return link
            except OSError:
                pass
            self._drop()
        link = socket.create_connection(self._address, self._timeout_s)
        self._socket = link
        self._exchange = IoExchange(self._order)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return link

    def _reply(self, link: socket.socket, asked: IoRequest) -> int:
        deadline_s = time.monotonic() + self._timeout_s
        while True:
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0:
                raise self._silent(asked)
            link.settimeout(left_s)
            try:
                data = link.recv(_RECEIVE_BYTES)
            except TimeoutError:
                raise self._silent(asked) from None
            if not data:
                raise IoConnectionError(
                    f"{self._name}: {asked}: the controller closed the connection; it serves one "
                    "at a time, so another program may have taken it"
                )
            value = self._exchange.receive(data)
            if value is not None:
                return value

    def _silent(self, asked: IoRequest) -> IoConnectionError:
        return IoConnectionError(f"{self._name}: {asked}: no answer within {self._timeout_s:g} s")

    def _drop(self) -> None:
        link, self._socket = self._socket, None
        if link is not None:
            with suppress(OSError):
                hang_up(link)
