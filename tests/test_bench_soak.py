"""Soak test: each of its rules is broken once in virtual time, and a short run is made."""

import json
import math
import os
import random
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from bench.soak import faults, motion_scripts, page, rules, soak, watch
from bench.soak.peers import steps_of
from bench.soak.report import RULES, Report, Sample, markdown
from bench.soak.rules import (
    AT_REST_S,
    RECOVERED_S,
    REPORT_S,
    ArmRules,
    RecoveryRule,
    SessionReport,
    drifts,
    problem_of,
    quantile_s,
)
from bench.soak.sampling import left_behind, marked_processes, use_of
from cardan.sim_peers.base import ScriptStep
from cardan.sim_peers.evdev.motion_script import SCRIPT_VERBS as PAD_VERBS
from cardan.sim_peers.spacemouse.motion_script import SCRIPT_VERBS as PUCK_VERBS
from cardan_wiimote.peer.motion_script import SCRIPT_VERBS as REMOTE_VERBS
from tests.test_cli import ENVIRONMENT

pytestmark = pytest.mark.matrix

STEP_S = 0.1
FAST = 0.1
"""rad/s"""


class Bench:
    """Simulated arm under the rules; each step measures and reports."""

    def __init__(self):
        self.broken = []
        self.arm = ArmRules("arm", frozenset({"device", "verbs"}), self.broken.append)
        self.now_s = 1000.0
        self.pid = 1
        self.authority, self.phase = "", "disarmed"

    def lasts(self, seconds, speed=0.0, tells=True):
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            self.arm.measured(self.now_s, speed)
            if tells:
                self.arm.on_report(SessionReport(self.now_s, self.pid, self.authority, self.phase))

    def is_moved_by(self, source):
        self.authority, self.phase = source, "moving"
        self.arm.asks(source, self.now_s)

    def is_left(self, source):
        self.arm.lets_go(source, self.now_s)
        self.authority, self.phase = "", "disarmed"

    @property
    def rules(self):
        return [each.rule for each in self.broken]


@pytest.fixture
def bench():
    bench = Bench()
    bench.lasts(1.0)
    return bench


def test_a_motion_that_was_asked_for_is_fine(bench):
    bench.is_moved_by("device")
    bench.lasts(10.0, FAST)
    bench.is_left("device")
    bench.phase = "braking"
    bench.lasts(AT_REST_S - 0.5, FAST)
    bench.phase = "disarmed"
    bench.lasts(10.0)
    assert bench.rules == []
    assert bench.arm.moves == 1
    assert bench.arm.moving_s == pytest.approx(10.0 + AT_REST_S - 0.5, abs=0.2)


def test_an_arm_that_goes_on_after_the_last_one_asked_breaks_a_rule_once(bench):
    bench.is_moved_by("device")
    bench.lasts(2.0, FAST)
    bench.arm.lets_go("device", bench.now_s)
    bench.lasts(AT_REST_S - 0.2, FAST)
    assert bench.rules == []
    bench.lasts(5.0, FAST)
    assert bench.rules == ["moves unasked"]
    bench.lasts(1.0)
    bench.lasts(1.0, FAST)
    assert bench.rules == ["moves unasked"] * 2


def test_two_who_ask_are_both_waited_for(bench):
    bench.is_moved_by("device")
    bench.arm.asks("verbs", bench.now_s)
    bench.lasts(1.0, FAST)
    bench.arm.lets_go("device", bench.now_s)
    bench.lasts(2 * AT_REST_S, FAST)
    assert bench.rules == []
    bench.arm.void(bench.now_s)
    bench.lasts(2 * AT_REST_S, FAST)
    assert bench.rules == ["moves unasked"]


def test_a_motion_without_authority_breaks_a_rule(bench):
    bench.arm.asks("device", bench.now_s)
    bench.lasts(REPORT_S - 0.2, FAST)
    assert bench.rules == []  # late reports of the session are allowed
    bench.lasts(REPORT_S, FAST)
    assert bench.rules == ["moves without authority"]


def test_braking_needs_no_authority(bench):
    bench.arm.asks("device", bench.now_s)
    bench.phase = "braking"
    bench.lasts(5.0, FAST)
    assert bench.rules == []


def test_a_session_that_tells_nothing_is_not_judged_by_what_it_reported(bench):
    bench.is_moved_by("device")
    bench.authority = ""
    bench.lasts(5.0, FAST, tells=False)
    assert bench.rules == []


def test_a_session_that_comes_back_armed_breaks_a_rule(bench):
    bench.is_moved_by("device")
    bench.lasts(1.0, FAST)
    bench.arm.void(bench.now_s)
    bench.pid, bench.phase = 2, "holding"
    bench.lasts(0.5)
    assert bench.rules == ["armed by itself"]


def test_a_session_that_comes_back_may_be_armed_by_a_new_act(bench):
    bench.is_moved_by("device")
    bench.arm.void(bench.now_s)
    bench.pid = 2
    bench.authority, bench.phase = "", "disarmed"
    bench.lasts(1.0)
    bench.is_moved_by("device")
    bench.lasts(1.0, FAST)
    assert bench.rules == []


def test_an_unknown_source_breaks_a_rule(bench):
    bench.is_moved_by("mallory")
    bench.lasts(0.5, FAST)
    assert bench.rules == ["unknown source"]


def test_two_sources_that_move_it_break_a_rule(bench):
    bench.arm.accepted("alice", bench.now_s)
    bench.arm.over("alice")
    bench.arm.accepted("bob", bench.now_s)
    assert bench.rules == []
    bench.arm.accepted("alice", bench.now_s)
    assert bench.rules == ["two sources"]


def test_a_robot_that_is_another_process_is_where_it_is(bench):
    bench.is_moved_by("device")
    bench.lasts(0.5, FAST)
    bench.arm.void(bench.now_s)
    bench.now_s += 20.0
    bench.arm.begins(bench.now_s)
    bench.lasts(1.0)
    assert bench.rules == []
    assert bench.arm.moving_s < 1.0


def test_a_robot_that_was_stopped_may_end_its_motion(bench):
    bench.is_moved_by("device")
    bench.lasts(0.5, FAST)
    bench.arm.void(bench.now_s)
    bench.now_s += 5.0
    bench.arm.resumes(bench.now_s)
    bench.phase = "braking"
    bench.lasts(AT_REST_S - 0.5, FAST)
    assert bench.rules == []
    bench.lasts(1.0, FAST)
    assert bench.rules == ["moves unasked"]


# -- recovery -------------------------------------------------------------------------------------


def test_what_does_not_recover_breaks_a_rule_once():
    broken = []
    recovery = RecoveryRule(broken.append)
    for second in range(int(RECOVERED_S) + 20):
        recovery.seen("arm", "robot lost", False, float(second))
    assert [each.rule for each in broken] == ["does not recover"]
    recovery.seen("arm", "", False, 1000.0)
    assert recovery.took_s == [("arm", 1000.0)]


def test_what_cannot_be_well_is_excused_until_it_can():
    broken = []
    recovery = RecoveryRule(broken.append)
    for second in range(300):
        recovery.seen("arm", "robot lost", True, float(second))
    recovery.seen("arm", "robot lost", False, 299.0 + RECOVERED_S)
    assert broken == []
    recovery.seen("arm", "robot lost", False, 300.5 + RECOVERED_S)
    assert len(broken) == 1


SESSION = {
    "kind": "session", "state": "running", "reason": "", "phase": "disarmed", "why": "",
    "robot_link": "live", "device_link": "live", "device_held": True,
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({}, ""),
        ({"state": "waiting", "reason": "it died"}, "waiting: it died"),
        ({"robot_link": "lost"}, "robot lost"),
        ({"robot_link": ""}, "robot not heard of"),
        ({"phase": "no robot", "why": "braked"}, "the robot is not ready: braked"),
        ({"device_link": "lost"}, "device lost"),
        ({"device_link": "closed", "device_held": False}, ""),
    ],
)
def test_what_is_wrong_with_a_session(change, problem):
    assert problem_of(SESSION | change, True) == problem


def test_a_device_that_is_away_is_no_problem_of_its_session():
    assert problem_of(SESSION | {"device_link": "lost"}, False) == ""


def test_a_server_has_to_serve():
    row = {"kind": "server", "state": "running", "reason": "", "endpoint": ""}
    assert problem_of(row, True) == "it does not serve"
    assert problem_of(row | {"endpoint": "ws://127.0.0.1:1"}, True) == ""


# -- drift ----------------------------------------------------------------------------------------


def grown(**by):
    """Return samples over an hour, with figures that grow linearly by this amount from 100."""
    return [
        (10.0 * n, {name: 100.0 + more * n / 360 for name, more in by.items()}) for n in range(361)
    ]


@pytest.mark.parametrize(
    ("figure", "more", "exceeded"),
    [("rss_mb", 5.0, False), ("rss_mb", 15.0, True), ("fds", 0.0, False), ("fds", 10.0, True),
     ("threads", 5.0, True), ("p99_ms", 20.0, False), ("p99_ms", 300.0, True)],
)  # fmt: skip
def test_what_grows_by_more_than_its_limit_is_found(figure, more, exceeded):
    (found,) = drifts("arm", 7, grown(**{figure: more}))
    assert (found.figure, found.pid, found.exceeded) == (figure, 7, exceeded)
    assert found.lived_s == pytest.approx(3600.0)


def test_a_short_life_is_not_judged():
    assert drifts("arm", 7, grown(rss_mb=100.0)[:30]) == []
    assert drifts("arm", 7, []) == []


def test_what_a_process_takes_to_begin_is_no_drift():
    samples = [(t, {"rss_mb": min(100.0, 20.0 + t)}) for t, _ in grown(rss_mb=0.0)]
    assert not drifts("arm", 7, samples)[0].exceeded


def test_quantiles_between_two_histograms():
    bounds_s = (1e-3, 2e-3, 4e-3)
    before, now = [100, 100, 100], [150, 190, 200]
    assert quantile_s(before, now, 100, bounds_s, 0.5) == pytest.approx(1e-3)
    assert quantile_s(before, now, 100, bounds_s, 0.7) == pytest.approx(1.5e-3)
    assert quantile_s(before, now, 100, bounds_s, 0.99) == pytest.approx(3.8e-3)
    assert quantile_s(before, now, 300, bounds_s, 0.99) == 4e-3
    assert math.isnan(quantile_s(before, before, 0, bounds_s, 0.5))


# -- devices --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("device", "verbs"), [("mouse", PUCK_VERBS), ("pad", PAD_VERBS), ("remote", REMOTE_VERBS)]
)
def test_motion_scripts_begin_and_end_at_rest(device, verbs):
    rng = random.Random(1)
    for _ in range(50):
        episode = motion_scripts.episode(device, rng)
        steps = [
            ScriptStep(float(time_s), verb, tuple(map(str, words)))
            for time_s, verb, *words in episode.script
        ]
        assert {step.verb for step in steps} <= set(verbs)
        assert [step.time_s for step in steps] == sorted(step.time_s for step in steps)
        pressed = [step for step in steps if step.verb == "press"]
        assert all(step.time_s >= episode.begins_s for step in pressed)
        down = set()
        for step in steps:
            if step.verb == "press":
                down.add(step.args)
            elif step.verb == "release":
                down.discard(step.args)
        assert not down
        assert steps[-1].time_s > episode.ends_s > episode.begins_s
    assert {motion_scripts.UNPLUG[device], motion_scripts.PLUG[device]} <= set(verbs)


def test_a_device_that_was_stopped_is_not_behind_its_hand():
    script = {"at_s": 1000.0, "steps": [[0.5, "press", "left"], [3.0, "release", "left"]]}
    in_time = [ScriptStep(20.5, "press", ("left",)), ScriptStep(23.0, "release", ("left",))]
    assert steps_of(script, 20.0, 1000.0) == in_time
    assert steps_of(script, 25.0, 1005.0) == in_time


# -- leftovers ------------------------------------------------------------------------------------


def test_what_is_left_is_found(tmp_path):
    for name in ("tmp", "run"):
        (tmp_path / name).mkdir()
    mark = f"CARDAN_SOAK_TEST={os.getpid()}"
    assert left_behind(tmp_path, mark, set(), 0.0) == []
    (tmp_path / "tmp" / "record.mcap").write_text("")
    memory = tmp_path / "1.zenoh"
    memory.write_text("")
    name, _, value = mark.partition("=")
    sleeper = subprocess.Popen(["sleep", "60"], env={**os.environ, name: value})
    with socket.socket(socket.AF_UNIX) as listening, sleeper:
        listening.bind(str(tmp_path / "left.sock"))
        try:
            found = left_behind(tmp_path, mark, {str(memory), "/nowhere"}, 0.0)
        finally:
            sleeper.kill()
    assert found == [
        f"process {sleeper.pid}: sleep 60", "socket left.sock", "file tmp/record.mcap",
        f"shared memory {memory}",
    ]  # fmt: skip
    assert marked_processes(mark) == {}


def test_what_a_process_takes():
    use = use_of(os.getpid())
    assert use.rss_mb > 5.0
    assert use.fds >= 3
    assert use.threads >= 1
    assert use.cpu_s > 0.0
    assert use_of(2**22 + 1) is None


# -- the report -----------------------------------------------------------------------------------


@pytest.fixture
def reported(tmp_path):
    report = Report(tmp_path, 5, 1.0)
    report.begin()
    begin_s = 1000.0
    for n in range(361):
        report.sample(Sample(begin_s + 10.0 * n, "arm", 7, 100.0 + n, 10, 5, 0.1, 0.4, math.nan, 0))
        report.load(3.0)
    report.did("fault", "kill_robot", "arm", "for 2 s")
    report.did("client", "jog", "arm", "refused: movv: 'device' has authority over the arm")
    report.count("device", "mouse: episode")
    report.answered(0.02, False)
    report.answered(9.0, True)
    report.violation(rules.Violation(begin_s, "moves unasked", "arm", "at 1 rad/s"))
    report.over = True
    report.write({"arm": (3, 12.0)}, [("arm", 2.0), ("arm", 4.0)])
    report.close()
    return tmp_path


def test_the_report_has_what_was_seen(reported):
    table = json.loads((reported / "report.json").read_text())
    assert table["violations"] == {"moves unasked": 1}
    assert table["acts"] == {"client jog": 1, "fault kill_robot": 1, "device mouse: episode": 1}
    assert table["outcomes"] == {"jog": {"refused": 1}}
    assert table["answer_max_ms"] == 20.0
    assert [(e["figure"], e["exceeded"]) for e in table["drift"]] == [
        ("rss_mb", True), ("fds", False), ("threads", False),
    ]  # fmt: skip
    text = (reported / "report.md").read_text()
    assert f"| {RULES['moves unasked']} | 1 |" in text
    assert "from the first quarter of its life to the last | 1 |" in text
    assert "**" in next(line for line in text.splitlines() if line.startswith("| arm, 60 min"))
    assert len((reported / "samples.csv").read_text().splitlines()) == 362
    assert json.loads((reported / "violations.jsonl").read_text())["rule"] == "moves unasked"


def test_every_rule_is_in_the_report():
    source = "".join(Path(each.__file__).read_text() for each in (rules, watch, faults, soak))
    for rule in RULES:
        assert f'"{rule}"' in source


def test_the_page_gets_the_reports_tables(reported, tmp_path):
    target = tmp_path / "soak.md"
    target.write_text("# Soak\n\n<!-- soak -->\n\nold\n\n<!-- end -->\n\nafter\n")
    page.rewrite_page(reported, target)
    text = target.read_text()
    assert "old" not in text
    assert text.endswith("after\n")
    table = json.loads((reported / "report.json").read_text())
    assert markdown(table, page.violations_of(reported)).splitlines()[2] in text


# -- complete runs --------------------------------------------------------------------------------


def test_a_short_run_ends_in_good_order_when_it_is_interrupted(tmp_path_factory):
    pytest.importorskip("zenoh", reason="cardan[network]")
    pytest.importorskip("prometheus_client", reason="cardan[metrics]")
    folder = Path(tmp_path_factory.mktemp("s"))
    environment = {**ENVIRONMENT, "CARDAN_SOAK_OUTER": str(os.getpid())}
    process = subprocess.Popen(
        [sys.executable, "-m", "bench", "soak", "--hours", "0.003", "--seed", "3",
         "--output", str(folder)],
        cwd=Path(__file__).parents[1], env=environment,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    with process:
        try:
            said, complaints = process.communicate(timeout=180.0)
        finally:
            process.send_signal(signal.SIGINT)
    assert process.returncode == 0, said + complaints
    table = json.loads((folder / "report.json").read_text())
    assert table["over"]
    assert table["violations"] == {}
    assert table["answers"] > 0
    assert sum(moves for moves, _ in table["moves"].values()) > 0
    assert marked_processes(f"CARDAN_SOAK_OUTER={os.getpid()}") == {}
