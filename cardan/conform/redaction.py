"""Redaction of addresses and serial numbers in texts that users may post."""

from __future__ import annotations

import ipaddress
import re

from cardan.common.sockets import is_loopback

_CANDIDATES = re.compile(
    r"\b(?:[0-9A-Fa-f]{2}[:-]){5}[0-9A-Fa-f]{2}\b"  # A MAC or Bluetooth address.
    r"|\b\d{1,3}(?:\.\d{1,3}){3}\b"
    r"|(?<![\w:.])[0-9A-Fa-f]{0,4}(?::[0-9A-Fa-f]{0,4}){2,7}(?![\w:])"
)
_SERIAL = re.compile(r"(?i)\b(serial(?:[ _-]?(?:number|no))?\b[\"']?\s*[:=]?\s*)([\"']?)[\w-]{4,}")
_HOME = re.compile(r"(?<![\w.])/(?:home|Users)/[^/\s]+")


class Redaction:
    """Replaces each address by a stable name: host-1, host-2, radio-1, ..."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}

    def hide(self, host: str) -> None:
        """Also replace `host`, a name that does not look like an address."""
        if host and host not in self._names and not is_loopback(host):
            self._names[host] = self._next("host")

    def __call__(self, text: str) -> str:
        """Return `text` without addresses, serial numbers and users' folders."""
        text = _CANDIDATES.sub(self._address, text)
        for host in sorted(self._names, key=len, reverse=True):
            text = re.sub(rf"(?<![\w.-]){re.escape(host)}(?![\w-])", self._names[host], text)
        text = _HOME.sub("~", text)
        return _SERIAL.sub(r"\1\2(redacted)", text)

    def _address(self, match: re.Match[str]) -> str:
        found = match.group()
        if re.fullmatch(r"(?:[0-9A-Fa-f]{2}[:-]){5}[0-9A-Fa-f]{2}", found):
            return self._names.setdefault(found, self._next("radio"))
        try:
            address = ipaddress.ip_address(found)
        except ValueError:
            return found
        if address.is_loopback or address.is_unspecified:
            return found
        return self._names.setdefault(found, self._next("host"))

    def _next(self, kind: str) -> str:
        count = sum(name.startswith(kind) for name in self._names.values())
        return f"{kind}-{count + 1}"
