"""Notifications from the daemon to systemd."""

import itertools
import socket

import pytest

from cardan.gateway.daemon.systemd_watchdog import Notifier


@pytest.fixture
def manager(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.bind(str(tmp_path / "n"))
        sock.setblocking(False)
        yield sock


def heard(manager):
    found = []
    while True:
        try:
            found.append(manager.recv(4096).decode())
        except BlockingIOError:
            return found


def environment(manager, **more):
    return {"NOTIFY_SOCKET": manager.getsockname(), **more}


def test_its_life(manager):
    notifier = Notifier(environment(manager))
    notifier.ready()
    notifier.status("2 running,\n1 failed")
    notifier.status("2 running,\n1 failed")
    notifier.reloading()
    notifier.ready()
    notifier.stopping()
    said = heard(manager)
    assert said[:2] == ["READY=1", "STATUS=2 running, 1 failed"]
    assert said[2].startswith("RELOADING=1\nMONOTONIC_USEC=")
    assert said[3:] == ["READY=1", "STOPPING=1"]


def test_the_watchdog_is_fed_within_half_of_its_time(manager):
    notifier = Notifier(environment(manager, WATCHDOG_USEC="10000000", WATCHDOG_PID="7"), pid=7)
    assert notifier.watched
    fed = []
    for tenth in range(300):
        notifier.alive(tenth * 0.1)
        fed += [tenth * 0.1] * len(heard(manager))
    assert fed[0] == 0.0
    gaps = [b - a for a, b in itertools.pairwise(fed)]
    assert 3.0 < min(gaps) <= max(gaps) <= 5.0


@pytest.mark.parametrize(
    "more", [{}, {"WATCHDOG_USEC": "x"}, {"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": "8"}]
)
def test_a_watchdog_of_somebody_else_is_not_fed(manager, more):
    notifier = Notifier(environment(manager, **more), pid=7)
    assert not notifier.watched
    notifier.alive(5.0)
    assert heard(manager) == []


def test_an_abstract_socket():
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("")  # Linux chooses an abstract name.
        manager.setblocking(False)
        name = "@" + manager.getsockname()[1:].decode()
        Notifier({"NOTIFY_SOCKET": name}).ready()
        assert heard(manager) == ["READY=1"]


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": "/nowhere/n"}])
def test_nobody_to_tell_is_no_fault(environment):
    notifier = Notifier(environment)
    notifier.ready()
    notifier.alive(1.0)
