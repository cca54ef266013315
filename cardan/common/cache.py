"""Cache of reproducible data in the user's cache folder, by a key of its sources."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from cardan.common import files


def content_key(parts: Iterable[str | bytes]) -> str:
    """Return the key of the parts; equal parts have equal keys."""
    digest = hashlib.sha256()
    for part in parts:
        data = part if isinstance(part, bytes) else part.encode("utf-8", "surrogatepass")
        digest.update(len(data).to_bytes(8, "big") + data)
    return digest.hexdigest()


def cached_text(kind: str, key: str) -> str | None:
    """Return a text kept by `cache_text`; None if there is none, or it is damaged."""
    data = cached_bytes(kind, key)
    return None if data is None else data.decode("utf-8", "surrogatepass")


def cached_bytes(kind: str, key: str) -> bytes | None:
    """Return bytes kept by `cache_bytes`; None if there are none, or they are damaged."""
    try:
        with files.open_file(_path(kind, key)) as file:
            whole = files.read_up_to(file, files.MODEL_BYTES)
    except (OSError, ValueError):
        return None
    check, _, data = whole.partition(b"\n")
    return data if check == content_key((key, data)).encode() else None


def cache_text(kind: str, key: str, text: str) -> None:
    """Keep a text if the user has a writable folder; else it must be made again."""
    cache_bytes(kind, key, text.encode("utf-8", "surrogatepass"))


def cache_bytes(kind: str, key: str, data: bytes) -> bool:
    """Keep bytes if the user has a writable folder. Return whether they are kept."""
    try:
        path = _path(kind, key)
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, made = tempfile.mkstemp(dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content_key((key, data)).encode() + b"\n" + data)
            os.replace(made, path)
        except BaseException:
            os.unlink(made)
            raise
    except (OSError, ValueError):
        return False
    return True


def _path(kind: str, key: str) -> Path:
    return files.cache_folder() / kind / f"{key}.json"
