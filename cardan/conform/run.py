"""Runs of a suite on its simulated peer in virtual time, a target or a capture; result files."""

from __future__ import annotations

import dataclasses
import hashlib
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from cardan.common.extras import missing_extra
from cardan.common.plugins import entry_points
from cardan.conform.attachments import pcap, read_mcap, write_mcap
from cardan.conform.live import Live
from cardan.conform.redaction import Redaction
from cardan.conform.report import SuiteReport, check_timeline
from cardan.conform.requirements import Level
from cardan.conform.runner import Exchange
from cardan.conform.suite import Suite
from cardan.conform.timeline import WireTimeline
from cardan.conform.transports import host_and_port
from cardan.errors import CaptureError, ConfigurationError, ExtraMissingError
from cardan.recording.mcap_file import is_mcap

CAPTURES = "cardan.captures"
"""Entry points of functions that make a timeline from a suite, a capture file and a target."""
LIVE_S = 10.0
"""Default length of a phase at a target."""


def simulated(
    suite: Suite[Any],
    level: Level,
    faults: Mapping[str, float] | None = None,
    seed: int = 0,
    seconds: float | None = None,
) -> tuple[SuiteReport, WireTimeline]:
    """Check the suite's simulated peer, in virtual time."""
    exchange = Exchange(suite.scenario(level, suite.seconds if seconds is None else seconds))
    suite.simulate(exchange, faults or {}, seed)
    report = check_timeline(suite, exchange.timeline, level, faults=faults)
    return report, exchange.timeline


def at(
    suite: Suite[Any],
    target: str,
    level: Level,
    instruct: Callable[[str], None],
    seconds: float = LIVE_S,
) -> tuple[SuiteReport, WireTimeline]:
    """Check the device or program at `target`. `instruct` gets the instructions to the operator.

    Raises ConfigurationError for a wrong target, AddressError or DeviceAccessError if it cannot be
    opened.
    """
    wires = suite.wires(target)
    redaction = Redaction()
    if "/" not in target:
        redaction.hide(host_and_port(target, "--target", 0)[0])
    exchange = Exchange(suite.scenario(level, seconds))
    Live(exchange, wires, instruct).run()
    report = check_timeline(suite, exchange.timeline, level, target=target, redaction=redaction)
    return report, exchange.timeline


def captured(suite: Suite[Any], path: Path, target: str = "") -> tuple[SuiteReport, WireTimeline]:
    """Check recorded traffic: a capture, or a record of `save` on its level. `target`,
    ``[HOST][:PORT]``, selects a capture's flow, also at an unusual port; or a device, by its name
    in `cardan dissect`.

    Raises CaptureError for a file that cannot be read, ConfigurationError for one without such a
    flow, and ExtraMissingError without the plug-in that reads captures, or without mcap.
    """
    level = suite.levels
    if is_mcap(path):
        if target:
            raise ConfigurationError("--target", "a record of --save has one target: leave it out")
        timeline, level = read_mcap(path, suite)
    else:
        point = next(iter(entry_points(CAPTURES)), None)
        if point is None:
            absent = ModuleNotFoundError("nothing installed reads captures")
            raise missing_extra("checking a capture", "cardan-dissect", "dissect", absent)
        timeline = point.load()(suite, path, target)
    report = check_timeline(suite, timeline, level, target=path.name, redaction=Redaction())
    return report, timeline


def save(
    folder: Path, suite: Suite[Any], report: SuiteReport, timeline: WireTimeline
) -> tuple[SuiteReport, list[str]]:
    """Write the report in all forms, the capture and the record into `folder`; return the report
    with their hashes, and each missing attachment with the reason. Raises CaptureError.

    Simulated runs are stamped with the epoch's zero, so that the same run gives the same bytes.
    """
    missing = []
    now_ns = 0 if report.simulated else time.time_ns() - round(timeline.end_s * 1e9)
    start_ns = now_ns if timeline.start_ns is None else timeline.start_ns
    try:
        folder.mkdir(parents=True, exist_ok=True)
        capture = pcap(suite, timeline, start_ns)
        if capture is None:
            missing.append("capture.pcap: the protocol has no packets of a network")
        else:
            (folder / "capture.pcap").write_bytes(capture)
        try:
            write_mcap(folder / "record.mcap", suite, timeline, start_ns, Level(report.level))
        except ExtraMissingError as error:
            missing.append(f"record.mcap: {error}")
        names = [name for name in ("capture.pcap", "record.mcap") if (folder / name).exists()]
        hashes = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in names}
        report = dataclasses.replace(report, attached=hashes)
        for name, text in (
            ("report.txt", report.as_text()),
            ("report.md", report.as_markdown()),
            ("report.json", report.as_json()),
            ("report.xml", report.as_junit()),
        ):
            (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise CaptureError(f"{folder} cannot be written: {error.strerror or error}") from None
    return report, missing
