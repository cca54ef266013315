"""Network benchmark: its place in the docs, and its tables of the measurements."""

import pytest

pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
pytest.importorskip("websockets", reason='websockets is not installed: "cardan[network]"')

from bench import network, pages
from bench.network import clients, publication, session
from studies.cartesian import command
from studies.cartesian.controller import START
from studies.cartesian.sessions import Robot

pytestmark = pytest.mark.matrix


def test_each_part_has_its_place_in_the_page():
    page = network.PAGE.read_text(encoding="utf-8")
    for name in network.PARTS:
        page = pages.replaced(page, f"network {name}", "measured")
    assert page.count("\n\nmeasured\n\n") == len(network.PARTS)


def test_a_publication_is_an_instant_by_the_number_of_its_messages():
    rows = {
        (kind, name): [seconds] * 3
        for kind, seconds in ((publication.ALONE, 100e-6), (publication.HEARD, 300e-6))
        for name in ("publish", "poll", "publish_cycle")
    }
    table = publication.table([publication.Cost(50.0, 10.0, rows, "real time")])
    assert "| 50 Hz | no subscribers | 10 | 100 / 100 µs | 10.0 µs | met: 0.40 of it |" in table
    assert "300 / 300 µs | 30.0 µs | missed: 1.20 of it |" in table


def test_sessions_are_compared_with_the_one_without_the_network():
    found = {
        session.WITHOUT: session.Answers([[1e-4] * 100] * 2, 0),
        "near": session.Answers([[1.05e-4] * 100] * 2, 0),
        "far": session.Answers([[1e-4] * 90 + [2e-4] * 10] * 2, 3),
    }
    table = session.table(found)
    assert "p99 with near at most 1.1 times without: met" in table
    assert "p99 with far at most 1.1 times without: missed" in table
    assert "| far | 100 µs | 200 µs | 1.00 | 2.00 | 200 to 200 µs | 3 |" in table


def test_what_obeys_in_which_datagram_is_counted():
    found = {
        "Zenoh": command.Delays([6e-3] * 4, [2, 2, 2, 2], 0),
        "rosbridge": command.Delays([9e-3] * 4, [2, 2, 2, 3], 1),
    }
    table = command.table(found)
    assert "| rosbridge | 9.00 ms | 9.00 ms | 1.50 | 1.50 | 0%, 75%, 25% | 1 of 5 |" in table


class Still(Robot):
    """Robot whose session answers with a sequence of joint positions."""

    def __init__(self, *joints):
        self._joints = list(joints)
        self.place = self._at(joints[0])

    @staticmethod
    def _at(joint):
        return START._replace(joints=(joint,) * 6)

    def ask(self):
        self.place = self._at(self._joints.pop(0))
        return 0.0


def test_the_first_datagram_with_other_joints_obeys():
    robot = Still(0.0, 0.0, 0.0, 0.1, 0.2)
    trial = command.Trial(robot)
    sent = []
    trial.put = sent.append
    for _ in range(command.ROUND):
        trial.publish()
    assert [x for x in sent if x] == [pytest.approx(-command.SPEED_M_S)]
    for _ in range(4):
        trial.ask()
    assert trial.datagrams == [4]
    assert len(trial.delays_s) == 1
    assert trial.obeys
    for _ in range(command.PULSE):
        trial.publish()
    assert len([x for x in sent if x]) == command.PULSE


def test_of_clients_cpu_and_what_the_session_notices():
    load = clients.Load(50, True, 0.2, 1.0, [2e-3], [1e-4] * 9, [1.5e-4] * 9, 1_500_000)
    table = clients.table([load])
    assert "| 50, and one that reads 1 kB/s | 45000 | 20.0% | 0.40% | 100.0% |" in table
    assert "| 100 / 150 µs | 1.50 | +1.5 MB |" in table
