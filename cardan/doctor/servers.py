"""Checks of servers with clients: tokens, certificates and their names."""

from __future__ import annotations

import datetime
import socket
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

from cardan.common.certificates import Certificate, read_certificate
from cardan.common.files import read_text
from cardan.common.sockets import is_loopback
from cardan.doctor.base import (
    Check,
    Finding,
    Subject,
    caution,
    failure,
    good,
    server_defaults,
    server_option,
)
from cardan.errors import ConfigurationError
from cardan.gateway.daemon.config import ServerEntry
from cardan.gateway.servers.console.server import ConsoleOptions
from cardan.gateway.servers.web import FORMER_TOKEN_VARIABLE, WebOptions, tls_context

GROUP = "network"

EXPIRES_SOON: Final = datetime.timedelta(days=30)

_MAKE_ONE: Final = (
    "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 365 "
    "-subj /CN={name} -addext subjectAltName=DNS:{name} -keyout key.pem -out cert.pem"
)


def check_certificate(
    who: str, found: Certificate, names: Sequence[str], now: datetime.datetime
) -> Iterator[Finding]:
    """Check that a server's certificate is valid, for long enough, and for a name of this
    computer."""
    make = _MAKE_ONE.format(name=names[0])
    subject_words = f"{who}: its certificate"
    why = "browsers refuse the connection"
    if now > found.ends:
        days = (now - found.ends).days
        yield failure("certificate", f"{subject_words} ended {days} days ago", why, make)
    elif now < found.begins:
        yield failure(
            "certificate",
            f"{subject_words} begins only on {found.begins:%Y-%m-%d}",
            why,
            "timedatectl says whether this computer's clock is right",
        )
    elif found.ends - now < EXPIRES_SOON:
        days = (found.ends - now).days
        yield caution("certificate", f"{subject_words} ends in {days} days", f"then {why}", make)
    else:
        yield good("certificate", f"{subject_words} is valid until {found.ends:%Y-%m-%d}")
    if any(_is_for(each, name) for each in found.names for name in names):
        yield good("certificate-name", f"{subject_words} is for {', '.join(found.names)}")
    else:
        yield caution(
            "certificate-name",
            f"{subject_words} is for {', '.join(found.names) or 'no name'}; this computer is "
            f"{', '.join(names)}",
            f"{why}, unless users open it by one of its names",
            make,
        )


def _is_for(pattern: str, name: str) -> bool:
    """Match a certificate's name with a host's; ``*`` stands for one label."""
    pattern, name = pattern.lower(), name.lower()
    if pattern.startswith("*."):
        return name.partition(".")[2] == pattern[2:]
    return pattern == name


def web_options(entry: ServerEntry) -> WebOptions:
    """Return the web options of a server from its words. Raises ConfigurationError."""
    words = entry.words
    kind = ConsoleOptions if entry.server == "console" else WebOptions
    return kind(
        host=server_option(entry, "host", "127.0.0.1"),
        token_file=server_option(entry, "token-file"),
        certificate=server_option(entry, "certificate"),
        key=server_option(entry, "key"),
        plaintext="--plaintext" in words,
        hosts=tuple(words[at + 1] for at in range(len(words) - 1) if words[at] == "--hosts"),
    )


def check_access(
    name: str, entry: ServerEntry, own: str, now: datetime.datetime
) -> Iterator[Finding]:
    """Check that a server can start and its clients can reach it. `own`: this computer's name."""
    who = f"server {name}"
    try:
        options = web_options(entry)
        token = options.given_tokens()
        tls_context(options.certificate, options.key)
    except ConfigurationError as error:
        mend = f"edit [servers.{name}] of {entry.file}"
        if error.key == FORMER_TOKEN_VARIABLE:
            mend = "rename it where it is set (shell or unit), then restart the daemon"
        yield failure("server", f"{who}: {error}", "it cannot start", mend)
        return
    if not options.encrypted and not is_loopback(options.host):
        yield caution(
            "clear",
            f"{who} listens at {options.host} without TLS",
            "the token and all messages can be read on the network, and browsers give pages of "
            "such an address no gamepad, no sensors and no VR",
            f"{_MAKE_ONE.format(name=own)}, then certificate and key in [servers.{name}]",
        )
    else:
        made = "no token" if is_loopback(options.host) else "tokens that it makes"
        guarded = "tokens" if token else made
        yield good("server", f"{who} listens at {options.host}, with {guarded}")
    if options.certificate:
        names = [*options.hosts, own, f"{own}.local", "localhost"]
        if not is_loopback(options.host):
            names.remove("localhost")
        try:
            found = read_certificate(read_text(Path(options.certificate)))
        except (OSError, ValueError) as error:
            yield failure(
                "certificate",
                f"{who}: {options.certificate}: {error}",
                "no client can connect",
                _MAKE_ONE.format(name=own),
            )
            return
        yield from check_certificate(who, found, names, now)


class ServerAccess(Check):
    """Servers with clients: access, tokens and certificates."""

    group, tells = GROUP, ("server", "clear", "certificate", "certificate-name")

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        now = datetime.datetime.now(datetime.timezone.utc)
        for name, entry in subject.servers.items():
            if "token_file" in server_defaults(entry):
                yield from check_access(name, entry, socket.gethostname().lower(), now)
