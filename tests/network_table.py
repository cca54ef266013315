"""Table of every topic, service and action of a session, with its judges on each transport.

The rows are the endpoints on a session's node. Each judge is a mark of a test, ``shown_on``;
docs/judged.md has the result, and nothing else. The table is part of the site only (site_tables).
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal, NamedTuple, get_args

from cardan.gateway.bus.arm_topics import ArmNames
from cardan.gateway.bus.compatibility import NamesOf
from cardan.gateway.bus.options import NetworkOptions
from cardan.gateway.session.network import SessionNetwork
from cardan.protocols.ros2.zenoh import data_key
from cardan.types import IDENTITY_POSE, DeviceCapabilities

TESTS = Path(__file__).parent
PLUGINS = TESTS.parent / "plugins"

Kind = Literal["published", "taken", "service", "action"]

TRANSPORTS = ("Zenoh", "DDS", "rosbridge", "Foxglove")

ACTION_PARTS = "/_action/"


class Row(NamedTuple):
    """Topic, service or action of a session."""

    name: str
    """~ is the arm's node; relative names are in its namespace."""
    kind: Kind
    type_name: str


class Coverage(NamedTuple):
    """Names that a test covers on a transport."""

    transport: str
    by: str
    kinds: tuple[Kind, ...] = ()
    """All names of these kinds, except for those in `but`."""
    but: tuple[str, ...] = ()
    """Excluded names."""
    names: tuple[str, ...] = ()
    """Alternatively, exactly these names."""

    def rows(self, among: Iterable[Row]) -> list[Row]:
        """Return the rows that it covers."""
        return [
            row
            for row in among
            if row.name in self.names or (row.kind in self.kinds and row.name not in self.but)
        ]


class _Channel:
    """Channel without subscribers and messages."""

    heard = False

    def put(self, _data: bytes, _now_ns: int) -> None:
        pass

    def poll(self) -> None:
        return None


class _Node:
    """Stand-in for a session's node that records its endpoints."""

    zid = name = full_name = "node"
    namespace, options = "/", NetworkOptions()

    def __init__(self) -> None:
        self.made: dict[str, Row] = {}

    def join(self) -> None:
        pass

    def open(self) -> None:
        pass

    def declare_key_token(self, _key: str) -> None:
        pass

    def _keep(self, name: str, kind: Kind, type_name: str) -> _Channel:
        action, part, _ = name.partition(ACTION_PARTS)
        if not part:
            self.made[name] = Row(name, kind, type_name)
        elif type_name.endswith("_SendGoal"):
            self.made[action] = Row(action, "action", type_name.removesuffix("_SendGoal"))
        return _Channel()

    def publisher(self, name: str, type_name: str, *_qos: Any) -> _Channel:
        return self._keep(name, "published", type_name)

    def subscription(self, name: str, type_name: str, *_depth_and_qos: Any) -> _Channel:
        return self._keep(name, "taken", type_name)

    def service(self, name: str, type_name: str, *_qos: Any) -> _Channel:
        return self._keep(name, "service", type_name)

    def key_of(self, name: str, type_name: str) -> str:
        return data_key(0, name, type_name)

    def watch_tokens(self, _key: str = "") -> _Channel:
        return _Channel()


def rows() -> list[Row]:
    """Return the rows of a session with everything: all sets of names, a device, and an arm."""
    options = NetworkOptions(device=True, other_names=get_args(NamesOf))
    network = SessionNetwork(
        options, ArmNames(("joint_1",)), "<robot/>", IDENTITY_POSE, print, bool, {}
    )
    node: Any = _Node()
    network._node = node
    can = DeviceCapabilities(True, (), frozenset(), True, gives_inertia=True)
    part: Any = SimpleNamespace(capabilities=can, raw_packet_callback=None)
    network.open(part, part, part)
    kinds = get_args(Kind)
    return sorted(node.made.values(), key=lambda row: (kinds.index(row.kind), _order(row.name)))


def _order(name: str) -> tuple[int, str]:
    """Sort key: the arm's own names first, then those common to all robots."""
    return ("~", "/").index(name[0]) if name[0] in "~/" else 2, name


def shown() -> set[Coverage]:
    """Return the coverage of every mark, including tests that cannot run here."""
    found = set()
    for path in (*TESTS.rglob("*.py"), *PLUGINS.glob("*/tests/*.py")):
        text = path.read_text(encoding="utf-8")
        if ".shown_on" not in text:  # Quick test: parsing all files takes seconds.
            continue
        for node in ast.walk(ast.parse(text)):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr == "shown_on"
            ):
                words = {word.arg: ast.literal_eval(word.value) for word in node.keywords}
                found.add(Coverage(**words))
    return found


def checked(marks: Collection[Coverage], among: Collection[Row]) -> None:
    """Raise ValueError if a mark names a row that does not exist."""
    names = {row.name for row in among}
    for mark in marks:
        strange = {*mark.names, *mark.but} - names
        strange |= {*mark.kinds} - {*get_args(Kind)} | {mark.transport} - {*TRANSPORTS}
        if strange:
            raise ValueError(f"{mark}: there is no {', '.join(sorted(strange))}")


def table() -> list[tuple[str, ...]]:
    """Return the rows of the table: name, purpose, type, and judges on each transport."""
    every, marks = rows(), shown()
    checked(marks, every)
    judges: dict[tuple[Row, str], list[str]] = {}
    for mark in sorted(marks):
        for row in mark.rows(every):
            known = judges.setdefault((row, mark.transport), [])
            if mark.by not in known:
                known.append(mark.by)
    return [
        (
            f"`{row.name}`",
            row.kind,
            row.type_name.replace("/msg/", "/").replace("/srv/", "/").replace("/action/", "/"),
            *(", ".join(judges.get((row, transport), ())) for transport in TRANSPORTS),
        )
        for row in every
    ]
