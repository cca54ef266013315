"""Runs an example without hardware: its simulated peers in separate processes, and a session.

The real gateway with the real drivers runs between the peers.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from cardan.common import output
from cardan.common.haptics import FeedbackLimits
from cardan.common.tables import resolved
from cardan.common.troubles import coded
from cardan.demos.examples import Demo, find_demos, read_demo
from cardan.demos.pauses import Pauses
from cardan.demos.peers import Peers
from cardan.demos.safety import CARDAN, check_unattended, check_words
from cardan.drivers.haptic import HapticDevice
from cardan.errors import ConfigurationError, DriverError, OptionError
from cardan.gateway.bus.sharing import SharedConfig
from cardan.gateway.session.config import SessionConfig, parse_config, read_part
from cardan.gateway.session.driver_assembly import make_device
from cardan.gateway.session.session import EXIT_OK, STOPPED_ON_REQUEST
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.subprocesses import READY_WITHIN_S
from cardan.gateway.session.supervisor import KILL_AFTER_S, supervise
from cardan.gateway.session.terminal_view import SessionView, summary
from cardan.gateway.session.with_server import with_server

EXIT_INCOMPLETE = 4

ALL_INTERFACES = "0.0.0.0"
HOSTS = {"console": (ALL_INTERFACES, "127.0.0.1"), "rosbridge": ("127.0.0.1",)}
"""Addresses of a server: the first that can be served. Phones can open the page too if a
certificate can be made."""

PAUSE_S = 0.03
"""A simulated device or robot that pauses for longer may be taken for a lost one."""

WELL_FOLLOWED_M = 0.02
"""Largest distance of the simulated arm from its reference at the demo's speeds: servo delay and
filter account for about 8 mm at 0.25 m/s."""

MISSED_SHARE = 0.01
"""Largest share of missed cycles. More is not explained by a loaded machine without real-time
scheduling; a real controller would tolerate this share as well."""

HELD_SHARE = 0.25
"""Largest RMS deviation of the contact force, as a share of its target. The stylus's own friction
of 0.26 N hides more than a third of the hand's force while it stands still, and less while it
slides. Approach and lifting count too."""

OUT_SHARE = 0.01
"""Largest share of the teleoperation time without force: a computer without real-time scheduling
delays its loop now and then."""

FORCE_AGE_S = 0.010
"""Largest age of a force on a machine that keeps up: one EGM cycle between two forces, and at most
2 ms to the device. Without real-time scheduling 1 % of the delays are longer."""


@contextlib.contextmanager
def simulated_hardware(demo: Demo, seconds: float) -> Iterator[tuple[SessionConfig, Sequence[str]]]:
    """Run all programs that the demo launches, for `seconds` and the time of starting and ending.

    Yields the session's configuration, and the command that it is run through (see `supervise`).
    """
    through: Sequence[str] = ()
    if demo.launcher:
        through = (*CARDAN, *check_words(demo, "launcher", shlex.split(demo.launcher)), "--")
    peers = Peers(demo, seconds + READY_WITHIN_S + KILL_AFTER_S)
    config = parse_config(resolved(SessionConfig, peers.tables, demo.file))
    check_unattended(demo, config)
    with peers:
        peers.start_all()
        yield config, through


@contextlib.contextmanager
def served_servers(
    demo: Demo, config: SessionConfig, say: Callable[[str], None], picture_of: Callable[[str], str]
) -> Iterator[None]:
    """Serve the demo's servers beside its session, and print their addresses."""
    with contextlib.ExitStack() as opened:
        for name in demo.servers:
            if config.network is None:
                raise ConfigurationError("network", f"is missing: the server {name} needs it")
            for host in HOSTS[name]:
                try:
                    server = opened.enter_context(with_server(name, config.network, host, 0))
                except DriverError:
                    if host == HOSTS[name][-1]:
                        raise
                    say(f"the server {name} is for this computer alone")
                    continue
                for line in (*server.before, f"server {name}: {server.endpoint}"):
                    say(line)
                if host == ALL_INTERFACES:
                    say(picture_of(server.endpoint))
                break
        yield


def haptic_limits(demo: Demo, config: SessionConfig) -> FeedbackLimits | None:
    """Return the limits of the demo's haptic device, here or remote; None if it has none."""
    device = make_device(config) if config.device is not None else None
    if not isinstance(device, HapticDevice):
        return None
    if (shared := demo.shared_file) is not None:
        device = make_device(read_part(SharedConfig, shared))
    return device.feedback_limits if isinstance(device, HapticDevice) else None


def find_problems(
    last: Snapshot,
    haptic: FeedbackLimits | None = None,
    *,
    may_rest: bool = False,
    paused_s: float = 0.0,
    far: bool = False,
) -> list[str]:
    """Return the problems of a demo from its last snapshot; empty if there were none.

    `haptic`: limits of a haptic device for its force. `may_rest`: the arm need not move.
    `paused_s`: longest pause of this computer (see Pauses); its consequences are remarks and not
    problems. `far`: the haptic device is at another computer, which does not know the age of a
    force; contact has to be rendered there.
    """
    found = []
    if last.loop.cycles == 0:
        found.append("the robot was never commanded")
    if last.tracking.path_m == 0.0 and not may_rest and not last.arm.trips:
        found.append("no path was commanded")
    if last.tracking.error_max_m > WELL_FOLLOWED_M:
        found.append(
            f"the robot was up to {last.tracking.error_max_m * 1e3:.1f} mm away from its reference "
            f"(expected: {WELL_FOLLOWED_M * 1e3:.0f} mm)"
        )
    if haptic is not None:
        found += _force_problems(last, haptic)
        if far and last.force.rendered_stiffness_n_m is None:
            found.append("no contact of the tool was rendered")
    return found if paused_s > PAUSE_S else found + _interruptions(last, haptic, far=far)


def _interruptions(last: Snapshot, haptic: FeedbackLimits | None, *, far: bool) -> list[str]:
    """Return problems that a pause of the computer can cause too."""
    found = []
    if last.arm.trips:
        found.append(f"teleoperation was disengaged {last.arm.trips} times")
    if haptic is None:
        return found
    if last.force.losses:
        found.append(f"{last.force.losses} times there was no force: {last.force.lost_reason}")
    elif last.force.out_s > OUT_SHARE * last.elapsed_s:
        found.append(
            f"teleoperation went on without force for {last.force.out_s:.2f} s: "
            f"{last.force.lost_reason}"
        )
    age_s = None if far else last.force.measured_age_p99_s
    if age_s is not None and age_s > FORCE_AGE_S:
        found.append(
            f"forces were up to {age_s * 1e3:.1f} ms old at the hand "
            f"(expected: {FORCE_AGE_S * 1e3:g} ms)"
        )
    return found


def find_remarks(
    last: Snapshot,
    haptic: FeedbackLimits | None = None,
    *,
    paused_s: float = 0.0,
    far: bool = False,
) -> list[str]:
    """Return remarks on the computer that a demo ran on, from the arguments of find_problems."""
    found = []
    if (missed := last.robot.missed_cycles) > MISSED_SHARE * last.loop.cycles:
        found.append(
            f"{missed} of {last.loop.cycles} cycles were missed: is this machine very busy?"
        )
    if paused_s > PAUSE_S:
        stood_still = f"not judged, because this computer stalled for {paused_s * 1e3:.0f} ms: "
        found += [stood_still + problem for problem in _interruptions(last, haptic, far=far)]
    return found


def _force_problems(last: Snapshot, haptic: FeedbackLimits) -> list[str]:
    """Return the problems of the force feedback."""
    found = []
    force, contact = last.force, last.contact
    if contact.target_n is not None:
        allowed_n = HELD_SHARE * contact.target_n
        if contact.path_m == 0.0:
            found.append("nothing was drawn: the tool touched nothing")
        elif contact.rms_error_n > allowed_n:
            found.append(
                f"the contact force was {contact.rms_error_n:.1f} N RMS away from its "
                f"target of {contact.target_n:g} N (expected: {allowed_n:.1f} N)"
            )
    if force.peak_n == 0.0:
        found.append("no force was rendered to the hand")
    if force.peak_n > haptic.force_n * (1.0 + 1e-6):
        found.append(f"the force was {force.peak_n:.2f} N, above {haptic.force_n:g} N")
    if haptic.energy_j is not None and force.energy_given_peak_j > haptic.energy_j:
        found.append(
            f"the hand was given up to {force.energy_given_peak_j * 1e3:.1f} mJ in one engagement "
            f"(bound: {haptic.energy_j * 1e3:g} mJ)"
        )
    if force.state != "enabled":
        found.append(f"the force was {force.state} at the end: {force.reason}")
    return found


def _success(demo: Demo, last: Snapshot, haptic: FeedbackLimits | None) -> str:
    """Return the message of a demo without problems."""
    if last.tracking.path_m == 0.0:
        return "nobody moved the arm"
    if haptic is None:
        return demo.success_message
    force = last.force
    said = f"{demo.success_message}, {force.peak_n:.2f} N at most"
    if force.rendered_stiffness_n_m is not None:
        said += (
            f", {force.rendered_stiffness_n_m:.0f} N/m, {force.rendered_depth_m * 1e3:.1f} mm deep"
        )
    if demo.delay_ms is not None:
        said += f", {demo.delay_ms:g} ms away"
    if haptic.energy_j is None:
        return said
    return (
        f"{said}: it was given at most {force.energy_given_peak_j * 1e3:.2f} mJ in one engagement, "
        f"of the {haptic.energy_j * 1e3:g} mJ that passivity allows"
    )


def choose_demo(name: str) -> Demo:
    """Return the demo of this name, or of this .toml file."""
    if name.endswith(".toml"):
        demo = read_demo(Path(name).absolute())
        if demo is None:
            raise ConfigurationError(
                "demo", f"{name} does not say how it runs without hardware (# /// demo)"
            )
        return demo
    demos = find_demos()
    if name not in demos:
        raise ConfigurationError("demo", f"there is no demo {name!r}; allowed: {', '.join(demos)}")
    return demos[name]


def with_delay(demo: Demo, delay_ms: float | None) -> Demo:
    """Return the demo with this delay of its network; None: its own. Raises ConfigurationError if
    it has no network, or the delay is too long."""
    if delay_ms is None:
        return demo
    if demo.delay_ms is None:
        raise ConfigurationError("--delay", f"the demo {demo.name} has no simulated network")
    try:
        return dataclasses.replace(demo, delay_ms=delay_ms)
    except OptionError as error:
        raise OptionError("--delay", error.value, error.allowed) from None


def check_length(demo: Demo, seconds: float) -> None:
    """Raise ConfigurationError if the demo has nothing to show in `seconds`."""
    if not demo.shortest_s <= seconds < math.inf:
        raise ConfigurationError(
            "--seconds",
            f"{seconds:g} are too {'many' if seconds > demo.shortest_s else 'few'} for this demo; "
            f"allowed: {demo.shortest_s:g} or more",
        )


def run_demo(
    seconds: float,
    name: str = "gofa",
    picture_of: Callable[[str], str] = str,
    delay_ms: float | None = None,
) -> int:
    """Run a demo by its name or file; return the exit code. `picture_of` turns a page's address
    into a QR code; `delay_ms`: one-way delay of the demo's network."""
    demo = with_delay(choose_demo(name), delay_ms)
    check_length(demo, seconds)
    with SessionView() as view:
        say = partial(view.console.print, markup=False, highlight=False, soft_wrap=True)
        view.console.print(demo.description, markup=False)
        with (
            simulated_hardware(demo, seconds) as (config, through),
            served_servers(demo, config, say, picture_of),
            Pauses() as pauses,
        ):
            if demo.invitation:
                say(demo.invitation)
            outcome = supervise(config, seconds, view.show, through=through, shown=output.is_read)
    if outcome.exit_code == EXIT_OK or outcome.last.loop.cycles:
        view.console.print(summary(outcome.last))
    if outcome.exit_code != EXIT_OK:
        print(f"cardan: {coded(outcome.last.error)}", file=sys.stderr)
        return outcome.exit_code
    if not outcome.last.finished or outcome.last.ending == STOPPED_ON_REQUEST:
        view.console.print("ended early: not judged")
        return EXIT_OK
    haptic = haptic_limits(demo, config)
    far, paused_s = demo.shared_file is not None, pauses.longest_s
    problems = find_problems(
        outcome.last, haptic, may_rest=bool(demo.invitation), paused_s=paused_s, far=far
    )
    for line in (*find_remarks(outcome.last, haptic, paused_s=paused_s, far=far), *problems):
        print(f"cardan demo: {line}", file=sys.stderr)
    if not problems:
        view.console.print(_success(demo, outcome.last, haptic), markup=False)
    return EXIT_INCOMPLETE if problems else EXIT_OK
