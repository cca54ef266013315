"""The tick's interface between threads, and between C and Python."""

from __future__ import annotations

import ctypes
import threading
from typing import Any

import pytest

from cardan.common.haptics import IDENTITY3, OperatingState
from cardan.errors import DriverError
from cardan.types import ZERO3, Pose, Quaternion, Vector3
from cardan_omni.driver import native, structures
from cardan_omni.driver.limits import TickLimits
from cardan_omni.driver.native import NativeMissingError, available, library_path
from cardan_omni.driver.tick import Tick
from cardan_omni.driver.values import haptic_state, tick_details
from omni_tick_bench import (
    ROOM,
)


@pytest.mark.matrix
def test_nothing_is_ever_read_half_written() -> None:
    """Three threads without the interpreter's lock: one commands, one steps, one reads."""
    free: Any = ctypes.CDLL(str(library_path()))
    limits = structures.c_limits(TickLimits(**ROOM))
    free.tick_create.restype = ctypes.c_void_p
    tick = ctypes.c_void_p(free.tick_create(ctypes.byref(limits)))
    stop = threading.Event()
    torn: list[Any] = []
    seen: set[int] = set()

    def command() -> None:
        c = structures.CCommand()
        c.linear[:] = c.rotation[:] = IDENTITY3
        c.fixture_count, c.force_scale = 8, 1.0
        sequence = 0
        for fixture in c.fixtures:
            fixture.kind = 4
            fixture.rotation[:] = IDENTITY3
            fixture.stiffness_n_m, fixture.cap_n = 1.0, 1e9
        while not stop.is_set():
            sequence += 1
            c.sequence, c.stamp_s = sequence, float(sequence)
            c.force[:] = c.offset[:] = (sequence, sequence, sequence)
            for fixture in c.fixtures:
                fixture.point[:] = (2.0 * sequence, 2.0 * sequence, 2.0 * sequence)
            free.tick_command(tick, ctypes.byref(c))

    def step() -> None:
        s = structures.CSample()
        s.rotation[:] = s.jacobian[:] = IDENTITY3
        s.calibrated = 1
        output = structures.COutput()
        k = 0
        while not stop.is_set():
            k += 1
            s.now_s = 1e-3 * k
            s.joints_rad[:] = s.gimbal_rad[:] = (k, k, k)
            free.tick_step(tick, ctypes.byref(s), ctypes.byref(output))

    def read() -> None:
        snapshot = structures.CSnapshot()
        while len(seen) < 1000 and not torn:
            free.tick_snapshot(tick, ctypes.byref(snapshot))
            if not snapshot.ticks:
                continue
            sequence = snapshot.command_sequence
            # 8 springs of 1 N/m pull with 2n - n each, and the separate force is n: 9 n along each
            # axis.
            if set(snapshot.force_commanded[:]) != {9.0 * sequence}:
                torn.append((sequence, snapshot.force_commanded[:]))
            if {*snapshot.joints_rad[:], *snapshot.gimbal_rad[:]} != {float(snapshot.ticks)}:
                torn.append((snapshot.ticks, snapshot.joints_rad[:], snapshot.gimbal_rad[:]))
            seen.add(snapshot.ticks)

    others = [threading.Thread(target=t) for t in (command, step)]
    for thread in others:
        thread.start()
    reader = threading.Thread(target=read)
    reader.start()
    reader.join(60.0)
    stop.set()
    for thread in others:
        thread.join()
    assert not torn
    assert len(seen) >= 1000
    free.tick_destroy(tick)


def test_both_languages_agree_on_every_field(monkeypatch: pytest.MonkeyPatch) -> None:
    assert available()
    right = structures.expected_layout()
    monkeypatch.setattr(native, "expected_layout", lambda: [*right[:-1], right[-1] + 4])
    native.tick_library.cache_clear()
    try:
        with pytest.raises(NativeMissingError, match="tools/native"):
            Tick()
        assert not available()
    finally:
        native.tick_library.cache_clear()


def test_without_the_compiled_part_it_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    monkeypatch.setattr(native, "library_path", lambda: tmp_path / "libcardan_omni.so")
    native.tick_library.cache_clear()
    try:
        assert not available()
        with pytest.raises(NativeMissingError, match="gcc"):
            Tick()
    finally:
        native.tick_library.cache_clear()


def test_packed_and_declared_structures_are_the_same() -> None:
    command = structures.Flat(structures.CCommand, without="fixtures")
    assert command.struct.size == structures.CCommand.fixtures.offset
    for structure in (structures.CFixture, structures.CSample, structures.CSnapshot):
        assert structures.Flat(structure).struct.size == ctypes.sizeof(structure)


def test_a_snapshots_numbers_are_read_by_their_names() -> None:
    snapshot = structures.CSnapshot(
        stamp_s=3.0, ticks=7, state=2, reason=2, gap_s=0.25, presses=(4, 5), inkwell=1, faults=6
    )
    snapshot.rotation[:] = IDENTITY3
    snapshot.force[:], snapshot.encoders[:] = (1.0, 2.0, 3.0), range(6)
    state = haptic_state(bytearray(snapshot), 9)
    assert state.pose == Pose(ZERO3, Quaternion(1.0, 0.0, 0.0, 0.0))
    assert (state.stamp_s, state.ticks, state.state) == (3.0, 7, OperatingState.PAUSED)
    assert (state.force, state.presses, state.inkwell) == (Vector3(1.0, 2.0, 3.0), (4, 5), True)
    assert (state.gap_s, state.faults, state.dropped_commands) == (0.25, 6, 9)
    assert type(state.force) is Vector3
    details = tick_details(bytearray(snapshot))
    assert (details.encoders, details.realtime) == ((0, 1, 2, 3, 4, 5), False)
    assert haptic_state(bytearray(ctypes.sizeof(snapshot)), 0).rate_hz == 0.0


def test_after_close_it_says_so() -> None:
    tick = Tick()
    tick.close()
    tick.close()
    with pytest.raises(DriverError, match="closed"):
        tick.snapshot()
