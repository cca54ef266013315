"""[force] and [[fixtures]]: valid values and error messages."""

import json

import pytest

from cardan.common.tables import as_table
from cardan.errors import ConfigurationError
from cardan.gateway.force.sources import ContactSource, MeasuredSource, SensorSource
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.force_assembly import load_force, make_source
from tests.gateway.force.fakes import FakeSensor

BASE = {
    "device": {"driver": "fake"},
    "robot": {"driver": "fake"},
    "mapping": {"mode": "position", "deadman": "button_1"},
}
SPHERE = {"shape": "sphere", "center_m": [0.3, 0.0, 0.4], "radius_m": 0.1, "stiffness_n_m": 100.0}
PLANE = {"shape": "plane", "normal": [0.0, 0.0, 1.0], "stiffness_n_m": 100.0}
SURFACE = """
[[fixtures]]
shape = "plane"
at = "start"
normal = [0.0, 0.0, 1.0]
stiffness_n_m = 100.0
"""
CONTACT = {
    "shape": "plane",
    "point_m": [0.0, 0.0, 0.1],
    "normal": [0.0, 0.0, 1.0],
    "stiffness_n_m": 1000.0,
}


@pytest.mark.parametrize(
    "tables",
    [
        {"fixtures": [SPHERE, {**PLANE, "at": "start"}, {**PLANE, "point_m": [0.1, 0.0, 0.2]}]},
        {"fixtures": [{"shape": "viscous", "damping_n_s_m": 2.0}]},
        {"force": {"source": "contact", "contact": [CONTACT]}},
        {"force": {"source": "sensor", "sensor": {"driver": "jr3_can", "node_id": 3}}},
        {"force": {"source": "remote", "socket": "x.sock"}},
        {"force": {"source": "measured", "sense": "reaction", "contact_target_n": 5.0}},
    ],
)
def test_a_configuration_is_the_same_in_the_sessions_own_process(tables):
    config = parse_config({**BASE, **tables})
    assert config.gives_force
    assert parse_config(json.loads(json.dumps(as_table(config)))) == config


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"fixtures": SPHERE}, r"fixtures: one table for each .* \[\[fixtures\]\]"),
        (
            {"fixtures": [{"shape": "sphere"}]},
            r'stiffness_n_m: is missing: shape = "sphere" needs it\n.*center_m: .*\n.*radius_m: ',
        ),
        ({"fixtures": [PLANE]}, r"fixtures\.0\.point_m: .* or at ="),
        (
            {"fixtures": [{**SPHERE, "centre_m": [0.3, 0.0, 0.4]}]},
            r"fixtures\.0\.centre_m: is now: center_m; rename it",
        ),
        (
            {"force": {"source": "measured", "sense": "felt"}},
            r"force\.sense: is now: 'reaction'; rename it",
        ),
        ({"fixtures": [{**PLANE, "at": "start", "point_m": [0.0, 0.0, 0.0]}]}, "one of both"),
        (
            {"fixtures": [{**SPHERE, "at": "start"}]},
            '0.at: there is no such key with shape = "sphere"; .* center_m, rad',
        ),
        ({"fixtures": [{**SPHERE, "stifness": 1.0}]}, "fixtures.0.stifness: there is no such key"),
        (
            {"fixtures": [{**PLANE, "at": "start", "normal": [0.0, 0.0, 0.0]}]},
            r"fixtures\.0\.normal: \[0.0, 0.0, 0.0\] is not allowed; .* has a direction",
        ),
        (
            {"fixtures": [{**SPHERE, "stiffness_n_m": -1.0}]},
            "-1.0 is not allowed; it must be above 0, at most",
        ),
        ({"fixtures": [SPHERE] * 9}, "9 are too many; allowed: at most 8"),
        ({"force": {"source": "sensor"}}, 'force.sensor: is missing: source = "sensor" needs it'),
        ({"force": {"source": "remote"}}, 'force.socket: is missing: source = "remote" needs it'),
        (
            {"force": {"source": "measured", "contact": [CONTACT]}},
            'contact: there is no such key with source = "measured"',
        ),
        ({"force": {"source": "contact", "contact": CONTACT}}, r"\[\[force.contact\]\]"),
        (
            {"force": {"source": "contact", "contact": [{**CONTACT, "radius_m": 1.0}]}},
            'force.contact.0.radius_m: there is no such key with shape = "plane"',
        ),
        ({"force": {"source": "contact", "zero_sensor": True, "contact": [CONTACT]}}, "zero_sens"),
        ({"force": {"source": "measured", "scale": 0.0}}, r"force\.scale: .* above 0"),
        ({"force": {"source": "remote", "socket": "x" * 200}}, "a path of up to 107 bytes"),
        ({"fixtures": [SPHERE], "mapping": {"mode": "rate"}}, 'fixtures: in mode = "rate"'),
        ({"force": {"source": "measured"}, "mapping": {}}, 'force: in mode = "rate"'),
    ],
)
def test_errors_name_the_key_and_what_is_allowed(tables, words):
    with pytest.raises(ConfigurationError, match=words):
        parse_config({**BASE, **tables})


def test_a_session_without_force_says_so():
    assert not parse_config(BASE).gives_force
    assert not parse_config({**BASE, "force": {}}).gives_force


def test_sources_are_made_with_their_sense(monkeypatch):
    monkeypatch.setitem(
        __import__("cardan.drivers.registry", fromlist=["BUILT_IN"]).BUILT_IN,
        "fake_sensor",
        "tests.gateway.force.fakes:FakeSensor",
    )
    table = parse_config({**BASE, "force": {"source": "measured"}}).force
    assert isinstance(make_source(table), MeasuredSource)
    sensor = {"source": "sensor", "sensor": {"driver": "fake_sensor"}, "zero_sensor": True}
    source = make_source(parse_config({**BASE, "force": sensor}).force)
    assert isinstance(source, SensorSource)
    assert isinstance(source.device, FakeSensor)
    contact = {"source": "contact", "contact": [CONTACT]}
    assert isinstance(make_source(parse_config({**BASE, "force": contact}).force), ContactSource)
    assert make_source(parse_config({**BASE, "fixtures": [SPHERE]}).force) is None


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"driver": "abb_egm"}, r"force\.sensor\.driver: 'abb_egm' is not an operator device"),
        ({"driver": "nothing"}, r"force\.sensor\.driver: there is no driver 'nothing'"),
        ({"driver": "jr3_can", "nod_id": 1}, r"force\.sensor\.nod_id: there is no such key"),
        ({"driver": "keyboard"}, r"force\.zero_sensor: 'keyboard' cannot be zeroed"),
    ],
)
def test_a_sensor_is_checked_before_anything_opens(table, words):
    force = {"source": "sensor", "sensor": table, "zero_sensor": True}
    with pytest.raises(ConfigurationError, match=words):
        make_source(parse_config({**BASE, "force": force}).force)


def test_a_force_nodes_file_needs_no_robot(tmp_path):
    file = tmp_path / "node.toml"
    file.write_text('[force]\nsource = "measured"\n')
    assert load_force(file).force.source == "measured"
    file.write_text('[force]\nsource = "remote"\nsocket = "x"\n')
    with pytest.raises(ConfigurationError, match="a file of its own"):
        load_force(file)
    file.write_text("[device]\n")
    with pytest.raises(ConfigurationError, match="nothing to send"):
        load_force(file)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[fixtures]\n", r"fixtures: one table for each .* \[\[fixtures\]\]"),
        (SURFACE * 9, "fixtures: 9 are too many; allowed: at most 8"),
        (SURFACE + "insde = true\n", r"fixtures\.0\.insde: there is no such key with shape"),
        (
            '[[fixtures]]\nshape = "bal"\n',
            r"fixtures\.0\.shape: 'bal' .* one of sphere, plane",
        ),
        ("[[fixtures]]\n", r"fixtures\.0\.shape: is missing"),
        ('[force]\nsource = "sensr"\n', "did you mean 'sensor'"),
        ("[force]\nsource = 1\n", r"force\.source: 1 is not allowed"),
        ("force = 1\n", "force: 1 is not a table"),
    ],
)
def test_a_force_nodes_tables_are_checked_as_a_sessions(tmp_path, text, words):
    file = tmp_path / "node.toml"
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=words):
        load_force(file)
