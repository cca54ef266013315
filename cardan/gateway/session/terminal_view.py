"""Views of a session for people: the live terminal view, plain lines, and the summary."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import Console, Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from cardan.common.troubles import coded
from cardan.gateway.arm.status import Phase
from cardan.gateway.force.snapshot import ForceSnapshot
from cardan.gateway.operator.mapping import AXES
from cardan.gateway.session.live_display import LivePanel
from cardan.gateway.session.snapshot import FIGURES, Snapshot

BAR_CELLS = 9
"""Cells on each side of zero in an axis bar."""

PLAIN_PERIOD_S = 1.0
"""Period of the lines of a view that is not on a terminal."""

_PHASE_STYLES = {
    "moving": "bold green",
    "holding": "green",
    "braking": "yellow",
    "recovering": "yellow",
    "disarmed": "yellow",
    "no robot": "red",
}


def _bar(value: float, full_scale: float) -> Text:
    filled = min(BAR_CELLS, round(abs(value) / full_scale * BAR_CELLS)) if full_scale else 0
    left, right = (filled, 0) if value < 0 else (0, filled)
    text = Text(" " * (BAR_CELLS - left) + "█" * left, style="cyan")
    return text.append("│", style="dim").append("█" * right + " " * (BAR_CELLS - right))


def _position_mm(pose: Sequence[float]) -> str:
    return "  ".join(f"{v * 1e3:8.1f}" for v in pose[:3]) if pose else "–"


def _newtons(force: Sequence[float]) -> str:
    return " ".join(f"{value + 0.0:+.2f}" for value in force)


def _microseconds(seconds: float | None) -> str:
    return "–" if seconds is None else f"{seconds * 1e6:,.0f} µs"


def _link(word: str) -> Text:
    return Text(word or "–", style="green" if word == "live" else "red")


def _messages(snapshot: Snapshot) -> str:
    """Return messages of controller and filters, and the source that was refused authority."""
    arm = snapshot.arm
    refused = f"refused: {arm.authority_refused}" if arm.authority_refused else ""
    return "; ".join(filter(None, (arm.message, *arm.filters, refused)))


def _diagnosis(snapshot: Snapshot) -> list[str]:
    """Return the diagnosis without parts that the message has already."""
    return [line for line in snapshot.diagnosis if line not in snapshot.arm.message]


def render(snapshot: Snapshot) -> RenderableType:
    """Render a frame of the live view."""
    s, arm, device, loop = snapshot, snapshot.arm, snapshot.device, snapshot.loop
    force, contact = s.force, s.contact
    axes_table = Table.grid(padding=(0, 1))
    for index, name in enumerate(AXES):
        deflection = device.axes[index] if device.axes else 0.0
        speed = arm.twist[index] if arm.twist else 0.0
        unit = "mm/s" if index < 3 else "mrad/s"
        axes_table.add_row(
            name, _bar(deflection, 1.0), f"{deflection:+.2f}", f"{speed * 1e3:+8.1f}", unit
        )

    robot = Table.grid(padding=(0, 2))
    robot.add_row("TCP measured, mm", _position_mm(s.robot.pose))
    robot.add_row("TCP commanded, mm", _position_mm(arm.reference))
    robot.add_row(
        "joints, deg", "  ".join(f"{math.degrees(q):6.1f}" for q in s.robot.joints_rad) or "–"
    )
    robot.add_row(
        "gripper, lead",
        f"{'closed' if s.gripper_closed else 'open'}, {arm.lead_used:.0%}"
        + (", at the workspace's edge" if arm.at_workspace_limit else ""),
    )
    if s.robot.utilization is not None:
        robot.add_row("needed of the robot's ability", f"{s.robot.utilization:.0%}")
    if arm.path_speed is not None:
        clearance = "–" if arm.clearance_m is None else f"{arm.clearance_m * 1e3:.0f} mm"
        robot.add_row("path speed, clearance", f"{arm.path_speed:.0%}, {clearance}")
    robot.add_row("answered, missed", f"{loop.cycles:,}, {s.robot.missed_cycles:,}")
    robot.add_row(
        "answer latency p50, p99",
        f"{_microseconds(loop.tick_p50_s)}, {_microseconds(loop.tick_p99_s)}",
    )
    if force.state:
        robot.add_row("rendered force, peak", f"{force.rendered_n:.2f} N, {force.peak_n:.2f} N")
        robot.add_row("force", Text(_force_words(force)))
        if force.measured_n:
            robot.add_row("for the hand, x y z", f"{_newtons(force.measured_n)} N, base axes")
        if contact.force_n is not None:
            robot.add_row(
                "contact force, path", f"{contact.force_n:.1f} N, {contact.path_m * 1e3:.0f} mm"
            )
    links = Text.assemble(
        "device ",
        _link(device.link),
        "   robot ",
        _link(s.robot.link),
        "   ",
        (arm.phase or "starting", _PHASE_STYLES.get(arm.phase, "")),
        f"   {s.elapsed_s:6.1f} s",
    )
    if arm.authority:
        links.append(f"   commanded by {arm.authority} for {arm.authority_s or 0.0:.0f} s")
    if device.buttons:
        links.append(f"   [{', '.join(device.buttons)}]")
    if device.battery is not None:
        links.append(f"   battery {device.battery:.0%}")
    lines: list[RenderableType] = [links]
    if arm.message:
        lines.append(Text(coded(arm.message), style="yellow"))
    if arm.authority_refused:
        lines.append(Text(f"refused: {arm.authority_refused}", style="dim"))
    if arm.limits_in_words and arm.phase != Phase.NO_ROBOT.value:
        lines.append(Text("; ".join(arm.limits_in_words), style="magenta"))
    if arm.filters:
        lines.append(Text("; ".join(arm.filters), style="cyan"))
    lines += [Text(coded(line), style="dim") for line in _diagnosis(s)[:3]]
    columns = Table.grid(padding=(0, 4))
    columns.add_row(axes_table, robot)
    return Panel(Group(*lines, Text(), columns), title="cardan", subtitle="Ctrl-C: brake and stop")


def _force_words(force: ForceSnapshot) -> str:
    """Return state of the haptic device's force, its age, and its energy."""
    words = [force.state]
    if force.age_s is not None and math.isfinite(force.age_s):
        words.append(f"{force.age_s * 1e3:.1f} ms old")
    words.append(f"energy {force.energy_j * 1e3:+.1f} mJ")
    if force.passivity_damping_n_s_m > 0.0:
        words.append(f"damped by {force.passivity_damping_n_s_m:.1f} N·s/m")
    return ", ".join(words)


def _milliseconds(seconds: float | None) -> str:
    return "–" if seconds is None else f"{seconds * 1e3:.2f} ms"


def _force_rows(s: Snapshot) -> list[tuple[str, str]]:
    """Return the summary's rows of force feedback; none without a haptic device."""
    force, contact = s.force, s.contact
    if not force.state:
        return []
    rows = [
        ("rendered force, peak", f"{force.peak_n:.2f} N"),
        ("energy given to the hand, net", f"at most {force.energy_given_j * 1e3:+.1f} mJ"),
        (
            "energy given since a clutch-in, net",
            f"at most {force.energy_given_peak_j * 1e3:.2f} mJ",
        ),
    ]
    if force.rendered_stiffness_n_m is not None:
        rows.append(
            (
                "rendered stiffness, depth of the hand",
                f"{force.rendered_stiffness_n_m:.0f} N/m, {force.rendered_depth_m * 1e3:.1f} mm",
            )
        )
    for name, p50, p99 in (
        ("fixture", force.fixture_age_p50_s, force.fixture_age_p99_s),
        ("measured", force.measured_age_p50_s, force.measured_age_p99_s),
    ):
        if p50 is not None:
            rows.append(
                (f"age of {name} force, p50 / p99", f"{_milliseconds(p50)} / {_milliseconds(p99)}")
            )
    if force.losses or force.out_s >= 0.01:
        rows.append(
            (
                "disengaged for lack of force",
                f"{force.losses} times; force out for {force.out_s:.2f} s",
            )
        )
    if contact.force_n is not None:
        about = "its mean" if contact.target_n is None else f"{contact.target_n:g} N"
        rows += [
            (
                "path drawn in contact",
                f"{contact.path_m * 1e3:.0f} mm in {contact.time_s:.1f} s",
            ),
            ("contact force, mean", f"{contact.mean_n:.2f} N"),
            (f"RMS error about {about}", f"{contact.rms_error_n:.2f} N"),
        ]
    return rows


class SessionView:
    """Shows snapshots: a live panel on a terminal, else one line a second."""

    def __init__(self, console: Console | None = None) -> None:
        self.console = console or Console()
        self._panel = LivePanel(self.console)
        self._next_line_s = 0.0
        self._messages = ""
        self._advice: set[str] = set()

    def __enter__(self) -> SessionView:
        self._panel.__enter__()
        self._panel.update(Text("starting"))
        return self

    def __exit__(self, *exception: object) -> None:
        self._panel.__exit__(*exception)

    def show(self, snapshot: Snapshot) -> None:
        """Show the newest snapshot."""
        if snapshot.error:
            return
        if self._panel.drawn:
            self._panel.update(render(snapshot))
            return
        due = snapshot.elapsed_s >= self._next_line_s
        said = FIGURES.sub("", _messages(snapshot))
        if due or said != self._messages:
            self._messages = said
            self._next_line_s = snapshot.elapsed_s + PLAIN_PERIOD_S
            print(plain(snapshot), flush=True)
        advice = {FIGURES.sub("", line): line for line in _diagnosis(snapshot)}
        for line in advice.keys() - self._advice:
            print(f"{'':10} {coded(advice[line])}", flush=True)
        self._advice = set(advice)


def plain(snapshot: Snapshot) -> str:
    """Return a snapshot as a line."""
    s = snapshot
    speed_mm_s = math.sqrt(sum(v * v for v in s.arm.twist[:3])) * 1e3
    text = (
        f"{s.elapsed_s:6.1f} s  {s.arm.phase or 'starting':9} device {s.device.link or '–'}, "
        f"robot {s.robot.link}  TCP {_position_mm(s.robot.pose)} mm  {speed_mm_s:5.1f} mm/s  "
        f"answers {s.loop.cycles}, missed {s.robot.missed_cycles}, "
        f"p99 {_microseconds(s.loop.tick_p99_s)}"
    )
    if s.force.state:
        text += f", force {s.force.rendered_n:.2f} N"
        if s.force.measured_n:
            text += f", for the hand {_newtons(s.force.measured_n)} N"
    said = _messages(s)
    return f"{text}  | {coded(said)}" if said else text


def summary(snapshot: Snapshot) -> Table:
    """Return the table at the end of a session."""
    s, loop, tracking, metrics = snapshot, snapshot.loop, snapshot.tracking, snapshot.robot.metrics
    table = Table(title="session summary", show_header=False, title_justify="left")
    table.add_column()
    table.add_column(justify="right")
    for name, value in (
        ("time", f"{s.elapsed_s:.1f} s, moving {tracking.moving_s:.1f} s"),
        ("commanded path", f"{tracking.path_m * 1e3:.0f} mm"),
        (
            "following error, RMS / max",
            f"{tracking.error_rms_m * 1e3:.2f} / {tracking.error_max_m * 1e3:.2f} mm",
        ),
        ("cycles answered", f"{loop.cycles:,}"),
        ("cycles missed", f"{s.robot.missed_cycles:,}"),
        ("robot sessions", f"{metrics.get('sessions', 0):.0f}"),
        *(
            (
                (
                    "cycle period, mean / jitter p99",
                    f"{metrics['period_s'] * 1e3:.3f} ms / "
                    f"{_microseconds(metrics.get('period_jitter_p99_s'))}",
                ),
            )
            if "period_s" in metrics
            else ()
        ),
        (
            "answer latency, p50 / p99 / max",
            " / ".join(map(_microseconds, (loop.tick_p50_s, loop.tick_p99_s, loop.tick_max_s))),
        ),
        *_force_rows(s),
        ("scheduling of the loop", s.scheduling or "–"),
        ("teleoperation disengaged", f"{s.arm.trips} times"),
        ("last message", s.arm.message or "–"),
    ):
        table.add_row(name, Text(value))  # Text in brackets is no markup.
    return table
