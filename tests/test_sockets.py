"""Unix sockets at paths: owners, access control, and trusted peers."""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import threading

import pytest

from cardan.common import sockets
from cardan.common.sockets import (
    EVERYBODY,
    Advice,
    UnixSocket,
    UntrustedServerError,
    absence,
    connected,
)
from cardan.errors import AddressError


@pytest.fixture
def path(tmp_path):
    return str(tmp_path / "device")


@pytest.fixture(params=[0o000, 0o022, 0o077, 0o777], ids=oct)
def umask(request):
    before = os.umask(request.param)
    yield
    os.umask(before)


def taken(path, *arguments, **keywords):
    return UnixSocket(path, socket.SOCK_SEQPACKET, *arguments, **keywords)


def mode(path):
    return stat.S_IMODE(os.stat(path).st_mode)


class TestPath:
    def test_is_taken_and_removed(self, path):
        first = taken(path)
        assert os.path.exists(path)
        first.close()
        first.close()
        assert not os.path.exists(path)

    def test_a_socket_left_behind_is_replaced(self, path):
        taken(path).sock.close()
        taken(path).close()
        assert not os.path.exists(path)

    def test_another_programs_is_refused_and_left_alone(self, path):
        served = taken(path)
        served.sock.listen()
        with pytest.raises(AddressError) as error:
            taken(path, advice=Advice(served="go away"))
        assert str(error.value) == f"another program serves {path!r} (it answers); go away"
        connected(path, socket.SOCK_SEQPACKET, 1.0).close()
        served.close()

    def test_another_kind_is_refused_and_left_alone(self, path, tmp_path):
        (tmp_path / "device").write_text("mine")
        with pytest.raises(AddressError) as error:
            taken(path)
        assert str(error.value) == f"{path!r} exists and is not a socket; give another path"
        assert (tmp_path / "device").read_text() == "mine"
        with pytest.raises(AddressError, match="socket; give another directory"):
            taken(path, advice=Advice(no_socket="give another directory"))

    @pytest.mark.parametrize("name", ["no/such/device", "d" * 150])
    def test_one_that_cannot_be_made_is_refused(self, tmp_path, name):
        with pytest.raises(AddressError, match="give a short path in a directory"):
            taken(str(tmp_path / name))

    def test_a_directory_that_is_missing_is_named(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        with pytest.raises(AddressError, match=f"there is no directory {tmp_path}/no/such; give"):
            taken("no/such/device")

    def test_only_what_is_still_ours_is_removed(self, path):
        first = taken(path)
        os.unlink(path)
        second = taken(path)
        first.close()
        assert os.path.exists(path)
        second.close()
        assert not os.path.exists(path)

    def test_is_removed_from_another_directory_too(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        made = taken("device")
        monkeypatch.chdir("/")
        made.close()
        assert not (tmp_path / "device").exists()


class TestAccess:
    @pytest.mark.usefixtures("umask")
    def test_a_socket_is_its_owners_whatever_the_umask(self, path):
        made = taken(path)
        assert mode(path) == 0o600
        made.close()

    @pytest.mark.usefixtures("umask")
    def test_a_socket_is_everybodys_when_asked(self, path):
        made = taken(path, EVERYBODY)
        assert mode(path) == 0o666
        made.close()

    def test_it_is_never_more_open_than_that(self, path, monkeypatch):
        before = os.umask(0)
        seen = []
        monkeypatch.setattr(sockets.os, "chmod", lambda path, _mode: seen.append(mode(path)))
        taken(path).close()
        os.umask(before)
        assert seen == [0o600]


class TestTrust:
    """Users 7 and 8 are others; the tests run as a different user, or as root."""

    @pytest.fixture
    def served(self, path):
        made = taken(path)
        made.sock.listen()
        yield made
        made.close()

    @pytest.mark.usefixtures("served")
    @pytest.mark.parametrize("user", [None, 0, os.geteuid()])
    def test_own_programs_and_the_superusers_are_believed(self, path, user, monkeypatch):
        monkeypatch.setattr(sockets, "user_of", lambda _: user)
        connected(path, socket.SOCK_SEQPACKET, 1.0).close()

    @pytest.mark.usefixtures("served")
    def test_another_users_is_refused(self, path, monkeypatch):
        monkeypatch.setattr(sockets, "user_of", lambda _: 7)
        monkeypatch.setattr(sockets.os, "geteuid", lambda: 8)
        with pytest.raises(UntrustedServerError, match="user 7 serves it, who is neither you"):
            connected(path, socket.SOCK_SEQPACKET, 1.0)

    @pytest.mark.usefixtures("served")
    def test_the_owner_of_the_directory_is_believed(self, path, monkeypatch, tmp_path):
        monkeypatch.setattr(sockets, "user_of", lambda _: tmp_path.stat().st_uid)
        monkeypatch.setattr(sockets.os, "geteuid", lambda: 8)
        connected(path, socket.SOCK_SEQPACKET, 1.0).close()

    def test_the_kernel_tells_who_it_is(self, served, path):
        with connected(path, socket.SOCK_SEQPACKET, 1.0) as peer:
            assert sockets.user_of(peer) == os.geteuid()


def test_what_is_missing_is_named_in_full(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert absence("no.sock") == f"there is no socket at {tmp_path}/no.sock"
    assert absence("no/such.sock") == (
        f"there is no socket at {tmp_path}/no/such.sock, and no directory {tmp_path}/no"
    )
    (tmp_path / "there").touch()
    assert absence("there") == ""


def test_a_queue_that_is_full_is_waited_for(tmp_path):
    path = str(tmp_path / "sock")
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(socket.socket(socket.AF_UNIX))
        server.bind(path)
        server.listen(0)
        waiting = stack.enter_context(connected(path, socket.SOCK_STREAM, 5.0))
        with pytest.raises(TimeoutError, match="too many connections wait there"):
            connected(path, socket.SOCK_STREAM, 0.05)
        timer = threading.Timer(0.05, lambda: stack.enter_context(server.accept()[0]))
        timer.start()
        connected(path, socket.SOCK_STREAM, 20.0).close()
        timer.join()
        assert waiting.fileno() >= 0
