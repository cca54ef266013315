"""A certificate of this installation for its own names and addresses, if none was given. Browsers
offer sensors, gamepads and headsets to pages of https only, and a published key protects no page:
each installation makes its own at the first start, keeps it, and replaces it before it expires and
when the computer has a new address."""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import os
import secrets
import ssl
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from cardan.common.certificates import (
    Certificate,
    is_address,
    make_certificate,
    make_key,
    read_certificate,
)
from cardan.common.files import read_text, state_folder
from cardan.errors import ConfigurationError

VALID_DAYS: Final = 397
"""Validity of a certificate; browsers refuse more than 398 days."""

RENEW_DAYS: Final = 30
"""Remaining validity below which a certificate is replaced at the start."""

MOST_NAMES: Final = 32
"""Most names in a certificate: a computer that moves between networks keeps its old addresses, so
that browsers need not ask again at each change."""

OPENSSL_S: Final = 30.0
"""Longest time for the openssl program; it takes some 10 ms."""

_WHAT_TO_DO: Final = (
    "install the program openssl (Debian: apt install openssl) or the package cryptography (pip "
    "install cryptography); or give a certificate and its key by the options of these names; or "
    "serve this computer alone (host 127.0.0.1), which needs none"
)

Maker = Callable[[Sequence[str], datetime.datetime], "tuple[bytes, bytes]"]
"""Makes certificate and key as PEM for names, at a time. Raises OSError or ImportError if it
cannot."""


class Own(NamedTuple):
    """A certificate made by this installation."""

    certificate: Path
    key: Path
    fingerprint: str
    """SHA-256 of the certificate in the form of browsers."""
    why_new: str
    """Reason for making it now; empty: it is that of the last start."""


def own_certificate(
    names: Sequence[str],
    now: datetime.datetime,
    folder: Path | None = None,
    makers: Sequence[Maker] = (),
) -> Own:
    """Return the certificate for `names` (host names and addresses), made if there is no valid one.
    Raises ConfigurationError."""
    folder = folder or state_folder()
    certificate, key = folder / "console-certificate.pem", folder / "console-key.pem"
    found = _stored(certificate, key)
    why = _why_another(found, names, now)
    if why:
        old = () if found is None else found.names
        wanted = list(dict.fromkeys((*names, *old)))[:MOST_NAMES]
        made, made_key = _make(wanted, now, makers or MAKERS)
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            _write(key, made_key)
            _write(certificate, made)
        except OSError as error:
            raise ConfigurationError(
                "certificate",
                f"none was given, and none can be kept in {folder}: {error.strerror or error}",
            ) from None
    text = read_text(certificate)
    digest = hashlib.sha256(ssl.PEM_cert_to_DER_cert(_first(text))).hexdigest().upper()
    fingerprint = ":".join(digest[at : at + 2] for at in range(0, len(digest), 2))
    return Own(certificate, key, fingerprint, why)


def _first(pem: str) -> str:
    foot = "-----END CERTIFICATE-----"
    return pem[pem.index("-----BEGIN CERTIFICATE-----") : pem.index(foot) + len(foot)]


def _stored(certificate: Path, key: Path) -> Certificate | None:
    """Return the certificate of the last start; None: there is no usable one."""
    try:
        if os.stat(key).st_mode & 0o077:
            return None  # Others may have read it.
        found = read_certificate(read_text(certificate))
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key)
    except (OSError, ValueError):
        return None
    return found


def _why_another(found: Certificate | None, names: Sequence[str], now: datetime.datetime) -> str:
    if found is None:
        return "there was none that can be used"
    if found.ends - now < datetime.timedelta(days=RENEW_DAYS):
        return f"the old one ends on {found.ends:%Y-%m-%d}"
    if found.begins > now:
        return f"the old one begins only on {found.begins:%Y-%m-%d}"
    missing = [each for each in names if each not in found.names]
    return f"the old one is not for {', '.join(missing)}" if missing else ""


def _write(path: Path, data: bytes) -> None:
    """Write a file atomically, readable by its owner only."""
    new = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    file = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    try:
        with os.fdopen(file, "wb") as stream:
            stream.write(data)
        os.replace(new, path)
    finally:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(new)


def _make(
    names: Sequence[str], now: datetime.datetime, makers: Sequence[Maker]
) -> tuple[bytes, bytes]:
    reasons: list[str] = []
    for maker in makers:
        try:
            return maker(names, now)
        except (OSError, ImportError, ValueError) as error:
            reasons.append(str(error))
    raise ConfigurationError(
        "certificate", f"none was given, and none can be made ({'; '.join(reasons)}): {_WHAT_TO_DO}"
    )


def by_cryptography(names: Sequence[str], _now: datetime.datetime) -> tuple[bytes, bytes]:
    """Make a certificate by the package cryptography. Raises ImportError."""
    key, private = make_key()
    own = f"Cardan on {names[0]}"
    made = make_certificate(
        own, key.public_key(), names, issuer=own, issuer_key=key, days=VALID_DAYS
    )
    return made, private


def by_openssl(names: Sequence[str], _now: datetime.datetime) -> tuple[bytes, bytes]:
    """Make a certificate by the openssl program. Raises OSError."""
    wanted = ",".join(f"{'IP' if is_address(each) else 'DNS'}:{each}" for each in names)
    common = "".join(each for each in names[0] if each.isalnum() or each in ".-")[:50]
    # Both come out of its standard output: nothing is written that others might read.
    command = [
        "openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256",
        "-nodes", "-sha256", "-days", str(VALID_DAYS), "-subj", f"/CN=Cardan on {common}",
        "-addext", f"subjectAltName={wanted}", "-addext", "basicConstraints=critical,CA:FALSE",
        "-addext", "extendedKeyUsage=serverAuth", "-keyout", "-", "-out", "-",
    ]  # fmt: skip
    try:
        done = subprocess.run(command, capture_output=True, timeout=OPENSSL_S, check=False)
    except subprocess.TimeoutExpired:
        raise OSError("openssl does not finish") from None
    except FileNotFoundError:
        raise OSError("there is no program openssl") from None
    text = done.stdout
    parts = text.split(b"-----BEGIN CERTIFICATE-----")
    if done.returncode != 0 or len(parts) != 2 or b"PRIVATE KEY" not in parts[0]:
        said = done.stderr.decode(errors="replace").strip().splitlines()
        raise OSError(f"openssl: {said[-1] if said else f'status {done.returncode}'}")
    return b"-----BEGIN CERTIFICATE-----" + parts[1], parts[0]


MAKERS: Final = (by_cryptography, by_openssl)
