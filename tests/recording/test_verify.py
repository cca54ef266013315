"""The control core compared with records: equal bit for bit, or the first different cycle is
reported."""

import dataclasses
import json
import math

import pytest

from cardan.drivers.sim_arm import SimArm
from cardan.errors import CaptureError
from cardan.gateway.arm.cycle_record import RecordError, decode_cycle
from cardan.gateway.arm.states import Inhibit
from cardan.gateway.arm.vocab import Begins
from cardan.gateway.session.assembly import make_robot, make_verbs
from cardan.gateway.session.config import parse_config
from cardan.recording.mcap_file import RecordedMessage, RecordedTopic, RecordWriter
from cardan.recording.verify import verify
from cardan.types import DeviceLink, DeviceState, Inertia, RobotLink, Vector3
from tests.recording.sessions import NODE, NS, STRING, TABLES, Recorded


@pytest.fixture(scope="module")
def recorded():
    return Recorded()


@pytest.fixture
def file(recorded, tmp_path):
    return recorded.write(tmp_path / "session.mcap")


def test_a_session_of_a_spacemouse_and_a_ur5_is_replayed_bit_for_bit(recorded, file):
    (report,) = verify(file)
    assert report.same
    assert not report.ended
    assert report.session == NODE
    assert report.cycles == len(recorded.texts) > 700
    assert report.lines() == [
        f"{NODE}: {report.cycles} cycles, each command bit for bit the recorded one"
    ]
    # the session has enough different commands
    commands = {decode_cycle(text).command for text in recorded.texts}
    assert len(commands) > 400


def test_a_changed_limit_is_found_at_the_first_cycle_that_it_changes(recorded, file):
    def slower(config):
        return dataclasses.replace(
            config, limits=dataclasses.replace(config.limits, angular_acceleration_rad_s2=2.5)
        )

    (report,) = verify(file, slower)
    assert not report.same
    assert not report.ended
    found = report.difference
    assert 0 < found.cycle < len(recorded.texts)
    assert found.cycle == report.cycles + 1
    assert decode_cycle(recorded.texts[found.cycle - 1]).command == found.recorded
    assert found.recorded != found.computed
    assert f"cycle {found.cycle} (at {found.stamp_s:.6f} s) differs" in report.lines()[0]


def test_one_changed_bit_is_found(recorded, tmp_path):
    other = Recorded.__new__(Recorded)
    other.tables, other.stamps_s, other.texts = TABLES, recorded.stamps_s, list(recorded.texts)
    table = json.loads(other.texts[500])
    table["command"][0][2] = math.nextafter(table["command"][0][2], math.inf)
    other.texts[500] = json.dumps(table, separators=(",", ":"))
    (report,) = verify(other.write(tmp_path / "bit.mcap"))
    assert report.difference.cycle == 501


def test_the_configuration_of_an_older_version_is_refused_in_words(recorded, tmp_path, monkeypatch):
    limits = {**TABLES.get("limits", {}), "leash_m": 0.05}
    monkeypatch.setattr(recorded, "tables", {**TABLES, "limits": limits})
    with pytest.raises(CaptureError, match=r"replay it by that one: limits\.leash_m: is now: max_"):
        verify(recorded.write(tmp_path / "older.mcap"))


def test_no_hardware_is_opened(file, monkeypatch):
    def refuse(*_):
        raise AssertionError("opened")

    for name in ("open", "send", "cycles"):
        monkeypatch.setattr(SimArm, name, refuse)
    assert verify(file)[0].same


@pytest.mark.matrix("request_stop-<lambda>", "suspend-<lambda>", "acknowledge-<lambda>")
# Inhibits like those of trip and suspend.
@pytest.mark.matrix("request_stop-<lambda>", "hold_off-<lambda>")
@pytest.mark.parametrize(
    ("name", "request_by"),
    [
        ("stop", lambda core: core.stop("enough")),
        ("request_stop", lambda core: core.inhibit("the time is over", Inhibit.FOR_GOOD)),
        ("trip", lambda core: core.inhibit("the force is in doubt", Inhibit.ONCE)),
        ("hold_off", lambda core: core.inhibit("the supervisor is silent", Inhibit.WHILE_SAID)),
        ("suspend", lambda core: core.inhibit("", Inhibit.MOTION_IGNORED)),
        ("acknowledge", lambda core: core.acknowledge()),
    ],
)
def test_requests_between_cycles_are_made_again(tmp_path, name, request_by):
    def ask(number, controller):
        if number == 250:
            request_by(controller)
        elif number == 320 and name == "hold_off":
            controller.inhibit("", Inhibit.WHILE_SAID)

    session = Recorded(seconds=1.8, during=ask)
    assert [each.name for each in decode_cycle(session.texts[250]).before] == [name]
    (report,) = verify(session.write(tmp_path / "asked.mcap"))
    assert report.same
    assert report.cycles == len(session.texts)


STILL = "0.1 axes 0.3 0 0 0 0 0\n0.2 neutral\n"
"""Device that lets programs move the arm."""


def streaming(kind, command):
    """Return a program that selects the stream `kind` and sends a command by `command` in every
    fifth cycle; some are refused. Then it releases the arm."""
    verbs = []

    def ask(number, controller):
        if number == 100:
            config = parse_config(TABLES)
            verbs.append(make_verbs(config, make_robot(config), controller, None))
            verbs[0].set_parameters(
                {"streamingCommand": kind, "controllerGain": 2.0}, source="page"
            )
        elif 100 < number < 400 and number % 5 == 0:
            sequence = number if number != 200 else 1  # one command with an old number
            name, value = command(number)
            verbs[0].stream(name, value, owner="page", sequence=sequence)
            verbs[0].stream(name, value, owner="another")
        elif number == 402:
            verbs[0].release("page")

    return ask


STREAMS = {
    "twist": lambda number: ("twist", (0.05 * math.sin(number), 0.02, 0.0, 0.0, 0.1, 0.0)),
    "pose": lambda number: ("jog", (0.001, 0.0005, 0.0, 0.0, 0.0, 0.002)),
    "joints": lambda number: ("joints", (0.1, 0.0, -0.1, 0.0, 0.2, 0.0)),
}


@pytest.mark.parametrize("kind", STREAMS)
def test_the_streams_of_programs_are_replayed_bit_for_bit(tmp_path, kind):
    preset = {"twist": "twst", "pose": "pose", "joints": "jnts"}[kind]
    session = Recorded(seconds=2.0, during=streaming(preset, STREAMS[kind]), hand=STILL)
    asked = [each.name for text in session.texts for each in decode_cycle(text).before]
    assert asked[0] == "set_parameters"
    assert asked[-1] == "release"
    assert len(asked) == 60  # without refused ones
    (report,) = verify(session.write(tmp_path / "stream.mcap"))
    assert report.lines() == [
        f"{NODE}: {len(session.texts)} cycles, each command bit for bit the recorded one"
    ]
    assert len({decode_cycle(text).command for text in session.texts}) > 250


def test_a_stream_that_began_by_itself_is_replayed(tmp_path):
    """Its first command selects the preset, and an invalid one reverts that."""
    verbs = []

    def ask(number, controller):
        if number == 100:
            config = parse_config(TABLES)
            verbs.append(make_verbs(config, make_robot(config), controller, None))
            assert verbs[0].stream("twist", (math.nan,) * 6, owner="page", begins=Begins.NEW)
        elif 120 < number < 300 and number % 5 == 0:
            twist = (0.0, 0.03, 0.0, 0.0, 0.0, 0.0)
            assert not verbs[0].stream("twist", twist, owner="page", begins=Begins.NEW)
        elif number == 302:
            verbs[0].hand_over("other", source="page")

    session = Recorded(seconds=1.6, during=ask, hand=STILL)
    asked = [each.name for text in session.texts for each in decode_cycle(text).before]
    assert asked[:4] == ["set_parameters", "take_back", "set_parameters", "twist"]
    (report,) = verify(session.write(tmp_path / "begun.mcap"))
    assert report.same
    assert not report.ended
    assert report.cycles == len(session.texts)


def test_a_verb_ends_the_replay_and_is_named(tmp_path):
    def ask(number, controller):
        if number == 250:
            controller.record_request("verb", "movl of 'ros2'")

    session = Recorded(seconds=1.4, during=ask)
    (report,) = verify(session.write(tmp_path / "verb.mcap"))
    assert report.same
    assert report.cycles == 250
    assert report.ended.startswith("not replayed from cycle 251 on: verb movl of 'ros2'")


def test_a_record_that_begins_later_says_so(recorded, tmp_path):
    other = Recorded.__new__(Recorded)
    other.tables = TABLES
    other.stamps_s, other.texts = recorded.stamps_s[100:], recorded.texts[100:]
    (report,) = verify(other.write(tmp_path / "late.mcap"))
    assert not report.same
    assert report.ended == (
        "not replayed from cycle 1 on: the record continues with 101; start `cardan net record` "
        "before the session"
    )


def test_a_missing_cycle_ends_the_replay(recorded, tmp_path):
    other = Recorded.__new__(Recorded)
    other.tables = TABLES
    other.stamps_s = recorded.stamps_s[:400] + recorded.stamps_s[401:]
    other.texts = recorded.texts[:400] + recorded.texts[401:]
    (report,) = verify(other.write(tmp_path / "gap.mcap"))
    assert report.same
    assert report.cycles == 400
    assert report.ended == "not replayed from cycle 401 on: the record continues with 402"


def test_filters_are_not_replayed(recorded, tmp_path):
    other = Recorded.__new__(Recorded)
    other.tables = TABLES | {"filters": [{"filter": "proximity"}]}
    other.stamps_s, other.texts = recorded.stamps_s, recorded.texts
    (report,) = verify(other.write(tmp_path / "filter.mcap"))
    assert not report.same
    assert "filters" in report.ended
    assert "proximity" in report.ended


@pytest.mark.parametrize(
    ("topic", "type_name", "words"),
    [
        ("/other", STRING, "no controller_log topic"),
        (
            "/arm/engine",
            "std_msgs/msg/String",
            "has /arm/engine in place of controller_log: an older",
        ),
    ],
)
def test_a_record_without_a_log_of_the_controller(tmp_path, topic, type_name, words):
    file = tmp_path / "other.mcap"
    writer = RecordWriter(file)
    recorded_topic = RecordedTopic(topic, type_name, "", False, ())
    writer.add(RecordedMessage(recorded_topic, NS, NS, 1, b"\0\1\0\0\1\0\0\0\0"))
    writer.finish()
    with pytest.raises(CaptureError, match=words):
        verify(file)


def test_a_cycle_reads_back_as_it_was(recorded):
    record = decode_cycle(recorded.texts[400])
    assert record.robot.link is RobotLink.LIVE
    assert record.device.link is DeviceLink.LIVE
    assert record.device.buttons == {"left"}
    assert type(record.robot.joints) is tuple
    assert record.robot.pose.position.x == json.loads(recorded.texts[400])["robot"][7][0][0]
    assert any(decode_cycle(text).events for text in recorded.texts)


def test_a_devices_inertia_reads_back_as_it_was(recorded):
    table = json.loads(recorded.texts[400])
    place = DeviceState._fields.index("inertia")
    for rates in (None, [0.1, 0.2, 0.3]):
        table["device"][place] = [[0.0, 0.5, 9.8], rates]
        inertia = decode_cycle(json.dumps(table)).device.inertia
        assert inertia == Inertia(Vector3(0.0, 0.5, 9.8), rates and Vector3(*rates))
        assert type(inertia.acceleration) is Vector3
    table["device"][-1] = ["left"]
    assert decode_cycle(json.dumps(table)).device.masked == {"left"}
    del table["device"][-1]  # like records from before the key existed
    assert decode_cycle(json.dumps(table)).device.masked == frozenset()
    del table["device"][place:]
    assert decode_cycle(json.dumps(table)).device.inertia is None


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "it is not JSON"),
        ("{}", "it has no 'cycle'"),
        ("[]", "a value in it is not of its kind"),
        ('{"cycle": 1}', "it has no 'before'"),
        ('{"cycle": 1e999}', "a value in it is not of its kind"),
        ('{"cycle": 1, "before": [1], "robot": []}', "a value in it is not of its kind"),
        ('{"cycle": 1, "before": [], "robot": 5}', "a value in it is not of its kind"),
        ("[" * 100_000, "it is nested too deeply"),
    ],
    ids=lambda each: each[:40],
)
def test_what_is_no_cycle_is_refused_in_words(text, why):
    """The messages are not those of Python's exceptions."""
    with pytest.raises(RecordError) as caught:
        decode_cycle(text)
    assert str(caught.value) == f"no record of a cycle: {why}"
