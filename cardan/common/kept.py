"""Keeps text that can be made again in the user's cache folder, by a key of what it is made of."""

from __future__ import annotations

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from cardan.common import files


def content_key(parts: Iterable[str | bytes]) -> str:
    """The same for the same parts."""
    digest = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else part.encode("utf-8", "surrogatepass")
        digest.update(len(data).to_bytes(8, "big") + data)
    return digest.hexdigest()


def kept_text(kind: str, key: str) -> str | None:
    """What `keep_text` has kept; None where there is nothing, or it is damaged."""
    try:
        text = files.read_text(_path(kind, key), files.MODEL_BYTES)
    except (OSError, ValueError):
        return None
    check, _, text = text.partition("\n")
    return text if check == content_key((key, text)) else None


def keep_text(kind: str, key: str, text: str) -> None:
    """Where the user has a folder that can be written to; elsewhere it is made again."""
    with contextlib.suppress(OSError, ValueError):
        path = _path(kind, key)
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, made = tempfile.mkstemp(dir=path.parent)
        try:
            with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
                file.write(f"{content_key((key, text))}\n{text}")
            os.replace(made, path)
        except BaseException:
            os.unlink(made)
            raise


def _path(kind: str, key: str) -> Path:
    return files.cache_folder() / kind / f"{key}.json"
