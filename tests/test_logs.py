"""Logs go to the current standard error."""

import io
import json
import logging
import os
import socket
import struct
import subprocess
import sys

import pytest

from cardan.common import logs
from cardan.common.logs import LogFormat, fields, found_format, log_to_stderr


@pytest.fixture
def logging_set_up(monkeypatch):
    """Set up a root logger without handlers, which pytest adds before each test."""
    logger = logging.getLogger()
    level = logger.level

    def set_up(form=LogFormat.TEXT):
        monkeypatch.setattr(logger, "handlers", [])
        log_to_stderr(logging.INFO, form)
        made.extend(logger.handlers)

    made = []

    yield set_up
    logger.setLevel(level)
    for handler in made:
        handler.close()


def test_a_line_goes_to_what_stderr_is_now(logging_set_up, monkeypatch):
    logging_set_up()
    for number in range(2):
        stream = io.StringIO()
        monkeypatch.setattr(sys, "stderr", stream)
        logging.getLogger("cardan.test").info("number %d \x1b", number)
        (line,) = stream.getvalue().splitlines()
        assert line.endswith(f"cardan.test: number {number} \\x1b")


def test_what_cannot_be_logged_harms_nobody(logging_set_up, monkeypatch):
    logging_set_up()
    stream = io.StringIO()
    stream.close()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(logging, "raiseExceptions", False)
    logging.getLogger("cardan.test").warning("lost")


@pytest.mark.parametrize("module", ["cardan.common.logs", "cardan.cli"])
def test_it_is_imported_by_every_python(module):
    done = subprocess.run(
        [sys.executable, "-c", f"import {module}"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def logged(monkeypatch):
    """Return lines logged with fields and with a traceback, as standard error shows them."""
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    log = logging.getLogger("cardan.test")
    log.warning("%s: it\nwaits\x1b", "gofa", extra=fields(name="gofa", event="waiting", why=""))
    try:
        raise ValueError("a fault")
    except ValueError:
        log.exception("oh")
    log.debug("not shown")
    return stream.getvalue()


def test_json_is_one_object_a_line(logging_set_up, monkeypatch):
    logging_set_up(LogFormat.JSON)
    first, second = map(json.loads, logged(monkeypatch).splitlines())
    assert first.pop("time")[10::13] == "TZ"
    assert first == {
        "level": "warning",
        "logger": "cardan.test",
        "name": "gofa",
        "event": "waiting",
        "message": "gofa: it\nwaits\x1b",
    }
    assert second["traceback"].splitlines()[-1] == "ValueError: a fault"


@pytest.fixture
def journal(tmp_path, monkeypatch):
    path = str(tmp_path / "journal")
    monkeypatch.setattr(logs, "JOURNAL_SOCKET", path)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as journal:
        journal.bind(path)
        journal.settimeout(5.0)
        yield journal


def entry(data):
    """Return the fields of an entry, decoded by systemd's documentation of the protocol."""
    found = {}
    while data:
        name, _, data = data.partition(b"\n")
        if b"=" in name:
            name, _, value = name.partition(b"=")
        else:
            (length,) = struct.unpack_from("<Q", data)
            value, data = data[8 : 8 + length], data[9 + length :]
        found[name.decode()] = value.decode()
    return found


def test_the_journal_gets_fields(logging_set_up, monkeypatch, journal):
    logging_set_up(LogFormat.JOURNAL)
    assert logged(monkeypatch) == ""
    assert entry(journal.recv(65536)) == {
        "MESSAGE": "gofa: it\\nwaits\\x1b",
        "PRIORITY": "4",
        "SYSLOG_IDENTIFIER": "cardan",
        "CARDAN_LOGGER": "cardan.test",
        "CARDAN_NAME": "gofa",
        "CARDAN_EVENT": "waiting",
    }
    fault = entry(journal.recv(65536))
    assert fault["PRIORITY"] == "3"
    assert fault["MESSAGE"].splitlines()[0] == "oh"
    assert fault["MESSAGE"].splitlines()[-1] == "ValueError: a fault"


def test_without_the_journal_its_lines_have_priorities(logging_set_up, monkeypatch, tmp_path):
    monkeypatch.setattr(logs, "JOURNAL_SOCKET", str(tmp_path / "none"))
    logging_set_up(LogFormat.JOURNAL)
    first, second = logged(monkeypatch).splitlines()
    assert first == "<4>cardan.test: gofa: it\\nwaits\\x1b"
    assert second.startswith("<3>cardan.test: oh\\nTraceback")


def test_who_reads_says_the_format(monkeypatch, tmp_path):
    with (tmp_path / "log").open("w") as file:
        monkeypatch.setattr(sys, "stderr", file)
        monkeypatch.delenv(logs.JOURNAL_VARIABLE, raising=False)
        assert found_format() is LogFormat.JSON
        found = os.fstat(file.fileno())
        monkeypatch.setenv(logs.JOURNAL_VARIABLE, f"{found.st_dev}:{found.st_ino}")
        assert found_format() is LogFormat.JOURNAL
        monkeypatch.setenv(logs.JOURNAL_VARIABLE, f"{found.st_dev}:{found.st_ino + 1}")
        assert found_format() is LogFormat.JSON, "the variable was meant for another process"
    theirs, ours = os.openpty()
    with os.fdopen(theirs, "rb", 0), os.fdopen(ours, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        assert found_format() is LogFormat.TEXT
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    assert found_format() is LogFormat.JSON


def test_levels_survive_the_way_through_another_process(logging_set_up, monkeypatch):
    logging_set_up(LogFormat.PRIORITY)
    first, second = map(logs.level_of, logged(monkeypatch).splitlines())
    assert first == (logging.WARNING, "cardan.test: gofa: it\\nwaits\\x1b")
    assert second[0] == logging.ERROR
    assert "ValueError: a fault" in second[1]


@pytest.mark.parametrize(
    ("line", "level", "text"),
    [
        ("<0>gone", logging.CRITICAL, "gone"),
        ("<2>gone", logging.CRITICAL, "gone"),
        ("<5>note", logging.INFO, "note"),
        ("<7>detail", logging.DEBUG, "detail"),
        ("<8>odd", logging.INFO, "<8>odd"),
        ("plain <3>", logging.INFO, "plain <3>"),
        ("", logging.INFO, ""),
    ],
)
def test_the_level_of_a_line(line, level, text):
    assert logs.level_of(line) == (level, text)
