"""Episodes from records: at a fixed rate, one per file or per engagement; all problems with time
stamps are reported."""

import json
import math

import pytest

from cardan.errors import CaptureError, OptionError
from cardan.gateway.session.snapshot import Snapshot
from cardan.robots import load_arm
from cardan.spatial import from_rotation_vector, multiply
from cardan.types import Vector3
from cardan_learning.resample import read_frames
from tests.recording.sessions import NODE, NS, STRING
from tests.recording.test_replay import topic, write

JOINT_STATE, POSE = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"
STATUS = "cardan_msgs/msg/ArmStatus"
JOINTS = ("one", "two")
HZ = 50


def stamp(stamp_s):
    whole = round(stamp_s * NS)
    return {"stamp": {"sec": whole // NS, "nanosec": whole % NS}}


def instant(
    at_s, *, node=NODE, authority="device", closed=False, log_s=None, ahead=0.1, joints=JOINTS
):
    """Return a session's messages at an instant: x and the joints equal the time."""
    log_s = at_s if log_s is None else log_s
    turn = {"w": math.cos(0.5 * at_s), "x": 0.0, "y": 0.0, "z": math.sin(0.5 * at_s)}
    namespace = node.rpartition("/")[0]

    def placed(x):
        return {"header": stamp(at_s), "pose": {"position": {"x": x}, "orientation": turn}}

    position = [at_s * (1 + number) for number, _ in enumerate(joints)]
    state = {"header": stamp(at_s), "name": list(joints), "position": position}
    yield log_s, topic(f"{namespace}/joint_states", JOINT_STATE, (node,)), state
    yield log_s, topic(f"{node}/state/pose", POSE, (node,)), placed(at_s)
    yield log_s, topic(f"{node}/state/target", POSE, (node,)), placed(at_s + ahead)
    status = {"header": stamp(at_s), "authority": authority, "phase": "moving"}
    yield log_s, topic(f"{node}/state/status", STATUS, (node,)), status
    text = Snapshot(gripper_closed=closed).to_bytes().decode()
    yield log_s - 1.0, topic(f"{node}/state/snapshot", STRING, (node,)), {"data": text}


def recorded(path, times, **more):
    """Write a record with an instant at each of `times`; further arguments may depend on the
    time."""
    rows = []
    for at_s in times:
        rows += instant(at_s, **{k: v(at_s) if callable(v) else v for k, v in more.items()})
    return write(path, rows)


def steadily(seconds, first_s=1.0):
    return [first_s + number / HZ for number in range(round(seconds * HZ) + 1)]


def test_frames_are_between_states(tmp_path):
    path = recorded(tmp_path / "r.mcap", steadily(2.0), closed=lambda t: t > 2.0)
    frames = read_frames([path], 30)
    assert frames.problems == []
    (episode,) = frames.episodes
    assert frames.observation_names[:3] == ("one.pos", "two.pos", "ee.x")
    assert frames.action_names == (
        *("ee.x", "ee.y", "ee.z", "ee.wx", "ee.wy", "ee.wz"),
        "ee.gripper_pos",
    )
    assert (len(episode.observations), len(episode.actions)) == (61, 61)
    assert episode.gaps == []
    for number, (seen, asked) in enumerate(zip(episode.observations, episode.actions, strict=True)):
        at_s = 1.0 + number / 30
        assert seen[:3] == pytest.approx((at_s, 2.0 * at_s, at_s))
        assert seen[5:8] == pytest.approx((0.0, 0.0, at_s))
        assert asked[0] == pytest.approx(at_s + 0.1)
        assert seen[-1] == asked[-1]
    grips = [seen[-1] for seen in episode.observations]
    assert (grips[0], grips[-1]) == (100.0, 0.0)
    assert grips.index(0.0) == pytest.approx(31, abs=1)


def test_a_rate_that_is_not_that_of_the_record(tmp_path):
    path = recorded(tmp_path / "r.mcap", steadily(1.0))
    for fps, count in ((7, 8), (50, 51)):
        assert len(read_frames([path], fps).episodes[0].actions) == count
    with pytest.raises(OptionError, match=r"--fps: 60 is not allowed; it must be at most 50"):
        read_frames([path], 60)


def test_stamps_that_go_back_are_left_out_and_reported(tmp_path):
    times = steadily(1.0)
    times[20:20] = times[10:15]  # The clock was set back by 0.2 s, for 0.1 s.
    frames = read_frames([recorded(tmp_path / "r.mcap", times)], 30)
    (episode,) = frames.episodes
    assert [seen[0] for seen in episode.observations] == sorted(
        seen[0] for seen in episode.observations
    )
    for what in ("joints", "measured poses", "commanded poses"):
        assert any(f"5 {what} left out: their stamps" in each for each in frames.problems)


def test_in_a_gap_what_was_before_holds_and_the_gap_is_reported(tmp_path):
    times = [each for each in steadily(3.0) if not 1.5 < each < 2.5]
    frames = read_frames([recorded(tmp_path / "r.mcap", times)], 10)
    (episode,) = frames.episodes
    assert len(episode.actions) == 31
    assert [seen[0] for seen in episode.observations][5:16] == pytest.approx([1.5] * 10 + [2.5])
    assert [gap.what for gap in episode.gaps] == ["joints", "measured poses", "commanded poses"]
    for gap in episode.gaps:
        assert gap.long_ns == pytest.approx(1.0 * NS, abs=0.05 * NS)


@pytest.mark.parametrize("step_s", [3600.0, 3.5 * 86400.0])
def test_at_a_clock_that_was_set_ahead_an_episode_ends(tmp_path, step_s):
    times = [each + (step_s if each > 2.0 else 0.0) for each in steadily(2.0)]
    frames = read_frames([recorded(tmp_path / "r.mcap", times)], 30)
    assert [len(each.actions) for each in frames.episodes] == [31, 30]
    assert not any(each.gaps for each in frames.episodes)
    assert len(frames.problems) == 3
    assert f"joints: nothing for {step_s:.1f} s: the episode ends there" in frames.problems[0]


def test_how_long_gaps_are_filled_is_an_option(tmp_path):
    path = recorded(tmp_path / "r.mcap", [*steadily(1.0), *steadily(1.0, 22.0)])
    for longest_s, counts in ((30.0, [221]), (15.0, [11, 11])):
        frames = read_frames([path], 10, longest_gap_s=longest_s)
        assert [len(each.actions) for each in frames.episodes] == counts


@pytest.mark.parametrize("at", [0, 20])
def test_an_instant_ahead_of_those_around_it_is_left_out_and_reported(tmp_path, at):
    times = steadily(1.0)
    times[at] += 3600.0
    frames = read_frames([recorded(tmp_path / "r.mcap", times)], 10)
    (episode,) = frames.episodes
    assert len(episode.actions) in (10, 11)
    assert any("1 joints left out: their stamps" in each for each in frames.problems)


def test_an_episode_each_engagement(tmp_path):
    def owner(at_s):
        return "device" if 1.5 <= at_s < 2.5 else "verbs" if 3.0 <= at_s < 3.5 else ""

    path = recorded(tmp_path / "r.mcap", steadily(3.0), authority=owner)
    frames = read_frames([path], 10, each_engagement=True)
    starts = [episode.observations[0][0] for episode in frames.episodes]
    assert starts == pytest.approx([1.5, 3.0])
    assert [len(episode.actions) for episode in frames.episodes] == [11, 6]
    (whole,) = read_frames([path], 10).episodes
    assert len(whole.actions) == 31


def test_an_engagement_that_is_too_short_is_reported(tmp_path):
    def owner(at_s):
        return "device" if 1.5 <= at_s < 1.54 or at_s > 2.0 else ""

    path = recorded(tmp_path / "r.mcap", steadily(2.0), authority=owner)
    frames = read_frames([path], 10, each_engagement=True)
    assert len(frames.episodes) == 1
    assert any("0.04 s are too short for an episode" in each for each in frames.problems)


def test_nobody_had_the_authority(tmp_path):
    path = recorded(tmp_path / "r.mcap", steadily(1.0), authority="")
    with pytest.raises(CaptureError, match="no episode is in there"):
        read_frames([path], 10, each_engagement=True)


def test_several_files_are_several_episodes_of_one_arm(tmp_path):
    paths = [recorded(tmp_path / f"{n}.mcap", steadily(1.0, first_s=n)) for n in (1.0, 5.0)]
    frames = read_frames(paths, 10)
    assert [each.record for each in frames.episodes] == paths
    other = recorded(tmp_path / "o.mcap", steadily(1.0), joints=("three", "four"))
    with pytest.raises(CaptureError, match="of another arm"):
        read_frames([paths[0], other], 10)


def test_one_of_several_arms_has_its_own_joints(tmp_path):
    rows = []
    for at_s in steadily(1.0):
        rows += [
            *instant(at_s, node="/left/server"),
            *instant(at_s, node="/right/server", ahead=0.5),
        ]
    path = write(tmp_path / "r.mcap", rows)
    (episode,) = read_frames([path], 10, arm="right/server").episodes
    assert episode.actions[0][0] == pytest.approx(1.5)
    assert episode.observations[0][0] == pytest.approx(1.0)
    with pytest.raises(OptionError, match=r"--arm.*one of /left/server, /right/server"):
        read_frames([path], 10)
    with pytest.raises(OptionError, match="--arm"):
        read_frames([path], 10, arm="middle")


def test_what_is_no_number_is_left_out_and_reported(tmp_path):
    rows = []
    for at_s in steadily(1.0):
        for log_s, where, message in instant(at_s):
            if where.name.endswith("joint_states") and 1.2 < at_s < 1.3:
                message = {**message, "position": [math.nan, 0.0]}
            rows.append((log_s, where, message))
    frames = read_frames([write(tmp_path / "r.mcap", rows)], 10)
    assert any("joints left out: they are not numbers" in each for each in frames.problems)
    assert all(math.isfinite(number) for seen in frames.episodes[0].observations for number in seen)


def test_a_record_without_what_is_needed_is_refused(tmp_path):
    path = write(tmp_path / "none.mcap", [(1.0, topic("/other"), {"data": "x"})])
    with pytest.raises(CaptureError, match="no state of an arm"):
        read_frames([path], 10)
    rows = [row for at in steadily(1.0) for row in instant(at) if "target" not in row[1].name]
    with pytest.raises(CaptureError, match="too few commanded poses for a frame"):
        read_frames([write(tmp_path / "t.mcap", rows)], 10)


def test_other_nodes_topics_of_these_names_do_no_harm(tmp_path):
    rows = [
        (1.0, topic("/other/state/pose", STRING), {"data": "x"}),
        (1.0, topic("/other/state/snapshot", STRING), {"data": "[1]"}),
        (1.0, topic("/joint_states", JOINT_STATE, ("/other",)), {"name": ["x"], "position": [1.0]}),
    ]
    for at_s in steadily(1.0):
        rows += instant(at_s)
    frames = read_frames([write(tmp_path / "r.mcap", rows)], 10)
    assert frames.problems == []
    assert frames.observation_names[0] == "one.pos"


def test_a_file_that_was_cut_off_says_so(tmp_path):
    path = recorded(tmp_path / "r.mcap", steadily(2.0))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    try:
        frames = read_frames([path], 10)
    except CaptureError as error:
        assert "too few" in str(error) or "no state" in str(error)  # noqa: PT017
    else:
        assert any("the file ends early" in each for each in frames.problems)


# -- rotation vectors -----------------------------------------------------------------------------

HOME = load_arm("ur5").home_tcp.orientation


def turned_record(path, turn, tables):
    """Return a record of an arm with its TCP rotated by `turn`, a small rotation vector, from a
    UR5's home, and the session's configuration."""
    w, x, y, z = multiply(from_rotation_vector(Vector3(*turn)), HOME)
    rows = []
    if tables is not None:
        data = {"data": json.dumps({"tables": tables})}
        rows.append((1.0, topic(f"{NODE}/configuration", STRING, (NODE,)), data))
    for at_s in steadily(0.5):
        for log_s, where, message in instant(at_s):
            if "pose" in message:
                message["pose"]["orientation"] = {"w": w, "x": x, "y": y, "z": z}
            rows.append((log_s, where, message))
    return write(path, rows)


UR5 = {"arm": {"model": "ur5", "tool_xyz_m": [0, 0, 0.1], "tool_rpy_deg": [0, 0, 0], "else": 1}}


def test_data_sets_of_an_arm_that_begin_alike_are_written_alike(tmp_path):
    written = []
    for number, sign in enumerate((1.0, -1.0)):
        turn = (2e-4 * sign, -2e-4 * sign, 1e-4)
        frames = read_frames([turned_record(tmp_path / f"{number}.mcap", turn, UR5)], 10)
        assert (frames.problems, frames.model) == ([], "ur5")
        (episode,) = frames.episodes
        written += [seen[5:8] for seen in episode.observations]
        written += [asked[3:6] for asked in episode.actions]
    assert max(math.dist(written[0], each) for each in written) < 2e-3


@pytest.mark.parametrize(
    "tables", [None, {}, {"arm": None}, {"arm": {"model": "nobody's"}}, {"arm": {"model": 1}}, []]
)
def test_without_a_model_that_is_known_here_the_first_pose_decides(tmp_path, tables):
    frames = read_frames([turned_record(tmp_path / "r.mcap", (0.0, 0.0, 0.0), tables)], 10)
    assert (frames.problems, frames.model) == ([], "")
    assert math.dist(frames.episodes[0].observations[0][5:8], frames.written.reference) < 1e-6


def test_records_with_other_tools_are_reported(tmp_path):
    arm = {**UR5["arm"], "tool_rpy_deg": [0, 0, 90]}
    paths = [
        turned_record(tmp_path / f"{number}.mcap", (0.0, 0.0, 0.0), tables)
        for number, tables in enumerate((UR5, {"arm": arm}))
    ]
    (problem,) = read_frames(paths, 10).problems
    assert "1.mcap: its arm has another model or tool than that of" in problem
