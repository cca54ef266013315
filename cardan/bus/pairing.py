"""Pairing of two computers by a short code: TLS certificates and Zenoh's configuration for both.

SPAKE2 (RFC 9382, package spake2) derives a key from the code, and both sides confirm it before any
other exchange. An impostor has one guess a connection and, unlike with a pre-shared key of TLS, no
data for an offline search. OpenSSL's SRP would do the same, but the server of OpenSSL 3.0 crashes
with it. Fernet tokens (package cryptography) follow, a line each::

operator: SPAKE2 message, ready, request (its key's, and HOST), stored
    robot:    SPAKE2 message or "busy", ready too, answer (certificate, authority), stored too

Each private key stays on its computer. The authority's key is discarded after two signatures: it
can sign no third certificate.
"""

from __future__ import annotations

import base64
import contextlib
import datetime
import functools
import json
import os
import re
import secrets
import select
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from cardan.bus.node import zenoh_settings
from cardan.bus.options import ROUTER
from cardan.common.certificates import is_address, make_certificate, make_key, read_certificate
from cardan.common.extras import missing_extra
from cardan.common.files import state_folder
from cardan.errors import AddressError, ConfigurationError, OptionError

try:
    from cryptography import x509
    from cryptography.fernet import Fernet, InvalidToken
    from cryptography.hazmat.primitives import hashes, serialization
    from spake2 import SPAKE2_A, SPAKE2_B
except ImportError as error:
    raise missing_extra("pairing", "spake2", "pair", error) from error

TLS_PORT: Final = 7448
"""Port of the robot's router for the operator's computer: UDP for QUIC, TCP for TLS."""
MIXED: Final = "mixed_rel"
"""Parameter of Zenoh's QUIC endpoints: best-effort messages go in datagrams, where no earlier loss
delays them, and reliable ones in streams. "auto": if the peer supports it."""
WAIT_S: Final = 300.0
"""How long the robot's computer waits."""
CLIENT_S: Final = 10.0
"""Longest time for one client, from its connection to its end."""
WRONG_CODES: Final = 3
"""Wrong guesses after which a new code is made."""
VALID_DAYS: Final = 825
CONFIG: Final = "zenoh.json5"
CODE_LETTERS: Final = 8
"""40 bits: ten thousand guesses within `WAIT_S` have a chance of 1 in 10^8."""
_ALPHABET: Final = "23456789ABCDEFGHJKLMNPQRSTUVWXYZ"
"""Without characters that are easily confused."""
_LINE_BYTES: Final = 65536
_HOST: Final = re.compile(r"[a-z0-9]([a-z0-9.-]{0,251}[a-z0-9])?")
_BUSY: Final = b"busy"
Say = Callable[[str], None]


class _EndedError(Exception):
    """Pairing failed, with the reason."""


class _WrongCodeError(_EndedError):
    """The other side used another code."""


def wait_for_operator(
    place: tuple[str, int], replace: bool, show: Say, tell: Say, wait_s: float = WAIT_S
) -> Path:
    """Wait on the robot's computer for the operator's; return the router's file.

    `show` is called with each new code, `tell` with each failure. Raises ConfigurationError, and
    AddressError, which also means that no operator has paired within `wait_s`.
    """
    folder = _folder("as-robot", replace)
    family = socket.AF_INET6 if ":" in place[0] else socket.AF_INET
    try:
        listener = socket.create_server(place, family=family)
    except (OSError, UnicodeError) as error:
        raise AddressError(f"cannot listen at {place[0]} port {place[1]}: {error}") from None
    end_s, code, wrong = time.monotonic() + wait_s, "", WRONG_CODES
    with listener:
        while (left_s := end_s - time.monotonic()) > 0.0:
            if wrong == WRONG_CODES:
                code, wrong = "".join(secrets.choice(_ALPHABET) for _ in range(CODE_LETTERS)), 0
                show(f"{code[:4]}-{code[4:]}")
            if not select.select((listener,), (), (), left_s)[0]:
                continue
            client, _ = listener.accept()
            try:
                with client:
                    until_s = min(end_s, time.monotonic() + CLIENT_S)
                    return _serve(_Channel(client, until_s, listener), code, folder)
            except (_EndedError, OSError) as error:
                wrong += isinstance(error, _WrongCodeError)
                tell(f"pairing did not finish, nothing is stored, still waiting: {error}")
    raise AddressError(f"no computer paired within {wait_s:g} s: pair again on both computers")


def pair_with(
    host: str, port: int, replace: bool, ask: Callable[[], str], *, quic: bool = False
) -> Path:
    """Pair this computer, the operator's, with the robot's at `host`, by the code that `ask`
    returns; return the client's file. `quic`: use QUIC, else TLS.

    Raises ConfigurationError, and AddressError if the robot's side stops answering.
    """
    host = host.lower().removesuffix(".")
    if host[:1] + host[-1:] == "[]" and is_address(host[1:-1]):
        host = host[1:-1]
    if not is_address(host) and not _HOST.fullmatch(host):
        allowed = "a host name (letters, digits, - and .) or an address, without a port"
        raise OptionError("HOST", host, allowed)
    folder = _folder(f"with-{host}", replace)
    code = re.sub(r"[\s-]", "", typed := ask()).upper()
    if len(code) != CODE_LETTERS or not set(code) <= set(_ALPHABET):
        allowed = f"the {CODE_LETTERS} letters and digits that the robot's computer shows"
        raise OptionError("--code", typed, allowed)
    again = "start `cardan net pair` there, and try again while it shows a code"
    try:
        robot = socket.create_connection((host, port), CLIENT_S)
    except (OSError, UnicodeError) as error:
        raise AddressError(
            f"no computer waits for pairing at {host} port {port} ({error}): {again}"
        ) from None
    try:
        with robot:
            channel = _Channel(robot, time.monotonic() + CLIENT_S)
            return _join(channel, host, code, folder, quic=quic)
    except _WrongCodeError:
        raise ConfigurationError(
            "--code", f"{host} shows another code: read it there and try again"
        ) from None
    except (_EndedError, OSError) as error:
        raise AddressError(f"pairing with {host} did not finish ({error}): {again}") from None


class _Channel:
    """Lines to and from the other side; other clients of a `listener` are refused meanwhile."""

    def __init__(self, far: socket.socket, end_s: float, *listener: socket.socket) -> None:
        self._far, self._end_s, self._listener = far, end_s, listener
        self._come = b""
        """Received bytes that were not read yet."""
        far.settimeout(CLIENT_S)

    def agree(self, side: Any) -> None:
        """Agree by SPAKE2 on the key for all later messages. Raises _EndedError."""
        self._write(side.start().hex().encode())
        if (line := self._read()) == _BUSY:
            raise _EndedError("it pairs with another computer")
        try:
            self._key = Fernet(base64.urlsafe_b64encode(side.finish(bytes.fromhex(line.decode()))))
        except Exception as error:  # Any error of the package.
            raise _EndedError(f"no message of a pairing: {type(error).__name__}") from None

    def send(self, step: str, **values: str) -> None:
        self._write(self._key.encrypt(json.dumps({"step": step, **values}).encode()))

    def receive(self, step: str) -> dict[str, str]:
        """Return the values from the other side. Reflected messages of this side fail: steps
        differ."""
        line = self._read()
        try:
            values: dict[str, str] = json.loads(self._key.decrypt(line))
        except InvalidToken:
            with contextlib.suppress(OSError):
                self._write(b"wrong code")
            raise _WrongCodeError("the code was wrong") from None
        if values["step"] != step:
            raise _EndedError(f"{values['step']!r} came in place of {step!r}")
        return values

    def _write(self, line: bytes) -> None:
        self._far.sendall(line + b"\n")

    def _read(self) -> bytes:
        while b"\n" not in self._come:
            left_s = max(0.0, self._end_s - time.monotonic())
            ready = select.select((self._far, *self._listener), (), (), left_s)[0]
            if not ready or not left_s:  # The other side has waited as long, and has left.
                raise _EndedError("it took too long")
            for each in set(ready).intersection(self._listener):
                with contextlib.suppress(OSError), each.accept()[0] as other:
                    other.sendall(_BUSY + b"\n")
            if self._far in ready:
                if not (piece := self._far.recv(4096)):
                    raise _EndedError("the connection ended")
                self._come += piece
                if len(self._come) > _LINE_BYTES:
                    raise _EndedError("its line is too long")
        # "ready" may arrive together with the SPAKE2 message before it.
        line, _, self._come = self._come.partition(b"\n")
        return line


def _serve(channel: _Channel, code: str, folder: Path) -> Path:
    channel.agree(SPAKE2_B(code.encode(), b"operator", b"robot"))
    channel.receive("ready")
    channel.send("ready too")
    asked = channel.receive("request")
    issuer, (root, _), (key, private) = "Cardan pair", make_key(), make_key()
    signed = functools.partial(make_certificate, issuer=issuer, issuer_key=root, days=VALID_DAYS)
    authority = signed(issuer, root.public_key())
    try:
        request = x509.load_pem_x509_csr(asked["request"].encode())
        if not request.is_signature_valid:
            raise ValueError("it is not signed by its key")
        ours = signed("robot", key.public_key(), [asked["host"]])
        theirs = signed("operator", request.public_key(), ["operator"], client=True)
    except (KeyError, ValueError) as error:
        raise _EndedError(f"its request cannot be used: {error}") from None
    # The operator's computer takes the first address of a name, of either family.
    both = socket.has_dualstack_ipv6() or ":" in asked["host"]
    everywhere = "[::]" if both else "0.0.0.0"
    outside = f"{everywhere}:{TLS_PORT}"
    settings = zenoh_settings(
        "router", (ROUTER, f"quic/{outside}?{MIXED}=auto", f"tls/{outside}"), ()
    )
    settings |= {"transport/link/tls/close_link_on_expiration": True}
    with _stored(folder, "listen", settings, authority, ours, private):
        channel.send("answer", certificate=theirs.decode(), authority=authority.decode())
        channel.receive("stored")
    with contextlib.suppress(OSError):  # The files exist, whether or not the confirmation arrives.
        channel.send("stored too")
    return folder / CONFIG


def _join(channel: _Channel, host: str, code: str, folder: Path, *, quic: bool) -> Path:
    channel.agree(SPAKE2_A(code.encode(), b"operator", b"robot"))
    channel.send("ready")
    channel.receive("ready too")
    key, private = make_key()
    request = x509.CertificateSigningRequestBuilder().subject_name(x509.Name([]))
    pem = request.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM).decode()
    channel.send("request", host=host, request=pem)
    answer = channel.receive("answer")
    _check_clock(answer["certificate"])
    ours, authority = (answer[name].encode() for name in ("certificate", "authority"))
    at = f"[{host}]" if ":" in host else host
    far = f"quic/{at}:{TLS_PORT}?{MIXED}=1" if quic else f"tls/{at}:{TLS_PORT}"
    settings = zenoh_settings("client", (), (far,))
    with _stored(folder, "connect", settings, authority, ours, private):
        channel.send("stored")
        channel.receive("stored too")
    return folder / CONFIG


def _check_clock(certificate: str) -> None:
    """Raise _EndedError if by this clock TLS would reject the robot's certificates."""
    begins, ends, _ = read_certificate(certificate)
    now = datetime.datetime.fromtimestamp(time.time(), datetime.timezone.utc)
    if not begins <= now <= ends:
        raise _EndedError(
            f"the clocks differ: here it is {now:%Y-%m-%d %H:%M} UTC, and its certificates begin "
            f"at {begins:%Y-%m-%d %H:%M}; set the clocks"
        )


def _folder(name: str, replace: bool) -> Path:
    """Return the folder for the new files, checked to be writable. Raises ConfigurationError."""
    folder = state_folder() / "pair" / name
    if folder.exists() and not replace:
        raise ConfigurationError(
            "--replace",
            f"paired already, in {folder}: give this option to pair again",
        )
    there = next(each for each in folder.parents if each.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise ConfigurationError("HOME", f"{there} cannot be written, where {folder} is to be")
    return folder


@contextlib.contextmanager
def _stored(folder: Path, side: str, settings: dict[str, object], *pems: bytes) -> Iterator[None]:
    """Write Zenoh's configuration, authority, certificate and key beside `folder`, and move all
    into it at once if the block inside succeeds. Raises OSError."""
    names = ("authority.pem", "certificate.pem", "key.pem", CONFIG)
    keys = ("root_ca_certificate", f"{side}_certificate", f"{side}_private_key")
    tls = {key: str(folder / name) for key, name in zip(keys, names, strict=False)}
    settings |= {f"transport/link/tls/{key}": value for key, value in tls.items()}
    whole: dict[str, Any] = {}
    for path, value in {**settings, "transport/link/tls/enable_mtls": True}.items():
        *tables, last = path.split("/")
        functools.reduce(lambda at, key: at.setdefault(key, {}), tables, whole)[last] = value
    data = (*pems, json.dumps(whole, indent=2).encode())
    folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".", dir=folder.parent) as aside:
        (new := Path(aside, "new")).mkdir(mode=0o700)
        for name, content in zip(names, data, strict=True):
            (new / name).touch(mode=0o600)
            (new / name).write_bytes(content)
        yield
        if folder.exists():
            os.rename(folder, Path(aside, "old"))
        os.rename(new, folder)
