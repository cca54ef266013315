"""Third-party text on its way to the terminal."""

from __future__ import annotations

import io
import logging

import pytest
from hypothesis import given, strategies as st

import cardan.cli
from cardan.cli.common import print_table
from cardan.common.logs import PrintableFormatter
from cardan.common.plugins import reason
from cardan.common.text_sanitizer import printable
from cardan.errors import ConfigurationError, DeviceAccessError

NASTY = "seen\x1b[2J\r\nforged\x9b"
SHOWN = r"seen\x1b[2J\r\nforged\x9b"


@given(st.text())
def test_all_of_it_is_printable_and_plain_text_is_as_it_was(text):
    assert printable(text).isprintable()
    assert text.isprintable() <= (printable(text) == text)


def test_line_ends_stay_where_they_may():
    assert printable("a\n\tb", "\n") == "a\n\\tb"


def test_a_log_has_one_line_a_message():
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.setFormatter(PrintableFormatter("%(levelname)s %(message)s"))
    log = logging.Logger("wire")
    log.addHandler(handler)
    log.warning("the device says %s", NASTY)
    assert stream.getvalue() == f"WARNING the device says {SHOWN}\n"
    try:
        raise ValueError(NASTY)
    except ValueError:
        log.exception("failed")
    assert "Traceback" in stream.getvalue()
    assert stream.getvalue().replace("\n", "").isprintable()


@pytest.mark.parametrize(
    "error", [DeviceAccessError(f"the daemon says {NASTY}"), ConfigurationError("key", NASTY)]
)
def test_an_error_does_not_command_the_terminal(error, monkeypatch, capsys):
    def fail(**_):
        raise error

    monkeypatch.setattr(cardan.cli, "app", fail)
    with pytest.raises(SystemExit):
        cardan.cli.main()
    said = capsys.readouterr().err
    assert said.startswith("cardan: ")
    assert said.replace("\n", "").isprintable()
    assert isinstance(error, ConfigurationError) or said.count("\n") == 1


def test_a_device_is_listed_by_a_printable_name(capsys):
    print_table(("device",), [(f"[/x]{NASTY}",)])
    said = capsys.readouterr().out
    assert said.replace("\n", "").isprintable()
    assert f"[/x]{SHOWN}" in said


def test_a_plugins_failure_is_printable():
    assert reason(RuntimeError(NASTY)) == r"RuntimeError: seen\x1b[2J forged\x9b"


def test_warnings_that_nobody_takes_are_printable(monkeypatch, capsys):
    monkeypatch.setattr(cardan.cli, "app", lambda **_: 0)
    monkeypatch.setattr(logging.lastResort, "formatter", None)
    with pytest.raises(SystemExit):
        cardan.cli.main()
    assert isinstance(logging.lastResort.formatter, PrintableFormatter)
    record = logging.LogRecord("x", logging.WARNING, "", 0, NASTY, (), None)
    logging.lastResort.emit(record)
    assert SHOWN in capsys.readouterr().err
