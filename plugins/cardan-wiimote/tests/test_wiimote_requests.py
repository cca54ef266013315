"""The request queue, one request at a time: matching, retries, timeouts."""

import pytest

from cardan_wiimote.driver.requests import (
    BUSY_PAUSE_S,
    BUSY_TRIES,
    NO_ANSWER,
    TIMEOUT_S,
    TRIES,
    Answer,
    Requests,
)
from cardan_wiimote.protocol import (
    EEPROM,
    IR_ENABLE_1_ID,
    Ack,
    ReadData,
    ReadMemory,
    Status,
    StatusRequest,
    Switch,
    WriteMemory,
)

READ = ReadMemory(0x16, 20, EEPROM)
WRITE = WriteMemory(0xA400F0, b"\x55")
STATUS = Status(0, False, False, False, False, 0, 200)


@pytest.fixture
def requests():
    return Requests()


def asked(requests, request, now_s=0.0):
    requests.ask(request)
    report = requests.poll(now_s)
    assert isinstance(report, bytes)
    return report


@pytest.mark.judged(device="Wiimote", transport="reports", by="worked bytes")
@pytest.mark.parametrize(
    ("request_", "report"),
    [
        (ReadMemory(0x16, 10, EEPROM), "1700000016000a"),
        (ReadMemory(0xA400FA, 6), "1704a400fa0006"),
        (WRITE, "1604a400f00155" + "00" * 15),
        (StatusRequest(), "1500"),
        (Switch(IR_ENABLE_1_ID, True, ack=True), "1306"),
    ],
)
def test_what_is_sent(requests, request_, report):
    assert asked(requests, request_).hex() == report
    assert requests.poll(0.5) is None


def test_a_read_in_pieces(requests):
    asked(requests, READ)
    assert requests.on_input(ReadData(0, 0, 0x16, bytes(16)), 0.1) is None
    answer = requests.on_input(ReadData(0, 0, 0x26, b"\x01\x02\x03\x04"), 0.11)
    assert answer == Answer(0, bytes(16) + b"\x01\x02\x03\x04")
    assert answer.ok
    assert requests.poll(9.0) is None


def test_answers_to_others_are_left_alone(requests):
    asked(requests, READ)
    assert requests.on_input(ReadData(0, 0, 0xFA, bytes(6)), 0.1) is None
    assert requests.on_input(ReadData(0, 7, 0xFA, b""), 0.1) is None
    assert requests.on_input(Ack(0, 0x16, 0), 0.1) is None
    assert requests.on_input(STATUS, 0.1) is None
    assert requests.foreign == 3
    assert requests.on_input(ReadData(0, 0, 0x16, bytes(16)), 0.1) is None
    assert requests.on_input(ReadData(0, 0, 0x26, bytes(4)), 0.1) is not None
    assert requests.on_input(ReadData(0, 0, 0x26, bytes(4)), 0.1) is None


@pytest.mark.parametrize("error", [3, 6, 7, 8])
def test_errors_are_answers(requests, error):
    asked(requests, READ)
    assert requests.on_input(ReadData(0, error, 0x16, b""), 0.1) == Answer(error)
    asked(requests, WRITE)
    answer = requests.on_input(Ack(0, 0x16, error), 0.1)
    assert answer == Answer(error)
    assert not answer.ok


def test_acknowledgments(requests):
    asked(requests, WRITE)
    assert requests.on_input(Ack(0, 0x11, 0), 0.1) is None
    assert requests.on_input(Ack(0, 0x16, 0), 0.1).ok
    asked(requests, Switch(IR_ENABLE_1_ID, True, ack=True))
    assert requests.on_input(Ack(0, 0x1A, 0), 0.1) is None
    assert requests.on_input(Ack(0, 0x13, 0), 0.1).ok
    asked(requests, StatusRequest())
    assert requests.on_input(STATUS, 0.1).ok


def test_silence_is_asked_again_and_then_given_up(requests):
    report = asked(requests, WRITE)
    for at in range(1, TRIES):
        assert requests.poll(at * TIMEOUT_S - 0.01) is None
        assert requests.poll(at * TIMEOUT_S) == report
    assert requests.poll(TRIES * TIMEOUT_S - 0.01) is None
    assert requests.poll(TRIES * TIMEOUT_S) is NO_ANSWER
    assert not NO_ANSWER.ok
    assert requests.poll(100.0) is None
    assert requests.timeouts == TRIES


def test_a_lost_piece_begins_the_read_anew(requests):
    report = asked(requests, READ)
    requests.on_input(ReadData(0, 0, 0x16, b"\xaa" * 16), 0.1)
    assert requests.poll(TIMEOUT_S) == report
    requests.on_input(ReadData(0, 0, 0x16, bytes(16)), 1.1)
    answer = requests.on_input(ReadData(0, 0, 0x26, bytes(4)), 1.1)
    assert answer == Answer(0, bytes(20))


@pytest.mark.parametrize("busy", [Ack(0, 0x17, 4), ReadData(0, 4, 0x16, b"")])
def test_a_busy_remote_is_asked_again(requests, busy):
    report = asked(requests, READ)
    now_s = 0.0
    for _ in range(BUSY_TRIES - 1):
        assert requests.on_input(busy, now_s) is None
        assert requests.poll(now_s + 0.9 * BUSY_PAUSE_S) is None
        now_s += BUSY_PAUSE_S
        assert requests.poll(now_s) == report
    assert requests.on_input(busy, now_s) == Answer(4)


def test_nothing_is_under_way(requests):
    assert requests.poll(0.0) is None
    assert requests.on_input(Ack(0, 0x16, 0), 0.0) is None
    asked(requests, READ)
    requests.reset()
    assert requests.poll(10.0) is None
