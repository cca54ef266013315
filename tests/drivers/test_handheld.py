"""Phones and headset controllers: mapping of device motion, and causes of disarming."""

import math
from types import SimpleNamespace

import pytest

from cardan.demos.examples import free_ports
from cardan.drivers.bus_devices import Phone, Xr
from cardan.drivers.bus_devices.device import RUMBLE_AGAIN_S, Rumbler
from cardan.drivers.handheld import HandheldOptions, PhoneOptions, XrOptions
from cardan.errors import DeviceNotFoundError, OptionError
from cardan.protocols.handheld.frames import BodyPart, GamepadFrame, OperatorFrame, encode_frame
from cardan.sim_peers.handheld import FAULTS, PagePeer, PagePeerOptions, XrPeerOptions
from cardan.sim_peers.handheld.core import FULL_WAY_M, SimulatedHandheld
from cardan.sim_peers.handheld.peer import wrapped
from cardan.spatial import rotation_between, subtract
from cardan.types import NEUTRAL, DeviceFeedback, DeviceLink
from tests.drivers.handheld_bench import KEY, Bench, received
from tests.serving import in_a_thread
from tests.waiting import until

KINDS = ("phone", "xr")
HALF = (0.4, -0.3, 0.0, 0.0, 0.0, 0.5)
"""Deflection of axes; a tilted phone would change its plane of translation."""
TIPPED = (0.0, 0.0, 0.0, 0.2, -0.3, 0.5)
PLAIN = {"dead_zone": 0.0}


# -- meaning of its motion ------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("axes", [HALF, TIPPED])
def test_a_held_hand_deflects_by_how_far_it_has_gone(kind, axes):
    bench = Bench(kind, **PLAIN).held(axes)
    assert bench.state.link is DeviceLink.LIVE
    assert bench.state.buttons == {"hold"}
    assert bench.state.axes == pytest.approx(axes, abs=0.01)


def test_a_drag_goes_along_the_screen_of_an_upright_phone():
    bench = Bench(full_turn_deg=90.0, **PLAIN).live()
    for step in range(1, 4):  # Tilted until the top edge points to the sky.
        bench.run(0.1, (0, 0, 0, 0, -step, 0))
    bench.device.press("hold")
    bench.run(0.1)
    bench.run(0.1, (0, 0, 0.5, 0, -3.0, 0))
    assert bench.state.axes == pytest.approx((0, 0, 0.5, 0, 0, 0), abs=0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_a_hand_that_is_not_held_deflects_nothing(kind):
    bench = Bench(kind, **PLAIN).live()
    bench.run(0.2, HALF)
    assert bench.state.axes == NEUTRAL
    # The pose at the press of hold is the zero of the deflection.
    bench.device.press("hold")
    bench.run(0.2)
    expected = (0.0,) * 6 if kind == "xr" else (*HALF[:3], 0, 0, 0)
    assert bench.state.axes == pytest.approx(expected, abs=0.01)
    bench.device.release("hold")
    bench.run(0.2, NEUTRAL)
    bench.device.press("hold")
    bench.run(0.2)
    assert bench.state.axes == pytest.approx(NEUTRAL, abs=0.01)


def test_the_way_up_of_a_controller_is_up():
    bench = Bench("xr", **PLAIN).held((0.0, 0.0, 0.5, 0.0, 0.0, 0.0))
    assert bench.state.axes.z == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_a_full_deflection_is_the_end(kind):
    bench = Bench(kind, full_turn_deg=10.0, **PLAIN).held((0, 0, 0, 0, 0, 1.0))
    assert bench.state.axes.yaw == 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_its_pose_is_along_the_robots_axes(kind):
    bench = Bench(kind, drag_m=FULL_WAY_M) if kind == "phone" else Bench(kind)
    bench.held()
    before = bench.state.pose
    bench.run(0.1, (0.2, -0.1, 0.0, 0.0, 0.0, 0.6))
    after = bench.state.pose
    turned = rotation_between(before.orientation, after.orientation)
    assert turned == pytest.approx((0, 0, 0.6 * math.radians(30)), abs=1e-3)
    way = subtract(after.position, before.position)
    assert way == pytest.approx((0.02, -0.01, 0.0), abs=1e-3)


def test_a_finger_that_is_lifted_does_not_go_back():
    bench = Bench(drag_m=0.1).held()
    for _ in range(3):
        bench.run(0.1, (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
        bench.run(0.1, (0.0,) * 6)
    assert bench.state.pose.position == pytest.approx((0.15, 0.0, 0.0), abs=1e-3)


def test_the_natural_grip_points_below_the_grips_axis():
    plain, natural = Bench("xr").held(), Bench("xr", grip_deg=45.0).held()
    difference = rotation_between(plain.state.pose.orientation, natural.state.pose.orientation)
    # Nose down is the positive rotation about y, which points left.
    assert difference == pytest.approx((0, math.radians(45), 0), abs=1e-3)


def test_buttons_have_edges():
    bench = Bench("xr").live()
    bench.device.press("trigger")
    bench.run(0.1)
    bench.device.release("trigger")
    bench.run(0.1)
    edges = [(each.button, each.pressed) for each in bench.core.events()]
    assert edges[-2:] == [("trigger", True), ("trigger", False)]


def test_a_phones_inertia_is_that_of_the_phone_as_it_lies():
    bench = Bench().live()
    assert bench.state.inertia.acceleration == pytest.approx((0, 0, 9.81), abs=0.01)
    assert bench.state.inertia.rates == pytest.approx((0, 0, 0), abs=0.01)
    # Tilted up by 30°: gravity has a component along the top edge.
    bench.run(0.1, (0, 0, 0, 0, -1.0, 0))
    assert bench.state.inertia.acceleration.x == pytest.approx(9.81 * 0.5, abs=0.02)


@pytest.mark.parametrize("part", ["left", "viewer"])
def test_the_other_hand_is_another_device(part):
    bench = Bench("xr", part=part)
    bench.run(1.0)
    assert bench.state.link is DeviceLink.STALE
    bench = Bench("xr", part=part)
    bench.device = SimulatedHandheld("xr", {}, part=BodyPart[part.upper()])
    assert bench.live().state.link is DeviceLink.LIVE


# -- alignment ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_a_hand_whose_heading_nobody_knows_moves_nothing(kind):
    bench = Bench(kind)
    bench.device.next_due_s = bench.now_s = 10.0  # Align was pressed long before this.
    bench.core.on_opened(10.0)
    bench.held(HALF)
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    assert "Align" in bench.state.reason
    assert bench.state.axes == NEUTRAL


@pytest.mark.parametrize("kind", KINDS)
def test_each_hold_can_be_its_own_heading(kind):
    bench = Bench(kind, heading="each hold", **PLAIN)
    bench.device.next_due_s = bench.now_s = 10.0
    bench.core.on_opened(10.0)
    bench.held(HALF)
    assert bench.state.axes == pytest.approx(HALF, abs=0.01)


def test_another_page_has_to_align_anew():
    bench = Bench().live()
    bench.sender = 2
    bench.mangle = lambda data: None
    bench.run(0.5)
    bench.mangle = lambda data: data
    bench.run(0.5)
    assert "Align" in bench.state.reason


# -- causes of disarming --------------------------------------------------------------------------


def let_go_and_hold(bench):
    bench.device.stuck = False
    bench.device.release("hold")
    bench.run(0.1, tuple(0.5 * each for each in bench.device.axes))
    bench.run(0.1, (0.0,) * 6)
    if bench.device.jumped:
        bench.device.align()
        bench.run(0.2)
    assert bench.state.link is DeviceLink.LIVE
    bench.device.press("hold")
    bench.run(0.1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("null", "Start"),
        ("lost", "tracking"),
        ("hidden", "hidden"),
        ("jump", "jumped"),
    ],
)
def test_a_fault_disarms_until_the_hand_lets_go(kind, fault, words):
    bench = Bench(kind).held(HALF)
    assert bench.state.axes != NEUTRAL
    device = bench.device
    {"null": device.lose_sensors, "lost": device.lose_tracking, "hidden": device.hide,
     "jump": device.jump}[fault]()  # fmt: skip
    bench.run(0.02)
    assert bench.state.axes == NEUTRAL
    assert bench.state.buttons == frozenset()
    reason = bench.state.reason
    assert words in reason or (kind == "xr" and fault == "null" and "tracking" in reason)
    device.senses = device.tracking = device.visible = True
    bench.run(0.5)
    # All faults are over, and hold is still pressed.
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    assert (bench.state.axes, bench.state.buttons) == (NEUTRAL, frozenset())
    let_go_and_hold(bench)
    assert bench.state.buttons == {"hold"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_control_that_is_stuck_from_the_beginning_moves_nothing(kind):
    bench = Bench(kind, faults={"stuck": 0.0}, heading="each hold")
    bench.run(1.0, HALF)
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    assert "let go" in bench.state.reason
    assert bench.state.axes == NEUTRAL


@pytest.mark.parametrize("kind", KINDS)
def test_silence_disarms_within_its_time_and_old_frames_do_not_help(kind):
    bench = Bench(kind).held(HALF)
    bench.device.silence()
    began_s = bench.now_s
    while bench.state.axes != NEUTRAL:
        bench.run(0.002)
    assert bench.now_s - began_s <= 0.155
    assert bench.state.link is DeviceLink.STALE
    assert bench.state.inertia is None
    assert bench.core.metrics(bench.now_s)["silences"] == 1
    bench.device.resume()
    bench.device.age_s = 0.2
    bench.run(0.5)
    assert bench.state.link is DeviceLink.STALE
    assert bench.core.metrics(bench.now_s)["old"] > 10
    bench.device.age_s = 0.02
    bench.run(0.5)
    assert bench.state.link is DeviceLink.NEEDS_NEUTRAL
    let_go_and_hold(bench)
    assert bench.state.buttons == {"hold"}


def test_frames_age_on_their_way():
    bench = Bench().held(HALF)
    bench.device.age_s = 0.1
    bench.run(0.1)
    bench.device.silence()
    began_s = bench.now_s
    while bench.state.axes != NEUTRAL:
        bench.run(0.002)
    assert bench.now_s - began_s <= 0.06


def test_frames_with_numbers_that_are_none_are_counted():
    bench = Bench(faults={"nan": 0.5}).live()
    bench.run(0.5)
    assert any("numbers" in words for words in bench.core.diagnosis(bench.now_s))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\0\1\0\0", "malformed"),
        (wrapped(b"", 0.0), "header"),
        (wrapped(b"\xc1" * 64, 0.0), "flags"),
        (wrapped(encode_frame(OperatorFrame(GamepadFrame(0, 0, 0, 0), True)), 0.0), "gamepad"),
        (wrapped(b"", -1.0), "age"),
        (wrapped(b"", math.nan), "age"),
    ],
)
def test_what_is_no_frame_of_this_hand_is_counted(data, words):
    bench = Bench().live()
    bench.core.on_received(received(data, bench.sequence + 1), bench.now_s)
    assert any(words in each for each in bench.core.diagnosis(bench.now_s))
    assert bench.run(0.1).state.link is DeviceLink.LIVE


def test_a_second_page_is_ignored_while_the_first_speaks():
    bench = Bench().live()
    frame = wrapped(bench.device.report(), 0.0)
    bench.core.on_received(received(frame, 1, sender=9), bench.now_s)
    bench.core.on_received(received(frame, bench.sequence), bench.now_s)
    metrics = bench.core.metrics(bench.now_s)
    assert (metrics["others"], metrics["late"]) == (1, 1)


def test_another_type_is_refused():
    bench = Bench().live()
    frame = wrapped(bench.device.report(), 0.0)
    key = KEY.replace("OperatorFrame", "RawPacket")
    bench.core.on_received(received(frame, bench.sequence + 1, key=key), bench.now_s)
    assert any("another type" in each for each in bench.core.diagnosis(bench.now_s))


def test_every_fault_is_one_that_disarms_or_is_counted():
    disarming = {"unplug", "replug", "silence", "refuse", "null", "lost", "hidden", "stuck"}
    disarming |= {"jump", "recenter"}
    assert {each.name for each in FAULTS} == disarming | {"late", "nan"}


def recentered(bench, turn_rad=math.pi / 2, reported=False):
    bench.device.recenter(turn_rad, reported=reported)


def lost_and_found(bench):
    bench.device.lose_tracking()
    bench.run(1.0)
    recentered(bench)
    bench.device.tracking = True


def silent_and_turned(bench):
    bench.device.silence()
    bench.run(1.0)
    recentered(bench)
    bench.device.resume()


def hidden_and_turned(bench):
    bench.device.hide()
    bench.run(1.0)
    recentered(bench)
    bench.device.visible = True


def reported_of_a_small_turn(bench):
    recentered(bench, math.radians(20), reported=True)


def reported_while_lost(bench):
    bench.device.lose_tracking()
    reported_of_a_small_turn(bench)
    bench.run(0.1)
    bench.device.tracking = True


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("held", [False, True], ids=["free", "held"])
@pytest.mark.parametrize(
    ("jumps", "words"),
    [
        (recentered, "jumped by 90°"),
        (lost_and_found, "elsewhere"),
        (silent_and_turned, "elsewhere"),
        (hidden_and_turned, "elsewhere"),
        (reported_of_a_small_turn, "frame was reset"),
        (reported_while_lost, "frame was reset"),
    ],
)
def test_an_alignment_is_void_after_a_jump_of_its_reference(kind, held, jumps, words):
    bench = Bench(kind, **PLAIN)
    (bench.held if held else bench.live)()
    jumps(bench)
    bench.run(0.5)
    if held:
        bench.device.release("hold")
        bench.run(0.1)
    # Hold was released and pressed again: forward would move sideways.
    state = bench.held(HALF).state
    assert (state.link, state.axes, state.pose) == (DeviceLink.NEEDS_NEUTRAL, NEUTRAL, None)
    assert words in state.reason
    assert "Align" in state.reason
    bench.device.release("hold")
    bench.run(0.1, (0.0,) * 6)
    bench.device.align()
    state = bench.run(0.2).held(HALF).state
    assert (state.link, state.reason) == (DeviceLink.LIVE, "")
    assert state.axes == pytest.approx(HALF, abs=0.01)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("interrupt", ["lose_tracking", "hide", "silence"])
def test_a_hand_that_is_found_where_it_was_lost_stays_aligned(kind, interrupt):
    bench = Bench(kind, **PLAIN).live()
    getattr(bench.device, interrupt)()
    bench.run(1.0)
    bench.device.tracking = bench.device.visible = True
    bench.device.resume()
    state = bench.run(0.1).held(HALF).state
    assert state.axes == pytest.approx(HALF, abs=0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_another_reference_disarms_where_each_hold_is_its_own_heading(kind):
    bench = Bench(kind, heading="each hold", **PLAIN).held(HALF)
    reported_of_a_small_turn(bench)
    bench.run(0.1)
    assert bench.state.axes == NEUTRAL
    assert "let go" in bench.state.reason
    let_go_and_hold(bench)
    assert bench.run(0.1, HALF).state.axes == pytest.approx(HALF, abs=0.01)


# -- options --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [
        (PhoneOptions, "topic", "no name"),
        (PhoneOptions, "name", "a-b"),
        (PhoneOptions, "full_turn_deg", 1.0),
        (PhoneOptions, "stale_after_s", 1.0),
        (XrOptions, "part", "nose"),
        (XrOptions, "grip_deg", 100.0),
        (HandheldOptions, "heading", "north"),
    ],
)
def test_options_that_are_none_are_refused(kind, key, value):
    with pytest.raises(OptionError, match=key):
        kind(**{key: value})


# -- rumble ---------------------------------------------------------------------------------------


def test_a_rumble_is_repeated_while_it_lasts():
    sent = []
    rumbler = Rumbler(SimpleNamespace(put=lambda data, stamp_ns: sent.append(data)))
    for now_s, level, messages in (
        (0.0, 0.0, 0),
        (0.1, 0.5, 1),
        (0.1 + 0.9 * RUMBLE_AGAIN_S, 0.5, 1),
        (0.1 + RUMBLE_AGAIN_S, 0.5, 2),
        (0.1 + RUMBLE_AGAIN_S, 1.0, 3),
        (9.0, 0.0, 4),
        (99.0, 0.0, 4),
    ):
        rumbler.level = level
        rumbler.run_due(now_s)
        assert len(sent) == messages
    rumbler.end()
    assert len(sent) == 4


# -- on the bus -----------------------------------------------------------------------------------


@pytest.mark.real
@pytest.mark.parametrize(("driver", "options"), [(Phone, PagePeerOptions), (Xr, XrPeerOptions)])
def test_a_page_on_the_bus_moves_and_feels(driver, options):
    pytest.importorskip(
        "zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]"
    )
    port = free_ports(1)
    peer = PagePeer(options(port=port, script="strokes"))
    with in_a_thread(peer), driver(port=port) as device:
        until(lambda: device.state().link is DeviceLink.LIVE, "it is live")
        device.feedback(DeviceFeedback(rumble=0.5))
        until(lambda: any(device.state().axes), "it is deflected")
        until(lambda: peer.device.rumble == 0.5, "the peer vibrates")
        assert device.capabilities.gives_pose
        assert "hold" in device.capabilities.buttons
        assert device.capabilities.feedback == {"rumble"}


@pytest.mark.matrix
def test_a_page_that_is_not_there_says_what_to_open():
    pytest.importorskip(
        "zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]"
    )
    port = free_ports(1)
    with pytest.raises(DeviceNotFoundError, match="cardan net server console"):
        Phone(port=port).open()


def test_the_hand_of_the_simulated_page_can_be_followed_by_a_hand():
    """Its fastest built-in motion is not taken for a jump."""
    bench = Bench("xr").held()
    for step in range(200):
        angle = 2 * math.pi * step / 60
        bench.run(1 / 60, (math.sin(angle), 0, 0, 0, 0, math.sin(angle)))
    assert bench.core.metrics(bench.now_s)["jumps"] == 0
