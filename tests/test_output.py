"""Output to a slow or vanished reader delays no program."""

import contextlib
import errno
import io
import os
import sys
import threading

import pytest

from cardan.common import output
from cardan.common.output import (
    AT_ONCE_BYTES,
    MAX_WAITING_BYTES,
    READ_WITHIN_S,
    BackgroundOutput,
    DroppingOutput,
)
from tests.waiting import until

WITHIN_S = 20.0
PIECE = b"x" * 4096


@pytest.fixture
def pipe():
    """Return both ends of a pipe, closed at the end if still open."""
    ends = os.pipe()
    yield ends
    for end in ends:
        with contextlib.suppress(OSError):
            os.close(end)


def fill(fd):
    os.set_blocking(fd, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(fd, PIECE)
    os.set_blocking(fd, True)


def drained(fd):
    """Return all data that arrives until none has arrived for a while."""
    os.set_blocking(fd, False)
    found = b""
    while True:
        try:
            found += os.read(fd, 1 << 16)
        except BlockingIOError:
            return found


def test_what_is_written_arrives_in_order(pipe):
    reading, writing = pipe
    stream = BackgroundOutput(writing, "<test>")
    for number in range(100):
        stream.write(f"{number}\n".encode())
    stream.finish()
    assert drained(reading).split() == [str(number).encode() for number in range(100)]
    assert stream.is_read()


def test_one_that_keeps_up_never_waits(pipe):
    reading, writing = pipe
    fill(writing)
    stream = BackgroundOutput(writing, "<test>")
    stream.keep_up()
    for _ in range(10 * MAX_WAITING_BYTES // len(PIECE)):
        assert stream.write(PIECE) == len(PIECE)
    until(lambda: not stream.is_read())
    drained(reading)
    until(stream.is_read)


def test_a_slow_terminal_is_read(monkeypatch):
    """Each write takes a while, and all together take long."""
    now_s = [100.0]
    writing, go_on = threading.Semaphore(0), threading.Semaphore(0)
    written = []

    def write(_fd, data):
        writing.release()
        assert go_on.acquire(timeout=WITHIN_S)
        written.append(bytes(data))
        return len(data)

    monkeypatch.setattr(output.os, "write", write)
    monkeypatch.setattr(output.os, "isatty", lambda _fd: True)
    monkeypatch.setattr(output.time, "monotonic", lambda: now_s[0])
    stream = BackgroundOutput(-1, "<test>")
    assert not stream.is_behind()
    stream.write(PIECE)
    writes = len(PIECE) // AT_ONCE_BYTES
    for _ in range(writes):
        assert writing.acquire(timeout=WITHIN_S)
        assert stream.is_read()
        now_s[0] += 0.9 * READ_WITHIN_S
        assert stream.is_read()
        assert stream.is_behind()
        go_on.release()
    until(lambda: not stream.is_behind())
    assert b"".join(written) == PIECE
    stream.write(b"x")
    assert writing.acquire(timeout=WITHIN_S)
    now_s[0] += 1.1 * READ_WITHIN_S
    assert not stream.is_read()
    go_on.release()
    until(stream.is_read)


def test_one_that_does_not_keep_up_waits_for_its_reader(pipe):
    reading, writing = pipe
    fill(writing)
    stream = BackgroundOutput(writing, "<test>")
    count = 2 * MAX_WAITING_BYTES // len(PIECE)
    done = threading.Event()

    def write():
        for _ in range(count):
            stream.write(PIECE)
        stream.finish()
        done.set()

    thread = threading.Thread(target=write)
    thread.start()
    until(lambda: not stream.is_read())
    assert not done.is_set()
    found = b""
    while not done.is_set():
        found += drained(reading)
    thread.join(WITHIN_S)
    found += drained(reading)
    assert len(found) >= count * len(PIECE)


def test_the_last_words_of_one_that_keeps_up_are_waited_for_briefly(pipe, monkeypatch):
    monkeypatch.setattr(output, "LAST_WORDS_S", 0.02)
    fill(pipe[1])
    stream = BackgroundOutput(pipe[1], "<test>")
    stream.keep_up()
    stream.write(PIECE)
    stream.finish()
    assert stream.write(PIECE) == len(PIECE)


@pytest.mark.parametrize("quiet", [False, True])
def test_an_error_is_raised_by_the_next_write_or_never(pipe, quiet):
    reading, writing = pipe
    os.close(reading)
    stream = BackgroundOutput(writing, "<test>", quiet=quiet)
    stream.write(b"a")
    until(lambda: stream.error is not None)
    if quiet:
        stream.write(b"b")
    else:
        with pytest.raises(BrokenPipeError):
            stream.write(b"b")
    stream.finish()
    assert output.why_unwritten(stream.error) == ""


def test_a_pipe_that_was_set_not_to_block_is_waited_for(pipe):
    reading, writing = pipe
    fill(writing)
    os.set_blocking(writing, False)
    stream = BackgroundOutput(writing, "<test>")
    stream.write(b"the end")
    until(lambda: not stream.is_read())
    assert stream.error is None
    found = drained(reading)
    until(stream.is_read)
    stream.finish()
    assert (found + drained(reading)).endswith(b"the end")


def test_without_a_thread_standard_error_says_so_and_standard_output_does_not_wait(
    pipe, monkeypatch
):
    reading, writing = pipe

    def start(_thread):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", start)
    words = BackgroundOutput(writing, "<test>")
    for _ in range(2):
        with pytest.raises(RuntimeError, match="new thread"):
            words.write(PIECE)
    words.finish()
    reported = BackgroundOutput(writing, "<test>", quiet=True)
    for each in (b"no more ", b"threads"):
        reported.write(each)
    reported.finish()
    assert reported.is_read()
    assert drained(reading) == b"no more threads"


def test_a_full_disk_is_reported_in_words():
    full = OSError(errno.ENOSPC, "No space left on device")
    assert output.why_unwritten(full) == (
        "standard output cannot be written: No space left on device"
    )


def test_a_session_s_own_stream_drops_what_does_not_fit(pipe):
    fill(pipe[1])
    os.set_blocking(pipe[1], False)
    assert DroppingOutput(pipe[1]).write(PIECE) == len(PIECE)
    text = output.dropping_text(pipe[1])
    print("a line", file=text)
    drained(pipe[0])
    print("a line ä \ud800", file=text)
    assert drained(pipe[0]).decode() == "a line ä \\ud800\n"


def test_streams_that_are_no_files_stay(monkeypatch):
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setattr(sys, "stderr", None)
    with output.in_background():
        print("said")
        assert output.is_read()
        assert output.finish("stdout") is None
    assert stream.getvalue() == "said\n"


def test_streams_are_put_back(pipe, monkeypatch):
    mine = io.TextIOWrapper(io.FileIO(pipe[1], "w", closefd=False), encoding="utf-8")
    monkeypatch.setattr(sys, "stdout", mine)
    with output.in_background():
        assert sys.stdout is not mine
        print("said")
        assert output.finish("stdout") is None
        print("too late")
    assert sys.stdout is mine
    assert drained(pipe[0]) == b"said\n"
