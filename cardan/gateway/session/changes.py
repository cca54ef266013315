"""What differs between two configurations of a session, and when each difference may take effect.

Every key of a session's file has one rule, here. Whether a limit is loosened is found by comparing
its two values: one that is tightened acts at once, one that is loosened waits until nobody has the
arm.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, Final, NamedTuple, get_args

from cardan.drivers import registry
from cardan.drivers.base import OperatorDevice
from cardan.drivers.registry import DriverTable
from cardan.errors import ConfigurationError
from cardan.gateway.hand.mapping import Mode
from cardan.gateway.session.config import SessionConfig
from cardan.options import hints
from cardan.tables import OTHER_KEYS, keys_of, plain, read_table


class Effect(str, enum.Enum):
    """When a change takes effect."""

    LIVE = "live"
    """At once, also while the arm moves."""
    WHEN_DISARMED = "when disarmed"
    """As soon as nobody has the arm, which is disarmed for it; the session goes on."""
    RESTARTED = "session restarted"
    """As soon as nobody has the arm; the session's process begins anew."""


class Moment(enum.IntEnum):
    """What a change waits for; each moment is also one for the changes before it."""

    NOW = 0
    LET_GO = 1
    """No button is held, and nothing is deflected: what a button or the hand's pose means must not
    change under the hand."""
    DISARMED = 2
    RESTART = 3


EFFECTS: Final = {
    Moment.NOW: Effect.LIVE,
    Moment.LET_GO: Effect.LIVE,
    Moment.DISARMED: Effect.WHEN_DISARMED,
    Moment.RESTART: Effect.RESTARTED,
}

WAITS: Final = {
    Moment.NOW: "",
    Moment.LET_GO: "until no button is held",
    Moment.DISARMED: "until disarmed",
    Moment.RESTART: "until disarmed",
}
"""What a change that has not taken effect waits for, in words."""


class Rule(NamedTuple):
    """When changes of a key take effect."""

    words: str
    moment: Callable[[Any, Any, SessionConfig], Moment]
    """Of the old value, the new one, and the old configuration."""


def _always(moment: Moment, words: str) -> Rule:
    return Rule(words, lambda _old, _new, _config: moment)


def _if_tighter(tighter: Callable[[Any, Any], bool], words: str) -> Rule:
    return Rule(
        f"live where {words}; otherwise when disarmed",
        lambda old, new, _config: Moment.NOW if tighter(old, new) else Moment.DISARMED,
    )


def _is_less(old: float | None, new: float | None) -> bool:
    return old is not None and new is not None and new < old


def _is_narrower(old: tuple[float, float] | None, new: tuple[float, float] | None) -> bool:
    return new is not None and (old is None or (new[0] >= old[0] and new[1] <= old[1]))


def _of_scale(old: tuple[float, ...], new: tuple[float, ...], config: SessionConfig) -> Moment:
    same = all((a > 0.0) is (b > 0.0) for a, b in zip(old, new, strict=True))
    return Moment.NOW if same and config.mapping.mode is Mode.RATE else Moment.LET_GO


def _of_button(old: Any, new: Any, _config: SessionConfig) -> Moment:
    return Moment.LET_GO if old and new else Moment.DISARMED


def _of_shaping(moment: Moment, words: str) -> Rule:
    return Rule(
        f"{words}; session restarted with drivers that cannot",
        lambda _old, _new, config: moment if _reshapes(config) else Moment.RESTART,
    )


def _reshapes(config: SessionConfig) -> bool:
    if config.device is None:
        return False
    kind = registry.load(config.device.driver)
    return issubclass(kind, OperatorDevice) and kind.reshapes


LIVE = _always(Moment.NOW, "live")
LET_GO = _always(Moment.LET_GO, "live, once no button is held and nothing is deflected")
DISARMED = _always(Moment.DISARMED, "when disarmed")
RESTART = _always(Moment.RESTART, "session restarted")
LOWER = _if_tighter(_is_less, "lower")
HIGHER = _if_tighter(lambda old, new: _is_less(new, old), "higher")
NARROWER = _if_tighter(_is_narrower, "narrower")
OFF = _if_tighter(lambda old, new: old and not new, "switched off")
SCALE = Rule(
    'live; in mode = "position" and "absolute", and where a sign changes, once no button is held '
    "and nothing is deflected",
    _of_scale,
)
HELD_BUTTON = Rule(
    "live, once no button is held and nothing is deflected; from or to none when disarmed",
    _of_button,
)
TOOL = Rule(
    "when disarmed; session restarted where it has a `[network]`",
    lambda _old, _new, config: Moment.RESTART if config.network else Moment.DISARMED,
)
"""The network has told of the tool, once and for all."""

RULES: Final[Mapping[str, Rule]] = {
    "device": RESTART,
    **dict.fromkeys(
        ("device.dead_zone", "device.dead_zone_shape", "device.curve", "device.dominant_axis"),
        _of_shaping(Moment.NOW, "live"),
    ),
    **dict.fromkeys(
        ("device.translation", "device.rotation"),
        _of_shaping(Moment.LET_GO, "live, once no button is held and nothing is deflected"),
    ),
    "robot": RESTART,
    "arm": RESTART,
    "arm.model": RESTART,
    "arm.policy": DISARMED,
    "arm.tool_xyz_m": TOOL,
    "arm.tool_rpy_deg": TOOL,
    "arm.speed_share": LOWER,
    "arm.acceleration_share": DISARMED,
    "arm.collisions": RESTART,
    "arm.i_accept_links_without_bodies": RESTART,
    "arm.safety_distance_m": HIGHER,
    "arm.tcp_tolerance_m": LOWER,
    **dict.fromkeys(
        ("arm.arrival_m", "arm.arrival_rad", "arm.arrival_joint", "arm.arrival_timeout_s"),
        LIVE,
    ),
    "authority": DISARMED,
    "obstacles": RESTART,
    **dict.fromkeys(
        (
            *("mapping.mode", "mapping.frame", "mapping.axes", "mapping.yaw_deg"),
            *("mapping.device_rpy_deg", "mapping.orientation", "mapping.origin_m"),
            *("mapping.device_centre_m", "mapping.hand_to_tool_rpy_deg", "mapping.joints"),
        ),
        DISARMED,
    ),
    **dict.fromkeys(
        (
            *("mapping.linear_speed_m_s", "mapping.angular_speed_rad_s"),
            "mapping.joint_speed_rad_s",
        ),
        LIVE,
    ),
    "mapping.scale": SCALE,
    **dict.fromkeys(
        (
            *("mapping.approach_speed_m_s", "mapping.approach_speed_rad_s"),
            *("mapping.slip_m", "mapping.slip_rad"),
            *("mapping.recapture", "mapping.enable", "mapping.pass_on"),
            *("gripper.toggle", "gripper.close", "gripper.open"),
        ),
        LET_GO,
    ),
    "mapping.deadman": HELD_BUTTON,
    "mapping.clutch": HELD_BUTTON,
    "filters": RESTART,
    **dict.fromkeys(("gripper.output", "gripper.closed_value", "gripper.open_value"), DISARMED),
    "feedback": LIVE,
    "limits.linear_speed_m_s": LOWER,
    "limits.angular_speed_rad_s": LOWER,
    "limits.leash_m": LOWER,
    "limits.leash_rad": LOWER,
    # Less of these takes longer to stop, more of them is harder: neither is the tighter.
    "limits.linear_acceleration_m_s2": DISARMED,
    "limits.angular_acceleration_rad_s2": DISARMED,
    "limits.linear_jerk_m_s3": DISARMED,
    "limits.angular_jerk_rad_s3": DISARMED,
    "limits.i_accept_long_stops": DISARMED,
    **{f"limits.workspace_{axis}_m": NARROWER for axis in "xyz"},
    "watchdogs.device_age_s": LOWER,
    "watchdogs.following_error_m": LOWER,
    "watchdogs.following_error_rad": LOWER,
    "watchdogs.recovery": OFF,
    "network": RESTART,
    "network.rate_hz": LIVE,
    "force": RESTART,
    "fixtures": RESTART,
}  # fmt: skip
"""The rule of each key; a table's holds for its keys that have none of their own, and where the
table itself comes or goes."""


class Change(NamedTuple):
    """A key that is another than before."""

    key: str
    old: Any
    """As JSON has it; None: none."""
    new: Any
    moment: Moment

    @property
    def effect(self) -> Effect:
        """When it takes effect."""
        return EFFECTS[self.moment]


class Stages(NamedTuple):
    """What a session becomes, one stage after the other."""

    changes: tuple[Change, ...]
    configs: Mapping[Moment, SessionConfig]
    """What it may have at each moment but a restart."""


def rule_of(key: str) -> Rule:
    """The rule of a dotted key."""
    while key not in RULES:
        key = key.rpartition(".")[0]
    return RULES[key]


def staged(
    old: SessionConfig,
    new: SessionConfig,
    check: Callable[[SessionConfig], None] = lambda _config: None,
) -> Stages:
    """What has changed, and what the session may have at each moment until it has all of `new`.

    Changes that do not go together with what has to wait (`check` raises ConfigurationError) wait
    with it.
    """
    changes = [
        Change(key, plain(was), plain(now), rule_of(key).moment(was, now, old))
        for key, was, now in _differences(old, new)
    ]
    configs: dict[Moment, SessionConfig] = {}
    before = old
    for moment in (Moment.NOW, Moment.LET_GO, Moment.DISARMED):
        try:
            made = _with(old, new, (each.key for each in changes if each.moment <= moment))
            if made != before:
                check(made)
        except ConfigurationError:
            later = Moment.RESTART if moment is Moment.DISARMED else Moment.DISARMED
            changes = [
                each._replace(moment=later) if each.moment is moment else each for each in changes
            ]
            made = before
        configs[moment] = before = made
    return Stages(tuple(changes), configs)


def _differences(old: SessionConfig, new: SessionConfig) -> Iterator[tuple[str, Any, Any]]:
    """The keys that differ, with both values."""
    for table in keys_of(SessionConfig):
        was, now = getattr(old, table), getattr(new, table)
        if was == now:
            continue
        if isinstance(was, DriverTable) and isinstance(now, DriverTable):
            if was.driver == now.driver:
                yield from _options(table, was, now)
            else:
                yield f"{table}.driver", was.driver, now.driver
        elif is_dataclass(was) and type(was) is type(now):
            for key in keys_of(type(was)):
                before, after = getattr(was, key), getattr(now, key)
                if before != after:
                    yield f"{table}.{key}", before, after
        else:
            yield table, was, now


def _options(table: str, was: DriverTable, now: DriverTable) -> Iterator[tuple[str, Any, Any]]:
    kind: Any = registry.load(was.driver).Options
    before, after = (read_table(kind, each.options, table) for each in (was, now))
    for each in fields(kind):
        values = getattr(before, each.name), getattr(after, each.name)
        if values[0] != values[1]:
            yield f"{table}.{each.name}", *values


def _with(old: SessionConfig, new: SessionConfig, keys: Iterable[str]) -> SessionConfig:
    """`old` with the values of `new` at `keys`. Raises ConfigurationError."""
    tables: dict[str, list[str]] = {}
    for key in keys:
        table, _, inner = key.partition(".")
        tables.setdefault(table, []).append(inner)
    if not tables:
        return old
    return replace(
        old,
        **{
            table: _table_with(getattr(old, table), getattr(new, table), inside)
            for table, inside in tables.items()
        },
    )


def _table_with(was: Any, now: Any, keys: list[str]) -> Any:
    if "" in keys or "driver" in keys:
        return now
    if isinstance(was, DriverTable):
        left = {key: each for key, each in was.options.items() if key not in keys}
        given = {key: now.options[key] for key in keys if key in now.options}
        return replace(was, options=left | given)
    return replace(was, **{key: getattr(now, key) for key in keys})


def all_keys() -> Iterator[str]:
    """Every key that a session's file may have, as the rules know them: those of the options of
    drivers and filters, and of tables of several kinds, are one with their table."""
    for table in keys_of(SessionConfig):
        hint = hints(SessionConfig)[table]
        kinds = [each for each in (hint, *get_args(hint)) if isinstance(each, type)]
        kind = next((each for each in kinds if is_dataclass(each)), None)
        if kind is None or any(each.metadata == OTHER_KEYS for each in fields(kind)):
            yield table
        else:
            yield from (f"{table}.{key}" for key in keys_of(kind))
