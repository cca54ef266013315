"""One readable line of a JR3 board's frame: raw, and in SI units where full scales are known."""

from __future__ import annotations

from cardan.dissect.jr3_can import (
    COUNTS_AT_FULL_SCALE,
    STATES,
    TENTHS,
    AckFrame,
    BrokenFrame,
    ForcesFrame,
    FullScalesAckFrame,
    GripperPwmFrame,
    Jr3Frame,
    MomentsFrame,
    SetFilterFrame,
    StartAsyncFrame,
    StartSyncFrame,
    UnknownFrame,
)

Scales = tuple[int, int, int]


def describe(frame: Jr3Frame, scales: Scales | None = None) -> str:
    """The named values of a frame that is not broken; `scales` are the full scales of a sample's
    forces (N) or moments (0.1 N·m)."""
    if isinstance(frame, UnknownFrame | BrokenFrame):
        return f"{frame.title} {frame.data.hex(' ')}".rstrip()
    if isinstance(frame, ForcesFrame | MomentsFrame):
        raw = (frame.x, frame.y, frame.z)
        text = f"{frame.title} {frame.x} {frame.y} {frame.z} counter {frame.counter}"
        if scales is not None:
            divisor = COUNTS_AT_FULL_SCALE * (TENTHS if isinstance(frame, MomentsFrame) else 1)
            unit = "N·m" if isinstance(frame, MomentsFrame) else "N"
            values = (f"{r * s / divisor:.6g}" for r, s in zip(raw, scales, strict=True))
            text += f" | {' '.join(values)} {unit}"
        return text + (" | OVERRANGE" if overrange(frame) else "")
    words = [frame.title]
    if isinstance(frame, AckFrame | FullScalesAckFrame):
        words.append(STATES.get(frame.state, f"state {frame.state}"))
    if isinstance(frame, FullScalesAckFrame):
        words.append(f"full scales {frame.x} {frame.y} {frame.z}")
    if isinstance(frame, StartSyncFrame | StartAsyncFrame | SetFilterFrame):
        cutoff = frame.cutoff_centihertz
        words.append(f"cut-off {cutoff / 100:g} Hz" if cutoff else "unfiltered")
    if isinstance(frame, StartAsyncFrame):
        words.append(f"period {frame.period_us / 1e3:g} ms")
    if isinstance(frame, GripperPwmFrame):
        words.append(f"{frame.pwm_percent:.6g} %")
    return " ".join(words)


def overrange(frame: Jr3Frame) -> bool:
    """Whether a sample's half has a value beyond full scale."""
    return max(abs(frame.x), abs(frame.y), abs(frame.z)) > COUNTS_AT_FULL_SCALE
