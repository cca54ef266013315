"""Opens sockets at addresses and paths as given by users, with errors that say what is wrong.

A Unix socket bound here is its owner's (mode 0600) for any umask, unless opened for all users; a
program that serves at a path is trusted only by its user.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import ipaddress
import os
import socket
import stat
import struct
import sys
import termios
import time
from collections.abc import Callable, Iterator
from typing import Any, Final, NamedTuple

from cardan.common.bounds import shared_address
from cardan.errors import AddressError

OWNER_ONLY: Final = 0o600
EVERYBODY: Final = 0o666

DRAIN_AT_MOST: Final = 256
"""Most datagrams taken from a socket at once: a flood must not delay a cycle."""

QUEUE_LOOK_S: Final = 0.01
"""Pause before another attempt to enter a full queue."""

_INT: Final = struct.Struct("i")
_NO_BYTES: Final = bytes(_INT.size)

_TWO: Final = struct.Struct("II")
_MEMINFO: Final = 55 if sys.platform == "linux" else None
"""Linux' SO_MEMINFO: the memory of unread data, its limit, and more."""

_STAMPS: Final = 35
"""Linux' SO_TIMESTAMPNS, which Python does not name; the stamps' own type is the same number."""
_STAMP: Final = struct.Struct("@ll")
_STAMP_BYTES: Final = socket.CMSG_SPACE(_STAMP.size)
LAIN_AT_MOST_S: Final = 10.0
"""Longest time of a datagram in the buffer; beyond, the clock of its stamp has been set since."""

_ANY_PORT: Final = 9
"""Port for querying the system about an address: nothing is sent."""


def hang_up(sock: socket.socket) -> None:
    """End and close a stream, even if a forked process still has it."""
    with contextlib.suppress(OSError):
        sock.shutdown(socket.SHUT_RDWR)
    sock.close()


def waiting_bytes(sock: socket.socket) -> int:
    """Return the unread bytes of a stream; 0 if it is closed."""
    if sock.fileno() < 0:
        return 0
    try:
        (waiting,) = _INT.unpack(fcntl.ioctl(sock.fileno(), termios.FIONREAD, _NO_BYTES))
    except OSError:
        return 0
    return int(waiting)


def has_room(sock: socket.socket) -> bool:
    """Return whether a stream's receive buffer is far from full: no data of its sender waits
    elsewhere."""
    try:
        if _MEMINFO is None:
            size = sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
            return waiting_bytes(sock) < size // 8
        held, size = _TWO.unpack(sock.getsockopt(socket.SOL_SOCKET, _MEMINFO, _TWO.size))
    except OSError:  # It is closed.
        return True
    return bool(held < size // 4)


def address_towards(host: str, port: int) -> str:
    """Return the address of this computer on the route to `host`. No packet is sent. Raises OSError
    without a route."""
    family, _, _, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    with socket.socket(family, socket.SOCK_DGRAM) as way:
        way.connect(place)
        return str(way.getsockname()[0])


def is_loopback(host: str) -> bool:
    """Return whether a name or an address, in brackets or not, is this computer only (names: RFC
    6761, 6.3)."""
    if host == "localhost" or host.endswith(".localhost"):
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def refuse_shared(problem: str, address: str, *, listens: bool) -> None:
    """Raise an AddressError that begins with `problem` unless `address`, a number, is one
    computer's; for `listens`, all addresses of this computer are allowed."""
    kind = shared_address(address)
    if kind and listens and ipaddress.ip_address(address).is_unspecified:
        return
    if not kind and ":" not in address:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect((address, _ANY_PORT))
            except PermissionError:  # A network's broadcast address needs a permission of its own.
                kind = "a broadcast address"
            except OSError:
                pass
    if kind:
        raise AddressError(f"{problem}: {address} is {kind}; give the address of one computer")


def opened(
    host: str,
    port: int,
    kind: socket.SocketKind,
    join: Callable[[socket.socket, Any], object],
    problem: str | Callable[[OSError], str],
    family: socket.AddressFamily = socket.AF_INET,
) -> socket.socket:
    """Return a non-blocking socket that `join` has bound or connected to `host` and `port`. Raises
    an AddressError that begins with `problem`, or the one that `problem` returns for the error."""
    sock = None
    try:
        found = socket.getaddrinfo(host, port, family=family, type=kind)[0]
        if kind is socket.SOCK_DGRAM:
            listens = join is not socket.socket.connect
            option = f"{'listen_host' if listens else 'host'} {host!r}"
            refused = problem if isinstance(problem, str) else option
            refuse_shared(refused, str(found[4][0]), listens=listens)
        sock = socket.socket(*found[:3])
        join(sock, found[4])
    except (OSError, UnicodeError) as error:
        if sock is not None:
            sock.close()
        if isinstance(error, UnicodeError):  # of a name that no host can have
            error = socket.gaierror(socket.EAI_NONAME, str(error))
        words = f"{problem}: {error}" if isinstance(problem, str) else problem(error)
        raise AddressError(words) from None
    sock.setblocking(False)
    return sock


def waiting(
    sock: socket.socket, largest: int, failed: Callable[[], object] = lambda: None
) -> Iterator[tuple[bytes, Any]]:
    """Yield the waiting datagrams of at most `largest` bytes, with their sources. `failed` is
    called for each OSError, such as of an earlier undeliverable datagram."""
    for _ in range(DRAIN_AT_MOST):
        try:
            yield sock.recvfrom(largest)
        except BlockingIOError:
            return
        except OSError:
            failed()


def ask_for_stamps(sock: socket.socket) -> bool:
    """Let the kernel stamp received datagrams; return False if it cannot, as on macOS."""
    if sys.platform != "linux":
        return False
    try:
        sock.setsockopt(socket.SOL_SOCKET, _STAMPS, 1)
    except OSError:
        return False
    return True


def waiting_stamped(sock: socket.socket, largest: int) -> Iterator[tuple[bytes, Any, float]]:
    """Yield waiting datagrams of a socket with stamps, each with its time in the receive buffer,
    s."""
    for _ in range(DRAIN_AT_MOST):
        try:
            data, ancillary, _flags, source = sock.recvmsg(largest, _STAMP_BYTES)
        except BlockingIOError:
            return
        except OSError:
            continue
        lain_s = 0.0
        for level, kind, value in ancillary:
            if (level, kind) == (socket.SOL_SOCKET, _STAMPS) and len(value) == _STAMP.size:
                seconds, ns = _STAMP.unpack(value)
                lain_s = (time.time_ns() - seconds * 10**9 - ns) * 1e-9
        yield data, source, lain_s if 0.0 <= lain_s <= LAIN_AT_MOST_S else 0.0


class Advice(NamedTuple):
    """Advice for a path that cannot be used, in terms of the option that the user gave."""

    no_socket: str = "give another path"
    """The path belongs to something else."""
    served: str = "end it or give another path"
    """Another program serves at the path."""
    refused: str = "give a short path in a directory that can be written"
    """The system refuses the path."""


ANOTHER_PATH = Advice()


class UnixSocket:
    """A Unix socket of `kind` bound at `path`, for the users of `mode`; it does not listen. A stale
    socket there is removed. Raises AddressError if the path cannot be used.
    """

    def __init__(
        self,
        path: str,
        kind: socket.SocketKind,
        mode: int = OWNER_ONLY,
        advice: Advice = ANOTHER_PATH,
    ) -> None:
        self.path = os.path.abspath(path)
        if not hasattr(socket, "AF_UNIX"):
            raise AddressError(f"cannot create the socket {path!r}: this system has none")
        _remove_stale(path, kind, advice)
        self.sock = socket.socket(socket.AF_UNIX, kind)
        try:
            self.sock.setblocking(False)
            # On Linux the node is made with its descriptor's mode: no other user gets in before.
            with contextlib.suppress(OSError):
                os.fchmod(self.sock.fileno(), mode)
            self.sock.bind(path)
            self._identity: tuple[int, int] | None = _identity(path)
            os.chmod(path, mode)
        except OSError as error:
            self.sock.close()
            why = error.strerror or str(error)
            if folder := _missing_folder(path):
                why = f"there is no directory {folder}"
            problem = f"cannot create the socket {path!r}: {why}; {advice.refused}"
            raise AddressError(problem) from None

    def close(self) -> None:
        """Close it and remove its path, unless another program has replaced it. Never raises;
        idempotent."""
        self.sock.close()
        with contextlib.suppress(OSError):
            if self._identity is not None and _identity(self.path) == self._identity:
                os.unlink(self.path)
        self._identity = None


class UntrustedServerError(PermissionError):
    """Error: another user's program serves at a path where anybody may put a socket."""


def connected(path: str, kind: socket.SocketKind, timeout_s: float | None) -> socket.socket:
    """Return a socket connected to the Unix socket at `path`; its operations take at most
    `timeout_s`. Raises OSError; an UntrustedServerError if neither the superuser, nor this user,
    nor the owner of the socket's directory serves there: anybody can put a socket into /tmp.
    """
    peer = socket.socket(socket.AF_UNIX, kind)
    try:
        peer.settimeout(timeout_s)
        _connect(peer, path, timeout_s)
        user = user_of(peer)
        if user is not None and user not in (0, os.geteuid()):
            folder = os.path.dirname(os.path.abspath(path))
            if user != os.stat(folder).st_uid:
                raise UntrustedServerError(
                    errno.EPERM,
                    f"user {user} serves it, who is neither you nor the superuser nor the owner "
                    f"of {folder}",
                )
    except OSError:
        peer.close()
        raise
    return peer


def _connect(peer: socket.socket, path: str, timeout_s: float | None) -> None:
    """Connect, including the wait for a place in the server's queue: with a time limit the kernel
    gives EAGAIN instead."""
    end_s = time.monotonic() + (timeout_s or 0.0)
    while True:
        try:
            peer.connect(path)
        except BlockingIOError:
            if time.monotonic() >= end_s:
                raise TimeoutError(errno.ETIMEDOUT, "too many connections wait there") from None
            time.sleep(QUEUE_LOOK_S)
        else:
            return


_CREDENTIALS = struct.Struct("=iII")
"""Linux's struct ucred: process, user, group."""


def user_of(peer: socket.socket) -> int | None:
    """Return the user at the other end of a Unix socket, known to the kernel since the connection;
    None: unknown."""
    if not hasattr(socket, "SO_PEERCRED"):
        return None
    data = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    user: int = _CREDENTIALS.unpack(data)[1]
    return user


def runtime_path(name: str) -> str:
    """Return the default path of a socket `name` of this user's programs. It is in the system's
    folder for sockets, XDG_RUNTIME_DIR; without one in the folder cardan-UID among the temporary
    files."""
    folder = os.environ.get("XDG_RUNTIME_DIR", "")
    if not os.path.isabs(folder):
        user = os.getuid() if hasattr(os, "getuid") else 0
        import tempfile

        folder = os.path.join(tempfile.gettempdir(), f"cardan-{user}")
    return os.path.join(folder, name)


def make_runtime_folder() -> None:
    """Make the folder of `runtime_path`, unless it is there. Raises AddressError if another user
    may change its contents."""
    folder = os.path.dirname(runtime_path(""))
    try:
        with contextlib.suppress(FileExistsError):
            os.mkdir(folder, 0o700)
        status = os.lstat(folder)
    except OSError as error:
        raise AddressError(f"cannot make the folder {folder}: {error.strerror}") from None
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid() or status.st_mode & 0o22:
        raise AddressError(
            f"{folder} is not a folder that only you can change: remove it, or give another path"
        )


def absence(path: str, what: str = "socket") -> str:
    """Return the missing part of the path `path`, which may be relative; empty if it exists."""
    whole = os.path.abspath(path)
    if os.path.lexists(whole):
        return ""
    folder = _missing_folder(path)
    return f"there is no {what} at {whole}" + (f", and no directory {folder}" if folder else "")


def _missing_folder(path: str) -> str:
    folder = os.path.dirname(os.path.abspath(path))
    return "" if os.path.isdir(folder) else folder


def _identity(path: str) -> tuple[int, int]:
    info = os.stat(path, follow_symlinks=False)
    return info.st_dev, info.st_ino


def _remove_stale(path: str, kind: socket.SocketKind, advice: Advice) -> None:
    """Remove a socket file that no program listens on. Raises AddressError for anything else."""
    try:
        if not stat.S_ISSOCK(os.lstat(path).st_mode):
            raise AddressError(f"{path!r} exists and is not a socket; {advice.no_socket}")
    except FileNotFoundError:
        return
    except OSError as error:
        raise AddressError(f"cannot use {path!r}: {error.strerror}") from None
    with socket.socket(socket.AF_UNIX, kind) as probe:
        probe.setblocking(False)
        try:
            result = probe.connect_ex(path)
        except OSError as error:
            raise AddressError(f"cannot use {path!r}: {error}") from None
    if result == errno.ECONNREFUSED:
        try:
            os.unlink(path)
        except FileNotFoundError:
            return
        except OSError as error:
            raise AddressError(f"cannot remove {path!r}: {error.strerror}") from None
    elif result != errno.ENOENT:
        how = os.strerror(result) if result else "it answers"
        raise AddressError(f"another program serves {path!r} ({how}); {advice.served}")
