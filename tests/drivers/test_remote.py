"""A device on another computer: age of states, button edges, and ownership."""

import math
import struct
from collections import Counter
from random import Random

import pytest

from cardan.drivers.remote import Remote, RemoteOptions
from cardan.drivers.remote.core import RemoteCore
from cardan.drivers.remote.shared import (
    CLAIM_PERIOD_S,
    CLAIM_TYPE,
    MOST_EDGES,
    STATE_TYPE,
    Claim,
    Edge,
    Shared,
    SharedDecoder,
    SharedEncoder,
    UnusableError,
    claim_message,
    read_claim,
    read_shared,
    shared_message,
)
from cardan.drivers.ros2_nodes.core import MOST_BYTES
from cardan.errors import DeviceNotFoundError, OptionError
from cardan.gateway.bus.sharing import LEASE_S, ShareCore, ShareOptions
from cardan.gateway.session.assembly import checked_config
from cardan.gateway.session.cautions import cautions
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.types import (
    NEUTRAL,
    NEVER_S,
    Axes,
    ButtonEvent,
    DeviceFeedback,
    DeviceLink,
    DeviceState,
    Frame,
    Inertia,
    Pose,
    Quaternion,
    Vector3,
    Wrench,
)
from tests.drivers.remote_bench import ABLE, LAN, STEP_S, Bench, Link, in_age, received

WIFI = Link(0.001, 0.015, loss=0.01, in_order=False, twice=0.01)
LTE = Link(0.025, 0.04, loss=0.01, in_order=False)
INTERNET = Link(0.110, 0.020, loss=0.005)
BAD = Link(0.005, 0.030, loss=0.10, twice=0.10, in_order=False)
PLAYOUTS = pytest.mark.parametrize("playout_ms", [0.0, 100.0], ids=["", "playout"])
NETWORKS = pytest.mark.parametrize(
    ("link", "max_age_s"),
    [(LAN, 0.15), (WIFI, 0.15), (LTE, 0.2), (INTERNET, 0.3), (BAD, 0.3)],
    ids=["lan", "wifi", "lte", "internet", "bad"],
)


@pytest.mark.matrix(  # With every change, one offset without playout and the other with it.
    *(f"{ids}-{link}" for ids in ("-1000000.0", "playout--40.0") for link in NETWORKS.kwargs["ids"])
)
@NETWORKS
@pytest.mark.parametrize("offset_s", [-40.0, 1e6])
@PLAYOUTS
def test_nothing_counts_that_is_too_old(link, max_age_s, offset_s, playout_ms):
    options = {"max_age_s": max_age_s, "playout_ms": playout_ms}
    bench = Bench(link, offset_s=offset_s, drift=50e-6, **options).live()
    error_s = 0.5 * (2.0 * link.delay_s + link.jitter_s) + 3 * STEP_S
    assert in_age(bench, max_age_s + error_s, 4.0) > 1500
    assert bench.count("clock_resets") == 0
    assert bench.count("future") == bench.count("back") == 0


@NETWORKS
def test_every_edge_comes_once_and_in_order(link, max_age_s):
    bench = Bench(link, max_age_s=max_age_s).live()
    for number in range(40):
        bench.press("hold" if number % 2 else "grip", True)
        bench.run(0.03)
        bench.press("hold" if number % 2 else "grip", False)
        bench.run(0.05)
    bench.run(1.0)
    reported = [(event.button, event.pressed) for event in bench.heard]
    assert reported == [
        ("hold" if number % 2 else "grip", pressed)
        for number in range(40)
        for pressed in (True, False)
    ]
    assert bench.count("missed_edges") == 0


def test_a_tap_within_one_state_has_both_edges():
    bench = Bench().live()
    bench.press()
    bench.press(pressed=False)
    bench.run(0.05)
    assert [event.pressed for event in bench.heard] == [True, False]


@pytest.mark.parametrize("seconds", [STEP_S, 0.1])
def test_a_press_whose_edge_is_taken_after_its_state_counts(seconds):
    bench = Bench().live()
    bench.press()
    later, bench.edges = bench.edges, []
    bench.run(seconds)
    assert (bench.state.buttons, bench.heard) == (frozenset(), [])
    bench.edges = later
    bench.run(0.1)
    assert bench.state.buttons == {"hold"}
    assert [event.pressed for event in bench.heard] == [True]
    assert bench.count("old_presses") == 0


@pytest.mark.parametrize("stall_s", [0.3, 0.6, 5.0])
@PLAYOUTS
def test_after_a_stall_nothing_is_caught_up(stall_s, playout_ms):
    bench = Bench(Link(0.045, 0.020), playout_ms=playout_ms).live()
    bench.press()
    bench.run(0.2)
    assert bench.state.buttons == {"hold"}
    fresh_s = bench.now_s
    bench.down.stall(bench.now_s + stall_s)
    seen = []
    in_age(bench, 0.15 + 0.07, stall_s + 0.5, lambda: seen.append((bench.now_s, bench.state)))
    lost_s = next(at_s for at_s, state in seen if state.link is DeviceLink.STALE)
    assert lost_s - fresh_s <= 0.15 + 2 * STEP_S
    # The hand did not stop: states count only after neutral and a new press of hold.
    assert (bench.state.axes, bench.state.buttons) == (NEUTRAL, frozenset())
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    assert "let go" in bench.state.reason
    bench.move(0.0)
    bench.run(0.2)
    assert (bench.state.link, bench.state.buttons) == (DeviceLink.LIVE, frozenset())
    bench.press(pressed=False)
    bench.run(0.2)
    bench.press()
    bench.run(0.2)
    assert bench.state.buttons == {"hold"}


@pytest.mark.parametrize("still_s", [0.3, 0.9, 3.0])
def test_what_was_done_while_the_sharing_process_stood_still_counts_for_nothing(still_s):
    """It reads all events only then, with new stamps."""
    bench = Bench().live()
    bench.press()
    bench.run(0.1)
    assert bench.state.buttons == {"hold"}
    bench.frozen = True
    bench.run(still_s)
    assert (bench.state.link, bench.state.buttons) == (DeviceLink.STALE, frozenset())
    bench.heard.clear()
    bench.frozen = False
    bench.run(0.01)  # The loop runs before the reader of the device.
    bench.press(pressed=False)
    bench.press()
    bench.press("grip")
    bench.move(0.5)
    seen = []
    bench.run(0.5, lambda: seen.append(bench.state))
    assert not [event for event in bench.heard if event.pressed]
    assert not any(any(state.axes) or state.buttons for state in seen)
    assert any("stalled for" in state.reason for state in seen)
    assert (bench.state.link, bench.count("missed_edges")) == (DeviceLink.NEEDS_NEUTRAL, 0)
    bench.move(0.0)
    bench.press(pressed=False)
    bench.run(0.1)
    bench.press()
    bench.run(0.1)
    assert (bench.state.link, bench.state.buttons) == (DeviceLink.LIVE, {"hold"})


def sent_while(bench, seconds, each=lambda: None):
    """Return the number of states sent per second while the deflection changes in each step."""
    before = len(bench.sent)

    def step():
        each()
        bench.move(0.5 + 0.4 * math.sin(bench.now_s))

    bench.run(seconds, step)
    return (len(bench.sent) - before) / seconds


def test_what_a_link_does_not_carry_is_not_sent():
    bench = Bench(LAN, max_age_s=0.5).live()
    free_hz = sent_while(bench, 1.0)
    bench.down.rate_bps = 200e3  # about 100 states per second
    sent_while(bench, 1.0)
    came = len(bench.came)
    assert sent_while(bench, 2.0) <= 0.5 * free_hz
    assert max(at_s - sent_s for at_s, sent_s, _ in bench.came[came:]) <= 0.1
    # The release of a button does not wait for other states.
    bench.press()
    sent_while(bench, 0.5)
    bench.press(pressed=False)
    before_s = bench.now_s
    sent_while(bench, STEP_S)
    assert list(bench.sent.values())[-1][0] == pytest.approx(before_s + STEP_S)
    bench.down.rate_bps = math.inf
    sent_while(bench, 0.2)
    assert sent_while(bench, 1.0) == pytest.approx(free_hz, rel=0.05)


@pytest.mark.parametrize("rate_bps", [math.inf, 200e3])
def test_the_first_state_of_a_motion_and_its_last_wait_for_no_others_turn(rate_bps):
    bench = Bench(LAN, max_age_s=0.5).live()
    bench.down.rate_bps = rate_bps
    for since in range(20):  # for any time since the last answered claim
        for x in (0.5, 0.0):
            # On a saturated link other states wait longer.
            sent_while(bench, 0.5)
            bench.move(0.5 - x)
            bench.run(0.15 + since * STEP_S)
            bench.move(x)
            bench.run(STEP_S)
            assert list(bench.sent.values())[-1][0] == bench.now_s


def test_a_hand_that_trembles_about_rest_fills_no_link():
    bench = Bench(LAN, max_age_s=0.5).live()
    bench.down.rate_bps = 200e3
    sent_while(bench, 1.0)
    came = len(bench.came)
    bench.run(4.0, lambda: bench.move(0.0 if bench.device.axes.x else 0.5))
    assert max(at_s - sent_s for at_s, sent_s, _ in bench.came[came:]) <= 0.1


def test_what_is_sent_into_a_stall_is_little_and_what_comes_after_it_is_not():
    bench = Bench(LTE._replace(in_order=True), max_age_s=0.25).live()
    moving_hz = sent_while(bench, 1.0)
    for way in (bench.down, bench.up):
        way.stall(bench.now_s + 1.0 - 0.1)
    assert sent_while(bench, 0.9) <= 0.25 * moving_hz
    sent_while(bench, 2 * LTE.slowest_s)
    assert sent_while(bench, 1.0) >= 0.8 * moving_hz


def test_claims_that_are_late_slow_no_state_down():
    bench = Bench(LAN, max_age_s=0.5).live()
    free_hz = sent_while(bench, 1.0)
    bench.up.link = LAN._replace(delay_s=0.26)
    sent_while(bench, 0.5)
    assert sent_while(bench, 1.0) >= 0.95 * free_hz


def test_a_press_that_is_too_old_arms_nothing_and_a_release_lets_go():
    bench = Bench().live()
    bench.press("grip")
    bench.run(0.1)
    bench.heard.clear()
    # Only states with edges are lost, while these are repeated.
    bench.mangle = lambda message: message | {"edges": [], "buttons": ["grip"]}
    bench.press("hold")
    bench.press("grip", False)
    bench.run(0.5)
    bench.mangle = lambda message: message
    bench.run(0.1)
    assert bench.state.link is DeviceLink.LIVE
    assert [(event.button, event.pressed) for event in bench.heard] == [("grip", False)]
    assert (bench.state.buttons, bench.count("old_presses")) == (frozenset(), 1)
    bench.press("hold", False)
    bench.press("hold")
    bench.run(0.1)
    assert bench.state.buttons == {"hold"}


def test_edges_beyond_the_most_that_wait_are_counted():
    bench = Bench().live()
    bench.press()
    bench.press(pressed=False)
    bench.run(0.1)
    bench.up.cut = True
    bench.down.cut = True
    for _ in range(MOST_EDGES):
        bench.press()
        bench.press(pressed=False)
    bench.run(0.3)
    bench.up.cut = bench.down.cut = False
    bench.run(0.3)
    assert bench.count("missed_edges") == MOST_EDGES
    assert bench.share.counts["edges that were not acknowledged in time"] == MOST_EDGES


@pytest.mark.parametrize("way", ["up", "down"])
@PLAYOUTS
def test_a_link_that_is_cut_in_one_direction_stops_in_time(way, playout_ms):
    bench = Bench(LTE, max_age_s=0.2, playout_ms=playout_ms).live()
    bench.move(0.5)
    bench.run(0.3)
    assert bench.state.axes.x == 0.5
    getattr(bench, way).cut = True
    bench.run(0.2 + CLAIM_PERIOD_S + 0.13)
    assert (bench.state.link, bench.state.axes) == (DeviceLink.STALE, NEUTRAL)
    bench.move(0.0)
    getattr(bench, way).cut = False
    bench.run(0.5)
    assert bench.state.link is DeviceLink.LIVE


# -- wrong clocks ---------------------------------------------------------------------------------


SEEDS_NOW = {"-lan": 0, "-lte": 1, "playout-lan": 2, "playout-lte": 3}
"""Seed of each link in the runs with every change; in the matrix, all links have all seeds."""


@pytest.mark.matrix(
    *(f"{ids}-{seed}" for ids, now in SEEDS_NOW.items() for seed in range(4) if seed != now)
)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("link", [LAN, LTE], ids=["lan", "lte"])
@PLAYOUTS
def test_no_clock_makes_a_state_younger_than_its_round_trip_allows(link, seed, playout_ms):
    """The operator's clock jumps by the length of a stall, at the time that hides the stall
    best."""
    bench = Bench(link, seed=seed, max_age_s=0.15, playout_ms=playout_ms).live()
    round_s = bench.core.metrics(bench.now_s)["round_trip_s"]
    bound_s = 0.15 + CLAIM_PERIOD_S + round_s + 2 * STEP_S
    began_s = bench.now_s
    lies = {0.5: 0.4, 1.5: 0.9, 2.5: 2.0, 3.5: -0.3, 4.5: 0.14}

    def lie():
        for at_s, lie_s in lies.items():
            if abs(bench.now_s - began_s - at_s) < 0.5 * STEP_S:
                bench.down.stall(bench.now_s + abs(lie_s))
                bench.lie_s += lie_s

    assert in_age(bench, bound_s, 6.0, lie)


@pytest.mark.parametrize("lie_s", [-0.6, -0.45, -0.4])
def test_no_clock_that_goes_back_makes_a_press_younger(lie_s):
    bench = Bench().live()
    bench.down.cut = True
    bench.press()
    bench.run(0.5)
    bench.lie_s = lie_s
    bench.device = bench.device._replace(stamp_s=bench.there_s)
    bench.down.cut = False
    bench.run(0.2, lambda: bench.move(0.0))
    # A state whose edges seem to be in the future is unused until they are acknowledged or past.
    assert (bench.state.buttons, bench.heard) == (frozenset(), [])
    bench.run(1.0)
    assert (bench.state.buttons, bench.heard) == (frozenset(), [])
    bench.press(pressed=False)
    bench.run(0.1)
    bench.press()
    bench.run(0.1)
    assert (bench.state.link, bench.state.buttons) == (DeviceLink.LIVE, {"hold"})


@pytest.mark.parametrize("lie_s", [0.0, 0.06, 0.08, 0.095])
def test_no_clock_makes_a_press_younger_than_the_claim_that_its_state_echoes_allows(lie_s):
    bench = Bench().live()
    bench.lie_s = lie_s
    bench.down.stall(bench.now_s + 0.2)
    bench.press()
    bench.run(0.5)
    assert (bench.state.buttons, bench.heard) == (frozenset(), [])
    assert bench.count("old_presses") == 1


def test_a_clock_that_runs_ahead_is_refused_until_a_round_trip_tells():
    bench = Bench().live()
    bench.up.cut = True
    bench.lie_s = 0.5
    bench.run(0.1)
    assert bench.count("future") > 0
    bench.up.cut = False
    bench.run(0.5)
    assert bench.count("clock_resets") == 1
    assert bench.state.link is DeviceLink.LIVE


def test_a_computer_that_slept_is_believed_again():
    bench = Bench().live()
    bench.down.cut = bench.up.cut = True
    bench.run(20.0, lambda: setattr(bench, "lie_s", bench.lie_s - STEP_S * 0.9))
    assert bench.state.link is DeviceLink.STALE
    bench.down.cut = bench.up.cut = False
    bench.run(1.0)
    assert bench.state.link is DeviceLink.LIVE


def test_stamps_that_go_back_are_refused():
    bench = Bench().live()
    bench.move(0.5)
    bench.run(0.1)
    bench.mangle = lambda message: (
        message | {"sent": message["sent"] - 2.0, "edges": [], "report": message["report"] - 2.0}
    )
    bench.run(0.3)
    assert bench.count("back") > 5
    assert (bench.state.link, bench.state.axes) == (DeviceLink.STALE, NEUTRAL)


def test_echoes_of_what_was_not_asked_are_refused():
    bench = Bench().live()
    bench.mangle = lambda message: message | {"asked": message["asked"] + 1.0}
    bench.run(0.3)
    assert bench.state.link is DeviceLink.STALE
    assert any("answer no request" in line for line in bench.core.diagnosis(bench.now_s))


# -- behavior of the remote device ----------------------------------------------------------------


def test_a_device_that_is_lost_there_is_lost_here_with_its_reason():
    bench = Bench().live()
    bench.press()
    bench.move(0.5)
    bench.run(0.1)
    bench.move(link=DeviceLink.LOST, reason="unplugged")
    bench.press(pressed=False)
    bench.run(0.1)
    state = bench.state
    assert (state.link, state.axes, state.buttons) == (DeviceLink.LOST, NEUTRAL, frozenset())
    assert state.reason == "at the operator's computer: unplugged"
    bench.move(link=DeviceLink.LOST, reason="its power is off")
    bench.run(0.1)
    assert bench.state.reason == "at the operator's computer: its power is off"
    bench.move(0.5)
    bench.run(0.1)
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    bench.move(0.0)
    bench.run(0.1)
    assert bench.state.link is DeviceLink.LIVE
    round_ms = 1e3 * bench.core.metrics(bench.now_s)["round_trip_s"]
    bench.down.stall(bench.now_s + 1.0)
    bench.run(0.5)
    assert f"(quickest round trip {round_ms:.0f} ms)" in bench.state.reason


def test_all_that_a_device_measures_comes():
    bench = Bench().live()
    pose = Pose(Vector3(0.1, 0.2, 0.3), Quaternion(0.0, 1.0, 0.0, 0.0))
    wrench = Wrench(Vector3(1.0, 2.0, 3.0), Vector3(0.1, 0.2, 0.3), Frame.TOOL)
    inertia = Inertia(Vector3(0.0, 0.0, 9.81), Vector3(0.1, 0.0, 0.0))
    measured = {"pose": pose, "battery": 0.5, "wrench": wrench, "inertia": inertia}
    bench.device = bench.device._replace(**measured)
    bench.run(0.1)
    assert {key: getattr(bench.state, key) for key in measured} == measured
    assert bench.core.capabilities == ABLE
    assert bench.core.driver == "spacemouse"
    assert 0.0 <= bench.now_s - bench.state.stamp_s <= 1.2


def decoded_alone(data):
    message = codec_of(STATE_TYPE).decode(data)
    return message if isinstance(message, MalformedCdr) else read_shared(message)


def outcome(decode, data):
    try:
        return decode(data)
    except UnusableError as error:
        return str(error)


def test_a_message_means_the_same_whichever_one_was_before_it():
    random = Random(1)
    encoder, decoder = SharedEncoder(), SharedDecoder()
    shared = Shared(
        5, 10.0, 7, "cell", 9.9, DeviceState(9.8, DeviceLink.LIVE, NEUTRAL, frozenset())
    )
    outcomes = Counter()
    for step in range(4000):
        axes = Axes(*(random.choice([0.0, random.uniform(-1.0, 1.0)]) for _ in range(6)))
        state = shared.state._replace(stamp_s=10.0 + step * 0.008, axes=axes)
        if random.random() < 0.1:
            pose = Pose(Vector3(0.1, 0.2, 0.3), Quaternion(1.0, 0.0, 0.0, 0.0))
            state = state._replace(
                buttons=frozenset(random.sample(["left", "right", "menu"], random.randrange(3))),
                pose=random.choice([None, pose]),
                battery=random.choice([None, 0.5]),
                link=random.choice(list(DeviceLink)),
            )
        shared = shared._replace(
            sent_s=state.stamp_s + 0.001,
            asked_s=random.choice([NEVER_S, state.stamp_s]),
            state=state,
            capabilities=ABLE if random.random() < 0.2 else None,
            edges=(Edge(1, 9.0, "left", True),) if random.random() < 0.1 else (),
        )
        data = encoder.encode(shared)
        assert data == codec_of(STATE_TYPE).encode(shared_message(shared))
        if random.random() < 0.3:
            changed = bytearray(data)
            begin = random.randrange(len(data) - 8)
            changed[begin : begin + 8] = random.choice(
                [bytes(8), b"\xff" * 8, struct.pack("<d", 2.0), random.randbytes(8)]
            )
            data = bytes(changed)[: random.choice([len(data), len(data) - 8])]
        found = outcome(decoder.decode, data)
        assert found == outcome(decoded_alone, data)
        outcomes[type(found)] += 1
    assert outcomes[Shared] > 2000
    assert outcomes[str] > 100
    assert outcomes[MalformedCdr] > 100


def test_force_is_not_passed_back():
    able = ABLE._replace(feedback=frozenset({"wrench", "led"}))
    share = ShareCore("omni", 1)
    share.on_received(received(CLAIM_TYPE, claim_message(claim())), 1.0)
    shared = share.offer(DeviceState(0.5, DeviceLink.LIVE, NEUTRAL, frozenset()), (), able, 1.0)
    there = read_shared(shared_message(shared))
    assert there.capabilities.feedback == {"led"}


def test_light_and_rumble_go_back_and_end_with_the_lease():
    bench = Bench()
    bench.given = DeviceFeedback(led=True, rumble=0.5)
    bench.live()
    assert bench.share.feedback(bench.there_s) == DeviceFeedback(True, 0.5)
    bench.up.cut = True
    bench.run(LEASE_S + 0.1)
    assert bench.share.feedback(bench.there_s) == DeviceFeedback(False, 0.0)


def test_light_is_given_again_to_a_device_that_was_unplugged():
    bench = Bench()
    bench.given = DeviceFeedback(led=True, rumble=0.5)
    bench.live()
    assert bench.share.feedback_due(bench.there_s) == bench.given
    assert bench.share.feedback_due(bench.there_s) is None
    bench.move(link=DeviceLink.LOST, reason="unplugged")
    bench.run(0.1)
    assert bench.share.feedback_due(bench.there_s) is None
    bench.move(0.0)
    bench.run(0.1)
    assert bench.share.feedback_due(bench.there_s) == bench.given
    assert bench.share.feedback_due(bench.there_s) is None


# -- owner ----------------------------------------------------------------------------------------


def claim(lessee=5, asked_s=1.0, wanted=True, **more):
    return Claim(lessee, "arm b at robot", asked_s, wanted, 0, DeviceFeedback(**more))


def test_the_second_is_refused_in_words_and_gets_it_once_it_is_free():
    bench = Bench().live()
    second = RemoteCore(RemoteOptions(device="x"), 8, "arm b")
    second.on_opened(bench.now_s)
    send = bench.down.send

    def to_both(item, now_s):
        send(item, now_s)
        second.on_received(item, now_s)

    bench.down.send = to_both

    def ask():
        if (asked := second.claim(bench.now_s, DeviceFeedback())) is not None:
            bench.up.send(bench.claimed(asked, sender=8), bench.now_s)

    bench.move(0.5)
    bench.run(0.5, ask)
    assert second.refusal == "x is used by arm at robot: end that session first"
    assert not second.leased
    assert second.state(bench.now_s).axes == NEUTRAL
    assert bench.state.axes.x == 0.5
    assert bench.share.counts["claims while another session has it"] > 5
    bench.up.send(bench.claimed(bench.core.final_claim(bench.now_s)), bench.now_s)
    bench.core.on_closed(bench.now_s)
    bench.move(0.0)
    bench.run(0.5, ask)
    assert second.leased
    assert second.state(bench.now_s).link is DeviceLink.LIVE


def test_a_lease_that_is_not_renewed_ends_and_is_had_again():
    bench = Bench().live()
    assert bench.share.lessee(bench.there_s) == "arm at robot"
    bench.press()
    bench.run(0.1)
    bench.up.cut = True
    bench.run(LEASE_S + 0.3)
    assert bench.share.lessee(bench.there_s) == ""
    assert (bench.state.link, bench.state.buttons) == (DeviceLink.LOST, frozenset())
    bench.up.cut = False
    bench.run(0.5)
    assert (bench.state.link, bench.state.buttons) == (DeviceLink.LIVE, frozenset())
    bench.press(pressed=False)
    bench.run(0.1)
    bench.press()
    bench.run(0.1)
    assert bench.state.buttons == {"hold"}


def test_claims_of_a_stranger_under_the_same_number_count_for_nothing():
    bench = Bench().live()
    stolen = Claim(7, "thief", bench.now_s + 100.0, False, 99, DeviceFeedback())
    bench.share.on_received(bench.claimed(stolen, sender=66), bench.there_s)
    assert bench.share.lessee(bench.there_s) == "arm at robot"
    assert bench.share.counts["claims while another session has it"] == 1


def test_a_claim_that_the_giving_back_overtook_takes_nothing():
    share = ShareCore("spacemouse", 1)
    for asked_s, wanted in ((1.0, True), (1.04, False), (1.02, True), (1.04, True)):
        message = claim_message(claim(asked_s=asked_s, wanted=wanted))
        share.on_received(received(CLAIM_TYPE, message), 1.0)
    assert share.lessee(1.0) == ""
    assert share.counts["duplicate or late claims"] == 2
    # Another session may claim it at once, by its own clock, and then the first one again.
    for lessee, asked_s, sender in ((6, 0.5, 2), (5, 1.06, 1)):
        for wanted in (True, False):
            reported = claim(lessee, asked_s + 0.01 * (not wanted), wanted)
            share.on_received(received(CLAIM_TYPE, claim_message(reported), sender=sender), 1.0)
            assert (share.lessee(1.0) != "") is wanted


def test_a_claim_from_before_a_silence_takes_nothing_after_it():
    share = ShareCore("spacemouse", 1)
    share.on_received(received(CLAIM_TYPE, claim_message(claim(asked_s=1.0))), 1.0)
    silent_s = 1.1 + LEASE_S
    assert share.lessee(silent_s) == ""
    share.on_received(received(CLAIM_TYPE, claim_message(claim(asked_s=0.9))), silent_s)
    assert share.lessee(silent_s) == ""
    share.on_received(received(CLAIM_TYPE, claim_message(claim(asked_s=1.5))), silent_s)
    assert share.lessee(silent_s) == "arm b at robot"


def test_claims_that_come_twice_are_counted():
    share = ShareCore("spacemouse", 1)
    for asked_s in (1.0, 1.0, 0.5):
        share.on_received(received(CLAIM_TYPE, claim_message(claim(asked_s=asked_s))), 1.0)
    assert share.counts["duplicate or late claims"] == 2


def test_giving_back_what_one_has_not_is_no_lease():
    share = ShareCore("spacemouse", 1)
    share.on_received(received(CLAIM_TYPE, claim_message(claim(wanted=False))), 1.0)
    assert share.lessee(1.0) == ""


def test_of_two_that_share_under_one_name_the_first_counts():
    bench = Bench().live()
    other = Bench(offset_s=5.0)
    other.now_s = bench.now_s
    other.sender, other.share = 2, ShareCore("gamepad", 12)
    other.move(0.7)

    def step():
        other.now_s = bench.now_s
        other.operator()
        for item in other.down.arrived(bench.now_s + 1.0):
            bench.core.on_received(item, bench.now_s)

    asked = claim_message(Claim(7, "arm at robot", bench.now_s, True, 0, DeviceFeedback()))
    other.share.on_received(received(CLAIM_TYPE, asked, sender=9), other.there_s)
    bench.run(0.5, step)
    assert (bench.state.link, bench.state.axes) == (DeviceLink.LIVE, NEUTRAL)
    assert bench.count("others") > 5
    assert any("a second computer" in line for line in bench.core.diagnosis(bench.now_s))


@pytest.mark.parametrize("lie_s", [-500.0, 0.0, 500.0])
def test_a_process_that_shares_anew_counts_from_rest(lie_s):
    bench = Bench().live()
    bench.press()
    bench.move(0.5)
    bench.run(0.1)
    bench.share, bench.lie_s = ShareCore("spacemouse", 99), lie_s
    bench.device = bench.device._replace(stamp_s=bench.there_s)
    seen = []
    bench.run(0.5, lambda: seen.append(bench.state))
    # States sent before are at most max_age_s old.
    assert not any(any(state.axes) or state.buttons for state in seen[80:])
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    assert bench.core.protocol_errors()["malformed"] == 0
    bench.move(0.0)
    bench.run(0.1)
    assert (bench.state.link, bench.state.buttons) == (DeviceLink.LIVE, frozenset())


# -- bad input ------------------------------------------------------------------------------------

MANY = [
    {"number": n, "stamp": 0.0, "button": "a", "pressed": True} for n in range(1, MOST_EDGES + 2)
]
BAD_STATES = {
    "version": ({"version": 1}, "of version 1, where this Cardan speaks 3"),
    "axes": ({"axes": [math.nan] * 6}, "not numbers"),
    "beyond": ({"axes": [2.0] + [0.0] * 5}, "beyond -1 to 1"),
    "sent": ({"sent": math.nan}, "an invalid time sent"),
    "report": ({"report": 1e12}, "newer than they are"),
    "link": ({"link": "fine"}, "a link 'fine'"),
    "battery": ({"battery": [math.nan]}, "a battery beyond"),
    "batteries": ({"battery": [0.5, 0.5]}, "several batteries"),
    "inertia": ({"inertia": [{"x": math.inf, "y": 0.0, "z": 0.0}]}, "inertia that are not numbers"),
    "edges": ({"edges": MANY}, f"more than {MOST_EDGES} edges"),
    "order": ({"edges": [MANY[1], MANY[0]]}, "edges out of order"),
    "zero": ({"edges": [MANY[0] | {"number": 0}]}, "edges out of order"),
    "early": ({"edges": [MANY[0] | {"stamp": 1e12}]}, "edges that are newer"),
    "NaN edge": ({"edges": [MANY[0] | {"stamp": math.nan}]}, "edges that are newer"),
    "nameless": ({"buttons": [""]}, "no name"),
    "buttons": ({"buttons": ["a"] * 1000}, "more than 256 buttons"),
    "orientation": (
        {
            "pose": [
                {
                    "position": {"x": 0.0, "y": 0.0, "z": 0.0},
                    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 0.0},
                }
            ]
        },
        "that is not a unit quaternion",
    ),
}


@pytest.mark.parametrize(("change", "words"), BAD_STATES.values(), ids=BAD_STATES)
def test_states_that_mean_nothing_move_nothing_and_are_named(change, words):
    bench = Bench().live()
    bench.mangle = lambda message: message | change
    bench.move(0.5)
    bench.run(0.1)
    assert bench.state.axes == NEUTRAL
    assert bench.core.protocol_errors()["malformed"] > 0
    assert any(words in line for line in bench.core.diagnosis(bench.now_s))


BAD_CLAIMS = {
    "version": ({"version": 0}, "of version 0"),
    "nobody": ({"lessee": 0}, "of nobody"),
    "asked": ({"asked": math.inf}, "an invalid time asked"),
    "rumble": ({"rumble": [math.nan]}, "a rumble beyond 0 to 1"),
    "late": ({"late": math.nan}, "a lateness that are not numbers"),
    "early": ({"late": -0.1}, "a negative lateness"),
    "lights": ({"led": [True, False]}, "several lights"),
}


@pytest.mark.parametrize(("change", "words"), BAD_CLAIMS.values(), ids=BAD_CLAIMS)
def test_claims_that_mean_nothing_are_named(change, words):
    share = ShareCore("spacemouse", 1)
    share.on_received(received(CLAIM_TYPE, claim_message(claim()) | change), 1.0)
    assert share.lessee(1.0) == ""
    assert any(words in what for what in share.counts)


def test_claims_that_are_none_are_counted():
    share = ShareCore("spacemouse", 1)
    whole = received(CLAIM_TYPE, claim_message(claim()))
    share.on_received(whole._replace(data=whole.data[:9]), 1.0)
    share.on_received(whole._replace(attachment=None), 1.0)
    share.on_received(received(CLAIM_TYPE, claim_message(claim()), key_type=STATE_TYPE), 1.0)
    assert share.counts == {"claims that are cut short": 1, "claims that cannot be decoded": 2}
    assert share.lessee(1.0) == ""


def test_a_message_that_is_longer_than_any_is_not_decoded():
    """Decoding 8 MB takes seconds, in which the arm's loop would wait for the state."""
    bench, decoded = Bench().live(), []
    for core in (bench.core, bench.share):
        core._codec = Decoding(core._codec, decoded)
    bench.core.on_received(received(STATE_TYPE, bytes(MOST_BYTES + 1), 10**6), bench.now_s)
    bench.share.on_received(received(CLAIM_TYPE, bytes(MOST_BYTES + 1), 10**6), bench.there_s)
    assert decoded == []
    assert any("more than" in line for line in bench.core.diagnosis(bench.now_s))
    assert bench.share.counts == {f"claims of more than {MOST_BYTES} bytes": 1}


def test_the_longest_state_there_is_is_short_enough():
    names = [f"{n:03}" + "x" * 60 for n in range(256)]
    able = ABLE._replace(buttons=tuple(names), further_buttons=tuple(names))
    edges = [ButtonEvent(1.0, name, True) for name in names]
    share = ShareCore("x", 1)
    share.on_received(received(CLAIM_TYPE, claim_message(claim())), 1.0)
    state = DeviceState(0.5, DeviceLink.LIVE, NEUTRAL, frozenset(names))
    shared = share.offer(state, edges, able, 1.0)
    data = received(STATE_TYPE, shared_message(shared)).data
    assert 50_000 < len(data) < MOST_BYTES


def test_a_stranger_cannot_fill_the_memory_with_words():
    bench, many = Bench().live(), 200
    for number in range(many):
        bench.mangle = lambda message, n=number: message | {"version": n + 3}
        bench.run(0.03)
        asked = claim_message(claim(asked_s=bench.now_s)) | {"version": number + 3}
        bench.share.on_received(received(CLAIM_TYPE, asked, sender=8), bench.there_s)
    assert bench.core.protocol_errors()["malformed"] >= many
    assert len(bench.core.diagnosis(bench.now_s)) < 50
    assert bench.share.counts.total() >= many
    assert len(bench.share.counts) < 50


class Decoding:
    """Codec that records decoded messages."""

    def __init__(self, codec, decoded):
        self._codec, self._decoded = codec, decoded

    def decode(self, data):
        self._decoded.append(len(data))
        return self._codec.decode(data)


def test_a_claim_is_read_as_it_was_written():
    given = claim(led=True, rumble=0.25)
    assert read_claim(claim_message(given)) == given


@pytest.mark.parametrize(
    ("kind", "given"),
    [
        (RemoteOptions, {"device": "a b"}),
        (RemoteOptions, {"device": "a/b"}),
        (RemoteOptions, {"max_age_s": 0.001}),
        (RemoteOptions, {"name": "1"}),
        (ShareOptions, {"name": "a b"}),
        (ShareOptions, {"name": "a/b"}),
    ],
)
def test_options(kind, given):
    with pytest.raises(OptionError, match=next(iter(given))):
        kind(**given)


def test_who_does_not_share_is_reported_how():
    pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
    with pytest.raises(DeviceNotFoundError, match="start `cardan devices share`"):
        Remote(router="", mode="peer").open()


@pytest.mark.parametrize(
    ("device", "watchdogs", "cautioned"),
    [
        ({}, {}, False),  # On a LAN both defaults hold.
        ({"max_age_s": 0.3}, {}, True),
        ({"max_age_s": 0.3}, {"device_age_s": 0.3}, False),
    ],
)
def test_an_age_that_the_session_does_not_allow_is_named(device, watchdogs, cautioned):
    tables = {
        "device": {"driver": "remote", **device},
        "robot": {"driver": "sim_arm", "robot": "ur5"},
        "arm": {"model": "ur5"},
        "mapping": {"deadman": "hold"},
        "watchdogs": watchdogs,
    }
    found = [each for each in cautions(checked_config(tables)) if "device_age_s" in each]
    assert bool(found) is cautioned
