"""Metrics for Prometheus, read by its own parsers, and by its linter if that is installed."""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
import urllib.error
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip("prometheus_client", reason="pip install cardan[metrics]")

from prometheus_client.openmetrics.parser import (
    text_string_to_metric_families as open_metrics_families,
)
from prometheus_client.parser import text_string_to_metric_families

from cardan.common.histogram import LatencyHistogram
from cardan.errors import AddressError
from cardan.gateway.daemon.client import ControlClient
from cardan.gateway.daemon.control import Response
from cardan.gateway.daemon.events import STOP_REASONS, SessionWatch
from cardan.gateway.daemon.metrics import MetricsOptions, MetricsServer, asked
from cardan.gateway.servers.stats import figures_of
from cardan.gateway.session.snapshot import BOUNDS_S, Snapshot
from tests.gateway.daemon.test_control_socket import serving
from tests.gateway.servers.bench import WAIT_S, served
from tests.snapshots import changed

UNPACKED_PROMTOOL = Path(__file__).parents[3] / "build/judges/promtool"
OPEN_METRICS = "application/openmetrics-text; version=1.0.0"


def histogram(*seconds):
    found = LatencyHistogram()
    for each in seconds:
        found.add(each)
    return found


CYCLES, AGES = histogram(0.3e-3, 0.4e-3, 0.2), histogram(0.9e-3, 3e-3)
MOVING = Snapshot.of(
    {
        "part_cost_s": {"network": 2e-5},
        "refusals": {"malformed": 1, "verb": 6, "busy": 0},
        "arm": {
            "phase": "moving",
            "authority": "device",
            "trips": 2,
            "limits": ["workspace", "joint"],
        },
        "robot": {
            "link": "live",
            "errors": {"malformed": 2, "order": 0},
            "metrics": {"lost": 3.0, "superseded": 1.0, "period_s": 0.004, "unknown": float("nan")},
        },
        "device": {
            "link": "live",
            "errors": {"malformed": 5},
            "metrics": {"age_s": 0.08, "jitter_s": float("nan")},
        },
        "loop": {
            "cycles": CYCLES.count,
            "tick_sum_s": CYCLES.sum,
            "tick_within": CYCLES.within(BOUNDS_S),
            "inputs": AGES.count,
            "input_age_sum_s": AGES.sum,
            "input_age_within": AGES.within(BOUNDS_S),
        },
        "tracking": {"error_m": 0.003, "error_rms_m": 0.002},
    }
)


def session(name, snapshot, **row):
    return {
        "name": name, "kind": "session", "state": "running", "restarts": 0, "pid": 7, "cpu": 0.095,
        "device": "spacemouse", "robot": "abb_egm", "stops": dict.fromkeys(STOP_REASONS, 0),
        "refusals": 0,
        "snapshot": None if snapshot is None else json.loads(snapshot.to_bytes()),
        **row,
    }  # fmt: skip


def server(name, **figures):
    return {
        "name": name, "kind": "server", "state": "running", "restarts": 1, "pid": 8, "cpu": None,
        "server": "rosbridge", "endpoint": "", "figures": figures,
    }  # fmt: skip


LAB = {
    "version": "1.2.3",
    "units": [
        session("gofa", MOVING, stops={**dict.fromkeys(STOP_REASONS, 0), "robot": 3}, refusals=4),
        session('odd"\\name', Snapshot(), device=""),
        session("gone", None, state="waiting", cpu=None),
        server("rosbridge", clients=5, superseded=6, denied=7, round_trip_us=1500),
        server("recorder", bytes=8, messages=9, dropped=10, lost=11),
        server("quiet"),
    ],
}


@pytest.fixture
def server():
    with metrics(lambda: LAB) as running:
        yield running


def metrics(figures, **options):
    return served(lambda: MetricsServer(MetricsOptions(**{"port": 0, **options}), figures))


def get(running, path="/metrics", **headers):
    request = urllib.request.Request(f"http://127.0.0.1:{running.port}{path}", headers=headers)
    with urllib.request.urlopen(request, timeout=WAIT_S) as response:
        return response.read().decode(), response.headers["Content-Type"]


def samples(families):
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in families
        for sample in family.samples
    }


def value(found, sample, /, **labels):
    return found[sample, frozenset(labels.items())]


@pytest.mark.parametrize(
    ("accept", "parse", "content_type"),
    [
        ("text/plain", text_string_to_metric_families, "text/plain"),
        ("*/*", text_string_to_metric_families, "text/plain"),
        (OPEN_METRICS, open_metrics_families, "application/openmetrics-text"),
    ],
)
def test_prometheus_reads_the_figures(server, accept, parse, content_type):
    text, kind = get(server, Accept=accept)
    assert kind.startswith(content_type)
    found = samples(parse(text))
    gofa = {"session": "gofa"}
    assert value(found, "cardan_build_info", version="1.2.3") == 1
    assert value(found, "cardan_session_state", state="running", **gofa) == 1
    assert value(found, "cardan_session_state", state="failed", **gofa) == 0
    assert value(found, "cardan_session_state", state="waiting", session="gone") == 1
    assert value(found, "cardan_arm_phase", phase="moving", **gofa) == 1
    assert value(found, "cardan_arm_phase", phase="disarmed", **gofa) == 0
    assert value(found, "cardan_authority", source="device", **gofa) == 1
    assert value(found, "cardan_robot_connected", **gofa) == 1
    assert value(found, "cardan_session_cycles_total", **gofa) == 3
    assert value(found, "cardan_cycle_overruns_total", **gofa) == 4
    assert value(found, "cardan_cycle_seconds_count", **gofa) == 3
    assert value(found, "cardan_cycle_seconds_sum", **gofa) == pytest.approx(0.2007)
    assert value(found, "cardan_cycle_seconds_bucket", le="0.0005", **gofa) == 2
    assert value(found, "cardan_cycle_seconds_bucket", le="0.05", **gofa) == 2
    assert value(found, "cardan_operator_input_age_seconds_bucket", le="0.004", **gofa) == 2
    assert value(found, "cardan_operator_inputs_total", device="spacemouse", **gofa) == 2
    assert value(found, "cardan_tracking_error_rms_meters", **gofa) == 0.002
    assert value(found, "cardan_driver_figure", figure="period_s", **gofa) == 0.004
    assert value(found, "cardan_session_part_seconds", part="network", **gofa) == 2e-5
    assert value(found, "cardan_device_figure", figure="age_s", **gofa) == 0.08
    not_known = {"figure": "jitter_s", **gofa}
    assert ("cardan_device_figure", frozenset(not_known.items())) not in found
    assert value(found, "cardan_stops_total", reason="robot", **gofa) == 3
    assert value(found, "cardan_refusals_total", reason="authority", **gofa) == 4
    assert value(found, "cardan_refusals_total", reason="verb", **gofa) == 6
    assert value(found, "cardan_trips_total", **gofa) == 2
    assert value(found, "cardan_tracking_error_meters", **gofa) == 0.003
    assert ("cardan_tracking_error_meters", frozenset({("session", 'odd"\\name')})) not in found
    assert value(found, "cardan_limit_active", limit="joint", **gofa) == 1
    assert value(found, "cardan_limit_active", limit="singularity", **gofa) == 0
    errors = "cardan_protocol_errors_total"
    assert value(found, errors, peer="robot", kind="malformed", **gofa) == 2
    assert value(found, errors, peer="device", kind="malformed", **gofa) == 5
    assert value(found, "cardan_ws_round_trip_seconds", server="rosbridge") == 0.0015
    assert value(found, "cardan_recording_bytes_total", server="recorder") == 8
    assert value(found, "cardan_recording_lost_messages_total", server="recorder") == 11
    assert value(found, "cardan_processor_ratio", kind="session", name="gofa") == 0.095
    assert value(found, "cardan_restarts_total", kind="server", name="quiet") == 1
    assert value(found, "cardan_server_clients", server="rosbridge") == 5
    assert value(found, "cardan_server_dropped_messages_total", server="rosbridge") == 6
    assert value(found, "cardan_server_denied_connections_total", server="rosbridge") == 7
    assert value(found, "cardan_session_cycles_total", session='odd"\\name') == 0
    assert ("cardan_server_clients", frozenset({("server", "quiet")})) not in found
    assert ("cardan_session_cycles_total", frozenset({("session", "gone")})) not in found
    assert ("cardan_driver_figure", frozenset({("figure", "unknown"), *gofa.items()})) not in found


def test_its_linter_finds_nothing(server):
    promtool = shutil.which("promtool") or shutil.which(UNPACKED_PROMTOOL)
    if promtool is None:
        pytest.skip("no promtool: tools/debian-packages judges installs it")
    text, _ = get(server)
    done = subprocess.run(
        [promtool, "check", "metrics"], input=text, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


def test_names_are_as_the_linter_wants_them(server):
    """Rules of ``promtool check metrics``: help, base units, suffixes."""
    for family in text_string_to_metric_families(get(server)[0]):
        assert family.documentation, family.name
        assert family.name.startswith("cardan_"), family.name
        words = family.name.split("_")
        assert not {"ms", "s", "mm", "m", "n", "milliseconds", "percent", "minutes"} & {*words}
        assert family.type not in words
        for sample in family.samples:
            assert sample.name.endswith("_total") == (family.type == "counter"), sample.name


def test_every_label_has_few_values(server):
    values = {}
    for family in text_string_to_metric_families(get(server)[0]):
        for sample in family.samples:
            for label, each in sample.labels.items():
                values.setdefault(label, set()).add(each)
    assert {*values} == {
        *("version", "kind", "name", "session", "state", "phase", "source", "device", "figure"),
        *("reason", "le", "server", "limit", "peer", "part"),
    }
    assert max(map(len, values.values())) <= 12


@pytest.mark.parametrize("path", ["/", "/metrics/", "/metric", "//["])
def test_there_is_one_page(server, path):
    with pytest.raises(urllib.error.HTTPError) as refused:
        get(server, path)
    assert refused.value.code == 404
    refused.value.close()


def test_without_the_daemon_a_scrape_fails_and_says_why():
    def gone():
        raise AddressError("no daemon runs here")

    with metrics(gone) as running:
        with pytest.raises(urllib.error.HTTPError) as refused:
            get(running)
        assert refused.value.code == 503
        assert refused.value.read() == b"no daemon runs here\n"


def test_a_fault_is_in_the_log(caplog):
    with metrics(lambda: {"units": []}) as running:
        with pytest.raises(urllib.error.HTTPError) as refused:
            get(running)
        assert refused.value.code == 500
        refused.value.close()
    assert "internal error of this server" in caplog.text
    assert "KeyError: 'version'" in caplog.text


def test_scrapes_wait_for_each_other():
    asking, most = [], []

    def slow():
        asking.append(1)
        most.append(len(asking))
        threading.Event().wait(0.02)
        asking.pop()
        return LAB

    with metrics(slow) as running:
        threads = [threading.Thread(target=get, args=(running,)) for _ in range(8)]
        for each in threads:
            each.start()
        for each in threads:
            each.join()
    assert most == [1] * 8


def test_it_asks_the_daemon_s_socket(tmp_path, monkeypatch):
    def handle(ask, figures_of):
        figures_of.tell(Response(ask.id, "result", [ask.do]))

    with serving(str(tmp_path / "sock"), handle=handle) as path:
        assert asked(path) == ["figures"]
        monkeypatch.setenv("CARDAN_SOCKET", path)
        assert asked("") == ["figures"]
        with ControlClient() as client:
            assert client.path == path


# -- sources of the figures -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"robot__link": "lost", "arm__trips": 3}, "robot"),
        ({"device__link": "lost", "arm__trips": 3}, "device"),
        ({"device__link": "lost", "device__held": False}, "none"),
        ({"arm__trips": 3}, "trip"),
        ({}, "none"),
    ],
)
def test_stops_are_counted_by_what_was_wrong(changes, reason):
    watch = SessionWatch("gofa")
    for snapshot in (MOVING, changed(MOVING, arm__phase="braking", **changes)) * 2:
        list(watch.take(snapshot, 1.0))
    watch.forget()
    assert watch.stops[reason] >= 1
    assert sum(watch.stops.values()) == 2, "the count outlives the process"


@pytest.mark.parametrize(
    ("line", "figures"),
    [
        ('FIGURES {"clients": 3, "denied": 1}', {"clients": 3, "denied": 1}),
        ('FIGURES {"clients": 3.5, "x": "y", "z": true, "n": 1}', {"n": 1}),
        ("FIGURES [", None),
        ("FIGURES [1]", None),
        ("FIGURES " + "[" * 5000, None),
        ("READY ws://", None),
    ],
)
def test_what_a_server_tells(line, figures):
    assert figures_of(line) == figures
