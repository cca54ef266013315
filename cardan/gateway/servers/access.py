"""Access control of a web server: by token, Origin and Host.

A browser lets every page open a WebSocket to this machine, and names the page in ``Origin``. A page
may let its own name resolve to this machine's address (DNS rebinding): ``Host`` has that name then.
Programs other than browsers send no Origin.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Sequence
from http import HTTPStatus
from typing import NamedTuple
from urllib.parse import parse_qs, unquote, urlsplit

from cardan.common.sockets import is_loopback
from cardan.errors import shown
from cardan.gateway.servers.rate_limit import BEGINNING_CHARACTERS, FailedTokens
from cardan.gateway.servers.tokens import WITHOUT_TOKEN, Role, Tokens

TOKEN_KEYS = ("t", "token")
"""Names of the token in an address's query."""


class AccessDenied(NamedTuple):
    """Reason for refusing a client; never with the token that it sent."""

    status: HTTPStatus
    reason: str
    retry_s: float | None = None
    """Time after which a retry may succeed; None: never."""


class ClientInfo(NamedTuple):
    """A client, by the first lines of its request."""

    address: str
    """IP address."""
    path: str
    """Path with query."""
    hosts: Sequence[str]
    """Values of the header Host."""
    origins: Sequence[str] = ()
    """Values of Origin."""
    authorizations: Sequence[str] = ()
    """Values of Authorization."""


class AccessControl:
    """Access rules of one server."""

    def __init__(self, tokens: Tokens, hosts: Sequence[str], origins: Sequence[str]) -> None:
        """`tokens` empty: none is needed. `hosts`: further names of this machine. `origins`:
        foreign pages that may connect, as browsers name them ("https://app.example", "null")."""
        self._tokens = tokens
        self._failed = FailedTokens(right=tokens.beginnings(BEGINNING_CHARACTERS))
        own = socket.gethostname().lower()
        self._hosts = {"localhost", own, f"{own}.local", *(each.lower() for each in hosts)}
        self._origins = {each.rstrip("/").lower() for each in origins}

    def check(
        self, caller: ClientInfo, now_s: float, *, public: bool = False
    ) -> Role | AccessDenied:
        """Return the client's role, or a denial; `now_s` is monotonic. `public`: no token is
        needed."""
        hosts, origins = caller.hosts, caller.origins
        if len(hosts) != 1 or (host := _host_name(f"//{hosts[0]}")) is None:
            return AccessDenied(HTTPStatus.BAD_REQUEST, "the request needs one Host header")
        if _address(host) is None and host not in self._hosts and not is_loopback(host):
            return AccessDenied(
                HTTPStatus.FORBIDDEN,
                "the Host header names another server; if it is this one, add the name to its "
                "option `hosts`",
            )
        if len(origins) > 1 or not all(self._is_ours(each, host) for each in origins):
            return AccessDenied(
                HTTPStatus.FORBIDDEN,
                f"the page {', '.join(map(shown, origins))} may not connect; "
                "if it is yours, add it to the server's option `origins`",
            )
        if public:
            return Role.VIEWER
        return self._by_token(caller, now_s) if self._tokens else WITHOUT_TOKEN

    def _by_token(self, caller: ClientInfo, now_s: float) -> Role | AccessDenied:
        given = _given(caller)
        # Checked first: a client that may not try learns nothing, not even with the right token.
        wait_s = max(
            (self._failed.wait_s(caller.address, each, now_s) for each in given), default=0.0
        )
        role = self._tokens.role(given) if wait_s == 0.0 else None
        if role is not None:
            return role
        wrong_s = self._failed.wrong_wait_s(caller.address, now_s) if given else 0.0
        if wait_s == 0.0:
            for each in given:
                self._failed.failed(caller.address, each, now_s)
        # The same answer to all wrong ones: none reveals the beginning of a right one.
        wait_s = max(wait_s, wrong_s)
        if wait_s > 0.0:
            return AccessDenied(
                HTTPStatus.TOO_MANY_REQUESTS,
                "there were too many wrong tokens like this one from this address",
                wait_s,
            )
        return AccessDenied(
            HTTPStatus.UNAUTHORIZED,
            "the request needs a token of the server: in the address, as /?t=TOKEN or as its path "
            '/TOKEN, or as the header "Authorization: Bearer TOKEN"',
        )

    def _is_ours(self, origin: str, host: str) -> bool:
        if origin.lower() in self._origins:
            return True
        name = _host_name(origin)
        return name is not None and (name == host or (is_loopback(name) and is_loopback(host)))


def _given(caller: ClientInfo) -> list[str]:
    """Return all that may be a token."""
    given = [
        words[1].strip()
        for each in caller.authorizations
        if len(words := each.split(None, 1)) == 2 and words[0].lower() == "bearer"
    ]
    try:
        parts = urlsplit(caller.path)
        query = parse_qs(parts.query)
    except ValueError:
        return given
    given += [value for key in TOKEN_KEYS for value in query.get(key, ())]
    if not given and (path := unquote(parts.path).strip("/")):
        given.append(path)
    return given


def _host_name(address: str) -> str | None:
    """Return the name in ``scheme://name:port``; None if there is none."""
    try:
        return urlsplit(address).hostname
    except ValueError:
        return None


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None
