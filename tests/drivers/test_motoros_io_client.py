"""Inputs, outputs and registers: requests, and results of answers or missing ones."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator
from itertools import count
from types import SimpleNamespace

import pytest
from hypothesis import given, strategies as st

from cardan.drivers.motoros import IoConnectionError, IoRefusedError, io_client
from cardan.drivers.motoros.diagnosis import io_result_in_words
from cardan.drivers.motoros.io_client import (
    IoClient,
    IoExchange,
    IoRequest,
    read_bit,
    read_group,
    read_register,
    write_bit,
    write_group,
    write_register,
)
from cardan.errors import (
    CommandError,
    ConfigurationError,
    DriverError,
    NotOpenError,
)
from cardan.protocols.simple_message.codec import wire
from cardan.protocols.simple_message.codes import (
    InvalidSubcode,
    IoResult,
    MessageType,
    MotionResult,
    ReplyCode,
)
from cardan.protocols.simple_message.framing import ByteOrder, FrameReader
from cardan.protocols.simple_message.messages import (
    Body,
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
    reply,
    request,
)

LITTLE, BIG = wire(ByteOrder.LITTLE), wire(ByteOrder.BIG)

CASES: list[tuple[IoRequest, str, Body, int]] = [
    # request, its bytes without the prefix's and the type's place in the header, answer, result
    (read_bit(10010), "10000000 d3070000", ReadIoReply(1, 0), 1),
    (write_bit(10010, 1), "14000000 d5070000", WriteIoReply(0), 0),
    (read_group(1001), "10000000 d7070000", ReadIoReply(0xA5, 0), 0xA5),
    (write_group(1001, 255), "14000000 d9070000", WriteIoReply(0), 0),
    (read_register(999), "10000000 dc070000", ReadRegisterReply(65535, 0), 65535),
    (write_register(559, 65535), "14000000 dd070000", WriteRegisterReply(0), 0),
]


def exchange_after(asked: IoRequest) -> IoExchange:
    exchange = IoExchange(ByteOrder.LITTLE)
    exchange.ask(asked)
    return exchange


class TestRequests:
    def test_worked_bytes(self) -> None:
        little = IoExchange(ByteOrder.LITTLE).ask(write_bit(10013, 1))
        assert little == bytes.fromhex("14000000 d5070000 02000000 00000000 1d270000 01000000")
        big = IoExchange(ByteOrder.BIG).ask(read_register(17))
        assert big == bytes.fromhex("00000010 000007dc 00000002 00000000 00000011")

    @pytest.mark.parametrize(("asked", "top", "_answer", "_result"), CASES)
    def test_each_request_has_its_type_and_length(
        self, asked: IoRequest, top: str, _answer: Body, _result: int
    ) -> None:
        data = IoExchange(ByteOrder.LITTLE).ask(asked)
        assert data[:16] == bytes.fromhex(f"{top} 02000000 00000000")
        assert len(data) == int.from_bytes(data[:4], "little") + 4
        assert LITTLE.decode(data) == request(asked.body, asked.msg_type)

    @pytest.mark.parametrize(
        "address", [10, 5127, 10010, 15127, 29567, 42567, 60647, 79997, 87207, 11120, 11127]
    )
    def test_bits_that_can_be_read(self, address: int) -> None:
        assert read_bit(address).body == ReadIo(address)

    @pytest.mark.parametrize("address", [18, 19, 10019, 5128])
    def test_a_bit_address_ends_in_0_to_7(self, address: int) -> None:
        with pytest.raises(CommandError, match="last digit must be 0 to 7"):
            read_bit(address)

    @pytest.mark.parametrize("address", [-1, -10, 0, 7, 5130, 10007, 90000, 10**12, 10.0, "10"])
    def test_other_addresses_are_refused(self, address) -> None:
        with pytest.raises(CommandError, match=r"10010 to 15127 \(general outputs\)"):
            read_bit(address)

    @pytest.mark.parametrize("address", [10, 20010, 30010, 37010, 50010, 80010])
    def test_what_can_only_be_read(self, address: int) -> None:
        read_bit(address)
        with pytest.raises(
            CommandError, match=r"cannot be written; allowed .* \(interface panel\)$"
        ):
            write_bit(address, 1)
        with pytest.raises(CommandError, match="cannot be written"):
            write_group(address // 10, 1)

    @pytest.mark.parametrize("address", [10010, 15127, 27010, 29567, 60010, 60647])
    def test_what_can_be_written(self, address: int) -> None:
        assert write_bit(address, False).body == WriteIo(address, 0)
        assert write_group(address // 10, 7).body == WriteIo(address // 10, 7)

    @pytest.mark.parametrize("address", [0, 513, 1000, 1513, 8721, 10010, -1])
    def test_group_addresses(self, address: int) -> None:
        assert read_group(512).body == ReadIo(512)
        with pytest.raises(CommandError, match=r"1001 to 1512 \(general outputs\)"):
            read_group(address)

    @pytest.mark.parametrize(
        ("ask", "allowed"),
        [
            (lambda: write_bit(10010, 2), "0 to 1"),
            (lambda: write_group(1001, 256), "0 to 255"),
            (lambda: write_group(1001, -1), "0 to 255"),
            (lambda: read_register(1000), "0 to 999"),
            (lambda: read_register(-1), "0 to 999"),
            (lambda: write_register(560, 0), "0 to 559"),
            (lambda: write_register(0, 65536), "0 to 65535"),
            (lambda: write_register(0, 1.5), "0 to 65535"),
        ],
    )
    def test_numbers_out_of_range_name_what_is_allowed(
        self, ask: Callable[[], IoRequest], allowed: str
    ) -> None:
        with pytest.raises(CommandError, match=f"must be {allowed}"):
            ask()


class TestReplies:
    @pytest.mark.parametrize(("asked", "_top", "answer", "result"), CASES)
    def test_the_value(self, asked: IoRequest, _top: str, answer: Body, result: int) -> None:
        data = LITTLE.encode(reply(answer, msg_type=asked.reply_type))
        assert exchange_after(asked).receive(data) == result

    @pytest.mark.parametrize(("asked", "_top", "answer", "result"), CASES)
    def test_in_pieces(self, asked: IoRequest, _top: str, answer: Body, result: int) -> None:
        data = LITTLE.encode(reply(answer, msg_type=asked.reply_type))
        exchange = exchange_after(asked)
        for i in range(len(data) - 1):
            assert exchange.receive(data[i : i + 1]) is None
        assert exchange.receive(data[-1:]) == result

    @pytest.mark.parametrize("code", [*(r for r in IoResult if r is not IoResult.OK), 4242])
    @pytest.mark.parametrize(("asked", "_top", "answer", "_result"), CASES)
    def test_refusals_have_words(
        self, asked: IoRequest, _top: str, answer: Body, _result: int, code: int
    ) -> None:
        refusal = answer._replace(result=code)  # type: ignore[union-attr]
        data = LITTLE.encode(reply(refusal, ReplyCode.FAILURE, asked.reply_type))
        with pytest.raises(IoRefusedError) as caught:
            exchange_after(asked).receive(data)
        assert io_result_in_words(code) in str(caught.value)
        assert caught.value.result == code
        assert isinstance(caught.value, DriverError)

    def test_a_message_that_was_not_understood(self) -> None:
        exchange = exchange_after(read_register(5))
        answer = MotionReply(MotionResult.INVALID, InvalidSubcode.MSGTYPE, 0, 0, 0)
        with pytest.raises(IoRefusedError, match="does not know the message") as caught:
            exchange.receive(LITTLE.encode(reply(answer)))
        assert caught.value.result == InvalidSubcode.MSGTYPE
        exchange.ask(read_register(5))

    @pytest.mark.parametrize(
        "message",
        [
            reply(ReadIoReply(1, 0), msg_type=MessageType.MOTO_READ_IO_GROUP_REPLY),
            reply(WriteIoReply(0), msg_type=MessageType.MOTO_WRITE_IO_BIT_REPLY),
            reply(ReadIoReply(2, 0), msg_type=MessageType.MOTO_READ_IO_BIT_REPLY),
            Message(MessageType.MOTO_READ_IO_BIT_REPLY, 2, 0, ReadIoReply(1, 0)),
            request(ReadIo(10010), MessageType.MOTO_READ_IO_BIT),
        ],
    )
    def test_another_answer_than_the_one_due(self, message: Message) -> None:
        with pytest.raises(IoConnectionError, match="was answered by"):
            exchange_after(read_bit(10010)).receive(LITTLE.encode(message))

    def test_a_register_s_request_is_not_its_reply(self) -> None:
        echo = LITTLE.encode(request(ReadRegister(5)))
        with pytest.raises(IoConnectionError, match="was answered by"):
            exchange_after(read_register(5)).receive(echo)

    def test_more_than_one_answer(self) -> None:
        data = LITTLE.encode(reply(ReadIoReply(1, 0), msg_type=2004))
        with pytest.raises(IoConnectionError, match="more than was asked"):
            exchange_after(read_bit(10010)).receive(data + data)
        with pytest.raises(IoConnectionError, match="more than was asked"):
            IoExchange(ByteOrder.LITTLE).receive(data)

    def test_the_wrong_byte_order(self) -> None:
        data = BIG.encode(reply(ReadIoReply(1, 0), msg_type=2004))
        with pytest.raises(IoConnectionError, match="is the byte order little"):
            exchange_after(read_bit(10010)).receive(data)

    def test_one_at_a_time(self) -> None:
        with pytest.raises(RuntimeError, match="not been answered"):
            exchange_after(read_bit(10010)).ask(read_bit(10010))

    @given(data=st.binary(max_size=200))
    def test_any_bytes_end_in_a_value_or_in_one_of_two_errors(self, data: bytes) -> None:
        with contextlib.suppress(IoConnectionError, IoRefusedError):
            exchange_after(read_group(1001)).receive(data)
        framed = len(data).to_bytes(4, "little") + data
        with contextlib.suppress(IoConnectionError, IoRefusedError):
            exchange_after(read_group(1001)).receive(framed)


Answer = Callable[[Message], "Message | bytes | None"]
"""None: close the connection."""


class ScriptedServer:
    """Server on loopback with an answering function for each connection; ends by itself."""

    def __init__(self, *connections: Answer, byte_order: ByteOrder = ByteOrder.LITTLE) -> None:
        self._wire = wire(byte_order)
        self._order = byte_order
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(5.0)
        self.port: int = self._listener.getsockname()[1]
        self.heard: list[Message] = []
        self.served = 0
        self.ended = [threading.Event() for _ in connections]
        self._thread = threading.Thread(target=self._serve, args=(connections,), daemon=True)
        self._thread.start()

    def _serve(self, connections: tuple[Answer, ...]) -> None:
        with self._listener:
            for answer, ended in zip(connections, self.ended, strict=True):
                try:
                    link, _ = self._listener.accept()
                except OSError:
                    return
                self.served += 1
                with link:
                    link.settimeout(5.0)
                    with contextlib.suppress(OSError):
                        self._talk(link, answer)
                ended.set()

    def _talk(self, link: socket.socket, answer: Answer) -> None:
        reader = FrameReader(self._order)
        while data := link.recv(4096):
            reader.feed(data)
            while (frame := reader.take()) is not None:
                message = self._wire.decode(frame)
                assert isinstance(message, Message)
                self.heard.append(message)
                said = answer(message)
                if said is None:
                    return
                link.sendall(said if isinstance(said, bytes) else self._wire.encode(said))

    def close(self) -> None:
        self._listener.close()
        self._thread.join(5.0)


@contextlib.contextmanager
def serving(
    *connections: Answer, byte_order: ByteOrder = ByteOrder.LITTLE, timeout_s: float = 2.0
) -> Iterator[tuple[ScriptedServer, IoClient]]:
    server = ScriptedServer(*connections, byte_order=byte_order)
    order = "little" if byte_order is ByteOrder.LITTLE else "big"
    try:
        with IoClient("127.0.0.1", server.port, order, timeout_s) as client:  # type: ignore[arg-type]
            yield server, client
    finally:
        server.close()


def memory() -> Answer:
    """Controller with bits, groups and registers that are independent of each other."""
    values: dict[tuple[int, int], int] = {}

    def answer(message: Message) -> Message:
        body, kind = message.body, message.msg_type
        if isinstance(body, ReadRegister):
            return reply(ReadRegisterReply(values.get((kind, body.register), 0), 0))
        if isinstance(body, WriteRegister):
            values[kind - 1, body.register] = body.value
            return reply(WriteRegisterReply(0))
        if isinstance(body, WriteIo):
            values[kind - 2, body.address] = body.value
            return reply(WriteIoReply(0), msg_type=kind + 1)
        assert isinstance(body, ReadIo)
        return reply(ReadIoReply(values.get((kind, body.address), 0), 0), msg_type=kind + 1)

    return answer


def silent(_: Message) -> bytes:
    return b""


def hang_up(_: Message) -> None:
    return None


class TestClient:
    @pytest.mark.parametrize("byte_order", ByteOrder)
    def test_reads_what_it_wrote(self, byte_order: ByteOrder) -> None:
        with serving(memory(), byte_order=byte_order) as (server, client):
            assert client.read_bit(10010) is False
            client.write_bit(10010, True)
            assert client.read_bit(10010) is True
            client.write_group(1002, 0xA5)
            assert client.read_group(1002) == 0xA5
            client.write_register(3, 40000)
            assert client.read_register(3) == 40000
            assert server.served == 1

    def test_a_refusal_keeps_the_connection(self) -> None:
        refusals = iter([1001, 1004])

        def answer(_: Message) -> Message:
            return reply(ReadIoReply(1, next(refusals, 0)), msg_type=2004)

        with serving(answer) as (server, client):
            for code in (1001, 1004):
                with pytest.raises(IoRefusedError) as caught:
                    client.read_bit(10010)
                assert caught.value.result == code
            assert client.read_bit(10010)
            assert server.served == 1

    def test_bad_requests_do_not_even_connect(self) -> None:
        with serving() as (server, client):
            with pytest.raises(CommandError):
                client.write_bit(10, True)
            assert server.served == 0

    @pytest.mark.parametrize(
        ("first", "words"),
        [
            (hang_up, "another program"),
            (silent, "no answer within 0.3 s"),
            (lambda _: b"\xff" * 20, "not a message"),
            (lambda _: reply(WriteIoReply(0), msg_type=2006), "was answered by"),
        ],
    )
    def test_the_next_call_connects_again(self, first: Answer, words: str) -> None:
        with serving(first, memory(), timeout_s=0.3 if first is silent else 2.0) as (
            server,
            client,
        ):
            with pytest.raises(IoConnectionError, match=words):
                client.read_bit(10010)
            assert client.read_bit(10010) is False
            assert server.served == 2

    def test_pieces_of_an_answer_do_not_prolong_the_wait(self, monkeypatch) -> None:
        clock = SimpleNamespace(monotonic=map(float, count()).__next__)
        monkeypatch.setattr(io_client, "time", clock)
        with (
            serving(lambda _: b"\x24\x00") as (_, client),
            pytest.raises(IoConnectionError, match="no answer within 2 s"),
        ):
            client.read_bit(10010)

    def test_a_connection_closed_between_two_calls_is_made_anew_unnoticed(self) -> None:
        once = memory()

        def answer_and_leave(message: Message) -> Message:
            answers.append(message)
            return once(message)  # type: ignore[return-value]

        answers: list[Message] = []

        class Leaving(ScriptedServer):
            def _talk(self, link: socket.socket, answer: Answer) -> None:
                if self.served > 1:
                    super()._talk(link, answer)
                    return
                message = self._wire.decode(link.recv(4096))
                assert isinstance(message, Message)
                said = answer(message)
                assert isinstance(said, Message)
                link.sendall(self._wire.encode(said))

        server = Leaving(answer_and_leave, answer_and_leave)
        try:
            with IoClient("127.0.0.1", server.port, timeout_s=2.0) as client:
                client.read_bit(10010)
                assert server.ended[0].wait(5.0)
                client.read_bit(10010)
            assert server.served == 2
            assert len(answers) == 2
        finally:
            server.close()

    def test_nobody_there(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
        with (
            IoClient("127.0.0.1", port) as client,
            pytest.raises(IoConnectionError, match=f"127.0.0.1:{port}: MOTO_READ_IO_BIT 10010"),
        ):
            client.read_bit(10010)

    def test_after_close(self) -> None:
        with serving(memory()) as (_, client):
            client.read_bit(10010)
            client.close()
            client.close()
            with pytest.raises(NotOpenError, match="closed"):
                client.read_bit(10010)

    def test_threads_take_turns(self) -> None:
        wrong: list[str] = []
        with serving(memory()) as (server, client):

            def work(register: int) -> None:
                for value in range(50):
                    client.write_register(register, value)
                    if client.read_register(register) != value:
                        wrong.append(f"{register}: {value}")

            threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join(10.0)
            assert not wrong
            assert len(server.heard) == 400
            assert server.served == 1

    @pytest.mark.parametrize(
        ("key", "arguments"),
        [
            ("byte_order", {"byte_order": "auto"}),
            ("timeout_s", {"timeout_s": 0.0}),
            ("timeout_s", {"timeout_s": float("nan")}),
            ("port", {"port": 0}),
            ("port", {"port": 65536}),
        ],
    )
    def test_settings_that_cannot_be(self, key: str, arguments) -> None:
        with pytest.raises(ConfigurationError) as caught:
            IoClient("127.0.0.1", **arguments)
        assert caught.value.key == key
