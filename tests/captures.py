"""Captures of real controllers. They are stored outside of the repository."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from cardan_dissect import network
from cardan_dissect.capture import Capture

FOLDER = Path(__file__).parents[2] / "shared" / "captures"
MOTOMAN = FOLDER / "motoman_single_group_simple_move.pcapng"


def require(path: Path) -> Path:
    """Return `path`, or skip and name the missing file."""
    if not path.exists():
        pytest.skip(f"the capture {path.name} is not in {FOLDER.name}/ beside the repository")
    return path


def tcp_segments(path: Path) -> Iterator[tuple[float, network.Segment]]:
    """Time in s since the first packet, and segment, of every TCP segment with a payload."""
    start_ns = None
    for frame in Capture(require(path)):
        start_ns = frame.time_ns if start_ns is None else start_ns
        segment = network.parse(frame)
        if isinstance(segment, network.Segment) and segment.protocol == "TCP" and segment.payload:
            yield (frame.time_ns - start_ns) * 1e-9, segment
