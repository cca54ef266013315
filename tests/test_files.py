"""Files that a user names: readable ones, and others refused at once in one line."""

from __future__ import annotations

import os
import socket
import stat

import pytest

from cardan.common.files import TEXT_BYTES, cache_folder, create_file, read_text, state_folder
from cardan.common.tables import read_toml
from cardan.errors import CaptureError, ConfigurationError, ScriptError
from cardan.gateway.kinematics.soft_neck import load_soft_neck
from cardan.gateway.session.assembly import load_config
from cardan.robots import load_arm
from cardan.sim_peers.base import load_script
from cardan_dissect.capture import Capture

THINGS = ["a pipe", "a device", "a directory", "a socket"]


@pytest.fixture(params=THINGS)
def no_file(request, tmp_path):
    """Return a path that is no regular file, and its kind."""
    path = tmp_path / "thing.toml"
    with socket.socket(socket.AF_UNIX) as sock:
        if request.param == "a pipe":
            os.mkfifo(path)
        elif request.param == "a device":
            path.symlink_to("/dev/zero")
        elif request.param == "a directory":
            path.mkdir()
        else:
            sock.bind(str(path))
        yield path, request.param


READERS = {
    "configuration": (load_config, ConfigurationError),
    "arm": (lambda path: load_arm(str(path)), ConfigurationError),
    "soft neck": (lambda path: load_soft_neck(str(path)), ConfigurationError),
    "script": (lambda path: load_script(str(path), {}, {}), ScriptError),
    "capture": (lambda path: list(Capture(path)), CaptureError),
}


PAIRS = [
    (reader, what)
    for reader in READERS
    for what in THINGS
    # Captures may also be pipes: test_dissect_captures_of_users.py of cardan-dissect.
    if (reader, what) != ("capture", "a pipe")
]


@pytest.mark.parametrize(("reader", "no_file"), PAIRS, indirect=["no_file"])
def test_what_is_no_file_is_refused_at_once(reader, no_file):
    path, what = no_file
    read, error = READERS[reader]
    with pytest.raises(error) as caught:
        read(path)
    assert f"it is {what}, and must be a file" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_arms_urdf_too(tmp_path):
    os.mkfifo(tmp_path / "arm.urdf")
    with pytest.raises(ConfigurationError, match="it is a pipe"):
        load_arm(str(tmp_path / "arm.urdf"))


@pytest.mark.parametrize("reader", ["configuration", "arm", "script"])
def test_a_huge_file_is_refused_unread(reader, tmp_path):
    path = tmp_path / "huge.toml"
    with path.open("wb") as file:
        file.truncate(2**40)
    read, error = READERS[reader]
    with pytest.raises(error, match="it is longer than 1 MiB"):
        read(path)


def test_the_longest_text_is_read(tmp_path):
    path = tmp_path / "text"
    path.write_bytes(b"#" * TEXT_BYTES)
    assert len(read_text(path)) == TEXT_BYTES


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"], ids=["plain", "byte-order mark"])
@pytest.mark.parametrize("end", [b"\n", b"\r\n"], ids=["lf", "crlf"])
def test_a_byte_order_mark_and_any_line_ends_are_read(tmp_path, mark, end):
    path = tmp_path / "own.toml"
    path.write_bytes(mark + b"a = 1" + end + b"b = '''x" + end + b"y'''" + end)
    assert read_toml(path) == {"a": 1, "b": "x\ny"}


def test_another_encoding_is_named(tmp_path):
    path = tmp_path / "own.toml"
    path.write_bytes("a = 1".encode("utf-16"))
    with pytest.raises(ConfigurationError, match="it is UTF-16; save it as UTF-8"):
        read_toml(path)


@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077])
def test_only_its_owner_may_change_a_record(tmp_path, umask):
    before = os.umask(umask)
    try:
        create_file(tmp_path / "record.csv").close()
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "record.csv").stat().st_mode) == 0o644 & ~umask


def test_a_record_replaces_an_old_one_and_keeps_line_ends(tmp_path):
    (tmp_path / "record.csv").write_text("much longer than the new one")
    with create_file(tmp_path / "record.csv") as file:
        file.write("a\r\n")
    assert (tmp_path / "record.csv").read_bytes() == b"a\r\n"


def test_a_record_into_a_pipe_that_nobody_reads_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "record.csv")
    with pytest.raises(OSError, match="nobody reads this pipe"):
        create_file(tmp_path / "record.csv")


def test_a_record_into_a_pipe_is_written(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    with create_file(tmp_path / "pipe") as file:
        file.write("row")
    assert os.read(reader, 10) == b"row"
    os.close(reader)


@pytest.mark.parametrize(("folder", "name"), [(state_folder, "STATE"), (cache_folder, "CACHE")])
def test_the_state_and_cache_of_a_user_without_a_home(monkeypatch, folder, name):
    for each in ("HOME", f"XDG_{name}_HOME", f"{name}_DIRECTORY"):
        monkeypatch.delenv(each, raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    with pytest.raises(ConfigurationError, match="HOME: this user has no home folder: set HOME"):
        folder()
    monkeypatch.setenv(f"XDG_{name}_HOME", "relative")
    with pytest.raises(ConfigurationError, match="no home folder"):
        folder()
    monkeypatch.setenv(f"XDG_{name}_HOME", "/var/tmp/own")
    assert str(folder()) == "/var/tmp/own/cardan"
    monkeypatch.setenv(f"{name}_DIRECTORY", "/var/service")
    assert str(folder()) == "/var/service"
