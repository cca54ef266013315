"""Ports in use and their owners, from /proc/net."""

import socket
import sys

import pytest
from hypothesis import given, strategies as st

from cardan.doctor.base import Subject
from cardan.doctor.files import read_files
from cardan.doctor.ports import (
    Bound,
    Ports,
    Wanted,
    bound_sockets,
    check_ports,
    collide,
    numeric,
    read_bound,
    wanted_ports,
)
from cardan.doctor.processes import Holder
from tests.doctor.levels_and_codes import levels_and_codes

LITTLE = sys.byteorder == "little"
UDP = """  sl  local_address rem_address   st tx_queue tr tm->when retrnsmt   uid  timeout inode
  10: 0100007F:196E 00000000:0000 07 0:0 00:0 00000000  1000        0 4711 2 0 0
 bad line
  11: 00000000:xyz 00000000:0000 07
"""
TCP6 = """  sl  local_address remote_address st
   0: 00000000000000000000000000000000:2382 00:0 0A 0:0 00:0 0 1000 0 51 1 0 100
   1: 0000000000000000FFFF00000100007F:2383 00:0 0A 0:0 00:0 0 1000 0 52 1 0 100
   2: 00000000000000000000000001000000:2384 00:0 01 0:0 00:0 0 1000 0 53 1 0 100
"""


@pytest.mark.skipif(not LITTLE, reason="the table is one of a computer of the other byte order")
def test_the_kernels_tables():
    assert list(read_bound(UDP, "udp")) == [Bound("udp", "127.0.0.1", 6510, 4711)]
    assert list(read_bound(TCP6, "tcp")) == [
        Bound("tcp", "::", 9090, 51),
        Bound("tcp", "127.0.0.1", 9091, 52),
    ]


@given(st.text(alphabet="0123456789abcdefABCDEF:; \n", max_size=300))
def test_no_table_raises(text):
    list(read_bound(text, "tcp"))


@pytest.mark.parametrize(
    ("one", "other", "collides"),
    [
        ("127.0.0.1", "127.0.0.1", True),
        ("127.0.0.1", "127.0.0.2", False),
        ("0.0.0.0", "127.0.0.1", True),
        ("127.0.0.1", "::", True),
        ("0.0.0.0", "::1", False),
        ("::1", "127.0.0.1", False),
    ],
)
def test_addresses_that_exclude_each_other(one, other, collides):
    assert collide(one, other) is collide(other, one) is collides


EGM = Wanted("udp", "127.0.0.1", 6510, "robot of gofa")
TAKEN = Bound("udp", "0.0.0.0", 6510, 4711)


@pytest.mark.parametrize(
    ("bound", "held", "level", "mend"),
    [
        ([], {}, "good", ""),
        ([TAKEN._replace(transport="tcp")], {}, "good", ""),
        ([TAKEN._replace(address="10.0.0.1")], {}, "good", ""),
        ([TAKEN], {4711: Holder(7, "RobotStudio", False)}, "failure", "kill 7"),
        ([TAKEN], {4711: Holder(7, "cardan daemon run", True)}, "good", ""),
        ([TAKEN], {}, "failure", "sudo ss -lntup 'sport = :6510' names it; then sudo kill its pid"),
    ],
)
def test_a_port(bound, held, level, mend):
    found = list(check_ports([EGM], bound, held))
    assert levels_and_codes(Ports, found) == [(level, "port")]
    assert found[0].mend == mend


def test_one_port_for_two():
    other = EGM._replace(who="robot of other")
    found = list(check_ports([EGM, other, EGM._replace(port=0)], [], {}))
    assert levels_and_codes(Ports, found) == [("good", "port"), ("failure", "port-twice")]


LAB = """
[[sessions]]
name = "gofa"
robot = { driver = "abb_egm", listen_port = PORT }
[servers.view]
server = "rosbridge"
port = 9191
[servers.rosbridge]
[servers.router]
"""


def test_which_ports_files_want(tmp_path):
    file = tmp_path / "lab.toml"
    file.write_text(LAB.replace("PORT", "6511"))
    config, wrong = read_files([file])
    assert not wrong
    assert list(wanted_ports(Subject((file,), config))) == [
        Wanted("udp", "127.0.0.1", 6511, "robot of gofa"),
        Wanted("tcp", "127.0.0.1", 9191, "server view"),
        Wanted("tcp", "127.0.0.1", 9090, "server rosbridge"),
    ]


@pytest.mark.matrix
def test_a_socket_of_this_process_is_seen(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        port = sock.getsockname()[1]
        assert ("udp", "127.0.0.1", port) in {each[:3] for each in bound_sockets(Subject())}
        file = tmp_path / "lab.toml"
        file.write_text(LAB.replace("PORT", str(port)))
        config, _ = read_files([file])
        found = list(Ports.look(Subject((file,), config)))
    assert levels_and_codes(Ports, found)[0] == ("failure", "port")


def test_names_of_hosts():
    assert numeric("127.0.0.1") == "127.0.0.1"
    assert numeric("no host of this name") == ""
