"""The figures of all sessions and servers as metrics of Prometheus, made from the daemon's rows,
without I/O. Names: base units, ``_total`` for counters, and labels of few values. Needs
prometheus_client."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)

from cardan.gateway.arm.status import LIMITS, OPERATOR, VERBS, Phase
from cardan.gateway.daemon.restart_policy import UnitState
from cardan.gateway.servers.stats import ROUND_TRIP
from cardan.gateway.session.snapshot import BOUNDS_S, Snapshot

LIVE: Final = "live"
"""State of a link that delivers reports."""

SOURCES: Final = (OPERATOR, VERBS, "stream")
"""Sources as label values; the owner of a stream, which may have any name, is "stream"."""

Row = Mapping[str, Any]


GAUGES: Final = (
    ("cardan_tracking_error_meters", "tracking.error_m",
     "Distance between reference and robot; only while it moves."),
    ("cardan_tracking_error_rms_meters", "tracking.error_rms_m",
     "Distance between reference and robot while moving, RMS since the session's start."),
    ("cardan_tracking_error_max_meters", "tracking.error_max_m", "Largest of these distances."),
    ("cardan_lead_used_ratio", "arm.lead_used", "Lead of the reference, share of its maximum."),
    ("cardan_path_speed_ratio", "arm.path_speed", "Possible share of the requested speed."),
    ("cardan_clearance_meters", "arm.clearance_m", "Distance between the nearest pair of bodies."),
    ("cardan_device_battery_ratio", "device.battery", "Charge of the operator device."),
    ("cardan_force_newtons", "force.rendered_n", "Force rendered to the hand."),
    ("cardan_contact_force_newtons", "contact.force_n", "Contact force at the tool."),
)  # fmt: skip
"""Gauges of a session: name, field of its snapshot, help."""

COUNTERS: Final = (
    ("cardan_session_cycles", "loop.cycles", "Control instants of the robot that were answered."),
    ("cardan_cycle_overruns", "robot.missed_cycles",
     "Control instants that never arrived, or that had passed before they were answered."),
    ("cardan_trips", "arm.trips", "Disengagements of the moving source by a watchdog or a fault."),
    ("cardan_moving_seconds", "tracking.moving_s", "Time with motion commands."),
    ("cardan_reference_path_meters", "tracking.path_m", "Distance traveled by the reference."),
    ("cardan_force_losses", "force.losses", "Disengagements because the force was lost."),
    ("cardan_device_passes", "device.passes",
     "Requests by the operator to pass the device on."),
)  # fmt: skip
"""Counters of a session, which restart with it."""

SERVER_COUNTERS: Final = (
    ("cardan_server_denied_connections", "denied", "Refused connections."),
    ("cardan_server_refusals", "refused", "Refused requests of clients."),
    ("cardan_server_dropped_messages", "superseded", "Messages that newer ones replaced."),
    ("cardan_server_unreadable_messages", "unreadable", "Messages that do not match their type."),
    ("cardan_server_slow_clients", "too slow", "Clients disconnected because they did not read."),
    ("cardan_server_cut_off_clients", "cut off",
     "Clients disconnected because the server stalled."),
    ("cardan_recording_bytes", "bytes", "Bytes that this recorder has written."),
    ("cardan_recording_messages", "messages", "Messages that this recorder has written."),
    ("cardan_recording_dropped_messages", "dropped", "Messages lost to a slow disk."),
    ("cardan_recording_lost_messages", "lost", "Messages lost before they reached the recorder."),
)  # fmt: skip
"""Counters of a server: name, the server's own name for it, help."""


def metrics_of(answer: Mapping[str, Any]) -> Iterator[Metric]:
    """Return the metrics of the daemon's answer to ``figures``."""
    rows: list[Row] = answer["units"]
    yield InfoMetricFamily(
        "cardan_build", "The daemon's version.", {"version": str(answer["version"])}
    )
    yield from _of_units(rows)
    yield from _of_sessions([row for row in rows if row["kind"] == "session"])
    yield from _of_servers([row for row in rows if row["kind"] == "server"])


def _of_units(rows: Sequence[Row]) -> Iterator[Metric]:
    restarts = CounterMetricFamily(
        "cardan_restarts",
        "Restarts after an unrequested end of a session's or server's process.",
        labels=("kind", "name"),
    )
    share = GaugeMetricFamily(
        "cardan_processor_ratio",
        "Share of one processor that a process uses.",
        labels=("kind", "name"),
    )
    for row in rows:
        labels = row["kind"], row["name"]
        restarts.add_metric(labels, row["restarts"])
        if row["cpu"] is not None:
            share.add_metric(labels, row["cpu"])
    yield restarts
    yield share
    for kind in ("session", "server"):
        states = GaugeMetricFamily(
            f"cardan_{kind}_state",
            f"1 of the state that the {kind} is in, 0 of all others.",
            labels=(kind, "state"),
        )
        for row in rows:
            if row["kind"] == kind:
                names = (state.value for state in UnitState)
                _one_of(states, row["name"], names, row["state"])
        yield states


def _one_of(family: Metric, name: str, all_of: Iterable[str], now: str) -> None:
    for each in all_of:
        family.add_metric((name, each), float(each == now))  # type: ignore[attr-defined]


def _of_sessions(rows: Sequence[Row]) -> Iterator[Metric]:
    running = [
        (row, Snapshot.of(row["snapshot"])) for row in rows if row.get("snapshot") is not None
    ]
    phases = GaugeMetricFamily(
        "cardan_arm_phase",
        "1 of the phase that the arm is in, 0 of all others.",
        labels=("session", "phase"),
    )
    authority = GaugeMetricFamily(
        "cardan_authority",
        "1 of the source that has the authority over the arm, 0 of all others.",
        labels=("session", "source"),
    )
    robots = GaugeMetricFamily(
        "cardan_robot_connected", "1 while the robot's link is live.", labels=("session",)
    )
    devices = GaugeMetricFamily(
        "cardan_device_connected", "1 while the device's link is live.", labels=("session",)
    )
    inputs = CounterMetricFamily(
        "cardan_operator_inputs",
        "Cycles in which the operator device was live.",
        labels=("session", "device"),
    )
    limits = GaugeMetricFamily(
        "cardan_limit_active",
        "1 while this limit slows the arm's motion.",
        labels=("session", "limit"),
    )
    errors = CounterMetricFamily(
        "cardan_protocol_errors",
        "Messages of the robot or the device that could not be used.",
        labels=("session", "peer", "kind"),
    )
    costs = GaugeMetricFamily(
        "cardan_session_part_seconds",
        "Mean time of a part of the session in a cycle after its answer.",
        labels=("session", "part"),
    )
    figures = GaugeMetricFamily(
        "cardan_driver_figure",
        "Figures of the robot's driver; the units are in their names.",
        labels=("session", "figure"),
    )
    device_figures = GaugeMetricFamily(
        "cardan_device_figure",
        "Figures of the operator device's driver; the units are in their names.",
        labels=("session", "figure"),
    )
    for row, s in running:
        name = row["name"]
        _one_of(phases, name, (each.value for each in Phase), s.arm.phase)
        owner = s.arm.authority
        source = owner if not owner or owner in SOURCES else SOURCES[-1]
        _one_of(authority, name, SOURCES, source)
        robots.add_metric((name,), float(s.robot.link == LIVE))
        for limit in LIMITS:
            limits.add_metric((name, limit), float(limit in s.arm.limits))
        for peer, counts in (("robot", s.robot.errors), ("device", s.device.errors)):
            for kind, count in counts.items():
                errors.add_metric((name, peer, kind), count)
        if row["device"]:
            devices.add_metric((name,), float(s.device.link == LIVE))
            inputs.add_metric((name, row["device"]), s.loop.inputs)
        for family, found in ((figures, s.robot.metrics), (device_figures, s.device.metrics)):
            for figure, value in found.items():
                if value is not None:
                    family.add_metric((name, figure), value)
        for part, cost_s in s.part_cost_s.items():
            costs.add_metric((name, part), cost_s)
    yield from (phases, authority, robots, devices, inputs, limits, errors, figures)
    yield from (device_figures, costs)
    for name, field, words in GAUGES:
        yield _filled(GaugeMetricFamily(name, words, labels=("session",)), field, running)
    for name, field, words in COUNTERS:
        yield _filled(CounterMetricFamily(name, words, labels=("session",)), field, running)
    yield from _histograms(running)
    yield from _of_watches(rows, running)


def _filled(family: Metric, field: str, running: Sequence[tuple[Row, Snapshot]]) -> Metric:
    for row, s in running:
        value = operator.attrgetter(field)(s)
        if value is not None:
            family.add_metric((row["name"],), value)  # type: ignore[attr-defined]
    return family


def _histograms(running: Sequence[tuple[Row, Snapshot]]) -> Iterator[Metric]:
    cycle = HistogramMetricFamily(
        "cardan_cycle_seconds",
        "From the robot's control instant to the answer.",
        labels=("session",),
    )
    age = HistogramMetricFamily(
        "cardan_operator_input_age_seconds",
        "Age of the operator device's newest report in a cycle.",
        labels=("session",),
    )
    for row, s in running:
        name, loop = (row["name"],), s.loop
        cycle.add_metric(name, _buckets(loop.tick_within, loop.cycles), loop.tick_sum_s)
        age.add_metric(name, _buckets(loop.input_age_within, loop.inputs), loop.input_age_sum_s)
    yield cycle
    yield age


def _buckets(within: Sequence[int], count: int) -> list[tuple[str, float]]:
    """Return the buckets in Prometheus' form: none before the session's first figures."""
    found = [(str(bound_s), float(each)) for bound_s, each in zip(BOUNDS_S, within, strict=False)]
    return [*found, ("+Inf", float(count))]


def _of_watches(rows: Sequence[Row], running: Sequence[tuple[Row, Snapshot]]) -> Iterator[Metric]:
    """Return counters of the daemon since its start; the sessions count most of the refusals."""
    stops = CounterMetricFamily(
        "cardan_stops",
        "Times that the arm began to brake, by the problem then; none: an intended stop.",
        labels=("session", "reason"),
    )
    refusals = CounterMetricFamily(
        "cardan_refusals", "Refused requests, by reason.", labels=("session", "reason")
    )
    for row in rows:
        for reason, count in row["stops"].items():
            stops.add_metric((row["name"], reason), count)
        refusals.add_metric((row["name"], "authority"), row["refusals"])
    for row, s in running:
        for reason, count in s.refusals.items():
            refusals.add_metric((row["name"], reason), count)
    yield stops
    yield refusals


def _of_servers(rows: Sequence[Row]) -> Iterator[Metric]:
    clients = GaugeMetricFamily("cardan_server_clients", "Clients connected.", labels=("server",))
    for row in rows:
        if "clients" in row["figures"]:
            clients.add_metric((row["name"],), row["figures"]["clients"])
    yield clients
    trips = GaugeMetricFamily(
        "cardan_ws_round_trip_seconds",
        "Round-trip time of the slowest client's newest ping.",
        labels=("server",),
    )
    for row in rows:
        if time_us := row["figures"].get(ROUND_TRIP):
            trips.add_metric((row["name"],), 1e-6 * time_us)
    yield trips
    for name, figure, words in SERVER_COUNTERS:
        family = CounterMetricFamily(name, words, labels=("server",))
        for row in rows:
            if figure in row["figures"]:
                family.add_metric((row["name"],), row["figures"][figure])
        yield family
