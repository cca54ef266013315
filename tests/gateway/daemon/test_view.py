"""Table of `cardan daemon ps` and `cardan daemon top`."""

import io

import pytest
from rich.cells import cell_len
from rich.console import Console

from cardan.gateway.daemon.view import frame, table, why, width_of

SESSION = {
    "name": "gofa", "kind": "session", "state": "running", "reason": "", "since_s": 12.3,
    "restarts": 0, "pid": 4711, "cpu": 0.095, "device": "spacemouse", "robot": "abb_egm",
    "phase": "moving", "device_link": "live", "robot_link": "live", "device_held": True,
    "authority": "device", "authority_s": 3.0, "why": "", "trips": 0, "cycles": 3000,
    "tick_p99_s": 0.0001, "changes_wait": [],
}  # fmt: skip
SERVER = {
    "name": "rosbridge", "kind": "server", "state": "running", "reason": "", "since_s": 7300.0,
    "restarts": 0, "pid": 4712, "cpu": None, "server": "rosbridge", "endpoint": "ws://127.0.0.1:9090",
}  # fmt: skip
UNPLUGGED = SESSION | {
    "name": "gp8", "phase": "disarmed", "authority": "", "device_link": "lost",
    "why": "unplugged, or it cannot be read",
}  # fmt: skip


def lines(*rows, width=80):
    return table(rows, width).plain.splitlines()


def test_what_moves_has_a_line_and_what_does_not_says_why_below_it():
    heading, gofa, gp8, reason = lines(SESSION, UNPLUGGED)
    assert heading.split() == [
        "name",
        "state",
        "for",
        "arm",
        "moved",
        "by",
        "device",
        "robot",
        "cpu",
    ]
    assert gofa.split() == [
        "gofa",
        "running",
        "12",
        "s",
        "moving",
        "device",
        "spacemouse",
        "abb_egm",
        "9.5%",
    ]
    assert "spacemouse (lost)" in gp8
    assert reason.strip() == "↳ unplugged, or it cannot be read"


def test_a_device_on_another_computer_has_the_figures_of_its_way():
    metrics = {"delay_s": 0.045, "jitter_s": 0.04, "loss": 0.012, "age_s": 0.081, "late": 0}
    remote = SESSION | {"device": "remote", "device_metrics": metrics}
    assert lines(remote, width=120)[2].strip() == (
        "↳ device: delay 45 ms, jitter 40 ms, loss 1.2%, age at the arm 81 ms"
    )
    unknown = remote | {"device_metrics": metrics | {"delay_s": None}}
    for other in (unknown, SESSION | {"device_metrics": {"age_s": 0.01}}):
        assert len(lines(other)) == 2


def test_a_session_that_loads_its_arms_model_is_starting():
    assert "starting" in lines(SESSION | {"phase": ""})[1]
    assert "starting" not in lines(SESSION | {"phase": "", "state": "waiting"})[1]


def test_sessions_come_first_and_all_by_their_names():
    names = ("ur5-10", "ur5-9", "gofa", "9", "a9b10", "a9b9")
    rows = [SERVER, *(SESSION | {"name": name} for name in names)]
    found = [line.split()[0] for line in lines(*rows)[1:]]
    assert found == ["9", "a9b9", "a9b10", "gofa", "ur5-9", "ur5-10", "rosbridge", "↳"]


@pytest.mark.parametrize("width", [60, 80, 100])
def test_it_fits_the_terminal_whatever_the_names_are(width):
    long = SESSION | {
        "name": "a-session-with-a-rather-long-name", "device": "ros2_spacenav",
        "device_link": "needs neutral", "phase": "recovering", "authority": "verbs",
        "why": "stopped before: " + 20 * "many words ",
    }  # fmt: skip
    found = lines(SESSION, long, SERVER, width=width)
    assert max(map(cell_len, found)) <= width
    assert " ".join(each.split("↳ ")[-1].strip() for each in found[2:-3]) == why(long).strip()
    assert "recovering" in found[1]
    assert found[1].endswith("9.5%") or width < 80


def test_a_program_that_reads_it_gets_all_of_it():
    console = Console(file=io.StringIO(), width=20)
    assert width_of(console) is None
    console.print(table([UNPLUGGED | {"why": 50 * "word "}], None), soft_wrap=True)
    text = console.file.getvalue()
    assert 50 * "word " in text.replace("\n", " ")
    assert "\x1b" not in text


def test_why():
    assert why(SESSION) == ""
    assert why(SESSION | {"state": "waiting", "reason": "busy", "why": "old"}) == "busy"
    changed = why(SESSION | {"changes_wait": ["arm.model", "limits.max_lead_m"]})
    assert changed == "changes wait until no source has its arm: arm.model, limits.max_lead_m"
    assert why(SERVER) == "at ws://127.0.0.1:9090"
    assert why(SERVER | {"state": "failed", "reason": "port taken"}) == "port taken"
    assert why(SESSION | {"why": "a\x1b[2J\nb"}) == why(SESSION | {"why": r"a\x1b[2J\nb"})


def test_the_head_counts_and_names_what_does_not_run():
    waiting = SESSION | {"name": "ur5", "state": "waiting", "reason": "its port is taken"}
    head = frame([SESSION, waiting, SERVER], None).plain.splitlines()[0]
    assert "2 sessions, 1 server; ur5 waiting" in head
    assert "nothing runs" in frame([], 80).plain
