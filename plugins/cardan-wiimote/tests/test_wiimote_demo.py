"""Registrations of the installed plug-in."""

import time

import pytest

from cardan.conform import registry as suites
from cardan.demos.examples import find_demos
from cardan.drivers import registry as drivers
from cardan.gateway.session.assembly import load_config
from cardan.gateway.session.session import make_session
from cardan.sim_peers import registry as peers
from cardan_dissect import registry as dissectors
from cardan_wiimote.driver import Wiimote
from cardan_wiimote.peer import WiimotePeer, WiimotePeerOptions
from tests import installed
from tests.serving import in_a_thread

NARROW = "\n[limits]\nworkspace_z_m = [-2.0, -1.0]  # the arm starts above it\n"


def test_all_of_it_is_found_by_name():
    assert drivers.load("wiimote") is Wiimote
    assert Wiimote.peer in peers.names()
    assert "wiimote" in suites.names()
    assert "Wiimote" in {each.name for each in dissectors.dissectors()}
    assert "wiimote" in find_demos()["wiimote-ur5"].drivers


@pytest.mark.matrix
def test_the_demo_runs():
    code, said = installed.cardan("demo", "wiimote-ur5", "--seconds", "8", sites=())
    # A busy machine may miss cycles.
    assert code in (0, 4), said
    assert "followed throughout" in said or "cycles were missed" in said, said


@pytest.mark.matrix
def test_a_remote_is_lit_and_rumbles_where_the_workspace_ends(tmp_path, monkeypatch):
    text = find_demos()["wiimote-ur5"].file.read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    narrow = tmp_path / "narrow.toml"
    narrow.write_text(text + NARROW, encoding="utf-8")
    options = WiimotePeerOptions(l2cap="wiimote-sockets", script="short")
    with in_a_thread(WiimotePeer(options)) as peer:
        last = make_session(load_config(narrow)).run(3.0)
        deadline_s = time.monotonic() + 5.0
        while True:  # The remote may still have to read the last reports.
            said = [entry.what for entry in peer.device.log]
            dark = [words for words in said if "LEDs" in words][-1:] == ["LEDs ----"]
            quiet = [words for words in said if "rumble" in words][-1:] == ["rumble off"]
            if (dark and quiet) or time.monotonic() > deadline_s:
                break
            time.sleep(0.01)
    assert last.error == "", last.arm.message
    assert "rumble on" in said, said
    assert [words for words in said if "rumble" in words][-1] == "rumble off"
    disarmed = said.index("LEDs ----")
    assert "LEDs 1---" in said[disarmed:], said
    assert [words for words in said if "LEDs" in words][-1] == "LEDs ----"
