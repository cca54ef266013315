"""Logs go to standard error as it is at the time."""

import io
import logging
import subprocess
import sys

import pytest

from cardan.logs import log_to_stderr


@pytest.fixture
def logging_set_up(monkeypatch):
    """Sets up a root logger that has not been: pytest gives it handlers before each test."""
    logger = logging.getLogger()
    level = logger.level

    def set_up():
        monkeypatch.setattr(logger, "handlers", [])
        log_to_stderr(logging.INFO)

    yield set_up
    logger.setLevel(level)


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


@pytest.mark.parametrize("module", ["cardan.logs", "cardan.cli"])
def test_it_is_imported_by_every_python(module):
    done = subprocess.run(
        [sys.executable, "-c", f"import {module}"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
