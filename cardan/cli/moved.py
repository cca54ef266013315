"""Renamed commands: a user who types the old name is shown the new one."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Final

MOVED: Final = {
    **{
        name: f"daemon {name}"
        for name in (
            "arm", "events", "log", "ps", "reload", "restart", "service", "start", "stop",
            "switch", "top",
        )
    },
    **{
        name: f"devices {name}"
        for name in ("drivers", "force", "haptic", "share", "spnav", "udev")
    },
    **{
        name: f"net {name}"
        for name in ("echo", "export", "hz", "messages", "plot", "record", "replay")
    },
    "face": "net server",
    "network": "net list",
    "serve": "daemon run",
}  # fmt: skip
"""New command by the old one, both without `cardan`."""

_UNIT: Final = (
    "; a systemd unit with the old `serve` does not start: "
    "rewrite it by `cardan daemon service install FILE...`"
)


def now_called(args: Sequence[str], group: str = "") -> str:
    """Return advice for a user who types `cardan` and `args`, or `cardan`, a group and `args`.
    Empty if the first word was never a command, or is not a former command of that group."""
    name = args[0]
    if name not in MOVED or not f"{MOVED[name]} ".startswith(f"{group} " if group else ""):
        return ""
    unit = _UNIT if name == "serve" else ""
    typed = shlex.join(("cardan", *MOVED[name].split(), *args[1:]))
    return f"`cardan {name}` is now `cardan {MOVED[name]}`: type `{typed}`{unit}"
