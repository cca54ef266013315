"""Keeps a router on this computer while something needs it: a process of its own, by this one."""

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
from cardan.errors import AddressError
from cardan.types import NEVER_S

LOOK_PERIOD_S = 1.0
"""Period of checks for a router: nodes that know each other do without one, and new nodes wait for
it longer than this."""

RESTART_PAUSE_S = 5.0
"""Pause after a router that has failed: the next one may fail as well, and its start takes a
processor for a second."""

START_TIMEOUT_S = 10.0
"""Longest wait for a router to serve, which takes a second."""

_WAIT_S = 0.05

END_TIMEOUT_S = 3.0
"""Longest wait for the end of the router's process, which closes its connections first."""

_log = logging.getLogger(__name__)


def router_address(options: BusOptions) -> tuple[str, int] | None:
    """Host and port of the router, where it is one that this computer would have to serve: on
    loopback, over TCP. None for every other, for none, and where Zenoh's own configuration says."""
    protocol, _, rest = options.router.partition("/")
    host, _, port = rest.partition("?")[0].partition("#")[0].rpartition(":")
    if options.zenoh_config or protocol != "tcp" or not is_loopback(host) or not port.isdecimal():
        return None
    return host.strip("[]"), int(port)


def is_served(address: tuple[str, int]) -> bool:
    """Whether a program listens there. Does not connect to it, which the program would tell of."""
    family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        # Remains of closed connections are no listener.
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except OSError as error:
            return error.errno == errno.EADDRINUSE
    return False


_ANNOUNCED = "cardan-router-"
"""How the files begin, among this user's sockets, in which running routers say where they are."""


@contextlib.contextmanager
def announced(endpoints: Iterable[str]) -> Iterator[None]:
    """Say that this process is a router there, for `routers_here`."""
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
    """The endpoints on loopback of the routers that this user's programs run on this computer, one
    each, in order. A killed router is not listed, whatever it has left behind."""
    found = set()
    for each in Path(runtime_path("")).glob(f"{_ANNOUNCED}*"):
        with contextlib.suppress(OSError, ValueError):
            for said in each.read_text(encoding="utf-8").splitlines():
                endpoint = said.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/127.0.0.1:")
                address = router_address(BusOptions(router=endpoint))
                if address is not None and served(address):
                    found.add(endpoint)
                    break
    return sorted(found)


class RouterKeeper:
    """Starts a router if none serves, and again if it has ended.

    Of several processes that do so at once one is first; the others see that the port is in use,
    and are content until it is free. A router ends with the process that has started it.
    """

    def __init__(
        self,
        options: BusOptions | None,
        *,
        served: Callable[[tuple[str, int]], bool] = is_served,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`options`: of the node that needs the router; None: no node does."""
        self._endpoint = "" if options is None else options.router
        self._address = None if options is None else router_address(options)
        self._served, self._clock = served, clock
        self._process: subprocess.Popen[bytes] | None = None
        self._looked_s = self._failed_s = NEVER_S

    @property
    def pid(self) -> int | None:
        """Process id of the router that this one has started; None: none."""
        return None if self._process is None else self._process.pid

    def poll(self) -> None:
        """Start a router if none serves; call this several times a second. Never raises."""
        if self._address is None or self._clock() - self._looked_s < LOOK_PERIOD_S:
            return
        self._looked_s = self._clock()
        process = self._process
        if process is not None and process.poll() is not None:
            self._process = None
            self._tell(process)
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
                # Ctrl-C in the terminal must not end it: its parent needs it to the end.
                start_new_session=True,
            )
        except OSError as error:
            _log.warning("the router cannot be started: %s", error)

    def _tell(self, ended: subprocess.Popen[bytes]) -> None:
        with ended:
            said = b"" if ended.stderr is None else ended.stderr.read()
        if self._address is not None and not self._served(self._address):
            self._failed_s = self._clock()
            words = said.decode("utf-8", "replace").strip().rpartition("\n")[2]
            _log.warning("the router at %s has ended: %s", self._endpoint, words or "no reason")

    def close(self) -> None:
        """End the router that this one has started. Never raises; twice is fine."""
        process, self._process = self._process, None
        if process is None:
            return
        process.terminate()
        with process:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=END_TIMEOUT_S)
            if process.poll() is None:
                process.kill()
