"""Configuration errors name the key, the value and the allowed ones; valid files are read
completely."""

import contextlib
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from cardan.common.tables import as_table
from cardan.errors import ConfigurationError
from cardan.gateway.operator.mapping import GripperAction, Orientation
from cardan.gateway.session.assembly import check_mode, load_config, make_filters, make_robot
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.driver_assembly import make_device
from cardan.types import Frame
from tests.examples import examples

EXAMPLES = [
    path
    for path in sorted((Path(__file__).parents[3] / "examples").glob("*.toml"))
    if "[[sessions]]" not in path.read_text("utf-8")
]

GOOD = {
    "device": {"driver": "fake_device", "deflection": 0.5},
    "robot": {"driver": "fake_robot"},
    "mapping": {"frame": "tool", "deadman": "go", "axes": ["y", "-x", "z", "rx", "fixed", "rz"]},
    "gripper": {"toggle": "grip", "output": 3},
    "limits": {"workspace_z_m": [0.1, 0.9]},
    "filters": [
        {"filter": "camera", "camera_rpy_deg": [0, 0, 90]},
        {"filter": "proximity", "alert_high": 700},
    ],
}


def test_a_good_table(fake_drivers):
    config = parse_config(GOOD)
    mapping = config.mapping
    assert mapping.frame is Frame.TOOL
    assert mapping.axes[1] == "-x"
    assert config.gripper.buttons == {"grip": GripperAction.TOGGLE}
    assert config.limits.workspace_m == (None, None, (0.1, 0.9))
    assert make_device(config).options.deflection == 0.5
    assert make_robot(config).options.cycles == 500
    camera, proximity = make_filters(config)
    assert (camera.name, proximity.name) == ("camera", "proximity")
    assert camera.options.camera_rpy_deg == (0, 0, 90)
    assert proximity.options.alert_high == 700


POSED = {"mode": "position", "clutch": "button_2", "recapture": "button_1"}
ABSOLUTE = {"mode": "absolute", "deadman": "go", "origin_m": [0.5, 0, 0.3]}


def test_mappings_of_a_pose():
    options = parse_config({**GOOD, "mapping": {**POSED, "orientation": "fixed"}}).mapping
    assert (options.clutch, options.recapture, options.deadman_buttons) == (
        "button_2",
        "button_1",
        (),
    )
    assert options.orientation is Orientation.FIXED
    assert parse_config({**GOOD, "mapping": POSED}).mapping.orientation is None
    mapping = {
        **ABSOLUTE,
        "orientation": "absolute",
        "device_center_m": [0.1, 0, 0],
        "device_to_tool_rpy_deg": [180, 0, 0],
        "approach_speed_m_s": 0.02,
    }
    config = parse_config({**GOOD, "mapping": mapping})
    options = config.mapping
    assert (options.origin_m, options.device_center_m) == ((0.5, 0, 0.3), (0.1, 0, 0))
    assert options.approach_speed_m_s == 0.02
    assert parse_config(as_table(config)) == config


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        ({"mode": "position"}, 'deadman: mode = "position" needs one'),
        ({"mode": "absolute", "origin_m": [0, 0, 0]}, 'deadman: mode = "absolute" needs one'),
        ({**POSED, "joints": {"rz": "joint_6"}}, "joints: in mode"),
        ({**POSED, "orientation": "absolute"}, 'is for mode = "absolute" only'),
        ({**POSED, "orientation": "follow"}, "follow-base, follow-tool, fixed, absolute"),
        ({**POSED, "origin_m": [0, 0, 0]}, "origin_m: only mode"),
        ({**POSED, "device_center_m": [0, 0, 1]}, "device_center_m: only mode"),
        (
            {**POSED, "recapture": "button_2"},
            "mapping.clutch: 'button_2' is the button of mapping.recapture",
        ),
        (
            {**POSED, "deadman": "button_2"},
            "mapping.clutch: 'button_2' is the button of mapping.deadman",
        ),
        ({"recapture": "button_1"}, 'recapture: mode = "rate" has no references'),
        ({"orientation": "fixed"}, 'orientation: mode = "rate" follows no pose'),
        ({"device_rpy_deg": [0, 0, 90]}, "device_rpy_deg: only mode"),
        ({**ABSOLUTE, "recapture": "button_1"}, 'recapture: mode = "absolute" has no references'),
        ({"mode": "absolute", "clutch": "a"}, 'origin_m: mode = "absolute" needs it'),
        ({**ABSOLUTE, "frame": "tool"}, "frame: 'tool' moves"),
        ({**ABSOLUTE, "approach_speed_m_s": 0}, "approach_speed_m_s"),
        (
            {**ABSOLUTE, "device_to_tool_rpy_deg": [1, 0, 0]},
            "device_to_tool_rpy_deg: only orientation",
        ),
        (
            {**ABSOLUTE, "orientation": "absolute", "scale": [1, 1, 1, 1, 1, 2]},
            "takes the device's whole orientation",
        ),
    ],
)
def test_a_mapping_that_does_not_fit_its_mode(mapping, words):
    with pytest.raises(ConfigurationError) as caught:
        parse_config({**GOOD, "mapping": mapping})
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("gives_pose", "gives_axes", "mapping", "words"),
    [
        (False, True, {}, ""),
        (False, True, POSED, 'measures deflections: set mode = "rate"'),
        (False, True, ABSOLUTE, 'measures deflections: set mode = "rate"'),
        (True, False, {}, 'set mode = "position"'),
        (True, False, POSED, ""),
        (True, True, {}, ""),
        (True, True, ABSOLUTE, ""),
    ],
)
def test_the_device_must_measure_what_the_mapping_wants(
    fake_drivers, monkeypatch, gives_pose, gives_axes, mapping, words
):
    config = parse_config({**GOOD, "mapping": mapping})
    device = make_device(config)
    able = type(device).capabilities._replace(gives_pose=gives_pose, gives_axes=gives_axes)
    monkeypatch.setattr(type(device), "capabilities", able)
    if not words:
        check_mode(config.mapping, device)
    else:
        with pytest.raises(ConfigurationError, match=words):
            check_mode(config.mapping, device)


def test_without_filters_there_are_none():
    assert make_filters(parse_config({**GOOD, "filters": []})) == ()


def test_survives_the_way_to_the_session_process():
    config = parse_config(GOOD)
    assert parse_config(as_table(config)) == config


@pytest.mark.parametrize(
    ("change", "key", "words"),
    [
        ({"mapping": {"deadmen": "x"}}, "mapping.deadmen", "did you mean 'deadman'"),
        ({"mapping": {"frame": "world"}}, "mapping.frame", "base, tool, mixed"),
        ({"mapping": {"axes": ["x"]}}, "mapping.axes", "6 values"),
        (
            {"mapping": {"axes": ["x", "y", "z", "rx", "ry", "w"]}},
            "mapping.axes",
            "'w' is not allowed",
        ),
        (
            {"mapping": {"linear_speed_m_s": -1}},
            "mapping.linear_speed_m_s",
            "-1 is not allowed; it must be 0.0001 to 5 m/s",
        ),
        ({"mapping": {"yaw_deg": float("nan")}}, "mapping.yaw_deg", "-360 to 360"),
        ({"limits": {"workspace_x_m": [1, 0]}}, "limits.workspace_x_m", "lower bound first"),
        ({"limits": {"max_lead_rad": 3}}, "limits.max_lead_rad", "1.5"),
        ({"limits": {"leash_rad": 0.3}}, "limits.leash_rad", "is now: max_lead_rad; rename it"),
        ({"mapping": {"device_centre_m": [0, 0, 0]}}, "mapping.device_centre_m", "device_center_m"),
        (
            {"mapping": {"hand_to_tool_rpy_deg": [0, 0, 0]}},
            "mapping.hand_to_tool_rpy_deg",
            "is now: device_to_tool_rpy_deg; rename it",
        ),
        ({"neighbours": []}, "neighbours", "is now: neighbors; rename it"),
        ({"authority": {"policy": "hand"}}, "authority.policy", "is now: 'device'; rename it"),
        (
            {"authority": {"policy": "named", "named": "hand"}},
            "authority.named",
            "is now: 'device'; rename it",
        ),
        ({"watchdogs": {"device_age_s": 10}}, "watchdogs.device_age_s", "0.5"),
        ({"speed": 1}, "speed", "allowed: device, robot"),
        ({"robot": {}}, "robot.driver", "missing"),
        ({"gripper": {"output": 99}}, "gripper.output", "39"),
        ({"gripper": {"output": True}}, "gripper.output", "True is not allowed"),
        ({"mapping": {"linear_speed_m_s": True}}, "mapping.linear_speed_m_s", "True"),
        ({"gripper": {"toggle": "go"}}, "gripper.toggle", "'go' is the button of mapping.deadman"),
        ({"limits": {"linear_acceleration_m_s2": 1e-3}}, "", "limits.linear_acceleration"),
    ],
)
def test_errors_name_the_key(change, key, words):
    with pytest.raises(ConfigurationError) as caught:
        parse_config({**GOOD, **change})
    assert caught.value.key.startswith(key)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("table", "key", "words"),
    [
        ({"driver": "spacemose"}, "device.driver", "spacemouse"),
        ({"driver": "fake_robot"}, "device.driver", "not an operator device"),
        ({"driver": "fake_device", "deflexion": 1}, "device.deflexion", "'deflection'"),
        ({"driver": "fake_device", "deflection": 7}, "device.deflection", "must be -1 to 1"),
        ({"driver": "fake_device", "deflection": "much"}, "device.deflection", "'much'"),
    ],
)
def test_driver_errors_name_the_key(fake_drivers, table, key, words):
    config = parse_config({**GOOD, "device": table})
    with pytest.raises(ConfigurationError) as caught:
        make_device(config)
    assert caught.value.key == key
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("tables", "key", "words"),
    [
        ([{"filter": "proximaty"}], "filters.0.filter", "allowed: camera, proximity"),
        ([{"filter": "camera"}, {"port": 1}], "filters.1.filter", "is missing"),
        ([{"filter": "camera", "prot": 1}], "filters.0.prot", "did you mean 'port'"),
        ([{"filter": "camera", "port": 0}], "filters.0.port", "1 to 65535"),
        ([{"filter": "camera", "port": "x"}], "filters.0.port", "'x'"),
        ([{"filter": "proximity", "alert_low": 900}], "filters.0.alert_low", "which is 800"),
        ({"filter": "camera"}, "filters", "[[filters]]"),
    ],
)
def test_filter_errors_name_the_key(tables, key, words):
    with pytest.raises(ConfigurationError) as caught:
        make_filters(parse_config({**GOOD, "filters": tables}))
    assert caught.value.key == key
    assert words in str(caught.value)


def test_a_file_with_a_wrong_filter_is_refused_whole(tmp_path):
    path = tmp_path / "session.toml"
    path.write_text(
        '[device]\ndriver = "spacemouse"\n[robot]\ndriver = "abb_egm"\n'
        '[[filters]]\nfilter = "camera"\ngain_rad_s = -1\n'
    )
    with pytest.raises(ConfigurationError, match=r"filters\.0\.gain_rad_s: -1 is not allowed"):
        load_config(path)


@pytest.mark.parametrize(
    "wrong", ["", "[limits]\nlinear_sped_m_s = 1\n", "[arm]\nmodel = 5\n"], ids=str
)
def test_each_wrong_key_of_a_file_is_reported_in_a_line_with_its_place(tmp_path, wrong):
    path = tmp_path / "session.toml"
    path.write_text(
        '[device]\ndriver = "spacemouse"\ndead_zon = 0.1\n'
        f'[robot]\ndriver = "ur_rtde"\nhosst = "10.0.0.1"\n{wrong}'
    )
    with pytest.raises(ConfigurationError) as caught:
        load_config(path)
    lines = str(caught.value).splitlines()
    assert len(lines) == (3 if wrong else 2)
    assert lines[-2].startswith(f"{path}:3:1: device.dead_zon: there is no such key")
    assert lines[-1].startswith(f"{path}:6:1: robot.hosst: there is no such key")


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(ConfigurationError, match="cannot read"):
        load_config(tmp_path / "none.toml")
    bad = tmp_path / "bad.toml"
    bad.write_text("[device\n")
    with pytest.raises(ConfigurationError, match=r"bad\.toml:1:8: is not TOML"):
        load_config(bad)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_examples_are_valid(path):
    load_config(path)


def test_a_robot_that_takes_no_poses_is_refused_before_anything_is_opened(fake_drivers):
    config = parse_config({**GOOD, "robot": {"driver": "fake_robot", "takes_poses": False}})
    with pytest.raises(ConfigurationError, match="it takes joint"):
        make_robot(config)


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        ({"linear_speed_m_s": 0.5}, ""),
        ({"linear_speed_m_s": 0.3, "linear_acceleration_m_s2": 0.6}, ""),
        (
            {"linear_acceleration_m_s2": 0.4},
            "limits.linear_acceleration_m_s2: stopping from full speed takes 0.625 s; it must not "
            "take more than 0.5 s: raise the acceleration or lower the speed; or accept it with "
            "i_accept_long_stops = true in [limits], up to 2 s",
        ),
        (
            {"angular_acceleration_rad_s2": 1.0},
            "limits.angular_acceleration_rad_s2: stopping from full speed takes 1 s",
        ),
        ({"linear_acceleration_m_s2": 0.4, "i_accept_long_stops": True}, ""),
        ({"linear_acceleration_m_s2": 0.125, "i_accept_long_stops": True}, ""),
        (
            {"linear_acceleration_m_s2": 0.1, "i_accept_long_stops": True},
            "takes 2.5 s; it must not take more than 2 s: raise the acceleration or lower the "
            "speed; no more is allowed",
        ),
        ({"i_accept_long_stops": 1}, "limits.i_accept_long_stops: "),
    ],
)
def test_an_arm_stops_soon_or_its_operator_accepts_it(limits, words):
    if not words:
        parse_config({**GOOD, "limits": limits})
        return
    with pytest.raises(ConfigurationError) as caught:
        parse_config({**GOOD, "limits": limits})
    assert words in str(caught.value)


def test_limits_that_the_driver_would_cut_are_refused():
    table = {**GOOD, "robot": {"driver": "abb_egm"}, "limits": {"linear_speed_m_s": 0.5}}
    with pytest.raises(ConfigurationError, match=r"limits\.linear_speed_m_s: 0\.5 is more than"):
        make_robot(parse_config(table))
    table["robot"] = {"driver": "abb_egm", "linear_speed_m_s": 0.5}
    assert make_robot(parse_config(table)).options.linear_speed_m_s == 0.5


def test_a_maximum_lead_longer_than_the_following_error_is_refused():
    with pytest.raises(ConfigurationError, match=r"limits\.max_lead_m: is 0\.2; .* which is 0\.1"):
        parse_config({**GOOD, "limits": {"max_lead_m": 0.2}})


scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
values = st.recursive(scalars, lambda v: st.lists(v, max_size=6), max_leaves=8)
KEYS = """
    driver frame axes scale deadman clutch recapture orientation origin_m toggle output max_lead_m
    device_age_s workspace_x_m listen_port port alert_high when_stale path robot dead_zone mode
    unknown
"""
keys = st.sampled_from(KEYS.split())
tables = st.dictionaries(
    st.sampled_from(
        ["device", "robot", "mapping", "gripper", "limits", "watchdogs", "filters", "else"]
    ),
    st.dictionaries(keys, values, max_size=5)
    | st.lists(st.dictionaries(keys, values, max_size=5), max_size=2)
    | values,
)


@settings(max_examples=examples(300))
@given(tables)
def test_any_table_is_a_configuration_or_an_error(table):
    table.setdefault("device", {})
    table.setdefault("robot", {})
    for name, driver in (("device", "spacemouse"), ("robot", "abb_egm")):
        if isinstance(table[name], dict):
            table[name] = {**table[name], "driver": driver}
    if isinstance(table.get("filters"), list):
        named = [{**t, "filter": "proximity"} for t in table["filters"] if isinstance(t, dict)]
        table["filters"] = named or table["filters"]
    with contextlib.suppress(ConfigurationError):
        config = parse_config(table)
        if config.device is not None:
            make_device(config)
        make_robot(config)
        make_filters(config)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            '[device]\ndriver = "abb_egm"\n',
            "2:1: device.driver: 'abb_egm' is not an operator device",
        ),
        ('[device]\ndriver = "ABB_EGM"\n', "2:1: device.driver: .*did you mean 'abb_egm'"),
        ('[device]\ndriver = "SpaceMouse"\n', "2:1: device.driver: .*did you mean 'spacemouse'"),
        ('[device]\n  driver = "ros2-joy"\n', "2:3: device.driver: .*did you mean 'ros2_joy'"),
        ('[device]\ndriver = "gamepad"\n[mapping]\ndeadman = "Left"\n', "4:1: mapping.deadman: "),
        ('[device]\ndriver = "leap"\nport = "6437"\n', "3:1: device.port: .*without quotes"),
        (
            '[limits]\nlinear_speed_m_s = "0.1 m/s"\n',
            "2:1: .*a number, without quotes and unit: 0.0001 to 5",
        ),
        ('[arm]\nmodel = "UR5E"\n', "2:1: arm.model: .*did you mean 'ur5e'"),
        ('[device]\ndriver = "leap"\nhost = "192.168.125.300"\n', "3:1: device.host: "),
    ],
)
def test_what_is_wrong_in_a_file_is_reported_with_its_line_and_column(tmp_path, text, words):
    path = tmp_path / "cell.toml"
    path.write_text(f'{text}[robot]\ndriver = "abb_egm"\n', encoding="utf-8")
    with pytest.raises(ConfigurationError, match=rf"cell\.toml:{words}"):
        load_config(path)


@pytest.mark.parametrize("name", ["ABB_EGM", "abb-egm", "ABB-EGM", "abb_emg"])
def test_a_robots_driver_is_written_as_it_is_called(tmp_path, name):
    path = tmp_path / "cell.toml"
    path.write_text(f'[robot]\ndriver = "{name}"\n', encoding="utf-8")
    said = f"2:1: robot.driver: there is no driver '{name}'; allowed: abb_egm, motoros, "
    with pytest.raises(ConfigurationError, match=rf"cell\.toml:{said}") as caught:
        load_config(path)
    assert str(caught.value).endswith("; did you mean 'abb_egm'?")
