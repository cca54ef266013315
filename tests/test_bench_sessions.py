"""Benchmark of many sessions: simulated robots, search for the limit, and place in the docs."""

import contextlib
import socket
import tempfile
import threading
from pathlib import Path

import pytest

from bench import pages, sessions
from bench.sessions.crowd import Crowd, Played, compiler, template
from bench.sessions.lab import Row
from cardan.protocols.connexion.reports import decode_input
from cardan.protocols.egm.decode import decode_robot
from cardan.protocols.egm.reader import FeedbackReader
from cardan.protocols.egm.replies import encode_joint_reply
from cardan.robots import load_arm

pytestmark = pytest.mark.matrix

PLAYED = Played(1000, 0, 0, 900, 0, 0.5e-3, 1e-3, 1e-5, 1e-4)


def row(count, missed=0, cost=0.1):
    return Row(count, (cost,) * count, 0.02, 0.03, 0.0, 45.0, 60.0, PLAYED._replace(missed=missed))


def searched(largest, turns=99):
    """Return the numbers of sessions measured by the search if more than `largest` are too many."""
    measured = []

    def measure(count):
        measured.append(count)
        return row(count, missed=0 if count <= largest else 2)

    def in_time():
        return len(measured) < len(sessions.COUNTS) + turns

    return measured, sessions.search(measure, sessions.COUNTS, in_time)


@pytest.mark.parametrize("largest", range(1, 32))
def test_the_largest_number_is_found(largest):
    measured, rows = searched(largest)
    assert [each.sessions for each in rows] == sorted(measured)
    assert f"missed: **{largest}**." in sessions.table(rows, "")
    assert len(measured) <= len(sessions.COUNTS) + 3


def test_what_is_not_known_is_not_said():
    _, rows = searched(13, turns=1)
    assert "missed: **12 to 15**." in sessions.table(rows, "")
    _, rows = searched(99)
    assert "missed: **at least 32, more were not tried**." in sessions.table(rows, "")
    _, rows = searched(0)
    assert "missed: **0**." in sessions.table(rows, "")


def test_the_aims_are_said():
    rows = [row(1, cost=0.03), row(32, cost=0.05)]
    assert sessions.further_mb(rows) == pytest.approx(45.0)
    assert (
        "Aims: 4.5% of a processor for a session: met; 32 sessions: met; "
        "30 MB for a further session: missed, 45 MB." in sessions.table(rows, "")
    )
    shared = rows[1]._replace(memory_mb=25.0, daemon_mb=70.0)
    assert sessions.further_mb([rows[0], shared]) == pytest.approx((25 * 32 + 70 - 45 - 60) / 31)
    words = sessions.verdicts([row(1, cost=0.05), row(24, cost=0.05), row(32, missed=9)])
    assert words[:2] == ["4.5% of a processor for a session: missed", "32 sessions: missed"]
    assert sessions.further_mb(rows[:1]) is None
    assert "32 sessions: not tried" in sessions.verdicts(rows[:1])


def test_the_costs_are_compared_up_to_the_largest_number():
    rows = [row(1, cost=0.09), row(4, cost=0.11), row(8, missed=9, cost=0.5)]
    assert "costs 10.0% of a processor, ±10% (aim: ±15%, met)" in sessions.table(rows, "")
    rows = [row(1, cost=0.08), row(4, cost=0.12)]
    assert "±20% (aim: ±15%, missed)" in sessions.table(rows, "")


def test_it_has_its_place_in_the_page():
    page = sessions.PAGE.read_text(encoding="utf-8")
    assert "measured" in pages.replaced(page, sessions.PART, "measured")


def test_the_template_is_a_robot_at_its_home():
    data, (sequence, clock, measured, planned, *clocks) = template()
    robot = decode_robot(data)
    home = load_arm("gofa_crb15000_5").home
    assert robot.feed_back.joints == pytest.approx(home)
    assert robot.planned.joints == pytest.approx(home)
    assert data[sequence - 1] == 0x08
    assert data[clock - 1] == 0x10
    assert data[measured - 1] == data[planned - 1] == 0x09
    for each in clocks:
        assert data[each - 1] == 0x08
        assert data[each + 5] == 0x10


def test_sessions_read_it_the_short_way():
    # Like a controller's message: joints, pose and clock. Without one of them the full decoder
    # runs.
    reader = FeedbackReader()
    data, (*_, clock, _) = template()
    first = reader.read(data)
    reader.learn()
    assert reader._unlearned is None
    a_second_before = data[: clock + 8] + b"\0" + data[clock + 9 :]
    assert reader.read(a_second_before).time_us < first.time_us
    assert reader._unlearned is None


@pytest.mark.skipif(compiler() is None, reason="no C compiler")
def test_robots_are_played_and_their_answers_counted():
    with tempfile.TemporaryDirectory(prefix="cardan-test-") as folder, contextlib.ExitStack() as up:
        kinds = (socket.AF_INET, socket.SOCK_DGRAM)
        obeyed, mute = (up.enter_context(socket.socket(*kinds)) for _ in range(2))
        for sock in (obeyed, mute):
            sock.bind(("127.0.0.1", 0))
        seen, stop = [], threading.Event()

        def answer():
            obeyed.settimeout(0.1)
            while not stop.is_set():
                with contextlib.suppress(TimeoutError):
                    data, peer = obeyed.recvfrom(2048)
                    robot = decode_robot(data)
                    seen.append(robot)
                    joints = [each + 1e-4 for each in robot.feed_back.joints]
                    still = robot.header.seqno % 4 == 0
                    joints = robot.feed_back.joints if still else joints
                    obeyed.sendto(encode_joint_reply(7, robot.header.tm_ms, joints, None), peer)

        thread = threading.Thread(target=answer)
        thread.start()
        up.callback(thread.join)
        up.callback(stop.set)
        ports = [sock.getsockname()[1] for sock in (obeyed, mute)]
        crowd = up.enter_context(Crowd(Path(folder), ports, "-Werror"))
        mouse = up.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
        mouse.connect(str(Crowd.mouse(Path(folder), 0)))
        begun = []
        played = crowd.play(2, 0.5, 1.0, lambda: begun.append(True))
        reports = []
        mouse.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                reports.append(decode_input(mouse.recv(64)))
    assert begun == [True]
    assert played.sent + played.skipped == pytest.approx(500, abs=2)
    # The silent one gives no answers; three of four answers of the other one move.
    assert played.worst == pytest.approx(250, abs=played.skipped + 2)
    answered = played.sent - played.missed
    assert answered > 0
    assert played.moved == pytest.approx(0.75 * answered, abs=0.1 * answered)
    assert 0.0 < played.p50_s <= played.p99_s
    numbers = [robot.header.seqno for robot in seen]
    assert numbers == list(range(1, len(numbers) + 1))
    assert [robot.header.tm_ms for robot in seen] == [1_000_000 + 4 * each for each in numbers]
    last = seen[-1]
    assert len(last.feed_back.joints) == 6
    assert last.feed_back.joints[0] > seen[0].feed_back.joints[0]
    assert len({str(each) for each in reports}) > 10
