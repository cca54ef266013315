"""A session as a person sees it: the live terminal view, plain lines, and the summary."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from rich.console import Console, Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from cardan.common import output
from cardan.common.troubles import coded
from cardan.gateway.arm.status import Phase
from cardan.gateway.operator.mapping import AXES
from cardan.gateway.session.live_display import LivePanel
from cardan.gateway.session.snapshot import Snapshot

BAR_CELLS = 9
"""Cells on each side of zero in an axis bar."""

PLAIN_PERIOD_S = 1.0
"""How often a view that is not on a terminal prints a line."""

_DIGITS = re.compile(r"[0-9.,]+")
"""Parts of a message that may change without being news."""

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


def _position_mm(pose: list[float]) -> str:
    return "  ".join(f"{v * 1e3:8.1f}" for v in pose[:3]) if pose else "–"


def _newtons(force: Sequence[float]) -> str:
    return " ".join(f"{value + 0.0:+.2f}" for value in force)


def _microseconds(seconds: float | None) -> str:
    return "–" if seconds is None else f"{seconds * 1e6:,.0f} µs"


def _link(word: str) -> Text:
    return Text(word or "–", style="green" if word == "live" else "red")


def _messages(snapshot: Snapshot) -> str:
    """Messages of controller and filters, and the source that was refused authority."""
    refused = f"refused: {snapshot.authority_refused}" if snapshot.authority_refused else ""
    return "; ".join(filter(None, (snapshot.message, *snapshot.filters, refused)))


def _diagnosis(snapshot: Snapshot) -> list[str]:
    """The diagnosis, without parts that the message says already."""
    return [line for line in snapshot.diagnosis if line not in snapshot.message]


def render(snapshot: Snapshot) -> RenderableType:
    """Render a frame of the live view."""
    s = snapshot
    hand = Table.grid(padding=(0, 1))
    for index, name in enumerate(AXES):
        deflection = s.axes[index] if s.axes else 0.0
        speed = s.twist[index] if s.twist else 0.0
        unit = "mm/s" if index < 3 else "mrad/s"
        hand.add_row(
            name, _bar(deflection, 1.0), f"{deflection:+.2f}", f"{speed * 1e3:+8.1f}", unit
        )

    robot = Table.grid(padding=(0, 2))
    robot.add_row("TCP measured, mm", _position_mm(s.pose))
    robot.add_row("TCP commanded, mm", _position_mm(s.reference))
    robot.add_row("joints, deg", "  ".join(f"{math.degrees(q):6.1f}" for q in s.joints_rad) or "–")
    robot.add_row(
        "gripper, lead",
        f"{'closed' if s.gripper_closed else 'open'}, {s.lead_used:.0%}"
        + (", at the workspace's edge" if s.at_workspace_limit else ""),
    )
    if s.utilization is not None:
        robot.add_row("needed of the robot's ability", f"{s.utilization:.0%}")
    if s.path_speed is not None:
        clearance = "–" if s.clearance_m is None else f"{s.clearance_m * 1e3:.0f} mm"
        robot.add_row("path speed, clearance", f"{s.path_speed:.0%}, {clearance}")
    robot.add_row("answered, missed", f"{s.cycles:,}, {s.missed_cycles:,}")
    robot.add_row(
        "answer latency p50, p99",
        f"{_microseconds(s.tick_p50_s)}, {_microseconds(s.tick_p99_s)}",
    )
    if s.haptic_state:
        robot.add_row("force felt, peak", f"{s.force_n:.2f} N, {s.force_peak_n:.2f} N")
        robot.add_row("force", Text(_force_words(s)))
        if s.measured_force_n is not None:
            robot.add_row("for the hand, x y z", f"{_newtons(s.measured_force_n)} N, base axes")
        if s.contact_force_n is not None:
            robot.add_row(
                "contact force, path", f"{s.contact_force_n:.1f} N, {s.contact_path_m * 1e3:.0f} mm"
            )
    links = Text.assemble(
        "hand ",
        _link(s.device_link),
        "   robot ",
        _link(s.robot_link),
        "   ",
        (s.phase or "starting", _PHASE_STYLES.get(s.phase, "")),
        f"   {s.elapsed_s:6.1f} s",
    )
    if s.authority:
        links.append(f"   commanded by {s.authority} for {s.authority_s or 0.0:.0f} s")
    if s.buttons:
        links.append(f"   [{', '.join(s.buttons)}]")
    if s.battery is not None:
        links.append(f"   battery {s.battery:.0%}")
    lines: list[RenderableType] = [links]
    if s.message:
        lines.append(Text(coded(s.message), style="yellow"))
    if s.authority_refused:
        lines.append(Text(f"refused: {s.authority_refused}", style="dim"))
    if s.arm_limits and s.phase != Phase.NO_ROBOT.value:
        lines.append(Text("; ".join(s.arm_limits), style="magenta"))
    if s.filters:
        lines.append(Text("; ".join(s.filters), style="cyan"))
    lines += [Text(coded(line), style="dim") for line in _diagnosis(s)[:3]]
    columns = Table.grid(padding=(0, 4))
    columns.add_row(hand, robot)
    return Panel(Group(*lines, Text(), columns), title="cardan", subtitle="Ctrl-C: brake and stop")


def _force_words(s: Snapshot) -> str:
    """State of the haptic device's force, its age, and its energy."""
    words = [s.haptic_state]
    if s.force_age_s is not None and math.isfinite(s.force_age_s):
        words.append(f"{s.force_age_s * 1e3:.1f} ms old")
    words.append(f"energy {s.energy_j * 1e3:+.1f} mJ")
    if s.passivity_damping_n_s_m > 0.0:
        words.append(f"damped by {s.passivity_damping_n_s_m:.1f} N·s/m")
    return ", ".join(words)


def _milliseconds(seconds: float | None) -> str:
    return "–" if seconds is None else f"{seconds * 1e3:.2f} ms"


def _force_rows(s: Snapshot) -> list[tuple[str, str]]:
    """The summary's rows of force feedback; none without a haptic device."""
    if not s.haptic_state:
        return []
    rows = [
        ("force felt, peak", f"{s.force_peak_n:.2f} N"),
        ("energy given to the hand, net", f"at most {s.energy_given_j * 1e3:+.1f} mJ"),
        (
            "energy given since a clutch-in, net",
            f"at most {s.energy_given_peak_j * 1e3:.2f} mJ",
        ),
    ]
    if s.felt_stiffness_n_m is not None:
        rows.append(
            (
                "stiffness felt, depth of the hand",
                f"{s.felt_stiffness_n_m:.0f} N/m, {s.felt_depth_m * 1e3:.1f} mm",
            )
        )
    for name, p50, p99 in (
        ("fixture", s.fixture_age_p50_s, s.fixture_age_p99_s),
        ("measured", s.measured_age_p50_s, s.measured_age_p99_s),
    ):
        if p50 is not None:
            rows.append(
                (f"age of {name} force, p50 / p99", f"{_milliseconds(p50)} / {_milliseconds(p99)}")
            )
    if s.force_losses or s.force_out_s >= 0.01:
        rows.append(
            (
                "disengaged for lack of force",
                f"{s.force_losses} times; force out for {s.force_out_s:.2f} s",
            )
        )
    if s.contact_force_n is not None:
        about = "its mean" if s.contact_target_n is None else f"{s.contact_target_n:g} N"
        rows += [
            ("path drawn in contact", f"{s.contact_path_m * 1e3:.0f} mm in {s.contact_s:.1f} s"),
            ("contact force, mean", f"{s.contact_force_mean_n:.2f} N"),
            (f"RMS error about {about}", f"{s.contact_force_rms_error_n:.2f} N"),
        ]
    return rows


class SessionView:
    """Shows snapshots: a live panel on a terminal, a line a second elsewhere."""

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

    def is_read(self) -> bool:
        """Whether a person can see it: False while its terminal or pipe takes nothing."""
        return output.is_read()

    def show(self, snapshot: Snapshot) -> None:
        """Show the newest snapshot."""
        if snapshot.error:
            return
        if self._panel.drawn:
            self._panel.update(render(snapshot))
            return
        due = snapshot.elapsed_s >= self._next_line_s
        said = _DIGITS.sub("", _messages(snapshot))
        if due or said != self._messages:
            self._messages = said
            self._next_line_s = snapshot.elapsed_s + PLAIN_PERIOD_S
            print(plain(snapshot), flush=True)
        advice = {_DIGITS.sub("", line): line for line in _diagnosis(snapshot)}
        for line in advice.keys() - self._advice:
            print(f"{'':10} {coded(advice[line])}", flush=True)
        self._advice = set(advice)


def plain(snapshot: Snapshot) -> str:
    """Return a snapshot as a line."""
    s = snapshot
    speed_mm_s = math.sqrt(sum(v * v for v in s.twist[:3])) * 1e3
    text = (
        f"{s.elapsed_s:6.1f} s  {s.phase or 'starting':9} hand {s.device_link or '–'}, "
        f"robot {s.robot_link}  TCP {_position_mm(s.pose)} mm  {speed_mm_s:5.1f} mm/s  "
        f"answers {s.cycles}, missed {s.missed_cycles}, "
        f"p99 {_microseconds(s.tick_p99_s)}"
    )
    if s.haptic_state:
        text += f", force {s.force_n:.2f} N"
        if s.measured_force_n is not None:
            text += f", for the hand {_newtons(s.measured_force_n)} N"
    said = _messages(s)
    return f"{text}  | {coded(said)}" if said else text


def summary(snapshot: Snapshot) -> Table:
    """The table at the end of a session."""
    s, metrics = snapshot, snapshot.metrics
    table = Table(title="session summary", show_header=False, title_justify="left")
    table.add_column()
    table.add_column(justify="right")
    for name, value in (
        ("time", f"{s.elapsed_s:.1f} s, moving {s.moving_s:.1f} s"),
        ("commanded path", f"{s.path_m * 1e3:.0f} mm"),
        ("following error, RMS / max", f"{s.error_rms_m * 1e3:.2f} / {s.error_max_m * 1e3:.2f} mm"),
        ("cycles answered", f"{s.cycles:,}"),
        ("cycles missed", f"{s.missed_cycles:,}"),
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
            " / ".join(map(_microseconds, (s.tick_p50_s, s.tick_p99_s, s.tick_max_s))),
        ),
        *_force_rows(s),
        ("scheduling of the loop", s.scheduling or "–"),
        ("teleoperation disengaged", f"{s.trips} times"),
        ("last message", s.message or "–"),
    ):
        table.add_row(name, Text(value))  # Text in brackets is no markup.
    return table
