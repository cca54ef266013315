"""Tokens of a server's clients, each with its role."""

from __future__ import annotations

import contextlib
import enum
import logging
import os
import stat
from collections.abc import Iterable, Mapping
from pathlib import Path

from cardan.common.files import read_text, state_folder
from cardan.errors import ConfigurationError, OptionError

MIN_TOKEN_CHARACTERS = 16
"""Length of the shortest token: shorter ones could be guessed over a network."""

TOKEN_BYTES = 16
"""Length of a generated token: 128 bits, which cannot be guessed."""

FILE_BYTES = 4096
"""Longest file of tokens."""

_log = logging.getLogger(__name__)


class Role(enum.IntEnum):
    """Role of a client; each role includes the rights of those before it."""

    VIEWER = 1
    """Read: topics, parameters, figures."""
    OPERATOR = 2
    """Command: publish, call and offer services, set parameters."""
    ADMIN = 3
    """Everything, including operations on the server itself."""

    @property
    def word(self) -> str:
        """Word in files and messages."""
        return self.name.lower()


WITHOUT_TOKEN = Role.OPERATOR
"""Role of clients if no token is needed, and of tokens without a role."""


class Tokens:
    """The tokens that one server knows; never logged."""

    def __init__(self, roles: Mapping[str, Role]) -> None:
        """An empty mapping: clients need no token."""
        self._roles = {token.encode(): role for token, role in roles.items()}

    def __bool__(self) -> bool:
        return bool(self._roles)

    def for_starter(self) -> str:
        """Token for the user who has started the server, an operator's if there is one; empty: none
        is needed. Must be shown to that user only."""
        found = {role: token.decode() for token, role in reversed(self._roles.items())}
        order = (Role.OPERATOR, Role.ADMIN, Role.VIEWER)
        return next((found[role] for role in order if role in found), "")

    def beginnings(self, characters: int) -> set[str]:
        """Return the first `characters` of each token."""
        return {token.decode()[:characters] for token in self._roles}

    def role(self, given: Iterable[str]) -> Role | None:
        """Return the role of the first known token; None: all are unknown. The time does not depend
        on how much of a token is right."""
        from hmac import compare_digest

        found: Role | None = None
        for each in given:
            data = each.encode("utf-8", "surrogateescape")
            for token, role in self._roles.items():
                if compare_digest(data, token) and found is None:
                    found = role
        return found


def parse_tokens(text: str, key: str) -> dict[str, Role]:
    """Parse tokens: one per line, after its role; without a role it is an operator's. Lines that
    begin with ``#`` are comments. Raises OptionError of `key`, which shows none of them."""
    roles = {role.word: role for role in Role}
    found: dict[str, Role] = {}
    for line in text.splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        role = roles.get(words[0]) if len(words) == 2 else WITHOUT_TOKEN
        if role is None or len(words) > 2:
            raise OptionError(
                key, "...", f"without spaces, one a line, after its role: {', '.join(roles)}"
            )
        check_token(words[-1], key)
        if words[-1] in found:
            raise OptionError(key, "...", "another one for each role: a token is there twice")
        found[words[-1]] = role
    if not found:
        check_token("", key)
    return found


def check_token(token: str, key: str) -> None:
    """Raise OptionError of `key` for an invalid token."""
    if len(token) < MIN_TOKEN_CHARACTERS:
        raise OptionError(key, "...", f"at least {MIN_TOKEN_CHARACTERS} characters")
    if any(each.isspace() or not each.isprintable() for each in token):
        raise OptionError(key, "...", "without spaces and line ends: it is part of an address")


def read_tokens(path: str | Path) -> dict[str, Role]:
    """Read the tokens of a file, which only its owner may read. Raises ConfigurationError."""
    try:
        text = read_text(path, FILE_BYTES)
        mode = stat.S_IMODE(os.stat(path).st_mode)
    except OSError as error:
        raise ConfigurationError(
            "token_file", f"{path} cannot be read: {error.strerror or error}"
        ) from None
    except ValueError as error:
        raise ConfigurationError("token_file", f"{path} has no token: {error}") from None
    if mode & 0o077:
        raise ConfigurationError(
            "token_file",
            f"{path} can be read or changed by other users (mode {mode:04o}); make it yours alone "
            f"(chmod 600 {path}), and its tokens new ones",
        )
    return parse_tokens(text, "token_file")


def own_token_file() -> Path:
    """Return the file of the tokens that are generated if none were given."""
    return state_folder() / "server-tokens"


def made_tokens() -> dict[str, Role]:
    """Return the tokens of `own_token_file`, which is made the first time, one for each role.
    Raises ConfigurationError."""
    path = own_token_file()
    if not path.exists():
        with contextlib.suppress(OSError):  # Its name before 0.2.0: clients have these tokens.
            path.with_name("face-tokens").rename(path)
    if not path.exists():
        _make(path)
        _log.warning("tokens were made for viewers, operators and admins: they are in %s", path)
    return read_tokens(path)


def _make(path: Path) -> None:
    import secrets

    lines = [
        "# Tokens of Cardan's servers, one a line, after its role. A viewer reads, an operator",
        "# commands, an admin may do everything. The server refuses a removed token",
        "# after its next start.",
        *(f"{role.word} {secrets.token_hex(TOKEN_BYTES)}" for role in Role),
        "",
    ]
    new = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        file = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        try:
            with os.fdopen(file, "w", encoding="utf-8") as text:
                text.write("\n".join(lines))
            # Whole from the first moment on; two servers that start together have the same one.
            with contextlib.suppress(FileExistsError):
                os.link(new, path)
        finally:
            os.unlink(new)
    except OSError as error:
        raise ConfigurationError(
            "token_file",
            f"no token was given, and none can be made in {path}: {error.strerror or error}",
        ) from None
