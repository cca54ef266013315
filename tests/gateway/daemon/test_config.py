"""Valid contents of the daemon's files."""

import pytest

from cardan.errors import ConfigurationError
from cardan.gateway.daemon.config import is_of_daemon, read_daemon_config
from cardan.robots.arm_loader import our_texts

ARM = '[robot]\ndriver = "sim_arm"\nrobot = "ur5"\n[arm]\nmodel = "ur5"\n'
LAB = """
[devices.left]
driver = "keyboard"
[robots.ur5]
driver = "sim_arm"
robot = "ur5"
[[sessions]]
name = "one"
device = "left"
robot = "ur5"
[sessions.arm]
model = "ur5"
[[sessions]]
name = "two"
file = "arm.toml"
start = false
[sessions.limits]
linear_speed_m_s = 0.1
[servers.web]
server = "rosbridge"
port = 9191
no-wait = true
topics = ["/a", "/b"]
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "arm.toml").write_text(ARM)
    return tmp_path


def read(folder, **files):
    for name, text in files.items():
        (folder / f"{name}.toml").write_text(text)
    return read_daemon_config([folder / f"{name}.toml" for name in files])


def test_a_file_with_a_robot_is_one_session(folder):
    daemon_config = read_daemon_config([folder / "arm.toml"])
    assert list(daemon_config.sessions) == ["arm"]
    assert daemon_config.sessions["arm"].config.robot.driver == "sim_arm"
    assert daemon_config.sessions["arm"].start
    assert not daemon_config.servers


@pytest.mark.parametrize("name", ["my lab", "läb", "-arm", "a" * 64])
def test_a_file_whose_name_is_none_of_a_session(folder, name):
    (folder / "arm.toml").rename(folder / f"{name}.toml")
    with pytest.raises(ConfigurationError, match=r"the file's name, is the session's.*rename"):
        read_daemon_config([folder])


def test_devices_and_robots_by_name(folder):
    daemon_config = read(folder, lab=LAB)
    one, two = daemon_config.sessions["one"], daemon_config.sessions["two"]
    assert one.config.device.driver == "keyboard"
    assert one.config.robot.options == {"robot": "ur5"}
    assert two.config.device is None
    assert two.config.limits.linear_speed_m_s == 0.1
    assert not two.start


def test_a_servers_keys_are_its_options(folder):
    web = read(folder, lab=LAB).servers["web"]
    assert web.server == "rosbridge"
    assert web.words == (
        "--port", "9191", "--no-wait", "--topics", "/a", "--topics", "/b"
    )  # fmt: skip


@pytest.mark.parametrize(
    ("router", "ports"),
    [
        ("", {7447}),
        ('endpoint = ["tcp/127.0.0.1:7448", "tcp/192.168.1.10:7449"]', {7448}),
        ('endpoint = "tcp/[::]:7448"', {7448}),
        ('server = "rosbridge"', set()),
        ('zenoh_config = "a.json5"', {7441}),
        ('zenoh_config = "b.json5"', {7442}),
        ('zenoh_config = "c.json5"', set()),
    ],
)
def test_where_a_server_is_the_router(folder, router, ports):
    (folder / "a.json5").write_text('{listen: {endpoints: ["tcp/127.0.0.1:7441"]}}')
    (folder / "c.json5").write_text("{")
    (folder / "b.json5").write_text('{listen: {endpoints: {router: ["tcp/127.0.0.1:7442"]}}}')
    routed = read(folder, lab=f"[servers.router]\n{router}\n").servers["router"].routed
    assert {port for _, port in routed} == ports


def test_the_former_name_of_the_servers_is_refused_by_the_new_one(folder):
    old = '[faces.web]\nface = "rosbridge"\n'
    with pytest.raises(ConfigurationError, match="faces: is now: servers, and `face` in it is"):
        read(folder, old=old)
    assert is_of_daemon({"robot": {}, "faces": {}})
    with pytest.raises(ConfigurationError, match=r"servers\.web\.face: is now: server"):
        read(folder, old='[servers.web]\nface = "rosbridge"\n')


@pytest.mark.parametrize("server", ["3", '["rosbridge"]', "{}"])
def test_the_name_of_a_server_is_a_text(folder, server):
    with pytest.raises(ConfigurationError, match=r"servers\.web\.server: .*is not allowed"):
        read(folder, lab=f"[servers.web]\nserver = {server}\n")


def test_a_folder_is_all_of_its_files(folder):
    (folder / "other.toml").write_text(ARM)
    (folder / ".hidden.toml").write_text("no toml")
    (folder / "notes.txt").write_text("no toml")
    assert list(read_daemon_config([folder]).sessions) == ["arm", "other"]


def test_one_file_may_name_what_another_has(folder):
    daemon_config = read(
        folder,
        robots='[robots.r]\ndriver = "sim_arm"\nrobot = "ur5"\n',
        sessions='[[sessions]]\nname = "s"\nrobot = "r"\n[sessions.arm]\nmodel = "ur5"\n',
    )
    assert list(daemon_config.sessions) == ["s"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "neither a session nor a server"),
        ('[[sessions]]\nname = "s"\nrobot = "x"\n', "there is no [robots.x]; allowed: none"),
        ('[[sessions]]\nname = "a b"\nrobot = "x"\n', "'a b' is not allowed; it must be letters"),
        ('[[sessions]]\nrobot = "x"\n', "sessions.0.name: is missing"),
        ('[servers.web]\nserver = "telnet"\n', "servers.web.server: there is no server 'telnet'"),
        ("[servers.rosbridge]\nport = { a = 1 }\n", "servers.rosbridge.port: is a table"),
        ("[daemon]\nstart_limit = 0\n", "daemon.start_limit"),
        ("[demon]\n", "demon: there is no such key"),
        ('[servers.rosbridge]\n[robot]\ndriver = "sim_arm"\n', "servers: is the daemon's"),
        ('[[sessions]]\nname = "arm"\nfile = "none.toml"\n', "cannot read"),
        (LAB.replace('robot = "ur5"\n[sess', 'robot = "ur6"\n[sess'), "did you mean"),
    ],
)
def test_what_is_wrong_is_named_with_its_file(folder, text, words):
    with pytest.raises(ConfigurationError) as error:
        read(folder, lab=text)
    assert words in str(error.value)
    assert "lab.toml" in str(error.value) or "neither" in words


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (LAB, '[robots.ur5]\ndriver = "sim_arm"\n'),
        (LAB, '[[sessions]]\nname = "one"\nfile = "arm.toml"\n'),
        ("[daemon]\n" + LAB, "[daemon]\n"),
        (LAB, "[servers.one]\nserver = 'router'\n"),
    ],
)
def test_no_name_means_two_things(folder, first, second):
    with pytest.raises(ConfigurationError, match=r"already|tell them apart"):
        read(folder, lab=first, more=second)


def test_a_folder_without_files_is_refused(tmp_path):
    with pytest.raises(ConfigurationError, match=r"has no \.toml file"):
        read_daemon_config([tmp_path])
    with pytest.raises(ConfigurationError, match="no file was given"):
        read_daemon_config([])


@pytest.mark.parametrize(
    ("was", "now", "words"),
    [
        ('driver = "keyboard"', 'driver = "keybord"', "lab.toml:3:1: one.device.driver: "),
        ('robot = "ur5"\n[[', 'robot = "ur6"\n[[', "lab.toml:6:1: one.robot.robot: "),
        ('device = "left"', 'device = "lefd"', "lab.toml:9:1: one.device: .*did you mean 'left'"),
        ("[sessions.arm]", "[sessions.arms]", "lab.toml:11:1: one.arms: "),
        (
            "linear_speed_m_s = 0.1",
            "linear_speed = 0.1",
            "lab.toml:18:1: two.limits.linear_speed",
        ),
        ("start = false", "starts = false", "lab.toml:16:1: two.starts: there is no such key"),
        ('server = "rosbridge"', 'server = "rosbridg"', "lab.toml:20:1: servers.web.server: "),
    ],
)
def test_an_error_says_where_its_key_stands(folder, was, now, words):
    assert LAB.count(was) == 1
    with pytest.raises(ConfigurationError, match=words):
        read(folder, lab=LAB.replace(was, now))


def test_an_error_in_the_file_that_a_session_names_is_of_that_file(folder):
    (folder / "arm.toml").write_text(ARM.replace("model", "modell"))
    with pytest.raises(ConfigurationError, match=r"arm\.toml:5:1: two\.arm\.modell: "):
        read(folder, lab=LAB)


@pytest.mark.parametrize("home", ["~", "$HOME", "${HOME}"])
def test_a_home_in_a_path_is_expanded(folder, tmp_path, monkeypatch, home):
    (folder / "arm.toml").rename(tmp_path / "other.toml")
    monkeypatch.setenv("HOME", str(tmp_path))
    daemon_config = read(folder, lab=LAB.replace("arm.toml", f"{home}/other.toml"))
    assert daemon_config.sessions["two"].config.arm.model == "ur5"


def test_paths_are_relative_to_the_file_that_names_them(folder, monkeypatch):
    (folder / "base").mkdir()
    (folder / "base" / "arm.toml").write_text(
        ARM.replace('robot = "ur5"', 'robot = "own.toml"').replace('"ur5"', '"own.toml"')
    )
    (folder / "base" / "own.toml").write_text('urdf = "own.urdf"\n')
    (folder / "base" / "own.urdf").write_bytes(our_texts("ur5").urdf.encode())
    monkeypatch.chdir("/")
    daemon_config = read(
        folder,
        lab='[daemon]\nevent_log = "log"\nsocket = "lab.sock"\n'
        '[[sessions]]\nname = "one"\nfile = "base/arm.toml"\n'
        '[servers.rosbridge]\ntoken-file = "tokens"\n',
    )
    config = daemon_config.sessions["one"].config
    assert config.arm.model == config.robot.options["robot"] == str(folder / "base" / "own.toml")
    assert daemon_config.daemon.event_log == str(folder / "log")
    assert daemon_config.daemon.socket == str(folder / "lab.sock")
    assert daemon_config.servers["rosbridge"].words == ("--token-file", str(folder / "tokens"))
    assert read(folder, lab=LAB + '[daemon]\nevent_log = "none"\n').daemon.event_log == "none"
