"""A device at one computer and an arm at the other, as whole programs in two network namespaces:
faults between them stop the arm in time, and no motion occurs without a request."""

import contextlib
import json
import math
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import pytest

from bench import remote
from bench.link import Conditions
from bench.two_computers import (
    ADDRESSES,
    OPERATOR,
    OTHER_ADDRESSES,
    ROBOT,
    NoNamespacesError,
    two_computers,
)
from cardan.bus import pairing
from cardan.bus.node import zenoh_settings
from cardan.drivers.remote.shared import CLAIM_PERIOD_S
from tests.certificates import pair
from tests.programs import Program
from tests.waiting import WITHIN_S

pytestmark = [pytest.mark.matrix, pytest.mark.timeout(600)]

PAGE = Path(__file__).parents[1] / "docs/faults.md"

LAN = next(network for network in remote.NETWORKS if network.name == "LAN")
LTE = next(network for network in remote.NETWORKS if network.name == "LTE")

STEP_S, RUN_UP_S, TRIES = 0.02, 0.3, 10
BRAKING_S = 0.1
OTHER_WORK_S = 0.5
"""Allowance for other load of the computer, like in tests/process_faults."""
REST_M_S = 0.01
"""Speed at rest, as a mean over AVERAGED_S."""
AVERAGED_S = 0.1
STILL_M = 0.005
"""Distance that counts as rest. The bench's robot obeys at once: if a busy computer answers a cycle
late, it oscillates by up to 3 mm about its rest position. At its speed the arm moves this far in
0.05 s."""
AGAIN_M = 0.01
FLOOD = """
import socket, time
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
end_s = time.monotonic() + 2.0
while time.monotonic() < end_s:
    for _ in range(13):
        s.sendto(bytes(1200), ("{to}", 9))
    time.sleep(1 / 30)
"""
"""Pictures of 16 kB, 30 per second: 3.8 Mbit/s, without congestion control."""


@contextlib.contextmanager
def apart(network, way=remote.TCP):
    with contextlib.ExitStack() as stack:
        try:
            yield stack.enter_context(remote.remote_lab(network, way))
        except NoNamespacesError as error:
            pytest.skip(str(error))


def watched(two, seconds):
    """Return the arm's position at intervals of STEP_S."""
    path, end_s = [], time.monotonic() + seconds
    while (now_s := time.monotonic()) < end_s:
        path.append((now_s, two.robot.place.cartesian[0]))
        two.cell.play(now_s + STEP_S)
    return path


def set_moving(two, network):
    """Wait until the arm has moved for a while."""
    two.cell.make_ready(two.robot, network.longest_s)
    for _ in range(TRIES):
        begun = two.robot.place.cartesian[0]
        for what in ({"axis": False}, {"buttons": False}, {"buttons": True}, {"axis": True}):
            two.cell.act(two.robot, **what)
            two.cell.wait(RUN_UP_S + network.longest_s)
        gone_m = math.dist(begun, two.robot.place.cartesian[0])
        if time.monotonic() - two.robot.moved_s < 2 * STEP_S and gone_m >= AGAIN_M:
            return
    raise AssertionError("the arm does not go on moving")


def rest(path):
    """Return the time of rest and the position there; inf: it did not rest."""
    behind = round(AVERAGED_S / STEP_S)
    fast = [
        at
        for at in range(behind, len(path))
        if math.dist(path[at][1], path[at - behind][1])
        > REST_M_S * (path[at][0] - path[at - behind][0])
    ]
    if not fast:
        return path[0]
    if fast[-1] == len(path) - 1:
        return math.inf, path[-1][1]
    # The mean looks backwards.
    return path[fast[-1] + 1 - behind // 2]


def assert_goes_on_by_rearming_alone(two, network, place):
    for axis in (False, True):
        two.cell.act(two.robot, axis=axis)
        path = watched(two, 0.3 + network.longest_s)
        assert max(math.dist(place, where) for _, where in path) <= STILL_M
    two.cell.act(two.robot, axis=False)
    set_moving(two, network)
    assert math.dist(place, two.robot.place.cartesian[0]) >= AGAIN_M


def _cut(*ways):
    def act(two, link):
        two.both.set(**dict.fromkeys(ways, link._replace(cut=True)))
        yield 1.5
        two.both.set(**dict.fromkeys(ways, link))

    return act


def _kill_router(two, link):
    two.routers[-1]._process.kill()
    yield 3.0
    two.start_router()


def _change_address(two, link):
    two.both.change_address()
    yield 1.5


def _flood(two, link):
    two.both.set(operator=link._replace(rate_bps=2e6))
    words = [sys.executable, "-c", FLOOD.format(to=ADDRESSES[OPERATOR])]
    flood = subprocess.Popen([*two.both.at(ROBOT), *words])
    yield 2.0
    flood.wait()
    two.both.set(operator=link)


FAULTS = {
    "cut": (_cut(ROBOT, OPERATOR), LAN, 0.0),
    "cut, QUIC": (_cut(ROBOT, OPERATOR), LAN, 0.0),
    "cut, LTE": (_cut(ROBOT, OPERATOR), LTE, 0.0),
    "only the way to the robot is cut": (_cut(ROBOT), LAN, 0.0),
    "only the way to the operator is cut": (_cut(OPERATOR), LAN, 0.0),
    "the router is killed": (_kill_router, LAN, 0.0),
    "the router is killed, TLS": (_kill_router, LAN, 0.0),
    "the router is killed, QUIC": (_kill_router, LAN, 0.0),
    "the operator's address changes": (_change_address, LAN, 0.0),
    "a camera fills a link of 2 Mbit/s, TLS": (_flood, LAN, 0.8),
    "a camera fills a link of 2 Mbit/s, QUIC": (_flood, LAN, 0.8),
    # The flood's program starts, and then fills a queue of 64 kB at 1.8 Mbit/s.
    "a camera fills a link of 2 Mbit/s": (_flood, LAN, 0.8),
}


@pytest.mark.parametrize("name", FAULTS)
def test_the_arm_is_at_rest_in_time_and_goes_on_by_rearming(name):
    act, network, begins_s = FAULTS[name]
    way = next((way for way in (remote.TLS, remote.QUIC) if name.endswith(way)), remote.TCP)
    with apart(network, way) as two:
        set_moving(two, network)
        begun_s = time.monotonic()
        fault = act(two, network.link)
        path = watched(two, next(fault))
        rested_s, place = rest(path)
        link = network.link
        within_s = begins_s + link.delay_s + link.jitter_s + network.max_age_s + BRAKING_S
        if "operator" in name:
            within_s += CLAIM_PERIOD_S
        assert rested_s - begun_s <= within_s + OTHER_WORK_S
        assert next(fault, None) is None
        path = watched(two, 1.0)
        assert max(math.dist(place, where) for _, where in path) <= STILL_M
        assert_goes_on_by_rearming_alone(two, network, place)


HOST = "cell.example"
OTHER_WAYS = """
mount --bind "$0" /etc/hosts
exec "$@"
"""
"""Give a program its own /etc/hosts."""
ROUTER = f"tcp/{{}}:{remote.ROUTER_PORT}"
GONE = "cannot be reached, and nothing moves the arm: start it again, or repair the network"


class Lab(contextlib.ExitStack):
    """Both computers in a LAN, with programs that tests end, stop and restart."""

    def __init__(self, folder):
        super().__init__()
        self.folder = folder
        try:
            self.both = self.enter_context(two_computers(LAN.link, LAN.link))
        except NoNamespacesError as error:
            pytest.skip(str(error))
        mouse = remote.Mouse(str(folder / "mouse"))
        self.callback(mouse.close)
        self.robot = remote.Robot(remote.EGM_PORT, mouse, self.both.datagrams(ROBOT))
        self.callback(self.robot.socket.close)
        self.cell = remote.Cell({remote.REMOTE: self.robot})
        self.hosts = folder / "hosts"
        self.name(ADDRESSES[ROBOT])
        self.operator = folder / "operator.toml"
        self.operator.write_text(
            f'[device]\ndriver = "spacemouse"\ntransport = "socket"\npath = "{folder}/mouse"\n'
        )

    def name(self, address):
        """Let HOST resolve to `address` at the operator's computer."""
        self.hosts.write_text(f"127.0.0.1 localhost\n{address} {HOST}\n")

    def start(self, computer, *words):
        """Start a program at that computer."""
        named = ("unshare", "--mount", "sh", "-ec", OTHER_WAYS, str(self.hosts))
        return self.enter_context(Program(*words, at=(*self.both.at(computer), *named)))

    def start_router(self, *way):
        self.router = self.start(ROBOT, "net", "server", "router", *way)
        self.await_said(self.router, "READY")

    def sharing(self, *way):
        return self.start(OPERATOR, "devices", "share", self.operator, "--name", "mouse", *way)

    def start_share(self, *way):
        self.share = self.sharing(*way)
        self.await_said(self.share, "READY")

    def start_session(self):
        keys = remote.remote(ROUTER.format("127.0.0.1"), "wait_for_device = true\n")
        config = self.folder / "session.toml"
        config.write_text(
            f'[robot]\ndriver = "abb_egm"\nlisten_port = {remote.EGM_PORT}\n\n'
            f'[device]\n{keys}\n[mapping]\ndeadman = "left"\nlinear_speed_m_s = 0.1\n\n'
            f"[watchdogs]\ndevice_age_s = {LAN.max_age_s}\n"
        )
        self.session = self.start(ROBOT, "run", config)

    def end(self, program, signal_number=signal.SIGTERM):
        """End a program while the robot's controller continues; return its exit code."""
        program.process.send_signal(signal_number)
        return self.code_of(program)

    def code_of(self, program):
        self.await_true(lambda: program.process.poll() is not None, "its end")
        return program.end()

    def await_true(self, found, what):
        end_s = time.monotonic() + WITHIN_S
        while not found():
            assert time.monotonic() < end_s, f"{what} did not happen"
            self.cell.wait(STEP_S)

    def await_said(self, program, words, after=0):
        """Wait for words in its output beyond the first `after` characters."""
        self.await_true(lambda: words in (program.out + program.err)[after:], words)


@pytest.fixture(scope="module")
def lan(tmp_path_factory):
    """Lab whose router has no certificates, for faults that leave it unchanged."""
    with Lab(tmp_path_factory.mktemp("lan")) as lab:
        lab.start_router("--endpoint", ROUTER.format("0.0.0.0"))
        lab.start_share("--router", ROUTER.format(ADDRESSES[ROBOT]))
        lab.start_session()
        yield lab


def assert_moves_by_rearming_alone(lab, fault, *, holds=True):
    """Watch the arm during a fault; assert that only re-arming moves it.

    `fault` yields twice: durations of watching, up to the fault's end.
    """
    set_moving(lab, LAN)
    begun_s = time.monotonic()
    path = watched(lab, next(fault))
    rested_s, place = rest(path)
    within_s = LAN.link.delay_s + LAN.max_age_s + BRAKING_S
    assert rested_s - begun_s <= within_s + OTHER_WORK_S
    assert next(fault, None) is None
    path = watched(lab, 1.0)
    assert max(math.dist(place, where) for _, where in path) <= STILL_M
    assert lab.robot.device.buttons is holds
    assert_goes_on_by_rearming_alone(lab, LAN, place)


@pytest.mark.parametrize("stall_s", [0.5, 3.0])
def test_after_a_link_that_stood_still_nothing_is_caught_up(lan, stall_s):
    def stall():
        # A single stall, now: the next one would be at twice the computer's uptime.
        now_s = time.monotonic()
        stalled = LAN.link._replace(stall_s=stall_s, stall_every_s=now_s)
        lan.both.set(robot=stalled, operator=stalled)
        yield stall_s + 0.5
        lan.both.set(robot=LAN.link, operator=LAN.link)

    assert_moves_by_rearming_alone(lan, stall())


@pytest.mark.parametrize("meanwhile", ["held", "let go", "let go and pressed anew"])
def test_a_laptop_that_sleeps_moves_nothing_when_it_wakes(lan, meanwhile):
    def sleep():
        lan.share.process.send_signal(signal.SIGSTOP)
        yield 1.0
        if meanwhile != "held":
            lan.cell.act(lan.robot, buttons=False)
        lan.cell.wait(0.3)
        if meanwhile == "let go and pressed anew":
            lan.cell.act(lan.robot, buttons=True)
        lan.cell.wait(1.7)
        lan.share.process.send_signal(signal.SIGCONT)

    assert_moves_by_rearming_alone(lan, sleep(), holds=meanwhile != "let go")


@pytest.mark.parametrize("then", ["it is back", "it is shared to the new one"])
def test_the_robots_computer_has_another_address(lan, then):
    def change():
        said = len(lan.share.out + lan.share.err)
        lan.both.change_address(ROBOT)
        yield 1.5
        words = f"the router {ROUTER.format(ADDRESSES[ROBOT])} {GONE}"
        lan.await_said(lan.share, words, said)
        if then == "it is back":
            lan.both.change_address(ROBOT, back=True)
            lan.await_said(lan.share, "is there again", said)
        else:
            lan.end(lan.share)
            lan.start_share("--router", ROUTER.format(OTHER_ADDRESSES[ROBOT]))
        lan.await_said(lan.share, "used by", said if then == "it is back" else 0)

    try:
        assert_moves_by_rearming_alone(lan, change())
    finally:
        if then != "it is back":
            lan.both.change_address(ROBOT, back=True)
            lan.end(lan.share)
            lan.start_share("--router", ROUTER.format(ADDRESSES[ROBOT]))


def zenoh_file(folder, mode, endpoints, files):
    """Write Zenoh's configuration for one side of a pair, as `cardan net pair` does."""
    router = mode == "router"
    side, owner = ("listen", "robot") if router else ("connect", "operator")
    settings = zenoh_settings(mode, *((endpoints, ()) if router else ((), endpoints)))
    pems = [files[name].read_bytes() for name in ("authority", owner, f"{owner}-key")]
    with pairing._stored(folder, side, settings, *pems):
        pass
    return folder / pairing.CONFIG


class Pair(NamedTuple):
    """Certificates and keys of a pair, with Zenoh's files of both sides."""

    files: dict[str, Path]
    router: Path
    operator: Path


def paired_files(folder):
    files = pair(folder, names=(HOST,))
    inside, outside = ROUTER.format("127.0.0.1"), f"tls/0.0.0.0:{pairing.TLS_PORT}"
    far = f"tls/{HOST}:{pairing.TLS_PORT}"
    return Pair(
        files,
        zenoh_file(folder / "as-robot", "router", (inside, outside), files),
        zenoh_file(folder / "with", "client", (far,), files),
    )


@pytest.fixture(scope="module")
def pairs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs")
    return {name: paired_files(folder / name) for name in ("ours", "theirs")}


@pytest.fixture(scope="module")
def secured(tmp_path_factory, pairs):
    """Lab of two paired computers."""
    with Lab(tmp_path_factory.mktemp("secured")) as lab:
        lab.start_router("--zenoh-config", pairs["ours"].router)
        lab.start_share("--zenoh-config", pairs["ours"].operator)
        lab.start_session()
        yield lab


def test_an_endpoint_by_name_follows_the_robots_computer_to_its_new_address(secured):
    def change():
        said = len(secured.share.out + secured.share.err)
        secured.both.change_address(ROBOT)
        yield 1.5
        secured.await_said(secured.share, f"the router {GONE}", said)
        secured.name(OTHER_ADDRESSES[ROBOT])
        secured.await_said(secured.share, "is there again", said)
        secured.await_said(secured.share, "used by", said)

    try:
        assert_moves_by_rearming_alone(secured, change())
    finally:
        secured.both.change_address(ROBOT, back=True)
        secured.name(ADDRESSES[ROBOT])


NO_MESSAGE = "no message passes; give the file of the present pair (zenoh_config), or pair both"
LOST = "mouse is not shared any more"
TWICE_SHARED = (
    "mouse is shared already, by the node /cardan_share_mouse: end that, or choose another"
)


def test_the_page_has_what_is_said():
    page = PAGE.read_text(encoding="utf-8")
    for words in (GONE, NO_MESSAGE, LOST, TWICE_SHARED):
        assert f"`{words}" in page


@pytest.fixture(scope="module")
def refused_ways(tmp_path_factory, pairs):
    """Options of shares that the router of the pair "ours" refuses, with the messages."""
    folder = tmp_path_factory.mktemp("refused")
    files = pairs["ours"].files
    expired = {**files, "operator": files["expired"]}
    others = pairs["theirs"].files
    forged = {**others, "authority": files["authority"]}
    far = f"tls/{HOST}:{pairing.TLS_PORT}"
    places = {}
    for name, each in {"expired": expired, "forged": forged}.items():
        places[name] = zenoh_file(folder / name, "client", (far,), each)
    bare = json.loads(pairs["ours"].operator.read_text())
    bare["transport"]["link"]["tls"] = {"root_ca_certificate": str(files["authority"])}
    places["bare"] = folder / "bare.json5"
    places["bare"].write_text(json.dumps(bare))
    by = "--zenoh-config"
    plain = "of a paired computer give its file (zenoh_config) [N008]"
    return {
        "of another pair": ((by, pairs["theirs"].operator), f"is not signed by .*: {NO_MESSAGE}"),
        "forged": ((by, places["forged"]), f"which is of another pair: {NO_MESSAGE}"),
        "expired": ((by, places["expired"]), f"has expired on 20.*: {NO_MESSAGE}"),
        "none": ((by, places["bare"]), f"asks for a certificate, and none is given: {NO_MESSAGE}"),
        "no TLS": (("--router", f"tcp/{HOST}:{pairing.TLS_PORT}"), plain),
        "its own programs' port": (("--router", ROUTER.format(HOST)), plain),
        "a second share": (
            (by, pairs["ours"].operator),
            TWICE_SHARED,
        ),
    }


def said_by(program):
    return " ".join(program.err.split())


def assert_refused(lab, share, words):
    assert lab.code_of(share) == 3
    assert "READY" not in share.out
    assert re.search(".*".join(map(re.escape, words.split(".*"))), said_by(share)), share.err


def test_who_is_refused_moves_nothing_while_the_pair_does(secured, refused_ways):
    set_moving(secured, LAN)
    used = len(secured.session.out)
    tried = [(secured.sharing(*way), words) for way, words in refused_ways.values()]
    for share, words in tried:
        assert_refused(secured, share, words)
    set_moving(secured, LAN)
    assert LOST not in secured.session.out[used:]
    assert secured.share.process.poll() is None


def test_where_none_but_refused_ones_share_the_device_is_lost_and_nothing_moves(
    secured, pairs, refused_ways
):
    def share_by_others():
        said = len(secured.session.out)
        secured.share.process.terminate()
        yield 1.0
        secured.code_of(secured.share)
        secured.await_said(secured.session, LOST, said)
        for name in ("of another pair", "expired"):
            way, words = refused_ways[name]
            assert_refused(secured, secured.sharing(*way), words)
        secured.start_share("--zenoh-config", pairs["ours"].operator)
        secured.await_said(secured.share, "used by")

    assert_moves_by_rearming_alone(secured, share_by_others())


def test_a_share_whose_router_was_paired_anew_says_so_and_goes_on_with_the_right_one(
    secured, pairs
):
    def pair_anew():
        said = len(secured.share.out + secured.share.err)
        secured.router.process.kill()
        yield 1.0
        secured.code_of(secured.router)
        secured.start_router("--zenoh-config", pairs["theirs"].router)
        secured.await_said(secured.share, GONE, said)
        secured.await_said(secured.share, NO_MESSAGE, said)
        secured.end(secured.router)
        secured.start_router("--zenoh-config", pairs["ours"].router)
        secured.await_said(secured.share, "is there again", said)
        secured.await_said(secured.share, "used by", said)

    assert_moves_by_rearming_alone(secured, pair_anew())


TWICE, OVERTAKING = Conditions(0.005, twice=1.0), Conditions(0.03, 0.03, in_order=False)


@pytest.mark.parametrize("link", [TWICE, OVERTAKING], ids=["twice", "overtaking"])
def test_what_comes_twice_or_overtakes_moves_nothing_once_the_hand_lets_go(link):
    network = LTE._replace(link=link)
    with apart(network) as two:
        set_moving(two, network)
        begun_s = two.cell.act(two.robot, buttons=False)
        path = watched(two, 1.5)
        rested_s, place = rest(path)
        assert rested_s - begun_s <= network.longest_s + BRAKING_S + OTHER_WORK_S
        assert_goes_on_by_rearming_alone(two, network, place)


SERVER = """
import hashlib, socket
with socket.create_server(("0.0.0.0", 7)) as server:
    print("ready", flush=True)
    peer, _ = server.accept()
    read = hashlib.sha256()
    while data := peer.recv(65536):
        read.update(data)
    print(read.hexdigest())
"""
CLIENT = """
import hashlib, socket
sent = hashlib.sha256()
with socket.create_connection(("{to}", 7)) as client:
    for number in range(200):
        data = number.to_bytes(2, "big") * 1000
        client.sendall(data)
        sent.update(data)
print(sent.hexdigest())
"""


def test_tcp_between_the_computers_sends_anew_what_the_link_loses():
    rough = Conditions(0.005, 0.005, loss=0.05, twice=0.05, in_order=False)
    with contextlib.ExitStack() as stack:
        try:
            both = stack.enter_context(two_computers(rough, rough))
        except NoNamespacesError as error:
            pytest.skip(str(error))
        words = [*both.at(ROBOT), sys.executable, "-c", SERVER]
        server = stack.enter_context(subprocess.Popen(words, stdout=subprocess.PIPE, text=True))
        assert server.stdout.readline() == "ready\n"
        words = [*both.at(OPERATOR), sys.executable, "-c", CLIENT.format(to=ADDRESSES[ROBOT])]
        sent = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True).stdout
        assert server.stdout.read() == sent
        assert both.counts()[ROBOT]["lost"]
        # Frames of the wire's MTU: with offloading, 400 kB would take fewer.
        assert both.counts()[ROBOT]["sent"] >= 400_000 / 1448
        with both.datagrams(ROBOT) as datagrams, pytest.raises(OSError, match="assign"):
            datagrams.bind((ADDRESSES[OPERATOR], 0))
