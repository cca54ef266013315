"""Allow list of programs for a demo: it moves a robot unattended, thus all of them must be
simulated.

The rule allows programs that are known to be harmless and refuses all others: see
:mod:`cardan.drivers.simulated` for drivers. Programs that a demo starts are simulated peers, and
``cardan devices spnav`` (of plugins/cardan-spnav-server) or ``cardan devices share`` of a simulated
device. These two are also the only programs that a peer is given to run: a device that is simulated
inside its program needs one, as in ``sim omni -- devices share ...``.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from cardan.bus.options import BusOptions
from cardan.common.tables import read_table, read_toml
from cardan.demos.examples import Demo
from cardan.drivers import registry
from cardan.drivers.simulated import is_elsewhere, stays_here, why_not_simulated
from cardan.errors import ConfigurationError, below
from cardan.gateway.force.tables import RemoteForceTable, SensorForceTable
from cardan.gateway.operator.filters import registry as filter_registry
from cardan.gateway.session.config import SessionConfig

CARDAN = (sys.executable, "-m", "cardan")

SIMULATED_BUSES = frozenset({"udp_multicast", "socketcand", "virtual"})
"""Only CAN buses that a launched peer may use."""

ADDRESSES = frozenset({"--host", "--listen", "--to"})
"""Options of peers that are a host, HOST:PORT, or a Zenoh endpoint by TCP."""

SERVING = {"spnav": "--socket", "share": "--listen"}
"""Commands of `cardan devices` that serve the device of a file, and the option with the address."""


def check_unattended(
    demo: Demo, config: SessionConfig, names: Mapping[str, str] | None = None
) -> None:
    """Raise ConfigurationError unless all that the session reaches is simulated.

    `names`: keys of ``device`` and ``robot`` in the file, if they differ: ``devices.left``.
    """
    if not (demo.launch or demo.launcher):
        _refuse(demo, "launch", "is empty, and so is launcher: no simulated peer is started")
    own = frozenset((*demo.files, *demo.ports))
    inside = shlex.split(demo.launcher)[1:2]
    tables = [("device", config.device), ("robot", config.robot)]
    if isinstance(config.force, SensorForceTable):
        tables.append(("force.sensor", config.force.sensor))
    for key, table in tables:
        if table is not None:
            _check_driver(demo, table, (names or {}).get(key, key), own, inside)
    for index, each in enumerate(config.filters):
        key = f"filters.{index}"
        with below(key):
            kind = filter_registry.load(each.filter)
        with filter_registry.using(each.filter, f"{key}.filter"):
            option, why = why_not_simulated(
                kind,
                read_table(kind.Options, each.options, key),
                lambda _: False,
                launched=False,
                needs_own=False,
            )
        if why:
            _refuse(demo, ".".join(filter(None, (key, option))), why)
    if isinstance(config.force, RemoteForceTable) and "force.socket" not in own:
        _refuse(
            demo, "force.socket", "it must be one of `files`: any force node could connect there"
        )
    if config.network is not None:
        _check_network(demo, config.network, "network.router" in own)


def _check_network(demo: Demo, network: BusOptions, own_router: bool) -> None:
    """Refuse a network that other programs may join."""
    if network.zenoh_config:
        _refuse(demo, "network.zenoh_config", "it may join any network")
    if not own_router:
        _refuse(
            demo,
            "network.router",
            "it must be one of `ports`: another program may listen at any other",
        )
    for key, endpoints in (("router", (network.router,)), ("listen", network.listen)):
        for each in endpoints:
            if not stays_here(each.partition("/")[2]):
                _refuse(demo, f"network.{key}", f"{each!r} is not of this computer only")


def _check_driver(
    demo: Demo, table: registry.DriverTable, key: str, own: frozenset[str], inside: Sequence[str]
) -> None:
    with below(key):
        kind = registry.load(table.driver)
    with registry.using(table.driver, f"{key}.driver"):
        option, why = why_not_simulated(
            kind,
            read_table(kind.Options, table.options, key),
            lambda name: f"{key}.{name}" in own,
            launched=[kind.peer] == list(inside),
        )
    if why:
        _refuse(demo, ".".join(filter(None, (key, option))), why)


def check_words(demo: Demo, key: str, words: Sequence[str]) -> list[str]:
    """Return the words of a launched command, with each value joined to its option, lest it be
    taken for a program to run. Raises ConfigurationError for a command that a demo may not
    start."""
    if key == "launch" and _serves(words):
        return _checked_serving(demo, words)
    if key == "launch" and "--" in words and _serves(program := words[words.index("--") + 1 :]):
        peer = check_words(demo, key, words[: words.index("--")])
        return [*peer, "--", *CARDAN, *_checked_serving(demo, program, inside=peer[1])]
    if len(words) < 2 or words[0] != "sim" or words[1].startswith("-"):
        what = shlex.join(words) or "nothing"
        _refuse(
            demo,
            key,
            f"it starts {what!r}; allowed: `sim PEER ...`, `devices spnav` or `devices share` of a "
            "FILE",
        )
    options, rest = _options(demo, key, words[2:])
    if rest:
        _refuse(demo, key, f"{rest[0]!r} is not a peer's option: a demo runs no other program")
    return [*words[:2], *options]


def _serves(words: Sequence[str]) -> bool:
    """Return True for a command of SERVING."""
    return len(words) > 1 and words[0] == "devices" and words[1] in SERVING


def _options(demo: Demo, key: str, words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return options as --NAME=VALUE, and the other words."""
    options: list[str] = []
    rest: list[str] = []
    takes_value = False
    for word in words:
        if word == "--":
            _refuse(demo, key, "'--' begins a program: a demo runs no other program")
        if word.startswith("--"):
            options.append(word)
            takes_value = "=" not in word
        elif takes_value:
            options[-1] += f"={word}"
            takes_value = False
        else:
            rest.append(word)
    for option in options:
        name, _, value = option.partition("=")
        if name in ("--uinput", "--uhid"):
            _refuse(demo, key, f"{name} makes a device of this computer: use a socket")
        if name in ("--router", "--zenoh-config"):
            _refuse(demo, key, f"{option} may be any network's: use --listen")
        if name in ADDRESSES and not stays_here(value.removeprefix("tcp/")):
            _refuse(demo, key, f"{option} is not an address of this computer only")
        if name == "--interface" and value not in SIMULATED_BUSES:
            _refuse(demo, key, f"{option} may reach hardware; allowed: {sorted(SIMULATED_BUSES)}")
        if is_elsewhere(value):
            _refuse(demo, key, f"{option} is an address that other computers have")
        if value.startswith(("/dev/", "/sys/")):
            _refuse(demo, key, f"{option} is a device of this computer")
    return options, rest


def _checked_serving(demo: Demo, words: Sequence[str], inside: str = "") -> list[str]:
    """Check a command of SERVING for a file with a simulated device, and return its words. Paths
    are in the demo's own folder, where the command runs, unless it runs `inside` this peer."""
    command, needed = words[1], SERVING[words[1]]
    options, rest = _options(demo, "launch", words[2:])
    named = any(option.startswith(f"{needed}=") for option in options)
    if not named or len(rest) != 1 or not Path(rest[0]).is_absolute():
        _refuse(demo, "launch", f"devices {command} serves {{examples}}/FILE, and needs {needed}")
    tables: Mapping[str, Any] = read_toml(Path(rest[0]))
    device = read_table(registry.DriverTable, tables.get("device"), "device")
    kind = registry.load(device.driver)
    options_of = read_table(kind.Options, device.options, "device")

    def in_folder(name: str) -> bool:
        path = getattr(options_of, name)
        return isinstance(path, str) and path == Path(path).name != ""

    option, why = why_not_simulated(kind, options_of, in_folder, launched=kind.peer == inside)
    if why:
        _refuse(demo, f"launch: {rest[0]}: device.{option}", why)
    return [*words[:2], *options, *rest]


def _refuse(demo: Demo, key: str, why: str) -> NoReturn:
    raise ConfigurationError(
        f"{demo.file}: {key}",
        f"{why}. A demo moves a robot unattended: all of its hardware must be simulated",
    )
