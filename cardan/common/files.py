"""Opening of files named by users, without blocking and without endless reads; and folders for a
program's own files."""

from __future__ import annotations

import errno
import os
import re
import stat
from pathlib import Path
from typing import BinaryIO, Final, Protocol, TextIO

from cardan.errors import ConfigurationError

TEXT_BYTES: Final = 2**20
"""Longest text that is read: a hundred times the longest configuration, parsed in seconds."""
MODEL_BYTES: Final = 16 * 2**20
"""Longest model of an arm that is read; published URDF files have less than 1 MB."""
MESH_BYTES: Final = 64 * 2**20
"""Longest mesh that is read; the longest published ones have 30 MB."""

PIECE_BYTES: Final = 2**20
"""Size of one read if the length comes from the file: a read allocates the requested memory before
the amount of data is known."""

_KINDS: Final = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)
_UTF_16: Final = (b"\xff\xfe", b"\xfe\xff")
_DECLARED: Final = re.compile(rb"""<\?xml[^>]*?\sencoding\s*=\s*["']([A-Za-z0-9._-]+)["']""")
_ENCODINGS: Final = ("us-ascii", "iso-8859-1", "iso-8859-15", "windows-1252")
"""Encodings of XML files that declare one, beside UTF-8."""
_VARIABLE: Final = re.compile(r"\$(\w+|\{\w+\})", re.ASCII)
_NO_WAIT: Final = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0)


class SupportsRead(Protocol):
    """A stream of bytes."""

    def read(self, size: int, /) -> bytes:
        """Read at most `size` bytes; none at the end."""
        ...


def expanded(path: str) -> Path:
    """Return a user's path with the home for ~ and variables of the environment. Raises
    ConfigurationError for an unset variable."""
    for found in _VARIABLE.finditer(path):
        if (name := found[1].strip("{}")) not in os.environ:
            raise ConfigurationError("", f"the environment has no variable {name}")
    return Path(os.path.expanduser(os.path.expandvars(path)))


def open_file(path: str | os.PathLike[str]) -> BinaryIO:
    """Open the regular file at `path` to read. Raises OSError, also for any other kind of file: a
    pipe or a device may never end."""
    mode = os.stat(path).st_mode
    if not stat.S_ISREG(mode):
        what = next((words for is_one, words in _KINDS if is_one(mode)), "something else")
        code = errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL
        raise OSError(code, f"it is {what}, and must be a file")
    return os.fdopen(os.open(path, os.O_RDONLY | _NO_WAIT | getattr(os, "O_BINARY", 0)), "rb")


def read_up_to(stream: SupportsRead, size: int) -> bytes:
    """Read at most `size` bytes; fewer if the stream ends. Allocates memory for the bytes that the
    stream has, not for `size`: it may be a damaged length."""
    data = stream.read(size if size < PIECE_BYTES else PIECE_BYTES)
    if len(data) == size or not data:
        return data
    pieces, left = [data], size - len(data)
    while left and (data := stream.read(min(left, PIECE_BYTES))):
        pieces.append(data)
        left -= len(data)
    return b"".join(pieces)


def read_text(
    path: str | os.PathLike[str], most_bytes: int = TEXT_BYTES, declared: bool = False
) -> str:
    """Read the text of a file in UTF-8, with or without a byte-order mark; line ends become
    ``\\n``. `declared`: an XML declaration may name another encoding. Raises OSError if it cannot
    be read or is longer than `most_bytes`, ValueError if it is not in its encoding.
    """
    with open_file(path) as file:
        data = file.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise OSError(errno.EFBIG, f"it is longer than {most_bytes / 2**20:g} MiB")
    if data.startswith(_UTF_16):
        raise ValueError("it is UTF-16; save it as UTF-8")
    encoding = "utf-8-sig"
    if declared and (found := _DECLARED.match(data)) and found[1].lower() != b"utf-8":
        encoding = found[1].decode("ascii")
        if encoding.lower() not in _ENCODINGS:
            raise ValueError(f"its encoding is {encoding}; save it as UTF-8")
    try:
        return _with_line_ends(data.decode(encoding))
    except UnicodeDecodeError as error:
        before = _with_line_ends(error.object[: error.start].decode("latin-1"))
        what = encoding.removesuffix("-sig").upper()
        raise ValueError(
            f"line {before.count(chr(10)) + 1} is not {what}; save it as UTF-8"
        ) from None


def text_or_empty(path: Path) -> str:
    """Return the stripped text of a file of the system; empty if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


def _with_line_ends(text: str) -> str:
    return text.replace("\r\n", "\n").replace("\r", "\n")


def create_file(path: str | os.PathLike[str]) -> TextIO:
    """Create a text file at `path`, in place of an old one; line ends are kept as they are written.

    Only its owner may change it, whatever the umask: it is a record. Raises OSError, also for a
    pipe without a reader.
    """
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | _NO_WAIT
    try:
        file = os.open(path, flags, 0o644)
    except OSError as error:
        if error.errno == errno.ENXIO:
            raise OSError(errno.ENXIO, "nobody reads this pipe") from None
        raise
    if _NO_WAIT:
        os.set_blocking(file, True)
    return os.fdopen(file, "w", encoding="utf-8", newline="")


def state_folder() -> Path:
    """Return the folder of data kept from run to run: a service's folder for its state, or the
    user's. It need not exist yet. Raises ConfigurationError for a user without a home."""
    return _own_folder("STATE_DIRECTORY", "XDG_STATE_HOME", "~/.local/state")


def cache_folder() -> Path:
    """Return the folder of reproducible data, with the rules of `state_folder`."""
    return _own_folder("CACHE_DIRECTORY", "XDG_CACHE_HOME", "~/.cache")


def _own_folder(of_service: str, of_user: str, default: str) -> Path:
    service = os.environ.get(of_service, "").partition(":")[0]
    if service:
        return Path(service)
    home = os.environ.get(of_user, "")
    if not os.path.isabs(home):
        home = os.path.expanduser(default)
    if not os.path.isabs(home):
        raise ConfigurationError(
            "HOME", f"this user has no home folder: set HOME, or {of_user} to a folder"
        )
    return Path(home) / "cardan"


def records_folder(folder: str = "") -> Path:
    """Return the folder of records: `folder`, or "records" in the state's. It need not exist yet.
    Raises ConfigurationError."""
    return Path(folder) if folder else state_folder() / "records"
