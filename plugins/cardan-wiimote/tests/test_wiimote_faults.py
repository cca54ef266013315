"""Every fault of the simulated remote: neutral in time, and motion only after a new grip."""

import random

import pytest

from cardan.types import DeviceLink
from cardan_wiimote.driver import WiimoteOptions
from cardan_wiimote.driver.roles import ROLES, STICK_BUTTON
from cardan_wiimote.peer import FAULTS
from cardan_wiimote.protocol import CalibrationSource
from wiimote_bench import REST, Bench, fault_default

pytestmark = pytest.mark.matrix

NEUTRAL_WITHIN_S = 0.1
OPTIONS = WiimoteOptions(dead_zone=0.0)

NAMES = [switch.name for switch in FAULTS if switch.name != "refuse"]
"""All faults except "refuse", which exists only with sockets."""
FATAL = {"out-of-range", "power-off", "woken-by-1-2"}
"""Faults without recovery."""
BEFORE = {"in-range": "out-of-range", "power-on": "power-off"}
STOPS = {
    "silence", "out-of-range", "in-range", "power-off", "power-on", "close-control",
    "close-interrupt", "burst",
}  # fmt: skip
"""Faults that disengage teleoperation."""
NEEDS = {"woken-by-1-2": {"tr": True}, "hot-plug": {"extension": "nunchuk"}}


def faulty(name, options=OPTIONS, **more):
    faults = {name: fault_default(name)}
    if name in BEFORE:
        faults[BEFORE[name]] = fault_default(BEFORE[name])
    return Bench(options, faults=faults, **NEEDS.get(name, {}), **more)


def check(bench):
    """Check the safety rule at every step so far, with the clutch held since the start."""
    distrusted = False
    for now_s, age_s, state in bench.states:
        if any(state.axes):
            assert state.link is DeviceLink.LIVE, now_s
            assert age_s <= NEUTRAL_WITHIN_S, now_s
            assert not distrusted, f"moves again at {now_s:.3f} s without a new grip"
        elif state.link is not DeviceLink.LIVE:
            distrusted = True
        if age_s > NEUTRAL_WITHIN_S:
            assert state.link is not DeviceLink.LIVE, now_s
            # At the start the buttons may be reported by acknowledgments only.
            assert not state.buttons or state.link is DeviceLink.NEEDS_NEUTRAL, now_s
            assert state.reason, now_s
        if state.link is not DeviceLink.LIVE:
            assert state.axes == REST


@pytest.mark.judged(device="Wiimote", transport="virtual time", by="simulated peer")
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("extension", ["", "nunchuk"])
def test_every_fault(name, extension):
    bench = faulty(name) if name in NEEDS else faulty(name, extension=extension)
    if name == "woken-by-1-2":
        state = bench.run(5.0)
        assert state.link is not DeviceLink.LIVE
        return
    bench.ready(20.0 if name in ("lost-ack", "slow-memory", "burst") else 2.0)
    bench.states.clear()
    bench.press("a")
    bench.tilt(20, 10)
    moved = bench.run(0.3)
    if name != "burst":
        assert any(moved.axes[3:])
    bench.run(9.5)
    check(bench)
    last = bench.states[-1][2]
    if name in STOPS:
        assert last.axes == REST
    else:
        assert last.link is DeviceLink.LIVE
        assert any(last.axes[3:])
    bench.release("a")
    bench.states.clear()
    state = bench.run(2.5)
    assert state.axes == REST
    if name in FATAL:
        assert state.link is DeviceLink.LOST
        return
    bench.until(lambda b: b.state.link is DeviceLink.LIVE, 5.0)
    if name != "burst":
        bench.press("a")
        assert any(bench.run(0.3).axes)
        bench.release("a")
    edges = [down for _, down in bench.edges()]
    assert edges == [True, False] * (len(edges) // 2)


def test_silence_ends_in_stale_then_lost():
    bench = faulty("silence")
    bench.ready()
    bench.press("a")
    bench.run(3.0 - bench.now_s)
    assert any(bench.state.axes)
    assert bench.run(0.12).link is DeviceLink.STALE
    assert "no report for 0.09 s" in bench.state.reason
    bench.until(lambda b: b.state.link is DeviceLink.LOST, 0.45)
    assert "silent for 0.5 s" in bench.state.reason
    state = bench.run(1.0)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert bench.opened == 2
    bench.release("a")
    assert bench.state.link is DeviceLink.LIVE
    assert [edge for edge in bench.edges() if edge[0] == "a"] == [
        ("a", True), ("a", False),
    ]  # fmt: skip
    bench.press("a")
    assert bench.edges() == [("a", True)]


def test_reports_that_are_late_do_not_count_as_rest():
    """Reports queued while the link was down do not show the present state."""
    bench = Bench(OPTIONS)
    bench.ready()
    bench.press("a")
    rest = bytes.fromhex("31604084829f")
    bench.deaf = True
    bench.run(0.2)
    assert bench.state.link is DeviceLink.STALE
    for _ in range(5):
        bench.core.on_report(rest, bench.now_s)
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    bench.deaf = False
    assert bench.run(0.5).axes == REST
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL


def test_garbled_reports_alone_are_no_sign_of_life():
    bench = Bench(OPTIONS)
    bench.ready()
    bench.press("a")
    bench.deaf = True
    for _ in range(60):
        bench.core.on_report(b"\x31\x60", bench.now_s)
        bench.core.on_report(b"\x2a\x60\x60", bench.now_s)
        bench.core.on_report(b"", bench.now_s)
        bench.run(0.002)
    assert bench.state.link is DeviceLink.STALE
    words = " ".join(bench.diagnosis())
    assert "60 reports too short (id 0x31)" in words
    assert "60 reports of an unknown id (id 0x2a)" in words


def test_acknowledgments_alone_are_no_data():
    bench = Bench(OPTIONS)
    bench.ready()
    bench.press("a")
    bench.deaf = True
    for _ in range(60):
        bench.core.on_report(bytes.fromhex("2200081600"), bench.now_s)
        bench.run(0.002)
    assert (bench.state.link, bench.state.axes) == (DeviceLink.STALE, REST)


@pytest.mark.parametrize("needed", ["nunchuk", "motion-plus"])
def test_a_part_that_falls_silent(needed):
    """The remote keeps sending, but without valid data of the part that the roles need."""
    plus = needed == "motion-plus"
    options = WiimoteOptions(dead_zone=0.0, roles="gyro" if plus else "paper")
    bench = Bench(options, extension="" if plus else "nunchuk", motion_plus=plus)
    bench.ready()
    bench.press("b")
    if plus:
        bench.remote.set_attitude(0.0, 0.0, 0.0, (1.0, 0.0, 0.0))
    else:
        bench.remote.set_stick(1.0, 0.0)
    assert any(bench.run(0.2).axes[1:4])
    bench.remote.port.data = lambda size: b"\xff" * size
    stopped_s = bench.now_s
    bench.until(lambda b: b.state.link is DeviceLink.STALE, 0.12)
    assert bench.now_s - stopped_s <= NEUTRAL_WITHIN_S + 0.02
    assert "nothing usable" in bench.state.reason
    del bench.remote.port.data
    bench.remote.set_attitude(0.0, 0.0)
    bench.remote.set_stick(0.0, 0.0)
    assert bench.run(3.0).axes == REST
    bench.release("b")
    assert bench.run(3.0).link is DeviceLink.LIVE


def test_the_second_calibration_is_used():
    bench = faulty("bad-checksum")
    bench.ready()
    assert bench.metrics()["force_z_g"] == pytest.approx(1.0, abs=0.02)
    assert any("first copy" in words for words in bench.diagnosis())


def test_defaults_are_used_with_a_warning():
    bench = faulty("no-calibration")
    bench.ready()
    assert any("calibration is unreadable" in words for words in bench.diagnosis())
    assert bench.core._session.calibration_source is CalibrationSource.DEFAULT


def test_a_remote_that_never_answers_is_given_up():
    bench = Bench(OPTIONS)
    bench.deaf = True
    bench.until(lambda b: b.state.link is DeviceLink.LOST, 4.0)
    assert "does not answer" in bench.state.reason


def test_a_remote_that_drops_the_link_at_once_gets_advice():
    bench = faulty("woken-by-1-2")
    bench.identity = bench.identity._replace(late_model=True)
    bench.run(1.0)
    words = " ".join(bench.diagnosis())
    assert "sync" in words
    assert "-TR" in words


def test_a_simulated_remote_that_drops_the_link_is_held_by_another():
    bench = faulty("woken-by-1-2")
    bench.identity = bench.identity._replace(transport="socket")
    bench.run(1.0)
    words = " ".join(bench.diagnosis())
    assert "another program holds it" in words
    assert "paired" not in words


def test_the_rumble_ends_with_the_link():
    bench = faulty("close-interrupt")
    bench.ready()
    while bench.opened == 1:
        bench.core.set_rumble(1.0, bench.now_s)
        bench.run(0.1)
    assert bench.run(0.5).link is DeviceLink.LIVE
    assert not bench.remote.rumble


ACTS = (
    "press a", "release a", "press b", "release b", "press z", "release z", "tilt", "level",
    "stick", "let go", "deaf", "hear", "hear", "plug", "unplug", "shake", "still", "leave",
    "come back", "come back", "steal", "garbage", "off", "on", "on", "status",
)  # fmt: skip


def act(bench, what):
    remote, now_s = bench.remote, bench.now_s
    verb, _, label = what.partition(" ")
    if verb in ("press", "release") and (label != "z" or remote.port.nunchuk is not None):
        getattr(remote, verb)(label)
    elif what in ("tilt", "level"):
        bench.tilt(*((30, -20) if what == "tilt" else (0, 0)))
    elif what in ("stick", "let go"):
        remote.set_stick(*((0.7, -0.7) if what == "stick" else (0.0, 0.0)))
    elif what in ("deaf", "hear"):
        bench.deaf = what == "deaf"
    elif what in ("shake", "still"):
        remote.set_acceleration((0.0, 0.0, 1.0 if what == "shake" else 0.0))
    elif what == "come back":
        remote.come_back(now_s)
    elif what in ("plug", "unplug", "leave"):
        getattr(remote, what)(now_s)
    elif what in ("off", "on"):
        (remote.power_off if what == "off" else remote.power_on)(now_s)
    elif what in ("steal", "status"):
        remote.output(bytes.fromhex("120030" if what == "steal" else "1500"), now_s)
    elif what == "garbage":
        for report in (b"", b"\x31", b"\x35" + b"\xff" * 9, b"\x99" * 22):
            bench.core.on_report(report, now_s)


@pytest.mark.parametrize("roles", ROLES)
def test_whatever_happens(roles):
    """The axes are nonzero only for a live remote whose clutch was released after the last
    fault."""
    moved = 0
    for seed in range(8):
        bench = Bench(
            WiimoteOptions(roles=roles, dead_zone=0.0),
            motion_plus=True,
            extension="nunchuk",
            noise_lsb=1,
            seed=seed,
        )
        bench.ready()
        chosen = random.Random(seed)
        for _ in range(40):
            act(bench, chosen.choice(ACTS))
            bench.run(0.3 * chosen.random())
        moved += check_all(bench, ROLES[roles].clutch | {STICK_BUTTON})
        for what in ("release a", "release b", "release z", "let go", "hear", "still", "on",
                     "come back", "level"):  # fmt: skip
            act(bench, what)
        assert bench.run(6.0).link is DeviceLink.LIVE
    assert moved > 2


def check_all(bench, clutch):
    """Check the rule at every step; return whether the remote moved anything."""
    let_go = moved = False
    for now_s, age_s, state in bench.states:
        if state.link is not DeviceLink.LIVE:
            let_go = False
            assert state.reason
            assert state.axes == REST
        elif not state.buttons & clutch:
            let_go = True
            assert state.axes == REST
        if any(state.axes):
            moved = True
            assert let_go, now_s
            assert age_s <= NEUTRAL_WITHIN_S, now_s
        if age_s > NEUTRAL_WITHIN_S:
            assert state.link is not DeviceLink.LIVE, now_s
    down = {}
    for event in bench.core.events():
        assert down.get(event.button, False) is not event.pressed
        down[event.button] = event.pressed
    return moved
