"""Access control of the daemon's socket, and robustness against authorized clients."""

import contextlib
import errno
import grp
import json
import os
import selectors
import shutil
import socket
import stat
import subprocess
import tempfile
import threading
import time

import pytest

from cardan.errors import AddressError, ConfigurationError
from cardan.gateway.daemon import server
from cardan.gateway.daemon.client import ControlClient
from cardan.gateway.daemon.control import MAX_LINE_BYTES, NEEDS, Response
from cardan.gateway.daemon.daemon import Daemon
from cardan.gateway.daemon.server import (
    MAX_CONNECTIONS,
    MAX_UNREAD_BYTES,
    SHORTAGE_PAUSE_S,
    ControlServer,
)
from cardan.gateway.servers.tokens import Role
from tests.waiting import until

WAIT_S = 10.0
NOBODY = 65534


@contextlib.contextmanager
def serving(path, group="", handle=None, **options):
    def answer(ask, asker):
        asker.tell(Response(ask.id, "result", 1))

    handle = handle or answer
    server = ControlServer(path, group, handle, **options)
    ended = threading.Event()

    def serve():
        while not ended.is_set():
            server.poll(0.05)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield path
    finally:
        ended.set()
        thread.join()
        server.close()


@pytest.fixture
def path(tmp_path):
    with serving(str(tmp_path / "sock")) as path:
        yield path


def opened(path):
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.connect(path)  # A socket without a timeout waits for its place in the queue.
    connection.settimeout(WAIT_S)
    return connection


def is_served(path):
    with opened(path) as connection:
        connection.sendall(b'{"id":1,"do":"version"}\n')
        return connection.recv(1000) == b'{"id":1,"result":1}\n'


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o777])
def test_it_is_its_user_s_alone_whatever_the_umask(tmp_path, umask):
    before = os.umask(umask)
    try:
        with serving(str(tmp_path / "sock")) as path:
            assert stat.S_IMODE(os.stat(path).st_mode) == 0o600
    finally:
        os.umask(before)


def test_a_group_may_be_let_in(tmp_path):
    group = grp.getgrgid(os.getgid())
    with serving(str(tmp_path / "sock"), group.gr_name) as path:
        found = os.stat(path)
        assert (stat.S_IMODE(found.st_mode), found.st_gid) == (0o660, group.gr_gid)
        assert is_served(path)


READS = ("units", "devices", "snapshot", "figures", "version", "watch", "log", "events", "beat")
MOVES = ("start", "stop", "restart", "switch")


def asked(path, do, value=None):
    with opened(path) as connection:
        line = {"id": 1, "do": do, "name": "one", **({} if value is None else {"value": value})}
        connection.sendall(json.dumps(line).encode() + b"\n")
        return json.loads(connection.recv(1000))


@pytest.mark.parametrize("role", Role)
def test_roles_of_those_who_come_in_by_the_group(tmp_path, monkeypatch, role):
    monkeypatch.setattr(server, "user_of", lambda sock: 12_345)
    group = grp.getgrgid(os.getgid()).gr_name
    with serving(str(tmp_path / "sock"), group, group_role=role) as path:
        for do in READS:
            assert asked(path, do)["result"] == 1
        for do in MOVES:
            assert ("result" in asked(path, do)) is (role >= Role.OPERATOR)
        assert ("result" in asked(path, "reload")) is (role is Role.ADMIN)
        for verb in ("stat", "status", "get_parameter", "get_parameters", "stop"):
            assert asked(path, "ask", {"verb": verb})["result"] == 1
        for verb in ("movl", "wait", "inv", "act", 3, None):
            refused = asked(path, "ask", {"verb": verb})
            assert ("result" in refused) is (role >= Role.OPERATOR)
        if role is Role.VIEWER:
            assert (
                "movl takes the role operator, and you have viewer"
                in (asked(path, "ask", {"verb": "movl"})["error"])
            )


def test_every_request_takes_a_role():
    daemon = {name.removeprefix("_do_") for name in vars(Daemon) if name.startswith("_do_")}
    assert daemon == NEEDS.keys() == {*READS, *MOVES, "ask", "reload"}


@pytest.mark.parametrize("user", [0, os.geteuid()])
def test_its_own_user_and_the_superuser_are_admins(tmp_path, monkeypatch, user):
    monkeypatch.setattr(server, "user_of", lambda sock: user)
    with serving(str(tmp_path / "sock"), group_role=Role.VIEWER) as path:
        assert asked(path, "reload")["result"] == 1


@pytest.mark.skipif(os.geteuid() != 0, reason="only the superuser can be somebody else")
def test_another_user_has_the_role_that_the_group_has(tmp_path):
    python = shutil.which("python3", path="/usr/bin")
    if python is None:
        pytest.skip("no Python that all users can run")
    code = (
        "import socket, sys; s = socket.socket(socket.AF_UNIX); s.connect(sys.argv[1]);"
        's.sendall(b\'{"id":1,"do":"reload"}\\n{"id":2,"do":"units"}\\n\');'
        "f = s.makefile(); print(f.readline(), f.readline())"
    )
    name = grp.getgrgid(NOBODY).gr_name
    with tempfile.TemporaryDirectory(prefix="cardan-test-") as folder:
        os.chmod(folder, 0o755)
        with serving(f"{folder}/sock", name, group_role=Role.OPERATOR) as path:
            done = subprocess.run(
                [python, "-c", code, path], user=NOBODY, group=NOBODY, extra_groups=(),
                capture_output=True, text=True, timeout=WAIT_S, check=True,
            )  # fmt: skip
            assert "reload takes the role admin, and you have operator" in done.stdout
            assert '"result":1' in done.stdout
            other = subprocess.run(
                [python, "-c", code, path], user=NOBODY, group=NOBODY - 1, extra_groups=(),
                capture_output=True, text=True, timeout=WAIT_S, check=False,
            )  # fmt: skip
            assert "PermissionError" in other.stderr


@pytest.mark.parametrize(("mode", "warned"), [(0o700, True), (0o711, False), (0o710, True)])
def test_a_folder_that_the_group_cannot_enter_is_warned_of(tmp_path, caplog, mode, warned):
    number = os.getgid()
    folder = tmp_path / "folder"
    folder.mkdir()
    folder.chmod(mode)
    monkey = grp.getgrgid(number).gr_name
    if mode == 0o710:
        warned = folder.stat().st_gid != number
    with serving(str(folder / "sock"), monkey):
        pass
    assert ("cannot enter" in caplog.text) is warned


def test_a_group_that_there_is_not(tmp_path):
    with pytest.raises(ConfigurationError, match=r"daemon.group: there is no group 'nobody-here'"):
        ControlServer(str(tmp_path / "sock"), "nobody-here", lambda ask, asker: None)
    assert not (tmp_path / "sock").exists()


def test_a_group_of_others(tmp_path, monkeypatch):
    def refused(*_given):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "chown", refused)
    name = grp.getgrgid(os.getgid()).gr_name
    with pytest.raises(AddressError, match="are you a member"):
        ControlServer(str(tmp_path / "sock"), name, lambda ask, asker: None)


@pytest.mark.parametrize("data", [b"\0\xff\n", b"[]\n", b"[" * 70_000 + b"\n", b'{"id":1}\n'])
def test_garbage_is_answered_and_harms_nobody(path, data):
    with opened(path) as connection:
        connection.sendall(data)
        assert b'"error"' in connection.recv(65536)
    assert is_served(path)


def test_a_line_without_an_end_is_hung_up_on(path):
    with opened(path) as connection:
        with contextlib.suppress(ConnectionError):
            connection.sendall(b"x" * (MAX_LINE_BYTES + 70_000))
        received = b""
        with contextlib.suppress(ConnectionError):
            while more := connection.recv(65536):
                received += more
        assert received.count(b"\n") <= 1
    assert is_served(path)


def test_there_are_only_so_many_connections(path):
    with contextlib.ExitStack() as stack:
        for _ in range(MAX_CONNECTIONS):
            stack.enter_context(opened(path))
        more = stack.enter_context(opened(path))
        assert b"programs are connected to the daemon already" in more.recv(1000)
        assert more.recv(1000) == b""


def test_a_long_answer_reaches_who_reads(tmp_path):
    long = "x" * (3 * MAX_UNREAD_BYTES)

    def handle(ask, asker):
        asker.tell(Response(ask.id, "event", long), Response(ask.id, "result", long))

    with serving(str(tmp_path / "sock"), handle=handle) as path, ControlClient(path) as client:
        assert client.ask("log") == long


def test_who_asks_much_at_once_keeps_nobody_waiting(tmp_path):
    answered = []

    def handle(ask, asker):
        answered.append(ask.name)
        time.sleep(0.002)
        asker.tell(Response(ask.id, "result", 1))

    with contextlib.ExitStack() as stack:
        path = stack.enter_context(serving(str(tmp_path / "sock"), handle=handle))
        greedy = stack.enter_context(opened(path))
        client = stack.enter_context(ControlClient(path))
        greedy.sendall(b'{"id":1,"do":"figures","name":"greedy"}\n' * 1000)
        until(lambda: answered, "the first answer")
        client.ask("version", "modest")
        assert answered.index("modest") < 500


def test_who_does_not_read_is_let_go(path):
    asked = b'{"id":1,"do":"version"}\n'
    with opened(path) as connection, pytest.raises(ConnectionError):  # noqa: PT012
        for _ in range(10_000):
            connection.sendall(asked * 100)
    assert is_served(path)


def test_a_shortage_of_files_costs_no_processor(tmp_path, monkeypatch):
    server = ControlServer(str(tmp_path / "sock"), "", lambda *_: None)
    now_s = [100.0]
    monkeypatch.setattr("cardan.gateway.daemon.server.time.monotonic", lambda: now_s[0])
    listener, short = server._socket.sock, [True]

    class Listener:
        """A socket whose accept() runs out of file descriptors."""

        accepted = 0

        def __getattr__(self, name):
            return getattr(listener, name)

        def accept(self):
            Listener.accepted += 1
            if short[0]:
                raise OSError(errno.EMFILE, "too many open files")
            return listener.accept()

    fake = Listener()
    monkeypatch.setattr(server._socket, "sock", fake)
    server._selector.unregister(listener)
    server._selector.register(fake, selectors.EVENT_READ)
    with contextlib.closing(opened(server.path)) as connection:
        for _ in range(20):
            server.poll(0.0)
        assert fake.accepted == 1
        now_s[0] += SHORTAGE_PAUSE_S
        server.poll(0.0)
        assert fake.accepted == 2
        short[0] = False
        now_s[0] += SHORTAGE_PAUSE_S
        server.poll(0.0)
        assert len(server._connections) == 1
        assert connection.fileno() >= 0
        assert len(server._connections) == 1
    server.close()
