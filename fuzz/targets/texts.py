"""Inputs as text or JSON: the daemon's requests, verbs, tokens, access checks, a user's files."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from cardan.bus.dds_options import DdsOptions
from cardan.common import certificates, tables
from cardan.demos.examples import example_files, read_demo
from cardan.doctor import ports
from cardan.errors import CardanError, ConfigurationError
from cardan.gateway.arm import cycle_record, requests, verb_table
from cardan.gateway.daemon import control
from cardan.gateway.daemon.config import DaemonConfig, read_daemon_config
from cardan.gateway.daemon.daemon import Daemon
from cardan.gateway.daemon.processes import Lines, RunningSession
from cardan.gateway.force import link
from cardan.gateway.servers import stats
from cardan.gateway.servers.access import AccessControl, AccessDenied, ClientInfo
from cardan.gateway.servers.tokens import Role, Tokens, parse_tokens
from cardan.gateway.session.config import SessionConfig, parse_config
from cardan.gateway.session.snapshot import Snapshot
from cardan.protocols.rosbridge import operations, rosapi
from cardan.protocols.rosbridge.session import RosbridgeSession
from cardan.robots import limits_in, parse_urdf
from cardan.robots.arm_file import ArmFile
from cardan.robots.arm_loader import FOLDER
from cardan.robots.mjcf import urdf_of
from cardan.robots.urdf import normal_form, read_tree
from cardan.types import Vector3
from cardan_filters.readings import decode_centroid, decode_proximity
from cardan_foxglove import protocol as foxglove
from cardan_foxglove.assets import AssetError, Packages
from fuzz.target import Form, Packets, Target
from fuzz.targets.captures import _file, _folder
from fuzz.targets.common import joined_streams, kinds, near, same, text_of

# -- the daemon -----------------------------------------------------------------------------------

_ASKS = (
    control.Ask(1, "units"),
    control.Ask(2, "start", "gofa"),
    control.Ask(3, "watch", "", 0.5),
    control.Ask(4, "log", "gofa", True),
    control.Ask(5, "ask", "gofa", {"id": 7, "source": "verbs", "verb": "movj", "value": [0.1] * 6}),
    control.Ask(6, "switch", "spacemouse", "gp8"),
)


def _asks() -> Iterator[bytes]:
    for ask in _ASKS:
        yield control.encode_ask(ask)
    for kind in ("result", "error", "event"):
        yield control.encode_response(control.Response(1, kind, [{"name": "gofa"}, "text"]))


def _control(data: bytes) -> object:
    results: list[object] = []
    for decode in (control.decode_ask, control.decode_response):
        try:
            found = decode(data)
            results.append(type(found).__name__)
        except control.ControlError as error:
            results.append((error.request is None, str(error)[:20]))
            continue
        if isinstance(found, control.Ask):
            again = control.decode_ask(control.encode_ask(found))
            same(again, found)
    return tuple(results)


def _control_stream(data: bytes) -> object:
    return kinds(joined_streams(lambda: control.LineReader().take, data))


def _server_lines(data: bytes) -> object:
    """Output of a server: lines, and figures in some of them."""
    said: list[str] = []
    lines = Lines(said.append)
    for at in range(0, len(data), 700):
        lines.take(data[at : at + 700])
    lines.take(b"\n")
    figures = [stats.figures_of(line) for line in said]
    for each in figures:
        assert each is None or all(type(value) is int for value in each.values())
    return len(said) > 1, any(each is not None for each in figures)


class _Program:
    """A connection of the daemon's that keeps the bytes written to it."""

    def __init__(self) -> None:
        self.reported: list[bytes] = []
        self.gone: list[Callable[[], None]] = []
        self.open, self.since_s = True, time.monotonic()

    def tell(self, *reported: control.Response) -> None:
        """As the server's own: what cannot be encoded would end the daemon."""
        for each in reported:
            assert each.kind != "error" or "a fault" not in each.value, each.value
            self.reported.append(control.encode_response(each))


class _Running(RunningSession):
    """A session's process that takes everything and does nothing."""

    def __init__(self) -> None:
        self.snapshot, self.heard_s = Snapshot.of({"arm": {"phase": "disarmed"}}), 0.0

    @property
    def pid(self) -> int:
        """Of this process."""
        return os.getpid()

    def send(self, packet: bytes) -> None:
        """Nothing."""

    def stop(self) -> None:
        """Nothing."""


@cache
def _config_of_two() -> DaemonConfig:
    folder = _folder() / "two"
    folder.mkdir(exist_ok=True)
    for name in ("one", "two"):
        text = (Path(str(example_files()[0])).parent / "gamepad-ur5-simulated.toml").read_text()
        (folder / f"{name}.toml").write_text(text)
    return read_daemon_config([folder])


def idle_daemon() -> tuple[Daemon, Any]:
    """A daemon with two sessions that starts no process, and a program that asks it."""
    config = _config_of_two()
    daemon = Daemon(config, lambda: config)
    daemon._look_after = lambda _now_s: None  # type: ignore[method-assign]
    for service in daemon._services.values():
        service.unit.stop(0.0, "")
        service.process = _Running()
    return daemon, _Program()


def _daemon(packets: Packets) -> object:
    """Requests that a daemon carries out, in which no process is started; it answers afterwards."""
    daemon, program = idle_daemon()
    for line in packets:
        try:
            ask = control.decode_ask(line)
        except control.ControlError:
            continue
        if ask.do != "reload":  # Checks every file and model: `daemon.config` is a target, too.
            daemon._handle(ask, program)
    daemon._tell_watchers(1e9)
    asked = len(program.reported)
    daemon._handle(control.Ask(1, "units"), program)
    assert control.decode_response(program.reported[-1]).kind == "result"
    for call in program.gone:
        call()
    assert not daemon._watchers
    return tuple(
        sorted({control.decode_response(each).kind for each in program.reported})
    ), asked > 4


def _daemon_asks() -> Iterator[Packets]:
    name = next(iter(_config_of_two().sessions))
    asks = [ask._replace(name=name if ask.name == "gofa" else ask.name) for ask in _ASKS]
    yield tuple(map(control.encode_ask, asks))
    for do in control.NEEDS:
        if do != "reload":
            yield (control.encode_ask(control.Ask(1, do, name)),)


# -- verbs ----------------------------------------------------------------------------------------


@cache
def _requests() -> tuple[bytes, ...]:
    found = []
    values: tuple[Any, ...] = (
        *([0.1] * 6, [0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0], [0.0] * 7, 1, "gripper", 0.5, True),
        *({}, {"vel": 0.1}, [[1, 0.5]], [[0.0] * 6] * 3, None),
        {"frame": "base", "linear": [0.1, 0, 0], "angular": [0, 0, 0]},
    )
    for verb in verb_table.IN_PACKETS:
        for value in values:
            table = {"id": 7, "source": "verbs", "verb": verb, "value": value}
            data = json.dumps(table).encode()
            try:
                requests.decode_request(data)
            except requests.PacketError:
                continue
            found.append(data)
        found.append(json.dumps({"id": 7, "source": "v", "verb": verb}).encode())
    return tuple(found)


def _request(data: bytes) -> object:
    try:
        found = requests.decode_request(data)
    except requests.PacketError as error:
        requests.encode_error(error.request, error)
        return error
    try:
        again = requests.decode_request(requests.encode_request(found))
    except CardanError as error:  # The verb itself does not take it.
        return found.verb, type(error).__name__
    near(tuple(requests.decode_request(requests.encode_request(again))), tuple(again))
    return found.verb, type(found.value).__name__


_NOTE = {
    "id": 3, "verb": "movj", "source": "verbs", "ends": True, "outcome": "running",
    "reason": "", "note": "", "duration_s": 1.5,
}  # fmt: skip


def _answers() -> Iterator[bytes]:
    yield requests.encode_reply(7, [0.1] * 6)
    yield json.dumps({"reply": 7, "result": _NOTE}, separators=(",", ":")).encode()
    yield json.dumps({"motion": _NOTE}, separators=(",", ":")).encode()
    ended = json.dumps({"reply": 7, "result": None, "ended": [_NOTE]}, separators=(",", ":"))
    yield ended.encode()
    for error in (requests.PacketError("what", 3), CardanError("no"), ConfigurationError("k", "w")):
        yield requests.encode_error(7, error)
    stat = {"pose": [0.0] * 6, "state": "hold", "stamp_s": 1.0}
    yield requests.encode_reply(7, stat)


def _answer(data: bytes) -> object:
    found = requests.decode_answer(data)
    if isinstance(found, requests.Reply) and found.error is None:
        results: list[object] = []
        for verb in requests._RESULTS:
            try:
                requests.result_of(verb, found.result)
                results.append(True)
            except requests.PacketError:
                results.append(False)
        return tuple(results)
    if isinstance(found, requests.Reply):
        str(found.error)
    return type(found).__name__


def _cycles() -> Iterator[bytes]:
    yield (
        b'{"cycle":7,"before":[["engage","true"]],"robot":[1.0,"live",1,7,0.004,[0.1,0.2],[],'
        b'[[0.1,0.2,0.3],[1,0,0,0],"base"],""],"device":[1.0,"live",[0,0,0,0,0,0],["left"],null,'
        b'null,""],"events":[[1.0,"left",true]],"command":[[0.1,0.2],null]}'
    )


def _cycle(data: bytes) -> object:
    return cycle_record.decode_cycle(text_of(data)).device is None


def _force_link(data: bytes) -> object:
    found = link.decode(data)
    if isinstance(found, link.ForceMessage):
        same(link.decode(link.encode_force(found)), found)
    elif isinstance(found, link.StateMessage):
        again = link.decode(link.encode_state(found))
        assert again is not None
    elif found is not None:
        assert len(link.encode_refusal(found)) <= link.MAX_PACKET_BYTES
    return found


def _force_seeds() -> Iterator[bytes]:
    yield link.encode_force(link.ForceMessage(7, 1.5, Vector3(1.0, 2.0, 3.0)))
    yield link.encode_refusal(link.RefusalMessage("another force node"))
    yield link.encode_state(link.StateMessage(7, 1.5, True, None, None, None))


def _readings(data: bytes) -> object:
    return decode_proximity(data), decode_centroid(data)


def _reading_seeds() -> Iterator[bytes]:
    boards = [
        " ".join([board, *(axis + "0A3" * 16 for axis in "XYZ")]) for board in ("I", "J", "K")
    ]
    yield "\n".join(boards).encode()
    yield b"0.1 0.2, 3e-1\n4"
    yield b"-0.25 0.5"


# -- servers --------------------------------------------------------------------------------------

_TOKEN = "0123456789abcdef0123456789abcdef"


def _door(data: bytes) -> object:
    """A request's first lines: path, then headers, one a line."""
    lines = data.decode("latin-1").split("\n")
    headers: dict[str, list[str]] = {"host": [], "origin": [], "authorization": []}
    for line in lines[1:]:
        key, _, value = line.partition(":")
        headers.setdefault(key.strip().lower(), []).append(value.strip())
    caller = ClientInfo(
        "192.0.2.7", lines[0], headers["host"], headers["origin"], headers["authorization"]
    )
    results = []
    for tokens in (Tokens({}), Tokens({_TOKEN: Role.OPERATOR})):
        door = AccessControl(tokens, ("robot",), ("https://app.example",))
        found = door.check(caller, 10.0)
        if isinstance(found, AccessDenied):
            assert _TOKEN not in found.reason or any(_TOKEN in each for each in headers["origin"])
            results.append(found.status.name)
        else:
            said = lines[0].replace("\t", "").replace("\r", "")
            assert not tokens or "%" in said or _TOKEN in "".join([said, *lines[1:]]), found
            results.append(found.name)
    return tuple(results)


def _doors() -> Iterator[bytes]:
    yield f"/?t={_TOKEN}\nHost: localhost:9090".encode()
    yield f"/{_TOKEN}\nHost: 127.0.0.1:9090\nOrigin: http://localhost:8000".encode()
    yield f"/\nHost: [::1]:9090\nAuthorization: Bearer {_TOKEN}".encode()
    yield b"/?token=x\nHost: robot\nOrigin: https://app.example"


def _tokens(data: bytes) -> object:
    return len(parse_tokens(text_of(data), "token_file"))


def _rosbridge(packets: Packets) -> object:
    """A client's frames, the first byte of each for text or binary: fragments, levels, anything;
    a good operation is understood afterwards."""
    session, now_s = RosbridgeSession(100_000), 10.0
    found: list[object] = []
    for data in packets:
        now_s += 0.01
        asked = session.receive(text_of(data) if data[:1] != b"\xff" else data, now_s)
        found.append(asked)
        if isinstance(asked, operations.RefusedOperation):
            session.status("error", asked.id, asked.reason)
            json.dumps(asked.id)
    good = session.receive('{"op": "advertise", "topic": "/a", "type": "b/C"}', now_s + 5.0)
    assert isinstance(good, operations.Advertise), good
    return kinds(found)


def _operations() -> Iterator[Packets]:
    texts = [
        {"op": "subscribe", "topic": "/a", "type": "std_msgs/String", "id": "1",
         "throttle_rate": 10, "queue_length": 1, "fragment_size": 500, "compression": "png"},
        {"op": "publish", "topic": "/a", "msg": {"data": "x"}},
        {"op": "call_service", "service": "/s", "args": [1, 2], "id": 7, "timeout": 1.5},
        {"op": "send_action_goal", "action": "/x", "action_type": "a/action/B", "args": {},
         "feedback": True, "id": "g"},
        {"op": "set_level", "level": "info"},
        {"op": "fragment", "id": "f", "num": 0, "total": 2, "data": '{"op": "unadvertise", '},
        {"op": "fragment", "id": "f", "num": 1, "total": 2, "data": '"topic": "/a"}'},
        {"op": "service_response", "service": "/s", "id": "1", "values": {}, "result": True},
        {"op": "advertise_service", "type": "std_srvs/Trigger", "service": "/s"},
        {"op": "auth", "mac": "x"},
    ]  # fmt: skip
    whole = tuple(json.dumps(each).encode() for each in texts)
    yield whole
    yield whole[5:7]
    for each in whole:
        yield (each,)


def _rosapi(data: bytes) -> object:
    value = rosapi.parameter_value(text_of(data), data[0] % 11 if data else 0)
    rosapi.parameter_text(value)
    return value["type"]


def _foxglove(data: bytes) -> object:
    foxglove.subscription_of(data)
    foxglove.is_time(data)
    foxglove.published_channel(data)
    found = foxglove.parse_operation(text_of(data))
    if isinstance(found, foxglove.SetParameters):
        results: list[object] = []
        for given in found.parameters:
            foxglove.network_name(given.name)
            try:
                value = foxglove.given_value(given, 3)
                entry = foxglove.parameter_entry("/a.b", value)
                foxglove.parameter_values([entry] if entry else [], found.id)
                results.append(value["type"])
            except ValueError as error:
                results.append(type(error).__name__)
        return tuple(results)
    return type(found).__name__


def _foxgloves() -> Iterator[bytes]:
    for table in (
        {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 2}]},
        {"op": "unsubscribe", "subscriptionIds": [1]},
        {"op": "getParameters", "parameterNames": ["/a.b"], "id": "1"},
        {"op": "setParameters", "parameters": [
            {"name": "/a.b", "value": 1.5}, {"name": "/a.c", "value": "AQ==", "type": "byte_array"},
            {"name": "/a.d", "value": [1, 2], "type": "float64_array"}], "id": "1"},
    ):  # fmt: skip
        yield json.dumps(table).encode()
    yield b"\x01" + bytes(12)


# -- files ----------------------------------------------------------------------------------------


def _configs() -> Iterator[bytes]:
    for path in example_files():
        yield path.read_bytes()


def _config(data: bytes) -> object:
    """A session's file as far as it is checked without a model, and as a demo."""
    table = tables.parse_toml(text_of(data), "fuzz.toml")
    read_demo(_file(data, "demo.toml"))
    config = parse_config(table)
    tables.as_table(config)
    assert isinstance(config, SessionConfig)
    return config.robot.driver if config.robot is not None else None


_LAYOUT = b"""
[daemon]
socket = "/tmp/x.sock"
start_limit = 5
[devices.mouse]
driver = "spacemouse"
serial = "1"
[robots.gofa]
driver = "sim-arm"
robot = "ur5"
[[sessions]]
name = "one"
device = "mouse"
robot = "gofa"
[servers.web]
server = "rosbridge"
port = 9090
"""


def _daemon_configs() -> Iterator[bytes]:
    yield _LAYOUT
    for path in example_files()[:6]:
        yield path.read_bytes()


def _daemon_config(data: bytes) -> object:
    config = read_daemon_config([_file(data, "daemon.toml")])
    return len(config.sessions), len(config.servers)


def _urdfs() -> Iterator[bytes]:
    for path in sorted(FOLDER.rglob("*.urdf"), key=lambda each: each.stat().st_size)[:3]:
        yield path.read_bytes()
    yield (
        b'<robot name="r"><link name="a"/><link name="b"><inertial><mass value="1"/><inertia '
        b'ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial><collision><geometry><sphere '
        b'radius="0.1"/></geometry></collision></link><joint name="j" type="revolute"><parent '
        b'link="a"/><child link="b"/><axis xyz="0 0 1"/><origin xyz="0 0 1" rpy="0 0 0"/><limit '
        b'lower="-1" upper="1" velocity="1" effort="9"/></joint></robot>'
    )


def _urdf(data: bytes) -> object:
    text = text_of(data)
    with contextlib.suppress(ConfigurationError):
        limits_in(text, ["j", "joint_1"])
    model = parse_urdf(text)
    return len(model.joints)


def _mjcfs() -> Iterator[bytes]:
    yield b"""<mujoco><compiler angle="radian" meshdir="m"/><default><joint range="-1 2"/>
      <default class="c"><geom type="capsule" size="0.1 0.2"/></default></default>
      <asset><mesh name="m" file="m.stl"/></asset><worldbody><geom type="plane" size="1 1 1"/>
      <body name="a" euler="0 0 1" childclass="c"><joint name="j" ref="0.1"/>
      <geom fromto="0 0 0 0 0 1"/><frame zaxis="0 1 1"><body name="b" pos="0 0 1">
      <joint name="k" type="slide" pos="0 0.1 0"/><geom type="mesh" mesh="m"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><site name="tip" xyaxes="0 1 0 1 0 1"/>
      </body></frame></body></worldbody><actuator><motor joint="j" ctrlrange="-1 1"/></actuator>
      <equality><joint joint1="k" joint2="j"/><connect body1="b"/></equality>
      <tendon><fixed name="t" range="0 1"><joint joint="j"/></fixed></tendon>
      <keyframe><key name="home" qpos="0 1"/></keyframe></mujoco>"""


def _mjcf(data: bytes) -> object:
    tree = read_tree(urdf_of(text_of(data)))
    normal_form(tree, ())
    return len(tree.joints) + len(tree.home())


def _arm_files() -> Iterator[bytes]:
    for path in sorted(FOLDER.glob("*.toml"))[:3]:
        yield path.read_bytes()


def _arm_file(data: bytes) -> object:
    table = tables.parse_toml(text_of(data), "fuzz.toml")
    file = tables.read_table(ArmFile, table)
    return file.urdf


def _snapshot(data: bytes) -> object:
    """Snapshot of a session; a daemon or a view of another version may not know its fields."""
    Snapshot.from_bytes(data).to_bytes()
    return True


def _doctor(data: bytes) -> object:
    """Texts of other programs that the doctor reads."""
    text = text_of(data)
    results: list[object] = []
    readers: tuple[Callable[[], object], ...] = (
        lambda: len(list(ports.read_bound(text, "tcp"))),
        lambda: certificates.read_certificate(text),
        lambda: certificates.decode_certificate(data),
    )
    for read in readers:
        try:
            results.append(type(read()).__name__)
        except ValueError as error:
            results.append(type(error).__name__)
    return tuple(results)


def _doctor_seeds() -> Iterator[bytes]:
    yield (
        b"  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid\n"
        b"   0: 0100007F:1F90 00000000:0000 0A 00000000:00000000 00:00000000 00000000  1000  0 1\n"
    )


def _packages(data: bytes) -> object:
    """Names of files that a viewer asks for."""
    root = _folder() / "meshes_pkg"
    root.mkdir(parents=True, exist_ok=True)
    (root / "a.stl").write_bytes(b"solid")
    (_folder() / "secret.stl").write_bytes(b"secret")
    found = Packages([str(root)]).read(text_of(data))
    assert found == b"solid", found
    return True


def _domain(data: bytes) -> object:
    text = data.decode("latin-1").replace("\0", "")
    before = os.environ.get("ROS_DOMAIN_ID")
    os.environ["ROS_DOMAIN_ID"] = text
    try:
        return DdsOptions().number
    finally:
        if before is None:
            del os.environ["ROS_DOMAIN_ID"]
        else:
            os.environ["ROS_DOMAIN_ID"] = before


TARGETS = (
    Target("daemon.control", Form.JSON, _control, _asks, longest=65536),
    Target("daemon.requests", Form.JSON_PACKETS, _daemon, _daemon_asks, slow_s=0.3),
    Target(
        "daemon.lines",
        Form.TEXT,
        _control_stream,
        lambda: (b"".join(_asks()),),
        raises=(control.ControlError,),
        longest=65536,
    ),
    Target(
        "daemon.server_lines",
        Form.TEXT,
        _server_lines,
        lambda: (b'READY ws://127.0.0.1:9090\nFIGURES {"clients": 1, "refused": 3}\nhello\n',),
        longest=65536,
    ),
    Target(
        "daemon.config",
        Form.TEXT,
        _daemon_config,
        _daemon_configs,
        raises=(CardanError,),
        slow_s=0.5,
    ),
    Target("verbs.request", Form.JSON, _request, _requests, longest=8192),
    Target("verbs.answer", Form.JSON, _answer, _answers, raises=(requests.PacketError,)),
    Target("cycle_record", Form.JSON, _cycle, _cycles, raises=(cycle_record.RecordError,)),
    Target("force.link", Form.BYTES, _force_link, _force_seeds, longest=2048),
    Target("filters.readings", Form.TEXT, _readings, _reading_seeds, longest=16384),
    Target(
        "servers.door", Form.TEXT, _door, _doors, words=(b"Host:", b"Origin:", b"%2F", b"[::1]")
    ),
    Target(
        "servers.tokens",
        Form.TEXT,
        _tokens,
        lambda: (b"# c\nviewer 0123456789abcdefgh\noperator aaaaaaaaaaaaaaaaaaaaaa\n",),
        raises=(ConfigurationError,),
    ),
    Target(
        "servers.assets",
        Form.TEXT,
        _packages,
        lambda: (b"package://meshes_pkg/a.stl",),
        raises=(AssetError,),
        words=(b"..", b"/", b"%2e%2e", b"../secret.stl"),
    ),
    Target("rosbridge.session", Form.JSON_PACKETS, _rosbridge, _operations, longest=60_000),
    Target(
        "rosbridge.rosapi",
        Form.JSON,
        _rosapi,
        lambda: (b"1", b"[1, 2]", b'["a"]', b"true", b"1.5", b'"text"', b"[1.5, 2]"),
        raises=(ValueError,),
    ),
    Target("foxglove", Form.JSON, _foxglove, _foxgloves),
    Target("config.session", Form.TEXT, _config, _configs, raises=(CardanError,), slow_s=0.2),
    Target("config.urdf", Form.TEXT, _urdf, _urdfs, raises=(ConfigurationError,), slow_s=0.5),
    Target("config.mjcf", Form.TEXT, _mjcf, _mjcfs, raises=(ConfigurationError,), slow_s=0.5),
    Target("config.arm", Form.TEXT, _arm_file, _arm_files, raises=(ConfigurationError,)),
    Target(
        "config.domain",
        Form.TEXT,
        _domain,
        lambda: (b"7",),
        raises=(ConfigurationError,),
        longest=8192,
    ),
    Target("doctor", Form.TEXT, _doctor, _doctor_seeds),
)
