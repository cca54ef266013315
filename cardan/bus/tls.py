"""Diagnosis of failed TLS connections to a router: Zenoh reports both a refused certificate and an
absent router as "Timeout!".

The certificates of Zenoh's configuration are read, and one handshake is made as Zenoh makes it. No
byte of Zenoh's protocol is sent.
"""

from __future__ import annotations

import datetime
import json
import socket
import ssl
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from cardan.common.certificates import is_address, read_certificate
from cardan.types import NEVER_S

PROBE_S: Final = 2.0
"""Longest wait for a router's answer."""

PERIOD_S: Final = 5.0
"""Pause between two probes of an absent router."""

PROTOCOLS: Final = ("tls", "quic")
"""Zenoh protocols with certificates. A paired router serves TLS at QUIC's port too."""

# RFC 8446, 6.2. The alert for a certificate of another authority depends on its issuer's name.
_ALERTS: Final = {
    "CERTIFICATE_REQUIRED": "the router at {place} asks for a certificate, and {own} is given",
    "CERTIFICATE_EXPIRED": "the router at {place} takes {own} as expired: check both clocks",
    "UNKNOWN_CA": "the router at {place} refuses {own}, which is of another pair",
    "DECRYPT_ERROR": "the router at {place} refuses {own}, which is of another pair",
    "BAD_CERTIFICATE": "the router at {place} refuses {own}, which is of another pair",
}

# From OpenSSL's x509_vfy.h.
_EXPIRED: Final = 10
_OTHER_NAMES: Final = (62, 64)


def tls_obstacle(config: Any) -> str:
    """Describe why TLS to the routers of a Zenoh configuration fails, and what to do. Empty if it
    does not fail or the reason cannot be found, as when no router answers. Waits up to PROBE_S for
    each router. Never raises."""
    try:
        places = [place for each in _endpoints(config) if (place := _place(each))]
        tls = json.loads(config.get_json("transport/link/tls"))
    except (ValueError, TypeError, AttributeError):
        return ""
    if not places or not isinstance(tls, dict):
        return ""
    certificate = tls.get("connect_certificate") if tls.get("enable_mtls") else None
    cause = _local(certificate)
    for host, port in () if cause else places:
        if cause := _handshake(host, port, tls, certificate):
            break
    if not cause:
        return ""
    return (
        f"{cause}: no message passes; give the file of the present pair (zenoh_config), or pair "
        "both computers again (`cardan net pair --replace` on each) and start the router again"
    )


def _endpoints(config: Any) -> list[str]:
    found = json.loads(config.get_json("connect/endpoints"))
    if isinstance(found, dict):
        found = found.get(json.loads(config.get_json("mode")), [])
    return [each["endpoint"] if isinstance(each, dict) else str(each) for each in found]


def _place(endpoint: str) -> tuple[str, int] | None:
    """Return host and port of an endpoint with certificates."""
    protocol, _, rest = endpoint.partition("/")
    host, _, port = rest.partition("?")[0].partition("#")[0].rpartition(":")
    if protocol not in PROTOCOLS or not port.isdecimal():
        return None
    return host.strip("[]"), int(port)


def _local(path: str | None) -> str:
    """Return the problems visible in the certificate itself."""
    if path is None:
        return ""
    try:
        begins, ends, _ = read_certificate(Path(path).read_text(encoding="ascii"))
    except (OSError, ValueError) as error:
        return f"the certificate {path} cannot be read ({error})"
    now = datetime.datetime.fromtimestamp(time.time(), datetime.timezone.utc)
    if now > ends:
        return f"the certificate {path} has expired on {ends:%Y-%m-%d %H:%M} UTC"
    if now < begins:
        return f"the certificate {path} begins on {begins:%Y-%m-%d %H:%M} UTC: set the clock"
    return ""


def _handshake(host: str, port: int, tls: dict[str, Any], certificate: str | None) -> str:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = tls.get("verify_name_on_connect") is not False
    own = "none" if certificate is None else f"the certificate {certificate}"
    place = f"{host} port {port}"
    try:
        if authority := tls.get("root_ca_certificate"):
            context.load_verify_locations(authority)
        else:
            context.load_default_certs()
        if certificate is not None:
            context.load_cert_chain(certificate, tls.get("connect_private_key"))
    except (OSError, TypeError) as error:
        return f"the certificates of the configuration cannot be used ({error})"
    try:
        with (
            socket.create_connection((host, port), PROBE_S) as plain,
            context.wrap_socket(plain, server_hostname=host) as connection,
        ):
            # TLS 1.3: a client receives the verdict on its certificate after its own handshake.
            connection.recv(1)
    except ssl.SSLCertVerificationError as error:
        if error.verify_code == _EXPIRED:
            return f"the certificate of the router at {place} has expired"
        if error.verify_code in _OTHER_NAMES:
            what = "address" if is_address(host) else "name"
            return f"the certificate of the router at {place} is not for this {what}"
        return f"the certificate of the router at {place} is not signed by {authority or 'anybody'}"
    except ssl.SSLError as error:
        for alert, words in _ALERTS.items():
            if error.reason and error.reason.endswith(f"ALERT_{alert}"):
                return words.format(place=place, own=own)
    except (OSError, UnicodeError):
        pass  # No router answers, or it waits for Zenoh's first message: the handshake succeeded.
    return ""


class TlsWatch:
    """Diagnoses an absent router in a separate thread, for a loop that must not wait."""

    def __init__(self, look: Callable[[], str]) -> None:
        """`look`: diagnosis to run, such as `tls_obstacle` of a configuration."""
        self._look = look
        self._found = ""
        self._thread: threading.Thread | None = None
        self._looked_s = NEVER_S

    def obstacle(self, now_s: float, *, routed: bool) -> str:
        """Return the last result; empty while the router is present, or nothing is known."""
        if self._thread is not None and self._thread.is_alive():
            return "" if routed else self._found
        if routed:
            self._found, self._looked_s = "", NEVER_S
        elif now_s >= self._looked_s + PERIOD_S:
            self._looked_s = now_s
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()
        return self._found

    def _run(self) -> None:
        self._found = self._look()
