"""Which change of a session's configuration takes effect when."""

from dataclasses import fields

import pytest
from hypothesis import given, settings, strategies as st

from cardan.errors import ConfigurationError
from cardan.gateway.hand.mapping import MappingOptions
from cardan.gateway.motion.reference import ReferenceLimits
from cardan.gateway.session.changes import RULES, Effect, Moment, all_keys, rule_of, staged
from cardan.gateway.session.config import parse_config
from cardan.tables import as_table
from tests.examples import examples

BASE = {
    "robot": {"driver": "sim_arm", "robot": "ur5"},
    "arm": {"model": "ur5"},
    "device": {"driver": "spacemouse"},
    "mapping": {"deadman": "left"},
}


def config(**tables):
    merged = dict(BASE)
    for name, table in tables.items():
        if table is None:
            merged.pop(name)
        elif isinstance(table, dict) and isinstance(merged.get(name), dict):
            merged[name] = merged[name] | table
        else:
            merged[name] = table
    return parse_config(merged)


def moments(old, new):
    return {each.key: each.moment for each in staged(old, new).changes}


def test_every_key_has_one_rule():
    keys = set(all_keys())
    # A table whose keys differ in their rules has one for each of them.
    mixed = {key.partition(".")[0] for key in RULES if "." in key} - {"device", "network"}
    assert {key for key in keys if key.partition(".")[0] in mixed} <= RULES.keys()
    for key in keys:
        assert rule_of(key)
    named = {key for key in RULES if not key.startswith("device.")}
    assert named <= keys | {key.partition(".")[0] for key in keys}


@pytest.mark.parametrize(
    ("old", "new", "found"),
    [
        ({}, {}, {}),
        (
            {"limits": {"linear_speed_m_s": 0.2, "leash_m": 0.04}},
            {"limits": {"linear_speed_m_s": 0.1, "leash_m": 0.05}},
            {"limits.linear_speed_m_s": Moment.NOW, "limits.leash_m": Moment.DISARMED},
        ),
        (
            {"limits": {"workspace_x_m": [-1.0, 1.0], "workspace_y_m": [0.0, 1.0]}},
            {"limits": {"workspace_x_m": [-0.9, 1.0], "workspace_y_m": [0.1, 1.1]}},
            {"limits.workspace_x_m": Moment.NOW, "limits.workspace_y_m": Moment.DISARMED},
        ),
        (
            {"limits": {"workspace_z_m": [0.0, 1.0]}},
            {"limits": {"workspace_x_m": [0.0, 1.0]}},
            {"limits.workspace_x_m": Moment.NOW, "limits.workspace_z_m": Moment.DISARMED},
        ),
        (
            {},
            {"watchdogs": {"device_age_s": 0.05, "recovery": False}},
            {"watchdogs.device_age_s": Moment.NOW, "watchdogs.recovery": Moment.NOW},
        ),
        (
            {},
            {"arm": {"speed_share": 0.5, "safety_distance_m": 0.02, "policy": "reach"}},
            {
                "arm.speed_share": Moment.NOW,
                "arm.safety_distance_m": Moment.NOW,
                "arm.policy": Moment.DISARMED,
            },
        ),
        ({}, {"arm": {"model": "ur10"}}, {"arm.model": Moment.RESTART}),
        ({}, {"arm": {"tool_xyz_m": [0, 0, 0.1]}}, {"arm.tool_xyz_m": Moment.DISARMED}),
        (
            {"network": {}},
            {"arm": {"tool_xyz_m": [0, 0, 0.1]}, "network": {"rate_hz": 20.0, "name": "other"}},
            {
                "arm.tool_xyz_m": Moment.RESTART,
                "network.rate_hz": Moment.NOW,
                "network.name": Moment.RESTART,
            },
        ),
        ({}, {"network": {}}, {"network": Moment.RESTART}),
        (
            {},
            {"mapping": {"scale": [2, 1, 1, 1, 1, 1], "linear_speed_m_s": 0.2}},
            {"mapping.scale": Moment.NOW, "mapping.linear_speed_m_s": Moment.NOW},
        ),
        ({}, {"mapping": {"scale": [-1, 1, 1, 1, 1, 1]}}, {"mapping.scale": Moment.LET_GO}),
        ({}, {"mapping": {"deadman": "right"}}, {"mapping.deadman": Moment.LET_GO}),
        ({}, {"mapping": {"deadman": ""}}, {"mapping.deadman": Moment.DISARMED}),
        ({}, {"mapping": {"yaw_deg": 90}}, {"mapping.yaw_deg": Moment.DISARMED}),
        ({}, {"device": {"serial": "A1"}}, {"device.serial": Moment.RESTART}),
        ({}, {"device": {"dead_zone": 0.2}}, {"device.dead_zone": Moment.NOW}),
        ({}, {"device": {"driver": "keyboard"}}, {"device.driver": Moment.RESTART}),
        ({}, {"device": None, "mapping": {"deadman": ""}}, {
            "device": Moment.RESTART, "mapping.deadman": Moment.DISARMED,
        }),
        ({}, {"feedback": {"led": False}}, {"feedback.led": Moment.NOW}),
    ],
)  # fmt: skip
def test_when_a_change_takes_effect(old, new, found):
    assert moments(config(**old), config(**new)) == found


def test_the_stages_have_what_may_be_had_by_then():
    old = config()
    new = config(
        limits={"linear_speed_m_s": 0.1, "angular_speed_rad_s": 2.0},
        mapping={"deadman": "right"},
        device={"serial": "A1", "dead_zone": 0.3},
    )
    configs = staged(old, new).configs
    now, let_go, disarmed = (configs[each] for each in sorted(configs))
    assert now.limits.linear_speed_m_s == 0.1
    assert now.limits.angular_speed_rad_s == 1.0
    assert now.device.options == {"dead_zone": 0.3}
    assert now.mapping.deadman == "left"
    assert let_go.mapping.deadman == "right"
    assert let_go.limits == now.limits
    assert disarmed.limits == new.limits
    assert disarmed.device == now.device


def test_what_does_not_go_together_with_what_waits_waits_with_it():
    """The leash must not be longer than the following error, which is shortened at once only where
    the leash is."""
    old = config(mapping={"deadman": "left", "clutch": "a"})
    new = config(mapping={"deadman": "", "clutch": "left"})
    assert moments(old, new) == {
        "mapping.deadman": Moment.DISARMED,
        "mapping.clutch": Moment.DISARMED,
    }
    assert staged(old, new).configs[Moment.LET_GO] == old
    assert staged(old, new).configs[Moment.DISARMED] == new


def test_what_the_session_cannot_take_as_it_is_waits_for_the_restart():
    def check(made):
        if made.limits.linear_speed_m_s > 0.25:
            raise ConfigurationError("limits.linear_speed_m_s", "the robot does not allow it")

    old = config()
    new = config(
        robot={"driver": "sim_arm", "robot": "gp8"},
        limits={"linear_speed_m_s": 0.4, "leash_m": 0.04},
    )
    stages = staged(old, new, check)
    assert {each.key: each.effect for each in stages.changes} == {
        "robot.robot": Effect.RESTARTED,
        "limits.linear_speed_m_s": Effect.RESTARTED,
        "limits.leash_m": Effect.LIVE,
    }
    assert stages.configs[Moment.DISARMED].limits.leash_m == 0.04
    assert stages.configs[Moment.DISARMED].limits.linear_speed_m_s == 0.25


# -- any two configurations ------------------------------------------------------------------------

SPANS = st.one_of(st.none(), st.tuples(st.floats(-2.0, 0.0), st.floats(0.01, 2.0)).map(list))
LIMITS = st.fixed_dictionaries(
    {
        "linear_speed_m_s": st.floats(0.01, 0.4),
        "angular_speed_rad_s": st.floats(0.1, 1.5),
        "linear_acceleration_m_s2": st.floats(0.9, 3.0),
        "angular_acceleration_rad_s2": st.floats(3.5, 8.0),
        "leash_m": st.floats(0.01, 0.1),
        "leash_rad": st.floats(0.1, 0.5),
    },
    optional={
        "workspace_x_m": SPANS, "workspace_y_m": SPANS, "workspace_z_m": SPANS,
        "linear_jerk_m_s3": st.floats(5.0, 50.0), "angular_jerk_rad_s3": st.floats(20.0, 100.0),
    },
).map(lambda table: {key: value for key, value in table.items() if value is not None})  # fmt: skip
WATCHDOGS = st.fixed_dictionaries(
    {
        "device_age_s": st.floats(0.05, 0.2),
        "following_error_m": st.floats(0.1, 0.2),
        "following_error_rad": st.floats(0.5, 1.0),
        "recovery": st.booleans(),
    }
)
ARMS = st.fixed_dictionaries(
    {
        "model": st.just("ur5"),
        "speed_share": st.floats(0.1, 1.0),
        "acceleration_share": st.floats(0.1, 1.0),
        "safety_distance_m": st.floats(0.005, 0.05),
        "policy": st.sampled_from(["path", "reach"]),
    },
    optional={"tool_xyz_m": st.just([0.0, 0.0, 0.1])},
)
MAPPINGS = st.fixed_dictionaries(
    {
        "deadman": st.sampled_from(["", "left", "right"]),
        "clutch": st.sampled_from(["", "menu"]),
        "linear_speed_m_s": st.floats(0.01, 0.3),
        "yaw_deg": st.sampled_from([0.0, 90.0]),
    }
)
CONFIGS = st.fixed_dictionaries(
    {"limits": LIMITS, "watchdogs": WATCHDOGS, "arm": ARMS, "mapping": MAPPINGS}
).map(lambda tables: parse_config(BASE | tables))

NO_HIGHER = {
    "limits": (
        *("linear_speed_m_s", "angular_speed_rad_s", "leash_m", "leash_rad"),
    ),
    "watchdogs": ("device_age_s", "following_error_m", "following_error_rad", "recovery"),
    "arm": ("speed_share",),
}  # fmt: skip
NO_LOWER = {"arm": ("safety_distance_m",)}
AS_IT_WAS = {
    "limits": (
        *("linear_acceleration_m_s2", "angular_acceleration_rad_s2"),
        *("linear_jerk_m_s3", "angular_jerk_rad_s3", "i_accept_long_stops"),
    ),
    "arm": ("model", "policy", "tool_xyz_m", "acceleration_share", "collisions"),
    "mapping": ("mode", "frame", "axes", "yaw_deg"),
}  # fmt: skip


def not_looser(now, before):
    """By the meaning of each limit, written down a second time."""
    for table, keys in NO_HIGHER.items():
        for key in keys:
            assert getattr(getattr(now, table), key) <= getattr(getattr(before, table), key), key
    for table, keys in NO_LOWER.items():
        for key in keys:
            assert getattr(getattr(now, table), key) >= getattr(getattr(before, table), key), key
    for table, keys in AS_IT_WAS.items():
        for key in keys:
            assert getattr(getattr(now, table), key) == getattr(getattr(before, table), key), key
    for inside, outside in zip(now.limits.workspace_m, before.limits.workspace_m, strict=True):
        if outside is not None:
            assert inside is not None
            assert outside[0] <= inside[0]
            assert inside[1] <= outside[1]
    for button in ("deadman", "clutch"):
        assert bool(getattr(now.mapping, button)) is bool(getattr(before.mapping, button))


@settings(max_examples=examples(25), deadline=None)
@given(CONFIGS, CONFIGS)
def test_before_it_is_disarmed_no_limit_is_looser(old, new):
    configs = staged(old, new).configs
    for moment in (Moment.NOW, Moment.LET_GO):
        not_looser(configs[moment], old)
    assert configs[Moment.DISARMED] == new
    assert not staged(new, new).changes
    assert parse_config(as_table(configs[Moment.NOW])) == configs[Moment.NOW]


def test_the_limits_of_this_test_are_all_that_there_are():
    """A new limit is to be judged here, too."""
    told = {key for tables in (NO_HIGHER, NO_LOWER, AS_IT_WAS) for key in tables.get("limits", ())}
    told |= {"workspace_x_m", "workspace_y_m", "workspace_z_m"}
    known = {each.name for each in fields(ReferenceLimits)} | {"i_accept_long_stops"}
    assert told == known
    assert {"deadman", "clutch"} <= {each.name for each in fields(MappingOptions)}
