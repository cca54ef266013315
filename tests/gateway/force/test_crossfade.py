"""The rendered map makes no jumps while the hand holds the device."""

import itertools
import math

import pytest
from hypothesis import given, settings, strategies as st

from cardan.common.haptics import WorldMap
from cardan.gateway.force.crossfade import CROSSFADE_M_S, LONGEST_STEP_S, MapCrossfade
from cardan.gateway.force.fixtures import world_point
from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.spatial import norm, subtract
from cardan.types import ZERO3, Vector3
from tests.examples import examples
from tests.gateway.device_pose_bench import DT_S, DevicePoseBench, displaced
from tests.gateway.operator.test_differential import plans, rpys

HERE = Vector3(0.1, -0.2, 0.05)


def shifted(x):
    return WorldMap(offset=Vector3(x, 0.0, 0.0))


def test_an_engagement_begins_with_its_own_map_at_once():
    glide, world = MapCrossfade(), shifted(0.5)
    assert glide.follow(world, HERE, 1.0) is world
    assert glide.follow(world, HERE, 1.004) is world
    glide.release()
    elsewhere = shifted(0.7)
    assert glide.follow(elsewhere, HERE, 1.008) is elsewhere


def test_a_jump_is_glided():
    glide = MapCrossfade()
    glide.follow(shifted(0.5), HERE, 1.0)
    places = [glide.follow(shifted(0.52), HERE, 1.0 + k * DT_S).offset.x for k in range(1, 600)]
    assert places[0] == pytest.approx(0.5)
    assert places[249] - places[0] == pytest.approx(CROSSFADE_M_S * 249 * DT_S, rel=0.01)
    assert max(b - a for a, b in itertools.pairwise(places)) < 1.01 * CROSSFADE_M_S * DT_S
    assert places[-1] == 0.52


def test_a_stall_makes_no_jump_of_the_glide():
    glide = MapCrossfade()
    glide.follow(shifted(0.5), HERE, 1.0)
    glide.follow(shifted(0.6), HERE, 1.004)
    after = glide.follow(shifted(0.6), HERE, 9.0).offset.x
    assert after == pytest.approx(0.5 + CROSSFADE_M_S * LONGEST_STEP_S)


def test_what_the_hand_does_itself_is_no_jump():
    """A slip and an edge of the workspace move the map no more than the hand moves."""
    glide = MapCrossfade()
    glide.follow(shifted(0.5), HERE, 1.0)
    slipped = shifted(0.499)
    assert glide.follow(slipped, HERE._replace(x=0.101), 1.004) is slipped
    held = WorldMap((0.0, 0.0, 0.0, 0, 1, 0, 0, 0, 1), Vector3(0.6, 0.0, 0.0))
    assert glide.follow(held, HERE._replace(x=0.102), 1.008) is held


def test_another_direction_is_glided_as_it_is_where_the_hand_is():
    glide, half = MapCrossfade(), math.sqrt(0.5)
    glide.follow(shifted(0.5), HERE, 1.0)
    turned = WorldMap((half, -half, 0, half, half, 0, 0, 0, 1), Vector3(0.5, 0.0, 0.0))
    rendered = glide.follow(turned, HERE, 1.0)
    assert world_point(rendered, HERE) == pytest.approx(world_point(shifted(0.5), HERE))


WORKSPACE = ReferenceLimits(
    workspace_x_m=(0.35, 0.6), workspace_y_m=(-0.15, 0.15), workspace_z_m=(0.3, 0.55)
)


@settings(max_examples=examples(60))
@given(plans, rpys, st.floats(0.3, 3.0))
def test_nothing_makes_the_rendered_place_jump(plan, rpy, factor):
    """With recaptures, slips and edges, the rendered place moves at most twice as far as the hand,
    plus the crossfade."""
    bench = DevicePoseBench(
        limits=WORKSPACE,
        device_rpy_deg=rpy,
        scale=(factor, factor, factor, 1.0, 1.0, 1.0),
        recapture="button_1",
        slip_m=0.05,
    )
    bench.run().tap("button_2")
    glide, before = MapCrossfade(), None
    for (kind, value), ticks, _ in plan:
        if kind in ("send", "jump"):
            bench.send_pose(displaced(*value[:3]))
        elif kind != "tap":
            continue
        elif value != "grip":
            bench.tap(value)
            if value == "button_2":
                glide.release()
                before = None
        for _ in range(ticks):
            bench.run()
            world = bench.core.device_map()
            if world is None:
                glide.release()
                before = None
                continue
            hand = bench.device.pose.position
            at = world_point(glide.follow(world, hand, bench.now_s), hand)
            if before is not None:
                hand_m = factor * norm(subtract(hand, before[1]))
                passed_s = bench.now_s - before[2]
                moved_m = norm(subtract(at, before[0]))
                assert moved_m <= 2.0 * hand_m + CROSSFADE_M_S * passed_s + 1e-6
            before = at, hand, bench.now_s


def test_after_a_recapture_the_glide_ends_at_the_true_map():
    bench = DevicePoseBench(recapture="button_1", slip_m=0.1).run().tap("button_2")
    glide = MapCrossfade()
    bench.send_pose(displaced(y=0.4))
    for k in range(1500):
        if k == 30:
            bench.press("button_1")
        bench.run()
        rendered = glide.follow(bench.core.device_map(), bench.device.pose.position, bench.now_s)
        if k == 30:
            jump = subtract(rendered.offset, bench.core.device_map().offset)
            assert norm(jump) > 0.02
    # distance of the hand since, by which the TCP has slipped
    assert bench.core.following
    while glide.left != ZERO3:
        bench.run()
        rendered = glide.follow(bench.core.device_map(), bench.device.pose.position, bench.now_s)
        assert bench.now_s < 130.0
    assert rendered == bench.core.device_map()
