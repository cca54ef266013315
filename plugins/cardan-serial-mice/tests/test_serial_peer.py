"""The simulated serial devices: in virtual time, then at their pseudo-terminal."""

import itertools
import os
import select
import time

import pytest

from cardan.errors import AddressError, OptionError, ScriptError
from cardan.sim_peers.base import parse_script
from cardan.sim_peers.scripted import play
from cardan.sim_peers.spacemouse.keyboard import KeyboardMotion, status_line
from cardan.sim_peers.spacemouse.motion_script import SCRIPT_VERBS, ScriptedPuck
from cardan_serial_mice.peer import (
    SERIAL_FAULTS,
    SerialPuckPeer,
    SerialPuckPeerOptions,
    peer as peer_module,
    simulated_serial_puck,
)
from cardan_serial_mice.protocol import (
    SERIAL_MODELS,
    MagellanKeys,
    MagellanMotion,
    MagellanReader,
    Malformed,
    OrbKeys,
    OrbMotion,
    OrbReader,
    OrbReset,
    SpaceballAdvancedKeys,
    SpaceballMotion,
    SpaceballReader,
    serial_model_by_key,
)
from tests.serving import in_a_thread
from tests.waiting import until

pytestmark = pytest.mark.matrix

PATIENCE_S = 10.0
STEP_S = 0.001
READERS = {"magellan": MagellanReader, "spaceball": SpaceballReader, "spaceorb": OrbReader}
UP = (0.0, 0.0, 0.5, 0.0, 0.0, 0.0)
REST = (0.0,) * 6


class Port:
    """A host at the port of a simulated device, in virtual time."""

    def __init__(self, key, faults=None, jitter_lsb=0, boot_s=None):
        self.puck = simulated_serial_puck(
            serial_model_by_key(key), faults=faults, jitter_lsb=jitter_lsb, boot_s=boot_s
        )
        self.now_s = 0.0
        self.received = []
        self.reader = READERS[self.puck.model.protocol]()
        self.values = []
        self.puck.power(True)

    def run(self, seconds):
        """Advance the time; return the bytes sent meanwhile."""
        came = b""
        end_s = self.now_s + seconds
        while self.now_s < end_s:
            self.now_s += STEP_S
            for portion in self.puck.reports(self.now_s):
                came += portion
                for value in self.reader.feed(portion):
                    self.values.append((self.now_s, value))
        self.received.append(came)
        return came

    def say(self, words, answer_s=0.3):
        """Send bytes at once; return the reply."""
        self.puck.receive(words)
        return self.run(answer_s)

    def say_slowly(self, words, pause_s=0.005):
        """Send bytes one by one; return the reply up to 0.3 s later."""
        came = b""
        for byte in words:
            self.puck.receive(bytes((byte,)))
            came += self.run(pause_s)
        return came + self.run(0.3)

    def motions(self, kind):
        return [(at_s, value) for at_s, value in self.values if isinstance(value, kind)]


# -- Magellan ----------------------------------------------------------------------------------


def test_the_start_up_of_vrpn():
    port = Port("magellan")
    port.run(1.0)
    assert port.say_slowly(b"z\rm3\rc30\rnH\rbH\r") == b"z\rm3\rc30\rnH\rb\r"
    assert port.puck.beeps == 1


def test_the_start_up_of_spacenavd():
    port = Port("magellan")
    assert port.say(b"\r@RESET\r", 2.0) == b""
    port.puck.receive(b"vQ\r")
    assert port.run(0.25)[:1] == b"v"
    assert port.received[-1].endswith(b"\r")
    assert b"MAGELLAN" in port.received[-1]
    assert port.say(b"m3\r") == b"m3\r"
    assert port.say(b"c3B\r") == b"c3B\r"


def test_the_start_up_of_inputattach():
    port = Port("magellan")
    port.run(1.0)
    assert port.say(b"m3\rpBB\rz\r") == b"m3\rpBB\rz\r"


def test_settings_are_kept_and_reported():
    port = Port("magellan")
    port.run(1.0)
    for setting in (b"m3", b"c3B", b"nA", b"qAB", b"pBB"):
        assert port.say(setting + b"\r") == setting + b"\r"
        assert port.say(setting[:1] + b"Q\r") == setting + b"\r"
    assert port.say(b"xy\r") == b"eAx\r"
    assert port.say(b"m1\r") == b"eAm\r"  # not a character of the alphabet
    assert port.say(b"dQ\r") == b"dH000H000H000H000H000H000\r"
    assert port.say(b"kQ\r") == b"k000\r"
    assert port.puck.refused_commands == 2
    port.puck.power(False)
    port.puck.power(True)
    port.run(1.0)
    assert port.say(b"nQ\r") == b"nH\r"


def test_a_deflected_magellan_reports_each_60_ms_and_once_at_rest():
    port = Port("magellan")
    port.run(1.0)
    port.puck.set_axes(UP)
    port.run(1.2)
    port.puck.set_axes(REST)
    port.run(1.0)
    motions = port.motions(MagellanMotion)
    gaps = [b[0] - a[0] for a, b in itertools.pairwise(motions)]
    assert all(gap == pytest.approx(0.06, abs=0.0021) for gap in gaps)
    assert len(motions) == pytest.approx(20, abs=1)
    assert [any(value) for _, value in motions] == [True] * (len(motions) - 1) + [False]
    assert motions[0][1] == MagellanMotion(0, 200, 0, 0, 0, 0)


def test_compressed_motion():
    port = Port("spaceball-5000")
    port.run(1.0)
    port.say(b"c33\r")
    port.puck.set_axes(UP)
    assert len(port.run(0.06)) <= 16
    assert port.run(1.0).count(b"d") == pytest.approx(17, abs=1)
    assert port.motions(MagellanMotion)[-1][1] == MagellanMotion(0, 200, 0, 0, 0, 0)


def test_modes_of_a_magellan():
    port = Port("magellan")
    port.run(1.0)
    port.puck.set_axes((0.5, 0.2, 0.0, 0.4, 0.0, 0.0))
    for mode, expected in (
        (b"mB", (-80, 0, -200, 0, 0, 0)),
        (b"mA", (0, 0, 0, 0, 0, -160)),
        (b"mG", (0, 0, -200, 0, 0, 0)),
    ):
        port.say(mode + b"\r")
        assert port.motions(MagellanMotion)[-1][1] == expected
    port.say(b"m:\r")
    assert port.run(0.5) == b""  # it is a mouse now
    port.say(b"m3\r")
    port.say(b"z\r")
    port.run(0.2)
    assert port.run(1.0) == b""
    assert port.motions(MagellanMotion)[-1][1] == (0,) * 6


def test_keys_of_a_magellan():
    port = Port("magellan")
    port.run(1.0)
    for label in ("1", "8", "star"):
        port.puck.press(label)
        port.run(0.1)
    assert port.puck.held == ("1", "8", "star")
    port.run(0.2)
    masks = [value.mask for _, value in port.motions(MagellanKeys)]
    assert masks == [1, 1 | 1 << 7, 1 | 1 << 7 | 1 << 8]
    assert port.received[-2].endswith(b"nH\rq00\r")  # star and 8 together: default settings
    port.puck.press("plus")
    assert port.run(0.1) == b"kAHA\r"  # without extended keys it is not reported
    port.say(b"c3B\r")
    assert port.say(b"kQ\r") == b"kAH3\r"


def test_a_command_without_its_end_makes_it_mute():
    port = Port("magellan")
    port.run(1.0)
    port.puck.set_axes(UP)
    assert port.run(0.5)
    port.puck.receive(b"m3")
    port.run(0.05)
    assert port.run(1.0) == b""
    assert port.say(b"\r", 0.05).startswith(b"m3\r")
    assert b"d" in port.run(0.5)


# -- Spaceball ---------------------------------------------------------------------------------


def test_a_spaceball_greets_and_waits_to_be_reported():
    port = Port("spaceball-3003")
    assert port.run(1.0).startswith(
        b"\x11\r@1 Spaceball alive and well after a poweron reset.\r@2 "
    )
    assert b"Firmware version 2.63" in port.received[-1]
    port.puck.set_axes(UP)
    assert port.run(1.0) == b""
    assert port.say(b"MSSV\r", 0.03).startswith(b"MSSV\r")
    port.run(1.0)
    assert port.motions(SpaceballMotion)[-1][1] == SpaceballMotion(800, 0, 4000, 0, 0, 0, 0)


def test_the_start_ups_of_spacenavd_and_vrpn_at_a_spaceball():
    port = Port("spaceball-2003")
    port.run(0.1)
    assert b"@1 Spaceball" in port.say(b"\r@RESET\r", 1.0)  # deaf, but the greeting is in time
    assert b"@1 Spaceball" in port.say(b"\r@RESET\r", 1.0)
    answer = port.say(b"\rCB\rMSSV\rk\r")
    assert answer == b"CB@\rMSSV\rK@@\r"
    answer = port.say_slowly(b"CB\rNT\rFTp\rFRp\rP@r@r\rMSSV\rZ\rBcCcC\r")
    echoes = answer.split(b"\r")[:-1]
    assert [len(echo) for echo in echoes] == [3, 2, 3, 3, 5, 4, 13]
    assert [echo[:1] for echo in echoes] == [b"C", b"N", b"F", b"F", b"P", b"M", b"Z"]
    assert port.puck.beeps == 1
    assert port.puck.refused_commands == 0
    assert port.say(b"W\r") == b"?W\r"


def test_a_line_that_is_full_is_no_reason_to_be_late():
    """Demand exceeds 9600 baud: the device measures when the line is free, and queues nothing."""
    port = Port("spaceball-3003", faults={"garbage": 1.0})
    port.run(1.0)
    port.say(b"MSSV\rP@T@T\r")  # every 20 ms, each after noise
    port.puck.set_axes(UP)
    port.run(20.0)
    port.puck.set_axes(REST)
    port.run(0.2)
    assert port.run(1.0) == b""


@pytest.mark.parametrize(
    ("key", "name"), [("spaceball-2003", b"Hm2003C\r"), ("spaceball-3003", b"Hm3003C\r")]
)
def test_the_start_up_of_inputattach_at_a_spaceball(key, name):
    port = Port(key)
    assert port.run(4.0).startswith(b"\x11\r@1 Spaceball alive")
    assert port.say_slowly(b"hm\r") == name
    assert port.say_slowly(b"P@A@A\rFT@\rMSS\r") == b"P@A@A\rFT@\rMSS\r"


def test_the_start_up_of_inputattach_at_a_4000_flx():
    port = Port("spaceball-4000")
    port.run(4.0)
    assert port.say(b"hm\r").startswith(b"HvFirmware")
    lines = port.say(b'"\r').split(b"\r")
    assert lines[0] == b'"1 Spaceball 4000 FLX'
    assert b" R " in lines[1]
    assert port.say(b"YS\rM\r") == b"YS\rM\r"


def test_a_spaceball_gives_displacements():
    port = Port("spaceball-2003")
    port.run(1.0)
    port.say(b"CB\rP@r@r\rMSSV\r")
    port.puck.set_axes((0.25, 0.0, 0.0, 0.0, 0.0, 0.5))
    port.run(1.0)
    assert port.motions(SpaceballMotion)[-1][1] == SpaceballMotion(800, 0, 0, 2000, 0, 800, 0)
    port.say(b"PAd@r\r")  # 100 ms: displacement twice as large
    port.run(1.0)
    assert port.motions(SpaceballMotion)[-1][1] == SpaceballMotion(1600, 0, 0, 4000, 0, 1600, 0)
    port.puck.receive(b"\x13")
    port.run(0.2)
    assert port.run(1.0) == b""
    port.puck.receive(b"\x11")
    assert b"D" in port.run(1.0)
    port.puck.set_axes(REST)
    port.run(1.0)
    at_rest = [not any(value[1:]) for _, value in port.motions(SpaceballMotion)]
    assert at_rest.count(True) == 1


def test_keys_of_a_4000_flx_come_both_ways():
    port = Port("spaceball-4000")
    port.run(1.0)
    port.puck.press("a")
    assert port.run(0.1) == b".d@\rK@@\r"
    port.puck.press("7")
    port.run(0.1)
    assert port.motions(SpaceballAdvancedKeys)[-1][1] == (0x64, 0xC0)


def test_power_loss_forgets_the_settings():
    port = Port("spaceball-2003", faults={"power-loss": 2.0})
    port.run(1.0)
    port.say(b"CB\rMSSV\r")
    port.puck.set_axes(UP)
    assert b"D" in port.run(0.5)
    port.run(0.4)
    assert b"@1 Spaceball alive" in port.run(1.0)
    assert port.run(1.0) == b""


# -- SpaceOrb ----------------------------------------------------------------------------------


def test_a_spaceorb_greets_and_beats_each_second():
    port = Port("spaceorb")
    assert port.run(0.95) == b""
    port.run(10.0)
    assert isinstance(port.values[0][1], OrbReset)
    beats = port.motions(OrbKeys)
    assert len(beats) in (10, 11)
    assert all(value == OrbKeys(100, 0) for _, value in beats[1:])
    port.puck.press("b")
    port.run(0.05)
    assert port.motions(OrbKeys)[-1][1].status == 2


def test_motion_of_a_spaceorb():
    port = Port("spaceorb")
    port.run(1.5)
    port.puck.press("a")
    port.puck.set_axes(UP)
    port.run(0.99)
    motions = port.motions(OrbMotion)
    assert len(motions) == pytest.approx(30, abs=1)
    assert motions[-1][1] == OrbMotion(1, 0, 254, 0, 0, 0, 0)
    port.puck.set_axes(REST)
    port.run(1.0)
    assert [any(value[1:]) for _, value in port.motions(OrbMotion)].count(False) == 1
    count = len(port.motions(OrbMotion))
    port.say(b"d\r")
    assert len(port.motions(OrbMotion)) == count + 1
    port.say(b"P\x80\x80\r")  # on request only
    port.puck.set_axes(UP)
    port.run(1.0)
    assert len(port.motions(OrbMotion)) == count + 1
    port.say(b"d\r")
    assert len(port.motions(OrbMotion)) == count + 2
    port.say(b"P\x80\xe4\r")
    port.run(1.0)
    assert len(port.motions(OrbMotion)) == pytest.approx(count + 15, abs=2)


def test_questions_to_a_spaceorb():
    port = Port("spaceorb")
    port.run(1.5)
    port.say(b"?\r")
    known_model = [value.data for _, value in port.values if hasattr(value, "data")]
    assert known_model[0].startswith(b"1 Spaceball (R)")
    port.say(b"N\x85\rn\r")
    known_model = [value.data for _, value in port.values if hasattr(value, "data")]
    assert known_model[-2:] == [b"\x05", b"\x05"]
    port.puck.set_axes((0.0, 0.0, 0.3, 0.0, 0.0, 0.0))
    port.puck.press("rezero")
    port.run(0.2)
    count = len(port.motions(OrbMotion))
    port.run(1.0)
    assert len(port.motions(OrbMotion)) == count


# -- all ---------------------------------------------------------------------------------------

MODELS = [model.key for model in SERIAL_MODELS]


@pytest.mark.parametrize("key", MODELS)
def test_without_power_or_while_it_starts_nothing_is_heard(key):
    port = Port(key)
    port.puck.power(False)
    port.puck.receive(b"vQ\r@RESET\r?\r")
    assert port.run(2.0) == b""
    port.puck.power(True)
    assert port.say(b"vQ\r@RESET\r?\r", 0.3) == b""


@pytest.mark.parametrize("key", MODELS)
def test_silence_unplug_and_nonsense(key):
    port = Port(key)
    port.run(1.5)
    port.puck.receive(b"MSSV\r")
    port.puck.set_axes(UP)
    assert port.run(1.2)
    port.puck.silence()
    port.run(0.2)
    assert port.say(b"vQ\rk\r?\r", 2.0) == b""
    port.puck.resume()
    assert port.run(1.2)
    port.puck.unplug()
    assert not port.puck.plugged
    assert port.run(1.0) == b""
    port.puck.replug()
    assert port.run(1.0) == b""  # until a program opens the port
    with pytest.raises(ValueError, match="six finite"):
        port.puck.set_axes((1.0,))
    with pytest.raises(ScriptError, match="has no button 'x'"):
        port.puck.press("x")


@pytest.mark.parametrize("fault", ["parity-error", "half-packet", "garbage", "missing-zero"])
@pytest.mark.parametrize("key", MODELS)
def test_a_bad_line(key, fault):
    port = Port(key, faults={fault: 3.0}, jitter_lsb=2)
    port.run(1.5)
    port.puck.receive(b"MSSV\r")
    good = 0
    for _ in range(6):
        port.puck.set_axes((0.3, 0.2, 0.5, -0.4, 0.1, -0.3))
        port.run(1.0)
        port.puck.set_axes(REST)
        port.run(0.5)
    good = sum(1 for _, value in port.values if not isinstance(value, Malformed))
    bad = sum(1 for _, value in port.values if isinstance(value, Malformed))
    assert good > 20
    # Packets of a Spaceball have no checksum: a wrong bit is a wrong value.
    if fault != "missing-zero" and not (fault == "parity-error" and key.startswith("spaceball-")):
        assert bad >= 10


@pytest.mark.parametrize("fault", ["key-lost", "key-parity", "key-half", "key-garbage"])
@pytest.mark.parametrize("key", MODELS)
def test_a_line_that_is_bad_for_keys(key, fault):
    def packets(faults):
        """Return the packets of each press and each release."""
        port = Port(key, faults=faults)
        port.run(1.5)
        label = next(iter(port.puck.model.buttons.values()))
        known_model = []
        for _ in range(4):
            port.puck.press(label)
            known_model.append(port.run(0.05))
            port.puck.release(label)
            known_model.append(port.run(0.05))
        return known_model

    good, bad = packets({}), packets({fault: 2.0})
    # For a SpaceOrb, the packet at power-up was the first one.
    odd = slice(int(key != "spaceorb"), None, 2)
    even = slice(int(key == "spaceorb"), None, 2)
    assert bad[even] == good[even]
    for known_model, expected in zip(bad[odd], good[odd], strict=True):
        assert known_model != expected
        assert (
            len(known_model)
            == {
                "key-lost": 0,
                "key-parity": len(expected),
                "key-half": len(expected) // 2,
                "key-garbage": max(len(known_model), len(expected) + 1),
            }[fault]
        )


def test_a_device_takes_its_place_at_power_up_for_rest():
    for key in MODELS:
        port = Port(key)
        port.puck.set_axes(UP)
        port.run(1.2)
        port.puck.receive(b"MSSV\r")
        port.run(1.2)
        kinds = (MagellanMotion, SpaceballMotion, OrbMotion)
        assert not port.motions(kinds)
        port.puck.set_axes(REST)
        port.run(0.5)
        assert any(any(value[1:]) for _, value in port.motions(kinds))


def test_when_a_host_has_begun():
    for key, words in (
        ("magellan", b"m3\r"),
        ("magellan", b"kQ\r"),
        ("spaceball-2003", b"MSSV\r"),
        ("spaceball-4000", b"k\r"),
    ):
        port = Port(key)
        port.say(b"vQ\r@RESET\rCB\r", 1.5)
        assert not port.puck.host_began
        port.say(words)
        assert port.puck.host_began
    for key, faults in (("spaceorb", {}), ("magellan", {"deaf": 1.0}), ("magellan", {"mute": 1.0})):
        port = Port(key, faults=faults)  # a host need not begin, or cannot
        assert not port.puck.host_began
        port.run(1.2)
        assert port.puck.host_began


def test_answers_may_be_slow_and_the_line_dead():
    port = Port("magellan", faults={"slow-answer": 400.0})
    port.run(1.0)
    assert port.say(b"vQ\r", 0.39) == b""
    assert port.run(0.2).startswith(b"v")
    for fault in ("mute", "deaf"):
        port = Port("magellan", faults={fault: 1.0})
        port.run(1.0)
        assert port.say(b"vQ\r") == b""
        port.puck.set_axes(UP)
        assert bool(port.run(0.5)) is (fault == "deaf")


def test_drift_and_overrange_and_a_stuck_button():
    port = Port("magellan", faults={"drift": 20.0, "overrange": 1.5, "stuck-button": 1.0})
    port.run(2.0)
    assert port.motions(MagellanMotion)[-1][1] == (20,) * 6
    port.puck.set_axes((0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    port.puck.press("1")
    port.puck.release("1")
    port.run(0.5)
    assert port.motions(MagellanMotion)[-1][1][1] == 620
    assert port.motions(MagellanKeys)[-1][1].mask == 1


def test_a_stalled_peer_makes_no_burst():
    steps = parse_script("1.0 axes 0 0 0.5 0 0 0", SCRIPT_VERBS)
    puck = simulated_serial_puck(serial_model_by_key("magellan"))
    hand = ScriptedPuck(steps, puck.model)
    puck.power(True)
    play(puck, hand, 1.5)
    hand.advance(9.9, puck)
    puck.skip_to(9.9)
    assert len(play(puck, hand, 10.0)) <= 6


def test_keys_of_a_terminal_move_it_too():
    puck = simulated_serial_puck(serial_model_by_key("spaceorb"))
    keys = KeyboardMotion()
    keys.feed("W ", 0.0)
    keys.advance(0.1, puck)
    assert puck.axes[0] == pytest.approx(0.4)
    assert puck.held == ("a",)
    assert status_line(puck).startswith("x +0.40")  # and no LED


def test_every_fault_does_something_and_others_are_refused():
    with pytest.raises(ScriptError, match="there is no fault 'x'"):
        Port("magellan", faults={"x": 1.0})
    with pytest.raises(ScriptError, match="needs the fault unplug"):
        Port("magellan", faults={"replug": 1.0})
    port = Port("magellan", faults={"unplug": 1.0, "replug": 2.0, "silence": 3.0, "burst": 0.25})
    port.run(1.5)
    assert not port.puck.plugged
    port.run(1.0)
    assert port.puck.plugged
    port.puck.power(True)
    port.run(0.6)
    port.puck.set_axes(UP)
    assert port.run(1.0)
    port.run(1.0)
    assert port.run(1.0) == b""
    assert {switch.name for switch in SERIAL_FAULTS} >= {"refuse", "half-packet", "power-loss"}


# -- the pseudo-terminal -----------------------------------------------------------------------


def options(tmp_path, script="", **more):
    file = tmp_path / "script"
    file.write_text(script or "0.0 neutral")
    return SerialPuckPeerOptions(port=str(tmp_path / "port"), script=str(file), **more)


def hear(fd, wanted, patience_s=PATIENCE_S):
    """Read until `wanted` has arrived."""
    came = b""
    end_s = time.monotonic() + patience_s
    while wanted not in came:
        left_s = end_s - time.monotonic()
        assert left_s > 0.0, came
        if select.select([fd], [], [], left_s)[0]:
            data = os.read(fd, 4096)
            if not data:
                raise EOFError
            came += data
    return came


def test_the_port_is_a_terminal_and_powers_the_device(tmp_path):
    peer = SerialPuckPeer(options(tmp_path, boot_s=0.02))
    assert peer.endpoint == str(tmp_path / "port")
    with in_a_thread(peer):
        assert not peer.device.powered
        fd = os.open(peer.endpoint, os.O_RDWR | os.O_NOCTTY)
        assert os.isatty(fd)
        until(lambda: peer.device.powered)
        until(lambda: peer.device.next_due_s == float("inf"))
        os.write(fd, b"\rnA\rvQ\r")
        assert hear(fd, b"97 \r").startswith(b"nA\rv   MAGELLAN")
        os.close(fd)
        until(lambda: not peer.device.powered)
        fd = os.open(peer.endpoint, os.O_RDWR | os.O_NOCTTY)
        until(lambda: peer.device.powered)
        until(lambda: peer.device.next_due_s == float("inf"))
        os.write(fd, b"nQ\r")
        assert hear(fd, b"\r") == b"nH\r"  # as after power-up
        os.close(fd)
    assert not os.path.lexists(peer.endpoint)


def test_unplugging_hangs_the_port_up(tmp_path):
    script = "0.1 unplug\n0.3 replug"
    peer = SerialPuckPeer(options(tmp_path, script, model="spaceorb", boot_s=0.0))
    with in_a_thread(peer):
        fd = os.open(peer.endpoint, os.O_RDWR | os.O_NOCTTY)
        hear(fd, b"R")
        with pytest.raises((EOFError, OSError)):
            hear(fd, b"nothing more")
        os.close(fd)
        assert not os.path.lexists(peer.endpoint)
        until(lambda: os.path.exists(peer.endpoint))
        fd = os.open(peer.endpoint, os.O_RDWR | os.O_NOCTTY)
        hear(fd, b"R")
        os.close(fd)


def test_the_script_waits_for_a_host(tmp_path, monkeypatch):
    monkeypatch.setattr(peer_module, "SCRIPT_DELAY_S", 0.2)
    script = "0.0 axes 0 0 0.5 0 0 0"
    peer = SerialPuckPeer(options(tmp_path, script, boot_s=0.0, faults={"unplug": 0.4}))
    with in_a_thread(peer):
        fd = os.open(peer.endpoint, os.O_RDWR | os.O_NOCTTY)
        until(lambda: peer.device.powered)
        os.write(fd, b"vQ\r")
        hear(fd, b"97 \r")
        assert not select.select([fd], [], [], 0.6)[0]  # it is not that long
        os.write(fd, b"m3\r")
        asked_s = time.monotonic()
        assert hear(fd, b"d").startswith(b"m3\r")
        assert time.monotonic() - asked_s >= 0.2
        assert peer.device.plugged
        until(lambda: not peer.device.plugged)  # times of faults count from the script, too
        assert time.monotonic() - asked_s >= 0.6
        os.close(fd)


def test_a_link_that_a_killed_peer_left_is_taken_over(tmp_path):
    dead = SerialPuckPeer(options(tmp_path))
    dead.open()
    left = os.readlink(dead.endpoint), (tmp_path / "port.lock").read_text()
    assert left[0] == left[1]
    dead.close()
    assert list(tmp_path.iterdir()) == [tmp_path / "script"]
    master, slave = os.openpty()  # Another process has reused the number.
    os.symlink(os.ttyname(slave), tmp_path / "port")
    with pytest.raises(AddressError, match="no simulated device made it"):
        SerialPuckPeer(options(tmp_path)).open()
    assert os.path.islink(tmp_path / "port")
    (tmp_path / "port.lock").write_text(os.ttyname(slave))
    peer = SerialPuckPeer(options(tmp_path))
    peer.open()
    assert os.readlink(peer.endpoint) != os.ttyname(slave)
    peer.close()
    (tmp_path / "port.lock").write_text("mine")
    with pytest.raises(AddressError, match="is not the lock of a link"):
        SerialPuckPeer(options(tmp_path)).open()
    assert (tmp_path / "port.lock").read_text() == "mine"
    os.close(master)
    os.close(slave)


def test_a_refused_port_comes_later(tmp_path):
    with in_a_thread(SerialPuckPeer(options(tmp_path, faults={"refuse": 0.1}))) as peer:
        assert not os.path.lexists(peer.endpoint)
        until(lambda: os.path.exists(peer.endpoint))


def test_paths_that_are_taken(tmp_path):
    first = SerialPuckPeer(options(tmp_path))
    first.open()
    with pytest.raises(AddressError, match="another simulated device"):
        SerialPuckPeer(options(tmp_path)).open()
    first.close()
    first.close()
    os.symlink("/dev/pts/not-there", tmp_path / "port")  # of a peer that has died
    again = SerialPuckPeer(options(tmp_path))
    again.open()
    again.close()
    (tmp_path / "port").write_text("mine")
    with pytest.raises(AddressError, match="is not a link"):
        SerialPuckPeer(options(tmp_path)).open()
    (tmp_path / "port").unlink()
    nowhere = SerialPuckPeerOptions(port=str(tmp_path / "no" / "port"), script="rest")
    with pytest.raises(AddressError, match="cannot create the link"):
        SerialPuckPeer(nowhere).open()


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"model": "spaceball-9000"}, "model: 'spaceball-9000' is .* it must be one of magellan"),
        ({"jitter_lsb": -1}, "jitter_lsb: -1 .* it must be"),
        ({"boot_s": -1.0}, r"boot_s: -1\.0 .* it must be"),
        ({"faults": {"seized": 1.0}}, "there is no fault 'seized'"),
        ({"script": "1.0 press left"}, "has no button 'left'"),
    ],
)
def test_bad_options(tmp_path, settings, words):
    error = OptionError if "it must be" in words else ScriptError
    with pytest.raises(error, match=words):
        SerialPuckPeer(options(tmp_path, **settings))
