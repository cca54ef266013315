"""Snapshots of sessions for tests."""

import dataclasses
from typing import Any

from cardan.gateway.session.snapshot import Snapshot


def changed(snapshot: Snapshot, **fields: Any) -> Snapshot:
    """Return `snapshot` with other values: its own fields by name, those of a part as
    PART__FIELD."""
    for name, value in fields.items():
        part, _, field = name.rpartition("__")
        if part:
            value = dataclasses.replace(getattr(snapshot, part), **{field: value})
        snapshot = dataclasses.replace(snapshot, **{part or field: value})
    return snapshot
