"""Devices: access rights, udev rules, and other processes that have them open."""

from cardan.doctor.base import Subject, Used
from cardan.doctor.devices import (
    Holders,
    PluggedIn,
    UdevRules,
    check_devices,
    check_holders,
    check_paths,
    check_rules,
    check_spacenavd,
)
from cardan.doctor.files import read_files
from cardan.doctor.processes import Holder
from cardan.drivers.base import FoundDevice
from cardan.drivers.keyboard import Keyboard
from cardan.drivers.spacemouse import SpaceMouse
from cardan.drivers.udev import udev_rules
from tests.doctor.levels_and_codes import levels_and_codes
from tests.doctor.test_processes import process

MOUSE = FoundDevice("SpaceMouse", "256f:c635", "hid", "/dev/hidraw0", "", "spacemouse")
DENIED = MOUSE._replace(obstacle="no permission for /dev/hidraw0: install the udev rules")
WANTED = [Used("gofa", "device", "spacemouse", SpaceMouse())]


def test_devices():
    assert levels_and_codes(PluggedIn, check_devices([], WANTED)) == [("good", "device")]
    assert levels_and_codes(PluggedIn, check_devices([MOUSE], WANTED)) == [("good", "device")]


def test_an_obstacle_is_grave_where_a_file_wants_the_device():
    wanted = list(check_devices([DENIED], WANTED))
    other = list(check_devices([DENIED], [Used("x", "device", "keyboard", Keyboard())]))
    assert levels_and_codes(PluggedIn, wanted) == [("failure", "device")]
    assert levels_and_codes(PluggedIn, other) == [("caution", "device")]
    assert wanted[0].mend.startswith(
        "cardan devices udev | sudo tee /etc/udev/rules.d/70-cardan.rules"
    )
    assert "gofa" in wanted[0].why


def test_what_mends_an_obstacle():
    for obstacle, mend in (
        ("another program holds /dev/hidraw0: end it", "sudo cardan doctor"),
        ("python-can is not installed: pip install x", "pip install x"),
        ("/dev/hidraw0 is gone: plug it in again", "cardan devices"),
        ("a pad in its mode D: set the switch to X", "set the switch to X"),
    ):
        found = list(check_devices([MOUSE._replace(obstacle=obstacle)], []))
        assert found[0].mend.endswith(mend)


def test_nodes_that_files_name():
    paths = [("a", "/dev/ttyUSB0"), ("b", "/dev/ttyUSB1"), ("c", "/dev/hidraw0"), ("d", "/dev/x")]
    there = {"/dev/ttyUSB0": False, "/dev/ttyUSB1": True, "/dev/hidraw0": True, "/dev/x": True}
    allowed = {**dict.fromkeys(there, False), "/dev/x": True}
    found = list(check_paths(paths, there, allowed))
    assert levels_and_codes(PluggedIn, found) == [
        *[("failure", "node")] * 3,
        ("good", "node"),
    ]
    assert "dialout" in found[1].mend
    assert "udev" in found[2].mend


def test_a_file_that_names_a_node(tmp_path):
    file = tmp_path / "mouse.toml"
    file.write_text(
        '[device]\ndriver = "spacemouse_serial"\npath = "/dev/ttyNONE7"\n'
        '[robot]\ndriver = "abb_egm"\n'
    )
    config, wrong = read_files([file])
    assert not wrong
    found = PluggedIn.look(Subject((file,), config, devices=lambda: [MOUSE]))
    assert levels_and_codes(PluggedIn, found) == [("good", "device"), ("failure", "node")]


def test_udev_rules(tmp_path):
    rules = tmp_path / "etc/udev/rules.d"
    rules.mkdir(parents=True)
    subject = Subject(root=tmp_path)
    none = list(UdevRules.look(subject))
    assert levels_and_codes(UdevRules, none) == [("caution", "udev")]
    assert none[0].what == "the udev rules are not installed"
    (rules / "70-mine.rules").write_text(udev_rules())
    assert levels_and_codes(UdevRules, UdevRules.look(subject)) == [("good", "udev")]


def test_udev_rules_of_an_older_release():
    found = check_rules({"a": "# x\nONE, MODE\n"}, "# y\n\nONE, MODE\nTWO, MODE\n")
    assert levels_and_codes(UdevRules, found) == [("caution", "udev")]
    assert found.what == "1 of 2 udev rules are not installed"
    assert levels_and_codes(UdevRules, check_rules({}, "# none\n")) == [("good", "udev")]


def test_spacenavd():
    assert levels_and_codes(Holders, check_spacenavd([], ["spacemouse"], [])) == [
        ("good", "spacenavd")
    ]
    assert levels_and_codes(Holders, check_spacenavd([7], ["spacemouse"], ["spnav"])) == [
        ("good", "spacenavd")
    ]
    assert levels_and_codes(Holders, check_spacenavd([7], [], [])) == [("good", "spacenavd")]
    taken = check_spacenavd([7], ["spacemouse"], ["spacemouse"])
    assert levels_and_codes(Holders, taken) == [("caution", "spacenavd")]


def test_holders():
    held = {"/dev/hidraw0": Holder(7, "blender", False), "/dev/hidraw1": Holder(8, "cardan", True)}
    found = list(check_holders(held))
    assert levels_and_codes(Holders, found) == [("caution", "holder"), ("good", "holder")]
    assert found[0].mend == "kill 7"


def test_holders_by_proc(tmp_path):
    process(tmp_path, 70, "/usr/bin/spacenavd", comm="spacenavd", opened=["/dev/hidraw0"])
    found = list(Holders.look(Subject(root=tmp_path, devices=lambda: [MOUSE])))
    assert levels_and_codes(Holders, found) == [("good", "spacenavd"), ("caution", "holder")]
    assert found[1].what == "/dev/hidraw0 is open in /usr/bin/spacenavd (pid 70)"
