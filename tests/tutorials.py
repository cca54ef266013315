"""Reader of docs/tutorials who follows every step: files, terminals, commands.

They are typed as they stand, in an empty folder and an environment that has what the page installs:
Cardan's wheel, and of its source archive what the page takes from there. `STAND_INS` has what takes
another thing's place.
"""

from __future__ import annotations

import re
import shlex
import signal
import socket
import subprocess
import sys
import tarfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from scapy.layers.inet import IP, UDP
from scapy.layers.l2 import Ether
from scapy.utils import wrpcap

from cardan.sim_peers.egm_controller import EgmController, EgmControllerOptions
from tests.released import ROOT, clean_environment, run
from tests.serving import free_tcp_port, free_udp_port
from tests.waiting import until

FOLDER = ROOT / "docs" / "tutorials"
PAGES = sorted(FOLDER.glob("*.md"))

BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
OWN_TERMINALS = re.compile(r"\b(separate terminal|two terminals)\b")
OF_THE_SOURCES = re.compile(r"\b(?:examples|plugins)/")
"""Source archive's folders in a command."""
LONGEST_S = 120.0
"""Time limit of a command on a busy computer."""

UDP_PORT, TCP_PORT, CONSOLE_PORT = "6510", "7447", 8443
STAND_INS = {
    UDP_PORT: "a free port: another test, or a controller, may have the page's",
    TCP_PORT: "a free port: another test, or a router, may have the page's",
    "0.0.0.0": "127.0.0.1: a test listens for no other computer",
    "capture.pcap": "made by the test: what is on the wire is shown to the superuser alone",
    "pip": "uv, where it is there: it needs seconds for half a gigabyte",
}
"""Substitutes in the test for parts of the page, each with the reason."""

FINDS = re.compile(r"cardan doctor\b")
"""Commands that may exit with 4, because this computer lacks something or has no controller."""
UNTIL_CTRL_C = re.compile(r"cardan run (?!.*--seconds)")
SERVES = "console http"


@dataclass(frozen=True)
class Step:
    """Block of a page: a file to write, or commands."""

    file: str
    """Name of the file; empty: commands."""
    text: str
    aside: bool
    """True if the commands keep running during the next steps."""

    @property
    def commands(self) -> list[str]:
        return [] if self.file else self.text.replace("\\\n", " ").splitlines()


def steps(page: str) -> Iterator[Step]:
    """Yield the steps of the page in its order."""
    end = 0
    for found in BLOCK.finditer(page):
        before = page[end : found.start()].rstrip().split("\n\n")[-1]
        end = found.end()
        if found[1]:
            if named := re.findall(r"`([\w-]+\.\w+)`", before):
                yield Step(named[-1 if before.endswith("`:") else 0], found[2], False)
        else:
            yield Step("", found[2], bool(OWN_TERMINALS.search(before)))


class Reader:
    """Environment and folder of a page's reader."""

    def __init__(self, folder: Path, wheel: Path, sdist: Path) -> None:
        """Make both, empty, in `folder`."""
        self.here = folder / "here"
        self.here.mkdir()
        self._sdist = sdist
        self._environment = folder / "environment"
        run(sys.executable, "-m", "venv", "--without-pip", self._environment)
        constraints = folder / "constraints.txt"
        locked = (ROOT / "locks" / "dev.txt").read_text(encoding="utf-8").splitlines()
        lines = [line.rstrip(" \\") for line in locked if re.match(r"[\w.-]+==", line)]
        constraints.write_text("\n".join([*lines, f"cardan @ {wheel.as_uri()}\n"]))
        outside = clean_environment()
        self.variables = {
            **outside,
            "PATH": f"{self._environment / 'bin'}:{outside['PATH']}",
            "VIRTUAL_ENV": str(self._environment),
            "UV_CONSTRAINT": str(constraints),
            "PIP_CONSTRAINT": str(constraints),
            "XDG_STATE_HOME": str(folder / "state"),
        }
        uv = Path(sys.executable).with_name("uv")
        pip = (sys.executable, "-m", "pip", "--python", str(self._environment))
        self._pip = [str(uv), "pip"] if uv.exists() else [*pip]

    def words(self, command: str) -> list[str]:
        """Split the command like a shell."""
        first, *others = shlex.split(command, comments=True)
        # The search for the program uses this process's own PATH.
        program = self._environment / "bin" / first
        if first == "pip":
            return [*self._pip, *others]
        return [str(program) if program.exists() else first, *others]

    def run(self, command: str) -> str:
        """Run a command that ends by itself; return its output."""
        if OF_THE_SOURCES.search(command) and not (self.here / "plugins").exists():
            self._unpack_sources()
        codes = (0, 4) if FINDS.match(command) else (0,)
        words = self.words(command)
        return run(
            *words, codes=codes, folder=self.here, environment=self.variables, longest_s=LONGEST_S
        )

    def start(self, command: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            self.words(command),
            cwd=self.here,
            env=self.variables,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            text=True,
        )

    def run_until_it_serves(self, command: str) -> str:
        """Run a command until it serves, and end it by Ctrl-C; return its output."""
        wait_until_free(CONSOLE_PORT)
        with self.start(command) as process:
            try:
                assert process.stdout is not None
                said = ""
                for line in process.stdout:
                    said += line
                    if SERVES in line:
                        process.send_signal(signal.SIGINT)
                assert SERVES in said, said
            finally:
                process.kill()
        assert process.returncode == 0, said
        return said

    @contextmanager
    def aside(self, command: str, port: int) -> Iterator[None]:
        """Run the command during the block, which starts once it is ready."""
        with self.start(command) as process:
            try:
                assert process.stdout is not None
                if " sim " in command:
                    assert process.stdout.readline().startswith("READY"), command
                else:
                    wait_for(port, process)
                yield
            finally:
                process.terminate()

    def place_of_cardan(self) -> Path:
        """Return the path of Cardan in the environment."""
        said = run(
            self._environment / "bin/python",
            "-c",
            "import cardan; print(cardan.__file__)",
            folder=self.here,
            environment=self.variables,
        )
        return Path(said.strip()).relative_to(self._environment)

    def _unpack_sources(self) -> None:
        """Unpack the folders of the source archive that the pages name."""
        with tarfile.open(self._sdist) as archive:
            for member in archive:
                _, _, name = member.name.partition("/")
                if OF_THE_SOURCES.match(name):
                    member.name = name
                    archive.extract(member, self.here)


def wait_for(port: int, process: subprocess.Popen[str]) -> None:
    """Wait until a server listens at that TCP port of this computer."""
    end_s = time.monotonic() + LONGEST_S
    while time.monotonic() < end_s and process.poll() is None:
        if listens(port):
            return
        time.sleep(0.05)
    raise AssertionError(f"{process.args} does not listen at {port}")


def wait_until_free(port: int) -> None:
    """Wait until no process listens at that TCP port, which another test may have."""
    until(lambda: not listens(port), f"the release of port {port}", LONGEST_S)


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def write_capture(path: Path) -> None:
    """Write a datagram of an ABB controller in tcpdump's format."""
    data = EgmController(EgmControllerOptions()).cycle(0.0)
    assert data is not None
    wrpcap(str(path), [Ether() / IP() / UDP(sport=40000, dport=int(UDP_PORT)) / data])


def follow(page: Path, reader: Reader) -> Iterator[tuple[str, str]]:
    """Take every step of the page; return each command's line and its output."""
    udp, tcp = free_udp_port(), free_tcp_port()
    text = page.read_text(encoding="utf-8")
    shown = {UDP_PORT: str(udp), TCP_PORT: str(tcp), "0.0.0.0": "127.0.0.1"}
    with ExitStack() as terminals:
        for step in steps(text):
            places = rf"\b({'|'.join(map(re.escape, shown))})\b"
            body = re.sub(places, lambda found: shown[found[1]], step.text)
            if step.file:
                (reader.here / step.file).write_text(body, encoding="utf-8")
                continue
            commands = Step("", body, step.aside).commands
            for line, command in zip(step.commands, commands, strict=True):
                if "capture.pcap" in line:
                    write_capture(reader.here / "capture.pcap")
                if step.aside:
                    terminals.enter_context(reader.aside(command, tcp))
                elif UNTIL_CTRL_C.match(line):
                    yield line, reader.run_until_it_serves(command)
                else:
                    yield line, reader.run(command)
