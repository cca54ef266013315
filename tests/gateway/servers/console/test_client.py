"""Frames from a page: permissions, ends of a hold, and messages to the page."""

from __future__ import annotations

import json
import time

import pytest

pytest.importorskip("cbor2", reason="cbor2 is not installed: pip install cardan[network]")

from cardan.drivers.ros2_nodes.options import LAYOUTS
from cardan.errors import MotionRefusedError
from cardan.gateway.arm.validation import LONGEST_NAME
from cardan.gateway.arm.vocab import Begins
from cardan.gateway.servers.console import commands
from cardan.gateway.servers.console.hold_to_run import FRESH_S
from cardan.gateway.servers.pause_detector import STOOD_STILL_S
from cardan.protocols.handheld.frames import (
    GamepadFrame,
    JogJoints,
    JogTwist,
    PhoneFrame,
    decode_frame,
)
from cardan.types import Frame, Twist, Vector3
from tests.gateway.servers.console.bench import ARM, VIEWER, FakeArm, console, page_program
from tests.protocols.test_handheld import TELEOP
from tests.waiting import until

pytestmark = pytest.mark.matrix

REST = (0.0,) * 6


@pytest.fixture
def arm(network):
    return FakeArm(network)


@pytest.fixture
def running(network, tmp_path):
    with console(network, tmp_path) as running:
        yield running


@pytest.fixture
def page(running):
    with page_program(running) as page:
        page.begin()
        yield page


def numbers(request):
    """All six numbers of a twist request."""
    return (*request.value.linear, *request.value.angular)


def held(page):
    """Let a page jog the arm. On a busy computer a frame may arrive too late to count, or the next
    one too late to continue the hold."""
    page.open(1, arm=ARM)
    page.press()
    while (reported := page.next("cardan.input"))["grip"] != "held":
        page.jog(False) if reported["grip"] == "lost" else page.jog()


def keep(page, seconds):
    """Keep the hold for some time."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        page.jog()
        time.sleep(0.01)


def test_a_page_is_reported_who_it_is(running):
    with page_program(running) as page:
        hello = page.begin()
    assert hello["role"] == "operator"
    assert hello["source"].startswith("console 127.0.0.1:")
    assert hello["fresh_ms"] == 1e3 * FRESH_S


def test_a_page_says_who_is_at_it_before_it_moves_anything(page, arm):
    def source(**fields):
        page.ask("cardan.hello", id="h", **fields)
        return page.next("cardan.hello", id="h")["source"]

    nameless = source()
    assert source(name="Ana Gil").startswith("console Ana Gil 127.0.0.1:")
    assert source(name="  ") == source() == nameless
    named = source(name="Ana")
    page.open(1, arm=ARM)
    assert source(name="Eva") == named
    page.ask("cardan.close", channel=1)
    assert len(source(name="x" * 30)) <= LONGEST_NAME
    for bad in ("x" * 31, "a\nb", 5, None):
        assert "at most 30 printable" in page.refused("cardan.hello", name=bad)


def test_a_message_of_the_page_has_the_codes_of_the_terminal(page):
    message = "gripper.output: 99 is not allowed; it must be 0 to 39"
    for text, codes in ((message, ["S004"]), ("all is well", [])):
        page.ask("cardan.codes", id="c", text=text)
        assert page.next("cardan.codes", id="c")["codes"] == codes
    for bad in (None, 5, "x" * 1001):
        assert "up to 1000 characters" in page.refused("cardan.codes", text=bad)


def test_rosbridge_goes_on_beside_it(page):
    page.ask("call_service", id="c", service="/rosapi/get_time")
    assert page.next("service_response")["result"]


def test_a_hold_is_a_stream_with_stamp_number_and_source(arm, page):
    held(page)
    until(lambda: arm.requests, "the arm is asked")
    keep(page, 0.05)
    page.jog(False)
    page.grip("free")
    until(lambda: numbers(arm.requests[-1]) == REST, "the stream rests")
    assert set(arm.verbs()) == {"twist"}
    page.ask("cardan.hello")
    assert {each.source for each in arm.requests} == {page.next("cardan.hello")["source"]}
    assert numbers(arm.requests[0]) == pytest.approx((0.1, 0, 0, 0, 0, 0))
    assert [each.begins for each in arm.requests][:2] == [Begins.NEW, None]
    for key in ("sequence", "stamp_s"):
        values = [getattr(each, key) for each in arm.requests]
        assert values == sorted(set(values))


def test_stamps_grow_though_what_is_known_of_the_pages_clock_changes(arm, page):
    held(page)
    until(lambda: arm.requests, "the arm is asked")
    for late_s in (0.0, 0.08, 0.04, 0.0):
        asked = len(arm.requests)
        page.jog(late_s=late_s)
        until(lambda before=asked: len(arm.requests) > before, "the arm is asked")
    stamps = [each.stamp_s for each in arm.requests]
    assert stamps == sorted(set(stamps))


def test_a_frame_of_its_own_and_joints(arm, page):
    page.open(1, arm=ARM)
    page.frame(JogJoints((0.0,) * 6), False)
    page.grip("free")
    mixed = JogTwist(Vector3(0, 0, 0.5), Vector3(0.25, 0, 0), Frame.MIXED)
    page.frame(mixed)
    until(lambda: arm.requests, "the arm is asked")
    assert arm.requests[0].value == Twist(*mixed)
    page.frame(JogJoints((0.0,) * 6), False)
    until(lambda: numbers(arm.requests[-1]) == REST, "the stream rests")
    page.frame(JogJoints((0.5, 0, 0, 0, 0, 0)))
    # the stream of the other kind is released first
    until(lambda: arm.verbs()[-3:] == ["twist", "set_parameters", "joints"], "joints move")
    assert arm.requests[-1].value == [0.5, 0, 0, 0, 0, 0]
    assert arm.requests[-1].begins is Begins.NEW


def test_zero_begins_nothing(arm, page):
    page.open(1, arm=ARM)
    page.jog(False)
    page.jog(x=0.0)
    page.grip("held")
    page.jog(False)
    page.grip("free")
    assert arm.requests == []


@pytest.mark.real
def test_silence_ends_it_at_once_and_it_stays_ended(arm, page):
    held(page)
    assert "no frame" in page.grip("lost")["why"]
    until(lambda: numbers(arm.requests[-1]) == REST, "the stream rests")
    asked = len(arm.requests)
    keep(page, 0.05)
    page.settle()
    assert len(arm.requests) == asked


def test_a_channel_that_is_opened_again_for_its_arm_keeps_the_authority(arm, page):
    """A page that a stop disarmed acquires the authority, and then opens its channel again."""
    held(page)
    until(lambda: arm.requests, "the arm is asked")
    page.open(1, arm=ARM)
    assert "let go" in page.grip("lost")["why"]
    until(lambda: numbers(arm.requests[-1]) == REST, "the stream rests")
    keep(page, 0.05)
    page.press()
    page.grip("held")
    assert "release" not in arm.verbs()
    page.ask("cardan.close", channel=1)
    until(lambda: "release" in arm.verbs(), "the authority is given up")


def test_a_page_renews_a_hold_and_is_reported_how_long_it_goes_on(network, arm, tmp_path):
    """The frames continue, as from a page whose browser hangs."""
    with console(network, tmp_path, hold_s=1.0) as running, page_program(running) as page:
        page.begin()
        page.open(1, arm=ARM)
        page.jog(False)
        assert "left_s" not in page.grip("free")
        page.jog()
        assert 0.0 < page.grip("held")["left_s"] <= 1.0
        page.heard.clear()
        for _ in range(4):
            keep(page, 0.5)
            page.ask("cardan.renew", channel=1)
        page.settle()
        assert not [each for each in page.heard if each.get("grip") == "lost"]
        keep(page, 2.0)
        assert "without a sign of the operator" in page.grip("lost")["why"]
        until(lambda: numbers(arm.requests[-1]) == REST, "the stream rests")
        page.ask("cardan.renew", channel=9, id="r")
        assert "not open" in page.next("cardan.refused", id="r")["why"]


def test_old_frames_move_nothing(arm, page):
    page.open(1, arm=ARM)
    page.jog(False)
    page.grip("free")
    for _ in range(5):
        page.jog(late_s=FRESH_S + 0.05)
    reported = page.next("cardan.input")
    assert reported["dropped"]["old"] == 5
    assert reported["age_ms"] > 1e3 * FRESH_S
    assert arm.requests == []


def test_frames_before_the_clock_is_known_move_nothing(arm, running):
    with page_program(running) as page:
        page.tells_time = False
        page.open(1, arm=ARM)
        page.jog(False)
        page.jog()
        page.settle()
        assert arm.requests == []


def test_the_page_is_reported_the_rate_that_arrives(arm, page):
    held(page)
    keep(page, 0.6)
    reported = page.next("cardan.input")
    assert reported["rate_hz"] > 10
    assert 0.0 <= reported["round_ms"] < 1000.0


@pytest.mark.real
def test_a_closed_socket_rests_and_releases(arm, running):
    with page_program(running) as page:
        page.begin()
        held(page)
        until(lambda: arm.requests, "the arm is asked")
    until(lambda: arm.verbs()[-2:] == ["twist", "release"], "the page has left")
    assert numbers(arm.requests[-2]) == REST


@pytest.mark.real
def test_a_cut_socket_rests_and_releases(arm, running):
    with page_program(running) as page:
        page.begin()
        held(page)
        until(lambda: arm.requests, "the arm is asked")
        page.connection.socket.shutdown(2)
        until(lambda: arm.verbs()[-2:] == ["twist", "release"], "the page has left")


@pytest.mark.usefixtures("notices_pauses")
def test_a_server_that_stood_still_acts_on_nothing_that_waited(arm, running, page):
    held(page)
    until(lambda: arm.requests, "the arm is asked")
    running.loop.call_soon_threadsafe(time.sleep, STOOD_STILL_S + 0.5)
    keep(page, 0.2)
    until(lambda: arm.verbs()[-1] == "release", "the page was cut off")
    after = [each for each in arm.requests if each.verb == "twist"][1:]
    moving = [each for each in after if numbers(each) != REST]
    assert len(moving) <= 1  # a twist that was already in transit


def test_what_the_arm_refuses_ends_the_hold_with_its_reason(arm, page):
    arm.refuses = "'device' has authority over the arm"
    held_refused(page, arm.refuses)
    asked = len(arm.requests)
    keep(page, 0.05)
    page.settle()
    assert len(arm.requests) == asked
    arm.refuses = ""
    page.press()
    page.grip("held")
    until(lambda: len(arm.requests) > asked, "a new hold continues")
    assert arm.requests[-1].begins is Begins.NEW


def held_refused(page, words):
    page.open(1, arm=ARM)
    page.press()
    assert words in page.grip("lost")["why"]


def test_an_error_of_the_arm_ends_the_hold_with_its_words(arm, page):
    arm.error = MotionRefusedError("twist: the robot is silent")
    held_refused(page, "the robot is silent")


def test_a_stream_that_the_arm_has_ended_is_not_begun_again_by_a_hold_that_goes_on(arm, page):
    held(page)
    until(lambda: arm.requests, "the arm is asked")
    arm.refuses = "twist: select twist streaming first: stopped"
    keep(page, 0.1)
    assert "stopped" in page.grip("lost")["why"]
    assert [each.begins for each in arm.requests].count(Begins.NEW) == 1


def test_an_arm_that_is_not_there_is_named_with_those_that_are(arm, page):
    page.ask("cardan.open", channel=1, arm="/other", id="o")
    refused = page.next("cardan.refused", id="o")
    assert "/other" in refused["why"]
    assert "/arm" in refused["why"]


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"channel": 256, "arm": ARM}, "0 to 255"),
        ({"channel": True, "arm": ARM}, "0 to 255"),
        ({"channel": 1}, "for one of arm, "),
        ({"channel": 1, "arm": ARM, "device": "/phone"}, "for one of arm, "),
        ({"channel": 1, "device": "no name"}, "name"),
    ],
)
def test_what_cannot_be_opened_says_why(arm, page, fields, words):
    assert words in page.refused("cardan.open", **fields)


def test_unknown_operations_and_bad_frames_say_why(page):
    page.ask("cardan.fly", id="f")
    assert "no operation" in page.next("cardan.refused", id="f")["why"]
    page.connection.send(b"\xc2" + b"\0" * 15)
    assert "version" in page.next("cardan.refused")["why"]
    page.ask("cardan.pong", server_us="soon", page_us=1)
    assert "server_us" in page.next("cardan.refused")["why"]


def test_a_page_has_so_many_channels(page):
    for number in range(16):
        page.open(number, device=f"/device{number}")
    page.ask("cardan.open", channel=16, device="/device16", id="more")
    assert "close one" in page.next("cardan.refused", id="more")["why"]
    page.open(3, device="/again")
    page.ask("cardan.close", channel=4)
    page.open(16, device="/device16")


def test_device_frames_go_to_the_driver_as_they_are(network, page):
    page.open(2, device="/phone")
    page.frame(PhoneFrame(None), False, channel=2)
    page.frame(PhoneFrame(Vector3(10, 20, 30)), True, channel=2, late_s=0.05)
    page.frame(PhoneFrame(Vector3(10, 20, 30)), True, channel=2, late_s=FRESH_S + 0.05)
    page.frame(PhoneFrame(None), False, channel=2)
    until(lambda: len(network.published) == 3, "three are passed on")
    topics, messages = zip(*network.published, strict=True)
    assert set(topics) == {"/phone"}
    frames = [decode_frame(bytes(each["frame"])) for each in messages]
    assert [each.hold for each in frames] == [False, True, False]
    assert messages[1]["age"] == pytest.approx(0.05, abs=0.04)
    assert network.topics()["/phone"].type == "cardan_msgs/msg/OperatorFrame"


def test_both_hands_of_a_page_are_one_sender(network, page):
    """A driver accepts only one sender on a topic."""
    for channel in (4, 5):
        page.open(channel, device="/xr")
    assert [topic for topic, *_ in network.publishers] == ["/xr"]
    page.ask("cardan.close", channel=4)
    page.frame(PhoneFrame((0.0, 0.0, 0.0)), channel=5)
    until(lambda: network.published, "the publication of poses")
    page.ask("cardan.close", channel=5)
    until(lambda: not network.publishers, "it ends with the last one")


def test_what_a_driver_lets_the_hand_feel_goes_to_the_page(network, page):
    page.open(2, device="/phone")
    network.publish("/phone/feedback", "sensor_msgs/msg/JoyFeedback", type=1, intensity=0.5)
    assert page.next("cardan.feedback") == {"op": "cardan.feedback", "channel": 2, "intensity": 0.5}


def test_frames_go_only_where_they_belong(arm, network, page):
    page.open(1, arm=ARM)
    page.open(2, device="/pad")
    page.frame(GamepadFrame(0, 0, 0, 0), True, channel=1)
    assert "jogs an arm" in page.next("cardan.refused")["why"]
    page.jog(True, channel=2)
    page.jog(True, channel=9)
    page.settle()
    assert (arm.requests, network.published) == ([], [])


def test_the_message_of_teleop_is_an_operator_on_xr(network, page):
    page.connection.send(json.dumps(TELEOP))
    page.connection.send(json.dumps({"type": "log", "data": "hello"}))
    until(lambda: network.published, "it is passed on")
    ((topic, message),) = network.published
    frame = decode_frame(bytes(message["frame"]))
    assert (topic, frame.hold, frame.body.position_m[0]) == ("/xr", True, pytest.approx(0.1))


def test_a_flood_is_cut_down(arm, page):
    page.open(1, arm=ARM)
    for _ in range(700):
        page.jog(False)
    reported = page.next("cardan.input")
    while "too many" not in reported["dropped"]:
        reported = page.next("cardan.input")
    assert reported["rate_hz"] <= 500


def test_a_viewer_moves_nothing_orders_nothing_and_asks_for_no_authority(network, arm, with_tokens):
    with page_program(with_tokens, f"/ws?t={VIEWER}") as page:
        assert page.begin()["role"] == "viewer"
        for op, fields in (
            ("cardan.open", {"channel": 1, "arm": ARM}),
            ("cardan.open", {"channel": 1, "device": "/phone"}),
            ("cardan.daemon", {"do": "list"}),
            ("cardan.ask", {"arm": ARM, "owner": "x"}),
            ("cardan.keep", {"arm": ARM, "source": "x"}),
        ):
            assert "viewer" in page.refused(op, **fields)
        page.jog(False)
        page.jog()
        assert "viewer" in page.next("cardan.refused")["why"]
        page.connection.send(json.dumps(TELEOP))
        assert "viewer" in page.next("cardan.refused")["why"]
    assert (arm.requests, network.published) == ([], [])


def test_an_operator_moves_it(arm, operator):
    held(operator)
    until(lambda: arm.requests, "the arm is asked")


def test_what_clients_may_not_use_they_may_not_open(network, arm, tmp_path):
    few = {"topics": ("/pad",), "services": ("/x",)}
    with console(network, tmp_path, **few) as running, page_program(running) as page:
        page.begin()
        for target in ({"arm": ARM}, {"device": "/phone"}):
            page.ask("cardan.open", channel=1, **target)
            assert "may use" in page.next("cardan.refused")["why"]
        page.open(1, device="/pad")


def test_every_page_is_a_source_of_its_own(arm, running):
    with page_program(running) as first, page_program(running) as second:
        sources = [each.begin()["source"] for each in (first, second)]
    assert len(set(sources)) == 2


def test_a_pad_is_a_game_controller_of_ros_2(network, page):
    page.open(3, joy="/joy")
    pad = GamepadFrame(-0.5, -1.0, 0.25, 0.75, 0.5, 1.0, 1 << 0 | 1 << 4 | 1 << 15)
    page.frame(pad, False, channel=3)
    page.frame(pad, False, channel=3, late_s=FRESH_S + 0.05)
    page.frame(pad, False, channel=3, visible=False)
    page.frame(PhoneFrame(None), False, channel=3)
    assert "opened for a pad" in page.next("cardan.refused")["why"]
    ((topic, message),) = network.published
    assert topic == "/joy"
    assert message["axes"] == [0.5, 1.0, -0.25, -0.75, 0.5, 1.0]
    # South, left shoulder and the pad's right, as gamepads name them.
    assert [number for number, down in enumerate(message["buttons"]) if down] == [0, 9, 14]
    network.publish("/joy/set_feedback", "sensor_msgs/msg/JoyFeedback", type=1, intensity=1.0)
    assert page.next("cardan.feedback")["intensity"] == 1.0


def test_the_driver_of_joy_reads_a_pad_as_it_is_held():
    """The left stick is x and y, as in the driver's layout."""
    layout = LAYOUTS["game_controller"][0]
    pad = GamepadFrame(-0.5, -1.0, 0.25, 0.75)
    axes = [0.5, 1.0, -0.25, -0.75, 0.0, 0.0]
    x, y, z, _, _, yaw = (axes[each - 1] if each else 0.0 for each in layout)
    assert (x, y) == (-pad.left_down, -pad.left_right)
    assert (z, yaw) == (-pad.right_down, -pad.right_right)


# -- commands -------------------------------------------------------------------------------------


def test_orders_are_those_of_the_command_line(page, monkeypatch, tmp_path):
    script = tmp_path / "cardan.py"
    script.write_text("import json, sys; print(json.dumps(sys.argv[1:]))")
    command = commands.carry_out.__defaults__[0]
    monkeypatch.setattr(commands.carry_out, "__defaults__", ((command[0], str(script)),))
    for fields, words in (
        ({"do": "list"}, ["daemon", "ps", "--json"]),
        ({"do": "stop", "name": "gofa-1"}, ["daemon", "stop", "gofa-1"]),
        ({"do": "doctor", "name": "x"}, ["doctor", "--json"]),
    ):
        page.ask("cardan.daemon", id="d", **fields)
        assert page.next("cardan.daemon", id="d")["result"] == words
    for fields in (
        {"do": "stop"},
        {"do": "stop", "name": "--help"},
        {"do": "stop", "name": ["a"]},
        {"do": "run"},
        {},
    ):
        page.ask("cardan.daemon", id="d", **fields)
        assert page.next("cardan.refused", id="d")["asked"] == "cardan.daemon"


def test_without_a_daemon_it_says_so(page, monkeypatch, tmp_path):
    monkeypatch.setenv("CARDAN_SOCKET", str(tmp_path / "none.sock"))
    assert "no daemon runs here" in page.refused("cardan.daemon", do="list")


# -- requests for authority -----------------------------------------------------------------------

REQUESTS, REQUEST = f"{ARM}/authority/request", "cardan_msgs/msg/AuthorityRequest"


def asked_for(page, **wanted):
    """Next request for authority that the page receives."""
    message = page.next("publish", topic=REQUESTS)["msg"]
    assert {key: message[key] for key in wanted} == wanted
    return message


def test_a_page_asks_another_for_the_authority_which_keeps_it(running, arm):
    with page_program(running) as owner, page_program(running) as other:
        names = [each.begin()["source"] for each in (owner, other)]
        for each in (owner, other):
            each.ask("subscribe", topic=REQUESTS, type=REQUEST)
            each.settle()
        other.ask("cardan.ask", arm=ARM, owner=names[0])
        for each in (owner, other):
            asked_for(each, source=names[1], owner=names[0], answer="")
        owner.ask("cardan.keep", arm=ARM, source=names[1])
        for each in (owner, other):
            asked_for(each, source=names[1], owner=names[0], answer="refused")
    assert arm.requests == []  # Only the owner can hand the arm over.


def test_who_asks_is_reported_what_is_wrong(page, running, arm, network):
    for fields, why in (
        ({"arm": ARM}, "owner"),
        ({"arm": ARM, "owner": ""}, "owner"),
        ({"arm": ARM, "owner": "a\nb"}, "owner"),
        ({"arm": ARM, "owner": "x" * 1000}, "owner"),
        ({"arm": "/none", "owner": "x"}, "no arm /none"),
        ({"arm": "no name", "owner": "x"}, "no name"),
        ({"owner": "x"}, "arm"),
    ):
        assert why in page.refused("cardan.ask", **fields)
    assert REQUESTS not in network.topics()
