"""Every topic, service and action of a session, and who has judged it on which transport.

The rows are what a session puts on its node. A judgment is a mark of a test, ``shown_on``; the
table of docs/judged.md, which is made of both, says no more and no less.
The site has it (site_tables).
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
    """A topic, service or action of a session."""

    name: str
    """~ is the arm's node; relative names are in its namespace."""
    kind: Kind
    type_name: str


class Coverage(NamedTuple):
    """Names that a test covers on a transport."""

    transport: str
    by: str
    kinds: tuple[Kind, ...] = ()
    """All of these kinds, ..."""
    but: tuple[str, ...] = ()
    """... without these names."""
    names: tuple[str, ...] = ()
    """Or these names only."""

    def rows(self, among: Iterable[Row]) -> list[Row]:
        """Which of the rows it shows."""
        return [
            row
            for row in among
            if row.name in self.names or (row.kind in self.kinds and row.name not in self.but)
        ]


class _Channel:
    """Channel without listeners and without messages."""

    heard = False

    def put(self, _data: bytes, _now_ns: int) -> None:
        pass

    def poll(self) -> None:
        return None


class _Node:
    """Stand-in for a session's node, which keeps the endpoints made on it."""

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
    """Of a session that has everything: all sets of names, a device, and an arm."""
    options = NetworkOptions(device=True, other_names=get_args(NamesOf))
    network = SessionNetwork(
        options, ArmNames(("joint_1",)), "<robot/>", IDENTITY_POSE, print, bool, {}
    )
    node: Any = _Node()
    network._node = node
    can = DeviceCapabilities(True, (), frozenset(), True, gives_inertia=True)
    part: Any = SimpleNamespace(capabilities=can, tap=None, witness=None)
    network.open(part, part, part)
    kinds = get_args(Kind)
    return sorted(node.made.values(), key=lambda row: (kinds.index(row.kind), _order(row.name)))


def _order(name: str) -> tuple[int, str]:
    """The arm's own names first, then those that every robot has."""
    return ("~", "/").index(name[0]) if name[0] in "~/" else 2, name


def shown() -> set[Coverage]:
    """Return the coverage of every mark, whether its test can run here or not."""
    found = set()
    for path in (*TESTS.rglob("*.py"), *PLUGINS.glob("*/tests/*.py")):
        text = path.read_text(encoding="utf-8")
        if ".shown_on" not in text:  # Most: reading them all takes seconds.
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
    """Raise ValueError where a mark names a row that does not exist."""
    names = {row.name for row in among}
    for mark in marks:
        strange = {*mark.names, *mark.but} - names
        strange |= {*mark.kinds} - {*get_args(Kind)} | {mark.transport} - {*TRANSPORTS}
        if strange:
            raise ValueError(f"{mark}: there is no {', '.join(sorted(strange))}")


def table() -> list[tuple[str, ...]]:
    """The rows of the table: name, what it is, type, and the judges on each transport."""
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
