"""Every topic of a session is received, and every command, service and action replies, over each
transport."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cardan.protocols.ros2.cdr import codec_of
from tests import network_table
from tests.fastdds import FastNode
from tests.network_table import Coverage
from tests.npm import installed
from tests.ros2_packages import write_packages
from tests.sweep.plan import RESULT, command, plan, wanted_rows
from tests.waiting import WITHIN_S

pytestmark = pytest.mark.matrix

MODULE = (Path(__file__).parent / "roslib_judge.mjs").read_text(encoding="utf-8")
LATCHED = ("_static", "_description", "/configuration", "/scene")
TIMEOUT_S = WITHIN_S
ROSLIB = ("node", "--input-type=module", "-e", MODULE, "--")


@pytest.fixture
def judgment(request, session):
    """The mark of a test, and the task of its judge."""
    mark = Coverage(**request.node.get_closest_marker("shown_on").kwargs)
    return plan(network_table.rows(), mark)


def reported(session, command, asked, **more):
    """Return the report of a judge in its own process; the arm moves once the judge has sent its
    commands."""
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, **more
    ) as judge:
        try:
            judge.stdin.write(asked.text())
            judge.stdin.close()
            assert judge.stdout.readline().strip() == "HEARING"
            session.moving.set()
            return json.loads(judge.stdout.readline())
        finally:
            session.moving.clear()
            judge.kill()


def check(asked, found):
    """Check that every topic was received and every request was answered."""
    assert [each[0] for each in asked.hear if not found["heard"].get(each[0])] == []
    assert [each[0] for each in asked.commands if not found["commands"][each[0]]] == []
    assert [each[0] for each in asked.services if found["services"][each[0]] is None] == []
    assert [each[0] for each in asked.actions if not found["actions"][each[0]]] == []


def test_the_table_has_what_a_session_has_on_the_graph(session):
    wanted = wanted_rows()
    assert session.wait(wanted) == wanted


@pytest.mark.real
@pytest.mark.shown_on(
    transport="Zenoh",
    by="dora-rs",
    kinds=("published", "taken", "service", "action"),
    but=("~/raw/device", "imu/data_raw"),
)
def test_dora_rs_over_zenoh(session, judgment, tmp_path):
    pytest.importorskip("dora", reason="dora-rs is not installed: pip install dora-rs pyarrow")
    write_packages(tmp_path)
    config = tmp_path / "zenoh.json5"
    config.write_text(
        f'{{mode: "peer", connect: {{endpoints: ["{session.endpoint}"]}}, '
        "listen: {endpoints: []}, scouting: {multicast: {enabled: false}}}"
    )
    command = [sys.executable, "-m", "tests.sweep.dora_judge", str(config)]
    env = {**os.environ, "AMENT_PREFIX_PATH": str(tmp_path)}
    check(judgment, reported(session, command, judgment, env=env))


@pytest.mark.shown_on(
    transport="rosbridge",
    by="roslibpy",
    kinds=("published", "taken", "service", "action"),
    but=("~/raw/device", "imu/data_raw"),
)
def test_roslibpy_over_rosbridge(session, judgment, running):
    pytest.importorskip("roslibpy", reason="roslibpy is not installed: pip install cardan[test]")
    command = [sys.executable, "-m", "tests.sweep.roslibpy_judge", str(running.port)]
    check(judgment, reported(session, command, judgment))


@pytest.mark.shown_on(
    transport="rosbridge",
    by="roslib 1.4.1",
    kinds=("published", "taken", "service"),
    but=("~/raw/device", "imu/data_raw"),
)
def test_roslib_1_over_rosbridge(session, judgment, running):
    command, folder = [*ROSLIB, str(running.port), RESULT], installed("roslib", "1.4.1")
    check(judgment, reported(session, command, judgment, cwd=folder))


@pytest.mark.shown_on(
    transport="rosbridge",
    by="roslib 2.1.0",
    kinds=("published", "taken", "service", "action"),
    but=("~/raw/device", "imu/data_raw"),
)
def test_roslib_2_over_rosbridge(session, judgment, running):
    command, folder = [*ROSLIB, str(running.port), RESULT], installed("roslib", "2.1.0")
    check(judgment, reported(session, command, judgment, cwd=folder))


# Over DDS dora-rs omits the one byte of an empty message, and Cyclone DDS drops the rest. dora-rs
# reads replies of services from the wrong byte.
@pytest.mark.shown_on(
    transport="DDS",
    by="dora-rs",
    kinds=("published", "taken"),
    but=(
        "~/raw/device",
        "imu/data_raw",
        "~/command/stop",
        "~/command/acknowledge",
        "~/command/acquire",
        "~/command/release",
    ),
)
def test_dora_rs_over_dds(session, judgment, domain, tmp_path):
    pytest.importorskip("dora", reason="dora-rs is not installed: pip install dora-rs pyarrow")
    write_packages(tmp_path)
    env = {**os.environ, "AMENT_PREFIX_PATH": str(tmp_path), "ROS_DOMAIN_ID": str(domain)}
    command = [sys.executable, "-m", "tests.sweep.dora_judge"]
    check(judgment, reported(session, command, judgment, env=env))


@pytest.mark.shown_on(
    transport="DDS",
    by="Fast DDS",
    kinds=("published", "taken"),
    but=("~/raw/device", "imu/data_raw"),
)
@pytest.mark.parametrize("discovery", ["whitelist", "unicast"])
def test_fast_dds(session, judgment, domain, discovery):
    with FastNode(domain, discovery) as node:
        check(judgment, met(session, judgment, node))


def met(session, asked, node):
    """Return the report of a node over Fast DDS."""
    reported_result = "cardan_msgs/msg/CommandResult"
    for name, type_name in {**dict(asked.hear), RESULT: reported_result}.items():
        node.subscribe(name, type_name, latched=name.endswith(LATCHED))

    def results():
        heard = node.found("sample", topic=RESULT)[len(known) :]
        known.extend(heard)
        return [codec_of(reported_result).decode(bytes.fromhex(each["cdr"])) for each in heard]

    known, commands = [], {}
    for each in asked.commands:
        topic, type_name, message, _verb, _tag = each
        node.advertise(topic, type_name)
        node.wait("matched", topic=f"rt{topic}", kind="writer")
        commands[topic] = command(
            each,
            lambda topic=topic, name=type_name, message=message: node.publish(topic, name, message),
            results,
            time.monotonic() + TIMEOUT_S,
        )
    session.moving.set()
    try:
        for name, type_name in asked.hear:
            node.heard(name, type_name)
    finally:
        session.moving.clear()
    return {"heard": dict.fromkeys(dict(asked.hear), True), "commands": commands}
