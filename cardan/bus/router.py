"""Keeps a router running on this computer, in a child process, while a node needs it."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from cardan.bus.options import BusOptions
from cardan.common.sockets import is_loopback, make_runtime_folder, runtime_path
from cardan.errors import AddressError, OptionError
from cardan.types import NEVER_S

LOOK_PERIOD_S = 1.0
"""Period of checks for a router: connected nodes do without one, and new nodes wait longer than
this."""

RESTART_PAUSE_S = 5.0
"""Pause after a router has failed: the next one may fail too, and its start takes a processor for a
second."""

START_TIMEOUT_S = 10.0
"""Longest wait for a router to serve, which takes a second."""

_WAIT_S = 0.05

END_TIMEOUT_S = 3.0
"""Longest wait for the end of the router's process, which closes its connections first."""

_log = logging.getLogger(__name__)


def router_address(options: BusOptions) -> tuple[str, int] | None:
    """Return host and port of a router that this computer has to serve: on loopback, over TCP. None
    for any other, without one, and with a Zenoh configuration file."""
    protocol, _, rest = options.router.partition("/")
    host, _, port = rest.partition("?")[0].partition("#")[0].rpartition(":")
    if options.zenoh_config or protocol != "tcp" or not is_loopback(host) or not port.isdecimal():
        return None
    return host.strip("[]"), int(port)


def router_addresses(endpoints: Iterable[str]) -> frozenset[tuple[str, int]]:
    """Return the addresses, as of `router_address`, that a router at these endpoints serves."""
    found = set()
    for endpoint in endpoints:
        with contextlib.suppress(OptionError):
            address = router_address(BusOptions(router=_on_loopback(endpoint)))
            if address is not None:
                found.add(address)
                if "127.0.0.1" in address or "localhost" in address:
                    found |= {("127.0.0.1", address[1]), ("localhost", address[1])}
    return frozenset(found)


def _on_loopback(endpoint: str) -> str:
    return endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/127.0.0.1:")


def is_served(address: tuple[str, int]) -> bool:
    """Return True if a program listens there, without a connection, which the program would log."""
    family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        # Remains of closed connections are not listeners.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except OSError as error:
            return error.errno == errno.EADDRINUSE
    return False


_ANNOUNCED = "cardan-router-"
"""Prefix of this user's socket files in which running routers announce their endpoints."""


@contextlib.contextmanager
def announced(endpoints: Iterable[str]) -> Iterator[None]:
    """Announce this process as a router at the endpoints, for `routers_here`."""
    path = Path(runtime_path(f"{_ANNOUNCED}{os.getpid()}"))
    try:
        make_runtime_folder()
        path.write_text("\n".join(endpoints), encoding="utf-8")
    except (AddressError, OSError) as error:
        # Programs that are given the endpoint find it all the same.
        _log.info("the router is not announced to other programs: %s", error)
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()


def routers_here(served: Callable[[tuple[str, int]], bool] = is_served) -> list[str]:
    """Return the loopback endpoints of this user's routers on this computer, one each, in order. A
    killed router is not listed, even if its file is left."""
    found = set()
    for each in Path(runtime_path("")).glob(f"{_ANNOUNCED}*"):
        with contextlib.suppress(OSError, ValueError):
            for said in each.read_text(encoding="utf-8").splitlines():
                endpoint = _on_loopback(said)
                address = router_address(BusOptions(router=endpoint))
                if address is not None and served(address):
                    found.add(endpoint)
                    break
    return sorted(found)


class RouterKeeper:
    """Starts a router if none serves, and again if it has ended.

    If several processes try at once, one succeeds; the others see the port in use, and wait until
    it is free. A router ends with the process that started it.
    """

    def __init__(
        self,
        options: BusOptions | None,
        *,
        served: Callable[[tuple[str, int]], bool] = is_served,
        promised: Callable[[tuple[str, int]], bool] = lambda _address: False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`options`: those of the node that needs the router; None: no node does. `promised`
        returns True while another program is to serve there: this object's router leaves then."""
        self._endpoint = "" if options is None else options.router
        self._address = None if options is None else router_address(options)
        self._served, self._promised, self._clock = served, promised, clock
        self._process: subprocess.Popen[bytes] | None = None
        self._looked_s = self._failed_s = NEVER_S

    @property
    def pid(self) -> int | None:
        """Return the process id of the router that this object started; None if none."""
        return None if self._process is None else self._process.pid

    def poll(self) -> None:
        """Start a router if none serves; call it several times a second. Never raises."""
        if self._address is None or self._clock() - self._looked_s < LOOK_PERIOD_S:
            return
        self._looked_s = self._clock()
        process = self._process
        if process is not None and process.poll() is not None:
            self._process = None
            self._tell(process)
        if self._promised(self._address):
            if self._process is not None:
                self._process.terminate()
            return
        if self._process is not None or self._served(self._address):
            return
        if self._clock() - self._failed_s >= RESTART_PAUSE_S:
            self._start()

    def wait(self, timeout_s: float = START_TIMEOUT_S) -> None:
        """Wait until a router serves, or the time is over. Never raises."""
        end_s = self._clock() + timeout_s
        while self._address is not None and self._clock() < end_s:
            self.poll()
            if self._served(self._address):
                return
            time.sleep(_WAIT_S)

    def _start(self) -> None:
        words = ["net", "server", "router", "--endpoint", self._endpoint, "--attached"]
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "cardan", *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                # Ctrl-C in the terminal must not end it: its parent needs it until its own end.
                start_new_session=True,
            )
        except OSError as error:
            _log.warning("the router cannot be started: %s", error)

    def _tell(self, ended: subprocess.Popen[bytes]) -> None:
        with ended:
            said = b"" if ended.stderr is None else ended.stderr.read()
        address = self._address
        if address is not None and not (self._promised(address) or self._served(address)):
            self._failed_s = self._clock()
            words = said.decode("utf-8", "replace").strip().rpartition("\n")[2]
            _log.warning("the router at %s has ended: %s", self._endpoint, words or "no reason")

    def close(self) -> None:
        """Stop the router that this object started. Never raises; may be called twice."""
        process, self._process = self._process, None
        if process is None:
            return
        process.terminate()
        with process:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=END_TIMEOUT_S)
            if process.poll() is None:
                process.kill()
