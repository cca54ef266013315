"""Pairing of two computers by a code: the files of each, and the clients that the router then
accepts or refuses."""

import contextlib
import json
import os
import re
import socket
import stat
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

pytest.importorskip("spake2", reason='spake2 is not installed: "cardan[pair]"')
pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')

from zenoh import Reliability

from cardan.bus import pairing
from cardan.bus.node import BusNode
from cardan.bus.options import ROUTER, BusOptions
from cardan.bus.pairing import wait_for_operator
from cardan.common.certificates import read_certificate
from cardan.drivers.remote import Remote
from cardan.errors import AddressError, ConfigurationError, DriverError, OptionError
from cardan.protocols.ros2.zenoh import PUBLISHER, Entity
from tests.programs import Program
from tests.serving import free_endpoint, free_tcp_port
from tests.test_cli import ENVIRONMENT
from tests.waiting import until

HOST = "127.0.0.1"
END_S = 1e9
NOTHING = "pairing did not finish, nothing is stored, still waiting"
CODE = re.compile(r"[2-9A-Z]{4}-[2-9A-Z]{4}")


@pytest.fixture(autouse=True)
def state(tmp_path, monkeypatch):
    """State folder of this user. One computer plays both roles here, in folders of two names."""
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path / "cardan" / "pair"


def pair_with(host, port, replace, code):
    return pairing.pair_with(host, port, replace, lambda: code)


def stored(state):
    """Return the texts of the files in that folder."""
    return {
        str(path.relative_to(state)): path.read_text(encoding="utf-8")
        for path in state.rglob("*")
        if path.is_file()
    }


class Waiting:
    """The robot's side of the pairing, in a thread."""

    def __init__(self, **options):
        self.port = free_tcp_port()
        self.codes, self.reported, self.result = [], [], None
        self._options = {"replace": False, **options}
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        show, tell = self.codes.append, self.reported.append
        try:
            self.result = wait_for_operator(
                (HOST, self.port), show=show, tell=tell, **self._options
            )
        except (AddressError, ConfigurationError) as error:
            self.result = error

    def __enter__(self):
        self._thread.start()
        until(lambda: self.codes or self.result)
        return self

    def __exit__(self, *_exception):
        # A test that did not pair pairs here, to end the thread.
        if self._thread.is_alive() and not self.result:
            with contextlib.suppress(AddressError, ConfigurationError):
                pair_with("localhost", self.port, True, self.codes[-1])
        self._thread.join(30.0)
        assert not self._thread.is_alive()


def wrong(code):
    return code[:-1] + ("A" if code[-1] != "A" else "B")


@pytest.mark.parametrize(
    ("host", "code", "said"),
    [
        ("a b", "ABCD-EFGH", "HOST: 'a b' is not allowed"),
        ("tcp/robot:7447", "ABCD-EFGH", "HOST: .*without a port"),
        ("../robot", "ABCD-EFGH", "HOST: "),
        ("", "ABCD-EFGH", "HOST: "),
        ("my_robot", "ABCD-EFGH", r"HOST: 'my_robot' .*letters, digits, - and \."),
        ("[robot]", "ABCD-EFGH", "HOST: "),
        ("fe80::1%eth0", "ABCD-EFGH", "HOST: "),
        (HOST, "ABCD", "--code: .*the 8 letters and digits"),
        (HOST, "ABCD-EFG0", "--code: "),
    ],
)
def test_what_is_wrong_is_said_before_anybody_is_called(state, host, code, said):
    with pytest.raises(OptionError, match=said):
        pair_with(host, 1, False, code)
    assert not state.exists()


@pytest.mark.parametrize(
    ("host", "meant"),
    [("[::1]", "::1"), ("::1", "::1"), ("Robot.local.", "robot.local"), ("127.0.0.1", "127.0.0.1")],
)
def test_a_host_may_be_written_as_elsewhere(state, monkeypatch, host, meant):
    called = []

    def refused(place, timeout):
        called.append(place)
        raise ConnectionRefusedError("refused")

    monkeypatch.setattr(socket, "create_connection", refused)
    with pytest.raises(AddressError, match=f"no computer waits for pairing at {meant} port 1 "):
        pair_with(host, 1, False, "abcd efgh")
    assert called == [(meant, 1)]


@pytest.mark.parametrize("quic", [False, True])
@pytest.mark.parametrize(
    ("both_families", "host", "served"),
    [
        (True, "robot.local", "[::]"),
        (False, "robot.local", "0.0.0.0"),
        (False, "127.0.0.1", "0.0.0.0"),
        (False, "::1", "[::]"),
    ],
)
def test_the_router_serves_the_families_that_a_name_may_have(
    state, monkeypatch, both_families, host, served, quic
):
    monkeypatch.setattr(socket, "has_dualstack_ipv6", lambda: both_families)
    here, there = socket.socketpair()
    with here, there, ThreadPoolExecutor() as threads:
        robot, operator = (pairing._Channel(each, END_S) for each in (here, there))
        of_robot = threads.submit(pairing._serve, robot, "ABCDEFGH", state / "as-robot")
        client = pairing._join(operator, host, "ABCDEFGH", state / "with", quic=quic)
        router = json.loads(of_robot.result(30.0).read_text(encoding="utf-8"))
    assert router["listen"]["endpoints"] == [
        ROUTER,
        f"quic/{served}:{pairing.TLS_PORT}?mixed_rel=auto",
        f"tls/{served}:{pairing.TLS_PORT}",
    ]
    (far,) = json.loads(client.read_text(encoding="utf-8"))["connect"]["endpoints"]
    at = f"[{host}]" if ":" in host else host
    assert far == (
        f"quic/{at}:{pairing.TLS_PORT}?mixed_rel=1" if quic else f"tls/{at}:{pairing.TLS_PORT}"
    )


def test_where_nobody_waits_it_says_what_to_do(state):
    with pytest.raises(
        AddressError, match=r"no computer waits for pairing at 127.0.0.1 .*start `cardan net pair`"
    ):
        pair_with(HOST, free_tcp_port(), False, "abcd efgh")
    with pytest.raises(AddressError, match=r"no computer waits for pairing at a\.\.b "):
        pair_with("a..b", 1, False, "abcd efgh")
    with pytest.raises(AddressError, match="no computer paired within 0 s: pair again"):
        wait_for_operator((HOST, free_tcp_port()), False, [].append, [].append, 0.0)
    with pytest.raises(AddressError, match=r"cannot listen at 192.0.2.1"):
        wait_for_operator(("192.0.2.1", 1), False, [].append, [].append)
    assert not state.exists()


def test_a_code_that_differs_confirms_nothing(state):
    here, there = socket.socketpair()
    robot, operator = (pairing._Channel(each, END_S) for each in (here, there))
    results = []

    def serve():
        try:
            pairing._serve(robot, "ABCDEFGH", state / "as-robot")
        except pairing._WrongCodeError as error:
            results.append(error)

    thread = threading.Thread(target=serve)
    thread.start()
    with pytest.raises(pairing._WrongCodeError):
        pairing._join(operator, HOST, "ABCDEFGJ", state / "with", quic=False)
    thread.join(30.0)
    here.close()
    there.close()
    assert len(results) == 1
    assert not state.exists()


@pytest.mark.parametrize("line", [b"GET / HTTP/1.1", b"00" * 33, b"41" * 33, b"ff", b"", b"42"])
def test_what_is_no_message_ends_it(line):
    here, there = socket.socketpair()
    with here, there:
        there.sendall(line + b"\n")
        channel = pairing._Channel(here, END_S)
        with pytest.raises(pairing._EndedError, match="no message of a pairing"):
            channel.agree(pairing.SPAKE2_B(b"code"))


def test_what_a_side_has_sent_itself_is_not_taken_for_the_others_answer(state):
    here, there = socket.socketpair()
    with here, there:
        there.sendall(pairing.SPAKE2_B(b"CODE").start().hex().encode() + b"\n")
        operator = pairing._Channel(here, END_S)
        operator.agree(pairing.SPAKE2_A(b"CODE"))
        there.recv(1000)
        operator.send("ready")
        there.sendall(there.recv(1000))
        with pytest.raises(pairing._EndedError, match="'ready' came in place of 'ready too'"):
            operator.receive("ready too")
    assert not state.exists()


def test_an_operator_that_leaves_after_the_last_step_leaves_the_robots_files(state):
    here, there = socket.socketpair()
    with here, there:
        operator = pairing._Channel(there, END_S)

        def leave():
            operator.agree(pairing.SPAKE2_A(b"CODE", b"operator", b"robot"))
            operator.send("ready")
            operator.receive("ready too")
            key, _ = pairing.make_key()
            request = pairing.x509.CertificateSigningRequestBuilder(pairing.x509.Name([]))
            signed = request.sign(key, pairing.hashes.SHA256())
            pem = signed.public_bytes(pairing.serialization.Encoding.PEM).decode()
            operator.send("request", host=HOST, request=pem)
            operator.receive("answer")
            assert not (state / "as-robot").exists()
            operator.send("stored")
            there.close()

        thread = threading.Thread(target=leave)
        thread.start()
        stored_at = pairing._serve(pairing._Channel(here, END_S), "CODE", state / "as-robot")
        thread.join(30.0)
    assert stored_at.exists()
    assert [path.name for path in state.iterdir()] == ["as-robot"]


@pytest.mark.parametrize("host", ["ä.example", ""])
def test_a_request_that_cannot_be_signed_leaves_nothing(state, host):
    here, there = socket.socketpair()
    with here, there:
        operator = pairing._Channel(there, END_S)

        def ask():
            operator.agree(pairing.SPAKE2_A(b"CODE", b"operator", b"robot"))
            operator.send("ready")
            operator.receive("ready too")
            operator.send("request", host=host, request="no PEM")

        thread = threading.Thread(target=ask)
        thread.start()
        with pytest.raises(pairing._EndedError, match="its request cannot be used"):
            pairing._serve(pairing._Channel(here, END_S), "CODE", state / "as-robot")
        thread.join(30.0)
    assert not state.exists()


def test_a_line_without_end_ends_it():
    here, there = socket.socketpair()
    with here, there:
        channel = pairing._Channel(here, END_S)
        thread = threading.Thread(target=there.sendall, args=(b"a" * 70000,))
        thread.start()
        with pytest.raises(pairing._EndedError, match="too long"):
            channel._read()
        here.close()
        thread.join(30.0)


def test_lines_that_come_together_are_read_one_by_one():
    # The operator's "ready" has arrived by then, because the robot's computer was busy.
    here, there = socket.socketpair()
    with here, there:
        there.sendall(b"one\ntwo\nthr")
        channel = pairing._Channel(here, END_S)
        assert [channel._read(), channel._read()] == [b"one", b"two"]
        there.sendall(b"ee\n")
        assert channel._read() == b"three"


def test_what_was_said_in_time_and_read_too_late_ends_it():
    # This side was stopped: the other one waited as long, and stored nothing.
    here, there = socket.socketpair()
    with here, there:
        there.sendall(b"00\n")
        with pytest.raises(pairing._EndedError, match="it took too long"):
            pairing._Channel(here, time.monotonic() - 1.0)._read()


def test_where_nothing_can_be_kept_no_code_is_shown_or_asked_for(tmp_path, monkeypatch):
    (tmp_path / "cardan").write_text("a file", encoding="utf-8")
    never = pytest.fail
    with pytest.raises(ConfigurationError, match=r"HOME: .*cardan cannot be written, where .*as-r"):
        wait_for_operator((HOST, free_tcp_port()), False, never, never, 0.0)
    with pytest.raises(ConfigurationError, match=r"HOME: .*cardan cannot be written, where .*with"):
        pairing.pair_with(HOST, 1, False, lambda: never("it asked for the code"))
    (tmp_path / "cardan").unlink()
    monkeypatch.setattr(os, "access", lambda path, _mode: path != tmp_path)  # root may write all
    with pytest.raises(ConfigurationError, match="cannot be written"):
        wait_for_operator((HOST, free_tcp_port()), False, never, never, 0.0)


@pytest.mark.parametrize(("days", "said"), [(-1, True), (0, False), (300, False), (900, True)])
def test_certificates_that_would_be_refused_by_the_clock_here_are_not_kept(days, said, monkeypatch):
    _, private = pairing.make_key()
    key = pairing.serialization.load_pem_private_key(private, None)
    pem = pairing.make_certificate(
        "operator", key.public_key(), issuer="one", issuer_key=key, days=pairing.VALID_DAYS
    ).decode()
    now_s = time.time() + days * 86400.0
    monkeypatch.setattr(time, "time", lambda: now_s)
    ended = pytest.raises(pairing._EndedError, match=r"the clocks differ: here it is .* set the")
    with ended if said else contextlib.nullcontext():
        pairing._check_clock(pem)


@pytest.mark.matrix
def test_an_operator_whose_clock_is_a_day_behind_keeps_nothing(state, monkeypatch):
    now_s = time.time
    with Waiting() as robot:
        with monkeypatch.context() as patched:
            patched.setattr(time, "time", lambda: now_s() - 86400.0)
            with pytest.raises(AddressError, match="the clocks differ: here it is"):
                pair_with(HOST, robot.port, False, robot.codes[0])
        until(lambda: robot.reported)
        assert stored(state) == {}
        pair_with(HOST, robot.port, False, robot.codes[0])
    assert "as-robot/zenoh.json5" in stored(state)


@pytest.mark.parametrize("words", [("",), ("--code", "ABCD-EFGH")])
def test_an_operator_without_host_does_not_wait_as_the_robot(words):
    with Program("net", "pair", *words) as operator:
        assert operator.process.wait(60.0) == 2
        operator.wait_for("HOST: '' is not allowed", "stderr")


@pytest.mark.matrix
def test_both_have_their_files_and_the_keys_differ(state):
    with Waiting() as robot:
        (code,) = robot.codes
        assert CODE.fullmatch(code)
        client = pair_with(HOST, robot.port, False, code.lower().replace("-", " "))
    assert (client, robot.result) == (
        state / "with-127.0.0.1" / "zenoh.json5",
        state / "as-robot" / "zenoh.json5",
    )
    files = stored(state)
    names = {"authority.pem", "certificate.pem", "key.pem", "zenoh.json5"}
    assert files.keys() == {
        f"{side}/{name}" for side in ("as-robot", "with-127.0.0.1") for name in names
    }
    for path in state.rglob("*"):
        mode = stat.S_IMODE(path.stat().st_mode)
        assert mode == (0o700 if path.is_dir() else 0o600), path
    assert files["as-robot/key.pem"] != files["with-127.0.0.1/key.pem"]
    assert files["as-robot/authority.pem"] == files["with-127.0.0.1/authority.pem"]
    assert read_certificate(files["as-robot/certificate.pem"]).names == (HOST,)
    for side in ("as-robot", "with-127.0.0.1"):
        tls = json.loads(files[f"{side}/zenoh.json5"])["transport"]["link"]["tls"]
        assert tls["enable_mtls"] is True
        paths = [each for each in tls.values() if isinstance(each, str)]
        assert len(paths) == 3
        assert all(os.path.isfile(each) for each in paths)

    # Already paired: without --replace nothing changes, with it every file does.
    with pytest.raises(ConfigurationError, match=r"--replace: paired already, in .*as-robot"):
        wait_for_operator((HOST, free_tcp_port()), False, [].append, [].append)
    with pytest.raises(ConfigurationError, match=r"--replace: paired already, in .*with-127"):
        pairing.pair_with(HOST, 1, False, lambda: pytest.fail("it asked for the code"))
    assert stored(state) == files
    with Waiting(replace=True) as robot:
        pair_with(HOST, robot.port, True, robot.codes[0])
    anew = stored(state)
    assert anew.keys() == files.keys()
    assert all(anew[name] != files[name] for name in files if name.endswith(".pem"))
    assert sorted(path.name for path in state.iterdir()) == ["as-robot", "with-127.0.0.1"]


@pytest.mark.matrix
def test_a_wrong_code_is_refused_three_times_and_then_there_is_another(state):
    with Waiting() as robot:
        for reported in (1, 2, 3):
            with pytest.raises(ConfigurationError, match=r"--code: 127.0.0.1 shows another code"):
                pair_with(HOST, robot.port, False, wrong(robot.codes[0]))
            until(lambda reported=reported: len(robot.reported) == reported)
        assert robot.reported == [f"{NOTHING}: the code was wrong"] * 3
        assert not state.exists()
        until(lambda: len(robot.codes) == 2)
        with pytest.raises(ConfigurationError, match="--code: "):
            pair_with(HOST, robot.port, False, robot.codes[0])
        assert not state.exists()
        pair_with(HOST, robot.port, False, robot.codes[1])
    assert "as-robot/zenoh.json5" in stored(state)


@pytest.mark.matrix
def test_another_client_is_refused_meanwhile_and_one_that_stays_away_is_left(state, monkeypatch):
    with Waiting() as robot:
        with socket.create_connection((HOST, robot.port)) as first:
            assert first.recv(1)  # The robot's side now serves this connection.
            with pytest.raises(AddressError, match="it pairs with another computer"):
                pair_with(HOST, robot.port, False, robot.codes[0])
        until(lambda: robot.reported)
        assert robot.reported[0].startswith(NOTHING)
        assert not state.exists()
        monkeypatch.setattr(pairing, "CLIENT_S", 0.2)
        with socket.create_connection((HOST, robot.port)):
            until(lambda: len(robot.reported) == 2)
        assert robot.reported[1].endswith("it took too long")
        monkeypatch.undo()


def program(home, *words):
    return Program(*words, env=ENVIRONMENT | {"XDG_STATE_HOME": str(home)})


def pair(folder, *more):
    """Pair two programs, the operator's with the options `more`; return the Zenoh files of both."""
    port = str(free_tcp_port())
    with program(folder / "robot", "net", "pair", "--address", HOST, "--port", port) as robot:
        code = robot.wait_for(r"code (\S+); on the operator's computer: cardan net pair ")[1]
        words = ("net", "pair", HOST, "--port", port, "--code", code.decode(), *more)
        with program(folder / "operator", *words) as operator:
            assert operator.process.wait(60.0) == 0, operator.err
            operator.wait_for("cardan devices share spacemouse --zenoh-config ")
        assert robot.process.wait(60.0) == 0, robot.err
        robot.wait_for(
            'cardan net server router --zenoh-config .*\n.*\n  .device.\n  driver = "remote"'
        )
    at = "cardan/pair/{}/zenoh.json5"
    return folder / "robot" / at.format("as-robot"), folder / "operator" / at.format(
        "with-127.0.0.1"
    )


def has_datagrams(config):
    """Return whether data that may be lost has a separate link from a client to its router."""
    with BusNode(BusOptions(zenoh_config=str(config)), "joined") as node:
        links = node._session.info.links()
    assert any(each.reliability == Reliability.RELIABLE for each in links)
    return any(each.reliability == Reliability.BEST_EFFORT for each in links)


def may_be_lost(router):
    """Return the topics whose publishers allow loss."""
    with BusNode(BusOptions(router=router, mode="client"), "looker") as node:
        watch, found = node.watch_tokens(), {}

        def look():
            while (change := watch.poll()) is not None:
                each = Entity.parse(change[0])
                if each is not None and each.kind == PUBLISHER:
                    found[each.name] = each.qos.reliable
            return len(found) >= 2

        until(look)
    return {name for name, reliable in found.items() if not reliable}


@pytest.mark.matrix
def test_the_router_takes_the_paired_operator_and_nobody_else(tmp_path):
    router, client = pair(tmp_path / "one", "--quic")
    _, stranger = pair(tmp_path / "other", "--quic")
    inside, outside = free_endpoint(), free_tcp_port()
    for path in (router, client, stranger):
        text = path.read_text(encoding="utf-8")
        text = re.sub(r"(0\.0\.0\.0|\[::\]):7448", f"{HOST}:7448", text)
        text = text.replace("tcp/127.0.0.1:7447", inside)
        path.write_text(text.replace(":7448", f":{outside}"), encoding="utf-8")
    config = json.loads(client.read_text(encoding="utf-8"))
    for key in ("connect_certificate", "connect_private_key"):
        del config["transport"]["link"]["tls"][key]
    config["transport"]["link"]["tls"]["enable_mtls"] = False
    bare = tmp_path / "bare.json5"
    bare.write_text(json.dumps(config), encoding="utf-8")
    # This client trusts the router, and presents a certificate of another pair's authority.
    text = stranger.read_text(encoding="utf-8")
    forged = tmp_path / "forged.json5"
    own = str(stranger.parent / "authority.pem")
    assert own in text
    forged.write_text(text.replace(own, str(client.parent / "authority.pem")), encoding="utf-8")
    mouse = ("devices", "share", "spacemouse", "--zenoh-config", client, "--name", "mouse")
    with Program("net", "server", "router", "--zenoh-config", router) as served:
        served.wait_for("READY")
        with Program(*mouse) as share:
            share.wait_for("READY /shared/mouse/state")
            with Remote(router=inside, device="mouse", wait_for_device=True):
                until(lambda: b"used by cardan_device_driver" in share.said["stderr"])
                assert may_be_lost(inside) == {"/shared/mouse/state", "/shared/mouse/claim"}
            # An explicit release, since an expired lease would come 1 s later and be logged.
            until(lambda: b"not in use" in share.said["stderr"])
            assert b"leases that were not renewed" not in share.said["stderr"]
        assert has_datagrams(client)
        # The same on a network that blocks UDP.
        text = client.read_text(encoding="utf-8")
        by_tls = tmp_path / "tls.json5"
        assert text.count(f"quic/{HOST}:{outside}?mixed_rel=1") == 1
        text = text.replace(f"quic/{HOST}:{outside}?mixed_rel=1", f"tls/{HOST}:{outside}")
        by_tls.write_text(text, encoding="utf-8")
        assert not has_datagrams(by_tls)
        for refused in (bare, stranger, forged):
            with pytest.raises(DriverError):
                BusNode(BusOptions(zenoh_config=str(refused)), "stranger").open()
        with BusNode(BusOptions(zenoh_config=str(client)), "operator") as node:
            until(lambda: node.neighbors()[0])
