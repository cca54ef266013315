"""The files of the page, as tools/console has built them, meshes of arms, and the headers of
each."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from http import HTTPStatus
from pathlib import Path
from typing import Final, NamedTuple

from cardan.errors import ConfigurationError
from cardan.gateway.servers.web import Answer
from cardan.robots.visuals import stored_visual

FOLDER: Final = Path(__file__).with_name("page")

START: Final = "index.html"

SECURITY: Final = (
    (
        "Content-Security-Policy",
        "default-src 'self'; connect-src 'self'; img-src 'self' blob: data:; style-src 'self'; "
        "worker-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    ("Cross-Origin-Opener-Policy", "same-origin"),
    ("Referrer-Policy", "no-referrer"),
    ("X-Content-Type-Options", "nosniff"),
)
"""Headers that block loading from and sending to other servers, and framing by other pages."""

VISUALS: Final = "/visuals/"
"""Path before the key of a mesh that an arm's session publishes."""

FOR_EVER: Final = ("Cache-Control", "private, max-age=31536000, immutable")
"""Cache header for meshes: the key depends on the content."""

_KEY: Final = re.compile(r"[0-9a-f]{64}")
"""Key of a mesh, never a path: finds only meshes kept by this user's sessions."""

ENCODINGS: Final = (("br", ".br"), ("gzip", ".gz"))
"""Encodings by preference. Browsers offer br by TLS and on their own computer."""


class Asset(NamedTuple):
    """A file of the page."""

    content_type: str
    etag: str
    data: Mapping[str, bytes]
    """Content by encoding; "" is the plain file."""


class Site:
    """All files of the page. They are read once."""

    def __init__(self, folder: Path = FOLDER) -> None:
        """Raises ConfigurationError if the page was not built."""
        try:
            table = json.loads((folder / "manifest.json").read_text("utf-8"))
            self.sources: str = table["sources"]
            self._assets = {
                f"/{name}": Asset(
                    about["type"],
                    f'"{about["sha256"][:32]}"',
                    {
                        encoding: (folder / f"{name}{suffix}").read_bytes()
                        for encoding, suffix in (("", ""), *ENCODINGS)
                    },
                )
                for name, about in table["files"].items()
            }
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ConfigurationError(
                "console",
                f"the page is not built ({error}): wheels have it; in a source tree run "
                "tools/console",
            ) from None
        self._assets["/"] = self._assets[f"/{START}"]

    def answer(self, path: str, accepts: str = "", known: str = "") -> Answer | None:
        """Return the answer to GET of `path`; None if there is no such file. `accepts`, `known`:
        the headers Accept-Encoding and If-None-Match."""
        asset = self._assets.get(path)
        if asset is None:
            return None
        headers = [*SECURITY, ("ETag", asset.etag), ("Cache-Control", "no-cache")]
        headers.append(("Vary", "Accept-Encoding"))
        if asset.etag in known:
            return Answer(asset.content_type, b"", HTTPStatus.NOT_MODIFIED, tuple(headers))
        offered = {each.partition(";")[0].strip() for each in accepts.split(",")}
        encoding = next((name for name, _ in ENCODINGS if name in offered), "")
        if encoding:
            headers.append(("Content-Encoding", encoding))
        return Answer(asset.content_type, asset.data[encoding], headers=tuple(headers))


def visual(key: str) -> Answer | None:
    """Return the answer to GET of the mesh kept by a key; None if there is none."""
    data = stored_visual(key) if _KEY.fullmatch(key) else None
    if data is None:
        return None
    return Answer("application/octet-stream", data, headers=(*SECURITY, FOR_EVER))
