"""Safety of unattended demos: they run only configurations that are simulated throughout."""

import shlex
from dataclasses import dataclass
from importlib.metadata import EntryPoint

import pytest

from cardan.demos import demo as demos
from cardan.demos.demo import run_demo
from cardan.demos.examples import find_demos, read_demo
from cardan.demos.peers import Peers
from cardan.demos.safety import CARDAN, check_unattended, check_words
from cardan.drivers import registry
from cardan.errors import ConfigurationError
from cardan.gateway.session.config import parse_config
from tests.gateway.fakes import FakeDevice

DEMOS = find_demos()
MOUSE = """
[device]
driver = "spacemouse"
transport = "socket"
path = "mouse.sock"
"""
EGM = """
[robot]
driver = "abb_egm"
"""
ARM = """
[robot]
driver = "sim_arm"
[arm]
model = "ur5"
"""
LAUNCH = 'launch = ["sim spacemouse --hid {device.path}"]'
FILES = 'files = ["device.path"]'
PORTS = 'ports = ["robot.listen_port"]'


def checked(tmp_path, block, tables):
    said = ('description = "d"', 'success_message = "s"', *block)
    lines = "".join(f"# {line}\n" for line in said)
    file = tmp_path / "it.toml"
    file.write_text(f"# /// demo\n{lines}# ///\n{tables}")
    demo = read_demo(file)
    tables, launches = demo.prepare(tmp_path)
    check_unattended(demo, parse_config(tables))
    for words in launches:
        check_words(demo, "launch", words)
    check_words(demo, "launcher", shlex.split(demo.launcher)) if demo.launcher else None


@pytest.mark.parametrize("name", DEMOS)
def test_every_demo_of_ours_is_simulated(name, tmp_path):
    tables, launches = DEMOS[name].prepare(tmp_path)
    if not DEMOS[name].is_lab:  # tests/demos/test_lab.py
        check_unattended(DEMOS[name], parse_config(tables))
    for words in launches:
        joined = check_words(DEMOS[name], "launch", words)
        plain = " ".join(joined).replace("=", " ").replace(f"-- {' '.join(CARDAN)} ", "-- ")
        assert plain == " ".join(words).replace("=", " ")


def test_a_demo_that_is_simulated_is_allowed(tmp_path):
    checked(tmp_path, (LAUNCH, FILES), MOUSE + ARM)
    checked(tmp_path, (LAUNCH, FILES, PORTS), MOUSE + EGM)
    checked(tmp_path, (LAUNCH, FILES), MOUSE + ARM.replace("[arm]", 'transport = "udp"\n[arm]'))
    network = '[network]\nrouter = "tcp/127.0.0.1:7447"\n'
    checked(tmp_path, (LAUNCH, FILES, 'ports = ["network.router"]'), MOUSE + ARM + network)


SENSOR = '[force]\nsource = "sensor"\n[force.sensor]\ndriver = "jr3_can"'
OMNI = '[device]\ndriver = "omni"\n'
POSITION = '[mapping]\nmode = "position"\nclutch = "button_2"\n'
GP8 = '[robot]\ndriver = "motoros"\nhost = "127.0.0.9"\nrobot = "gp8"\n[arm]\nmodel = "gp8"\n'
GP8_PORTS = 'ports = ["robot.motion_port", "robot.state_port", "robot.io_port"]'


@pytest.mark.parametrize(
    ("block", "tables", "words"),
    [
        ((FILES, PORTS), MOUSE + EGM, "launch: is empty, and so is launcher"),
        ((LAUNCH, FILES), MOUSE + EGM, r"robot.listen_port: 6510 may reach hardware; .*`ports`"),
        (
            (LAUNCH, FILES, PORTS),
            MOUSE + EGM + 'listen_host = "0.0.0.0"',
            "robot.listen_host: '0.0.0.0' is an address that other computers have",
        ),
        (
            (LAUNCH, FILES, PORTS),
            MOUSE + EGM + 'listen_host = "gofa"',
            "robot.listen_host: 'gofa' is not an address of this computer only",
        ),
        (
            (LAUNCH, FILES, PORTS),
            MOUSE + EGM + 'controller_host = "192.168.125.1"',
            "robot.controller_host: '192.168.125.1'",
        ),
        ((LAUNCH, FILES), MOUSE + GP8, "robot.motion_port: 50240 may reach hardware"),
        (
            (LAUNCH, FILES, GP8_PORTS),
            MOUSE + GP8.replace("127.0.0.9", "192.168.255.1"),
            "robot.host: '192.168.255.1'",
        ),
        (
            (LAUNCH, FILES),
            MOUSE + ARM.replace("[arm]", 'transport = "udp"\nendpoint = "arm:6520"\n[arm]'),
            "robot.transport: 'udp' may|robot.endpoint: 'arm:6520'",
        ),
        (
            (LAUNCH, FILES),
            MOUSE + ARM + "[network]\n",
            "network.router: it must be one of `ports`: another program may listen at any other",
        ),
        (
            (LAUNCH, FILES, 'ports = ["network.router"]'),
            MOUSE + ARM + '[network]\nrouter = "tcp/192.168.1.10:7447"\n',
            r"network.router: 'tcp/192\.168\.1\.10:\d+' is not of this computer only",
        ),
        (
            (LAUNCH, FILES, 'ports = ["network.router"]'),
            MOUSE + ARM + '[network]\nrouter = "tcp/127.0.0.1:7447"\nlisten = ["tcp/0.0.0.0:0"]\n',
            "network.listen: 'tcp/0.0.0.0:0' is not of this computer only",
        ),
        (
            (LAUNCH, FILES, 'ports = ["network.router"]'),
            MOUSE + ARM + '[network]\nrouter = "tcp/127.0.0.1:7447"\nzenoh_config = "z.json5"\n',
            "network.zenoh_config: it may join any network",
        ),
        ((LAUNCH,), MOUSE + ARM, "device.path: 'mouse.sock' may reach hardware; .*`files`"),
        *(
            (
                (LAUNCH, FILES),
                MOUSE.replace("socket", transport) + ARM,
                f"device.transport: '{transport}' may reach hardware; it must be 'socket'",
            )
            for transport in ("auto", "hidraw", "libusb", "usb")
        ),
        (
            (LAUNCH,),
            '[device]\ndriver = "spacemouse_serial"\npath = "mouse.sock"\n' + ARM,
            "device.path: 'mouse.sock' may reach hardware",
        ),
        *(
            (
                (LAUNCH, FILES),
                f'[device]\ndriver = "{driver}"\npath = "x"\ntransport = "{transport}"\n' + ARM,
                f"device.transport: '{transport}' may reach hardware",
            )
            for driver, transport in (
                ("gamepad", "evdev"),
                ("keyboard", "evdev"),
            )
        ),
        (
            ('launch = ["sim jr3"]',),
            '[device]\ndriver = "jr3_can"\n' + ARM,
            "device.interface: 'socketcan' may reach hardware",
        ),
        (
            ('launch = ["sim leap"]', 'ports = ["device.port"]'),
            '[device]\ndriver = "leap"\nhost = "tracker"\n' + ARM + POSITION,
            "device.host: 'tracker' is not an address of this computer only",
        ),
        (('launch = ["sim arm"]',), OMNI + ARM + POSITION, "device.library: '' may reach hardware"),
        (
            ('launcher = "sim omni"',),
            OMNI + 'library = "libHD.so"\n' + ARM + POSITION,
            "device.library: 'libHD.so' may reach hardware",
        ),
        (
            (LAUNCH, FILES),
            MOUSE + ARM + '[[filters]]\nfilter = "proximity"\nhost = "0.0.0.0"\nport = 6601',
            "filters.0.host: '0.0.0.0'",
        ),
        (
            ('launcher = "sim omni"',),
            OMNI + ARM + POSITION + '[force]\nsource = "remote"\nsocket = "force.sock"\n',
            "force.socket: it must be one of `files`",
        ),
        (
            ('launcher = "sim omni"',),
            OMNI + ARM + POSITION + SENSOR,
            "force.sensor.interface: 'socketcan' may reach hardware",
        ),
    ],
)
def test_what_may_reach_hardware_is_refused(tmp_path, block, tables, words):
    with pytest.raises(ConfigurationError, match=words) as refusal:
        checked(tmp_path, block, tables)
    assert "all of its hardware must be simulated" in str(refusal.value)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("nonsense --foo", "it starts 'nonsense --foo'; allowed: `sim PEER ...`"),
        ("run real.toml", "it starts 'run real.toml'"),
        ("demo real.toml", "it starts 'demo real.toml'"),
        ("sim", "it starts 'sim'"),
        ("sim omni cardan run real.toml", "'cardan' is not a peer's option"),
        (
            "sim omni --script demo cardan run real.toml",
            "'cardan' is not a peer's option",
        ),
        ("sim omni -- cardan run real.toml", "'--' begins a program"),
        ("sim abb-gofa --to 192.168.125.1:6510", "is not an address of this computer"),
        ("sim jr3 --channel 10.0.0.7", "other computers have"),
        ("sim jr3 --interface socketcan", "--interface=socketcan may reach hardware"),
        ("sim keyboard --uinput", "--uinput makes a device of this computer"),
        ("sim spacemouse --uhid", "--uhid makes a device of this computer"),
        ("sim abb-gofa --to gofa:6510", "--to=gofa:6510 is not an address of this computer only"),
        ("sim motoman-gp8 --host 0.0.0.0", "--host=0.0.0.0 is not an address of this computer"),
        ("sim spacemouse-serial --port /dev/ttyUSB0", "is a device of this computer"),
        ("devices spnav --socket x", "devices spnav serves {examples}/FILE"),
        (
            "devices spnav {examples}/spacemouse-gofa.toml",
            "devices spnav serves {examples}/FILE, and needs",
        ),
        (
            "devices share {examples}/spacemouse-gofa.toml",
            "devices share serves {examples}/FILE, and needs --listen",
        ),
        (
            "devices share --router tcp/127.0.0.1:7447 {examples}/x.toml",
            "may be any network's: use --listen",
        ),
        (
            "devices share --listen tcp/0.0.0.0:7447 {examples}/x.toml",
            "is not an address of this computer",
        ),
        (
            "devices share --listen tcp/127.0.0.1:0 spacemouse",
            "devices share serves {examples}/FILE",
        ),
        ("sim omni -- devices list", "'--' begins a program"),
        (
            "sim omni -- devices share {examples}/omni.toml",
            "devices share serves {examples}/FILE, and needs --listen",
        ),
        (
            "sim omni --log /dev/x -- devices share --listen tcp/127.0.0.1:0 {examples}/omni.toml",
            "is a device of this computer",
        ),
    ],
)
def test_a_demo_starts_nothing_but_simulated_peers(tmp_path, command, words):
    with pytest.raises(ConfigurationError, match=words):
        checked(tmp_path, (f'launch = ["{command}"]', FILES), MOUSE + ARM)


def test_a_served_device_is_simulated_too(tmp_path):
    real = tmp_path / "real.toml"
    command = 'launch = ["devices spnav --socket {device.path} {examples}/real.toml"]'
    real.write_text('[device]\ndriver = "spacemouse"')
    with pytest.raises(
        ConfigurationError, match=r"real\.toml: device\.transport: 'auto' may reach"
    ):
        checked(tmp_path, (command, FILES), MOUSE + ARM)
    real.write_text(MOUSE.replace("mouse.sock", "/dev/hidraw0"))
    with pytest.raises(ConfigurationError, match=r"real\.toml: device\.path: '/dev/hidraw0' may"):
        checked(tmp_path, (command, FILES), MOUSE + ARM)
    real.write_text(MOUSE)
    checked(tmp_path, (command, FILES), MOUSE + ARM)


def test_a_device_inside_a_launched_program_is_of_that_peer(tmp_path):
    (tmp_path / "omni.toml").write_text(OMNI)
    share = "devices share --listen tcp/127.0.0.1:0 {examples}/omni.toml"
    checked(tmp_path, (f'launch = ["sim omni -- {share}"]', FILES), MOUSE + ARM)
    for outside in (share, f"sim arm -- {share}"):
        with pytest.raises(ConfigurationError, match=r"omni\.toml: device\.library: '' may reach"):
            checked(tmp_path, (f'launch = ["{outside}"]', FILES), MOUSE + ARM)
    words = shlex.split(f"sim omni -- {share}")
    with pytest.raises(ConfigurationError, match="'--' begins a program"):
        check_words(DEMOS["omni"], "launcher", words)


def test_a_flag_takes_no_program_for_its_value():
    # Joined to its flag, `cardan` is a value that the flag refuses, and never a program.
    words = ["sim", "omni", "--library", "cardan"]
    assert check_words(DEMOS["omni"], "launcher", words) == ["sim", "omni", "--library=cardan"]


@dataclass(frozen=True)
class StickOptions:
    path: str = "/dev/stick"
    host: str = ""
    wire: str = ""


class Stick(FakeDevice):
    Options = StickOptions


class DeclaredStick(Stick):
    simulated = ({"wire": ("simulated",)},)


class InheritingStick(DeclaredStick):
    """A device whose access to hardware may differ from its base class."""


class MisspelledStick(Stick):
    simulated = ({"wier": ("simulated",)},)


@pytest.mark.parametrize(
    ("driver", "options", "files", "words"),
    [
        ("Stick", "", True, ""),
        ("Stick", "", False, "device.path: '/dev/stick' may reach hardware"),
        ("Stick", 'path = ""', False, "none of its options is a path or a port"),
        ("Stick", 'wire = "usb"', True, "device.wire: 'usb' may reach hardware"),
        ("Stick", 'host = "robot7"', True, "device.host: 'robot7' may reach hardware"),
        ("Stick", 'host = "10.0.0.7:80"', True, "an address that other computers have"),
        ("Stick", 'host = "127.0.0.1:80"', True, ""),
        ("DeclaredStick", "", True, "device.wire: '' may reach .*it must be 'simulated'"),
        ("DeclaredStick", 'wire = "simulated"', False, ""),
        ("DeclaredStick", 'wire = "simulated"\nhost = "10.0.0.7"', False, "other computers have"),
        ("InheritingStick", 'wire = "simulated"', False, "device.path: '/dev/stick' may reach"),
        ("MisspelledStick", "", True, "device.driver: driver 'stick' cannot be used: KeyError"),
    ],
)
def test_a_driver_of_another_package_is_held_to_the_strictest_rule(
    tmp_path, monkeypatch, driver, options, files, words
):
    point = EntryPoint("stick", f"{__name__}:{driver}", registry.ENTRY_POINT_GROUP)
    monkeypatch.setattr(registry.FINDER, "_installed", lambda: [point])
    tables = f'[device]\ndriver = "stick"\n{options}\n{ARM}'
    block = ('launch = ["sim stick"]', FILES if files else "")
    if words:
        with pytest.raises(ConfigurationError, match=words):
            checked(tmp_path, block, tables)
    else:
        checked(tmp_path, block, tables)


def test_nothing_is_started_before_a_demo_is_refused(tmp_path, monkeypatch):
    def refuse(*_words, **_options):
        raise AssertionError

    monkeypatch.setattr(Peers, "start", refuse)
    monkeypatch.setattr(demos, "supervise", refuse)
    file = tmp_path / "real.toml"
    file.write_text(
        '# /// demo\n# description = "d"\n# success_message = "s"\n'
        f"# {LAUNCH}\n# {FILES}\n# ///\n{MOUSE}{EGM}"
    )
    with pytest.raises(ConfigurationError, match=r"robot\.listen_port: 6510 may reach hardware"):
        run_demo(3.0, str(file))
