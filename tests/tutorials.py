"""The pages of docs/tutorials as a person goes through them: files, terminals, commands."""

from __future__ import annotations

import io
import os
import re
import shlex
import socket
import subprocess
import sys
import time
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from pathlib import Path

from tests.command_line import the_command_line
from tests.docs_commands import AT_ONCE
from tests.serving import free_tcp_port, free_udp_port

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "tutorials"
PAGES = sorted(FOLDER.glob("*.md"))

BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
OWN_TERMINALS = re.compile(r"\b(terminal of its own|two terminals)\b")
LONGEST_S = 60.0
"""Of a command, on a busy machine."""

UDP_PORT, TCP_PORT = "6510", "7447"
"""The pages' ports; free ones take their place."""


@dataclass(frozen=True)
class Step:
    """A block: a file to write, or commands."""

    file: str
    """Its name; empty: commands."""
    text: str
    aside: bool
    """The commands go on while the next steps are taken."""

    @property
    def commands(self) -> list[str]:
        return [] if self.file else self.text.replace("\\\n", " ").splitlines()


def steps(page: str) -> Iterator[Step]:
    """Yield the steps of the page, in its order."""
    end = 0
    for found in BLOCK.finditer(page):
        before = page[end : found.start()].rstrip().split("\n\n")[-1]
        end = found.end()
        if found[1]:
            if named := re.findall(r"`([\w-]+\.\w+)`", before):
                yield Step(named[-1 if before.endswith("`:") else 0], found[2], False)
        else:
            yield Step("", found[2], bool(OWN_TERMINALS.search(before)))


def words_of(command: str) -> list[str]:
    """The command with this Python, and the package of this source tree."""
    python = {"cardan": [sys.executable, "-m", "cardan"], "python": [sys.executable]}
    result: list[str] = []
    for word in shlex.split(command, comments=True):
        begins = not result or result[-1] == "--"
        result += python.get(word, [word]) if begins else [word]
    return result


def said_here(command: str, folder: Path) -> str:
    """Return the output of a command that opens nothing; a process would take a second."""
    printed = io.StringIO()
    with chdir(folder), redirect_stdout(printed), suppress(SystemExit):
        assert the_command_line()(shlex.split(command)[1:], standalone_mode=False) in (None, 0), (
            command
        )
    return printed.getvalue()


@contextmanager
def chdir(folder: Path) -> Iterator[None]:
    """contextlib's, which Python 3.10 does not have."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


@contextmanager
def aside(command: str, folder: Path, port: int) -> Iterator[None]:
    """The command running, from when it is ready on."""
    process = subprocess.Popen(
        words_of(command), cwd=folder, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True
    )
    with process:
        try:
            assert process.stdout is not None
            if " sim " in command:
                assert process.stdout.readline().startswith("READY"), command
            else:
                wait_for(port, process)
            yield
        finally:
            process.terminate()


def wait_for(port: int, process: subprocess.Popen[str]) -> None:
    """Wait until a server listens at that TCP port of this computer."""
    end_s = time.monotonic() + LONGEST_S
    while time.monotonic() < end_s and process.poll() is None:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)
    raise AssertionError(f"{process.args} does not listen at {port}")


def follow(page: Path, folder: Path, left_out: Collection[str]) -> Iterator[tuple[str, str]]:
    """Take every step of the page in `folder`; each command's line and what it printed."""
    udp, tcp = free_udp_port(), free_tcp_port()
    text = page.read_text(encoding="utf-8")
    shown = {UDP_PORT: str(udp), TCP_PORT: str(tcp)}
    with ExitStack() as terminals:
        for step in steps(text):
            body = re.sub(rf"\b({UDP_PORT}|{TCP_PORT})\b", lambda m: shown[m[1]], step.text)
            if step.file:
                (folder / step.file).write_text(body, encoding="utf-8")
                continue
            commands = Step("", body, step.aside).commands
            for line, command in zip(step.commands, commands, strict=True):
                if line in left_out:
                    continue
                if step.aside:
                    terminals.enter_context(aside(command, folder, tcp))
                    continue
                if AT_ONCE.match(line):
                    yield line, said_here(command, folder)
                    continue
                done = subprocess.run(
                    words_of(command),
                    cwd=folder,
                    stdin=subprocess.DEVNULL,
                    capture_output=True,
                    text=True,
                    timeout=LONGEST_S,
                    check=False,
                )
                assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
                yield line, done.stdout
