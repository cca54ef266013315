"""Cardan's interfaces as files of a ROS 2 installation, for programs that read those."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from cardan.protocols.ros2.interfaces import FILES, action_type, message_type, referenced
from cardan.protocols.ros2.type_hash import described, type_hash

_PARTS = {
    "msg": ("",),
    "srv": ("_Request", "_Response"),
    "action": ("_Goal", "_Result", "_Feedback"),
}
_NO_HASH = "RIHS01_" + "0" * 64
"""Placeholder for the hash of a whole action, which files contain but the wire does not."""


def write_packages(folder: Path) -> None:
    """Write the contents of AMENT_PREFIX_PATH: definitions, descriptions with hashes, packages."""
    needs: dict[str, set[str]] = {}
    for name, text in FILES.items():
        package, kind, last = name.split("/")
        place = folder / "share" / package / kind
        place.mkdir(parents=True, exist_ok=True)
        (place / f"{last}.{kind}").write_text(text)
        (place / f"{last}.json").write_text(json.dumps(_description(name, kind)))
        for part in _PARTS[kind]:
            within = {each.split("/")[0] for each in referenced(name + part)}
            needs.setdefault(package, set()).update(within - {package})
    for package, others in needs.items():
        depends = "".join(f"<depend>{each}</depend>" for each in sorted(others))
        xml = f"<package><name>{package}</name>{depends}</package>"
        (folder / "share" / package / "package.xml").write_text(xml)


def _description(name: str, kind: str) -> dict[str, Any]:
    if kind == "action":
        action = action_type(name)
        services = (action.send_goal, action.get_result)
        parts = [action.goal, action.result, f"{name}_Feedback", action.feedback]
        parts += [f"{each.name}{part}" for each in services for part in ("", *_PARTS["srv"])]
        hashes = [{"type_name": each, "hash_string": type_hash(each)} for each in parts]
        return {
            "type_description_msg": {
                "type_description": {"type_name": name, "fields": []},
                "referenced_type_descriptions": [],
            },
            "type_hashes": [{"type_name": name, "hash_string": _NO_HASH}, *hashes],
        }
    within = [*referenced(name)] if kind == "msg" else []
    return {
        "type_description_msg": {
            "type_description": _fields(name) if kind == "msg" else {"type_name": name},
            "referenced_type_descriptions": [_fields(each) for each in within],
        },
        "type_hashes": [
            {"type_name": each, "hash_string": type_hash(each)} for each in (name, *within)
        ],
    }


def _fields(name: str) -> dict[str, Any]:
    fields = [
        {**described(each), "default_value": each.default} for each in message_type(name).fields
    ]
    return {"type_name": name, "fields": fields}
