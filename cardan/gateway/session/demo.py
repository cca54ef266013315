"""The main job without hardware: simulated peers in processes of their own, and a session.

The peers are started as any other program would start them, through ``cardan sim``; what runs
between them is the real gateway with the real drivers.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from cardan.drivers.omni.options import OmniOptions
from cardan.errors import ConfigurationError, DriverError
from cardan.gateway.session.config import SessionConfig, parse_config
from cardan.gateway.session.session import EXIT_OK, STOPPED_ON_REQUEST
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor import KILL_AFTER_S, supervise
from cardan.gateway.session.view import SessionView, missed_cycles, summary

EXIT_INCOMPLETE = 4

READY_WITHIN_S = 20.0
"""A peer that is not serving by then has failed; importing takes a second on a slow machine."""

WELL_FOLLOWED_M = 0.02
"""The simulated arm keeps within this of its reference at the demo's speeds: servo delay and
filter account for about 8 mm at 0.25 m/s."""

MISSED_SHARE = 0.01
"""More than this of all cycles missed is no longer the hiccup of a machine that has other work to
do and does not grant real-time scheduling; a real controller would not mind it either."""

HELD_SHARE = 0.25
"""Of the target, the contact force may be away from it in the root mean square. The stylus's own
friction of 0.26 N hides more than a third of what the hand holds while it stands still, and less
while it slides; coming down and lifting count, too."""

OUT_SHARE = 0.01
"""Of the time, the force may have been out while the hand was followed: a computer that grants no
real-time scheduling holds its loop up now and then."""

DRAWN_AFTER_S = 10.0
"""The scripted hand draws from the eighth second on."""

FORCE_AGE_S = 0.010
"""One EGM cycle between two forces, and 2 ms at most to the hand, on a machine that keeps up; on
one that grants no real-time scheduling the hiccups of 1 % of the time are longer."""


class Demo(NamedTuple):
    """Something to show."""

    words: str
    """What is joined to what."""
    tables: Callable[[int], dict[str, Any]]
    """The configuration's tables for the port; without a device's it is the SpaceMouse's."""
    port: Callable[[], int]
    """Finds a free one, or the first of so many."""
    peer: Callable[[int], tuple[str, ...]]
    """``cardan sim`` of the controller, for the port."""
    judge: Callable[[Snapshot], list[str]]
    """What the last snapshot lacks, in words; empty when all went as it should."""
    praise: Callable[[Snapshot], str]
    """What there is to say then."""
    least_s: float = 0.0
    """A shorter run has nothing to show."""
    through: tuple[str, ...] = ()
    """``cardan`` with these words runs the session with its simulated device inside; empty: the
    device is a SpaceMouse in a process of its own."""


def _gofa(port: int) -> dict[str, Any]:
    """As examples/spacemouse-gofa-simulated.toml."""
    return {
        "robot": {"driver": "abb_egm", "listen_port": port},
        "mapping": {"deadman": "left", "linear_speed_m_s": 0.1, "angular_speed_rad_s": 0.4},
        "gripper": {"toggle": "right"},
    }


def _gp8(port: int) -> dict[str, Any]:
    """Velocity mode, by the joints of the arm's model."""
    return {
        "robot": {
            "driver": "motoros",
            "motion_port": port,
            "state_port": port + 1,
            "io_port": port + 2,
            "enable": "at-start",
        },
        "arm": {"model": "gp8"},
        "mapping": {"deadman": "left", "linear_speed_m_s": 0.1, "angular_speed_rad_s": 0.4},
    }


BOARD_M, HOLDER_N_M = 0.272, 500.0
"""Height of the drawing board, 20 mm below the pen at first, and stiffness of the pen's holder."""

PEN_DOWN_DEG = "0,20,30,0,40,0"
"""Joints that hold the pen straight down, at 0.618, 0, 0.292 m."""


def _drawing(port: int) -> dict[str, Any]:
    """As examples/omni-gofa-simulated.toml."""
    return {
        "device": {"driver": "omni", "stale_after_s": 0.1},
        "robot": {"driver": "abb_egm", "listen_port": port},
        "mapping": {
            "mode": "position",
            "frame": "base",
            "clutch": "button_2",
            "recapture": "button_1",
            "orientation": "fixed",
        },
        "force": {
            "source": "measured",
            "scale": 0.125,
            "environment_stiffness_n_m": HOLDER_N_M,
            "delay_s": 0.07,
            "contact_target_n": 5.6,
        },
        "limits": {
            "workspace_x_m": [0.45, 0.80],
            "workspace_y_m": [-0.20, 0.20],
            "workspace_z_m": [0.22, 0.45],
        },
    }


def demo_config(name: str, hid_path: str, port: int) -> SessionConfig:
    """The configuration of the demo called `name`."""
    device = {"driver": "spacemouse", "transport": "socket", "path": hid_path}
    return parse_config({"device": device, **DEMOS[name].tables(port)})


@contextlib.contextmanager
def simulated_peer(*arguments: str) -> Iterator[str]:
    """Run ``cardan sim ARGUMENTS``; gives its endpoint once it serves, and ends it after."""
    with tempfile.TemporaryFile("w+") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "cardan", "sim", *arguments],
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            start_new_session=True,
        )
        try:
            yield _endpoint(process, arguments[0])
        except BaseException:
            log.seek(0)
            sys.stderr.write(log.read()[-2000:])
            raise
        finally:
            process.terminate()
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            assert process.stdout is not None
            process.stdout.close()


def _endpoint(process: subprocess.Popen[str], name: str) -> str:
    assert process.stdout is not None
    give_up_s = time.monotonic() + READY_WITHIN_S
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while selector.select(max(0.0, give_up_s - time.monotonic())):
            line = process.stdout.readline()
            if line.startswith("READY "):
                return line.removeprefix("READY ").strip()
            if not line:
                raise DriverError(f"the simulated {name} ended before it served")
    raise DriverError(f"the simulated {name} did not serve within {READY_WITHIN_S:.0f} s")


def free_udp_port() -> int:
    """A UDP port nobody has now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def free_tcp_ports(count: int = 3) -> int:
    """The first of `count` TCP ports in a row that nobody has now."""
    for _ in range(100):
        with contextlib.ExitStack() as probes:
            first = 0
            try:
                for offset in range(count):
                    probe = probes.enter_context(socket.socket())
                    probe.bind(("127.0.0.1", first + offset if first else 0))
                    first = first or probe.getsockname()[1]
            except (OSError, OverflowError):
                continue
            return first
    raise DriverError(f"there are no {count} free TCP ports in a row")


def shortcomings(last: Snapshot) -> list[str]:
    """What the last snapshot of any demo lacks, in words; empty when all went as it should."""
    found = []
    if last.cycles == 0:
        found.append("the robot was never commanded")
    if last.path_m == 0.0:
        found.append("no path was commanded")
    if last.error_max_m > WELL_FOLLOWED_M:
        found.append(
            f"the robot was up to {last.error_max_m * 1e3:.1f} mm away from its reference "
            f"(expected: {WELL_FOLLOWED_M * 1e3:.0f} mm)"
        )
    if (missed := missed_cycles(last)) > MISSED_SHARE * last.cycles:
        found.append(f"{missed} of {last.cycles} cycles were missed: is this machine very busy?")
    if last.trips:
        found.append(f"teleoperation was disengaged {last.trips} times")
    return found


def drawing_shortcomings(last: Snapshot) -> list[str]:
    """What the last snapshot of the drawing lacks, beside that of any demo."""
    found = shortcomings(last)
    limits = OmniOptions().limits()
    if last.contact_path_m == 0.0:
        found.append("nothing was drawn: the hand draws from the eighth second on")
    elif last.contact_target_n is not None:
        allowed_n = HELD_SHARE * last.contact_target_n
        if last.contact_force_rms_error_n > allowed_n:
            found.append(
                f"the contact force was {last.contact_force_rms_error_n:.1f} N RMS away from its "
                f"target of {last.contact_target_n:g} N (expected: {allowed_n:.1f} N)"
            )
    if last.contact_path_m and last.force_peak_n == 0.0:
        found.append("the hand felt nothing")
    if last.force_peak_n > limits.clamp_n * (1.0 + 1e-6):
        found.append(f"the hand felt {last.force_peak_n:.2f} N, above {limits.clamp_n:g} N")
    if last.energy_given_peak_j > limits.energy_budget_j:
        found.append(
            f"the hand was given up to {last.energy_given_peak_j * 1e3:.1f} mJ in one engagement "
            f"(bound: {limits.energy_budget_j * 1e3:g} mJ)"
        )
    if last.force_losses:
        found.append(f"{last.force_losses} times there was no force: {last.force_lost_reason}")
    elif last.force_out_s > OUT_SHARE * last.elapsed_s:
        found.append(
            f"the hand was followed without force for {last.force_out_s:.2f} s: "
            f"{last.force_lost_reason}"
        )
    if last.measured_age_p99_s is not None and last.measured_age_p99_s > FORCE_AGE_S:
        found.append(
            f"forces were up to {last.measured_age_p99_s * 1e3:.1f} ms old at the hand "
            f"(expected: {FORCE_AGE_S * 1e3:g} ms)"
        )
    if last.haptic_state != "enabled":
        found.append(f"the force was {last.haptic_state} at the end: {last.haptic_reason}")
    return found


def followed(_last: Snapshot) -> str:
    """What there is to say of a SpaceMouse's demo that went well."""
    return "a hand's HID reports became robot motion; all of it was followed"


def drawn(last: Snapshot) -> str:
    """What there is to say of a drawing that went well."""
    return (
        f"a hand drew with the robot's pen and felt the board, {last.force_peak_n:.2f} N at most: "
        f"it was given at most {last.energy_given_peak_j * 1e3:.2f} mJ in one engagement, of the "
        f"{OmniOptions().energy_budget_j * 1e3:g} mJ that passivity allows"
    )


DEMOS: Mapping[str, Demo] = {
    "gofa": Demo(
        "simulated SpaceMouse (HID reports) -> gateway -> simulated GoFa (EGM, 250 Hz)",
        _gofa,
        free_udp_port,
        lambda port: ("abb-gofa", "--to", f"127.0.0.1:{port}"),
        shortcomings,
        followed,
    ),
    "gp8": Demo(
        "simulated SpaceMouse (HID reports) -> gateway -> simulated Motoman GP8 "
        "(simple message, velocity mode, 250 Hz)",
        _gp8,
        free_tcp_ports,
        lambda port: ("motoman-gp8", "--base-port", str(port), "--servo-on"),
        shortcomings,
        followed,
    ),
    "omni": Demo(
        "simulated Phantom Omni (libHD) <-> gateway <-> simulated GoFa (EGM, 250 Hz) with a pen on "
        "a board",
        _drawing,
        free_udp_port,
        lambda port: (
            "abb-gofa",
            *("--to", f"127.0.0.1:{port}"),
            *("--script", "teleop-retry"),
            *("--joints", PEN_DOWN_DEG),
            *("--surface", f"{BOARD_M:g}:{HOLDER_N_M:g}"),
        ),
        drawing_shortcomings,
        drawn,
        least_s=DRAWN_AFTER_S,
        through=("sim", "omni", "--script", "drawing", "--"),
    ),
}


def run_demo(seconds: float, name: str = "gofa") -> int:
    """Run one of DEMOS; returns the exit code of the command."""
    demo = DEMOS.get(name)
    if demo is None:
        raise ConfigurationError("demo", f"{name!r} is none; allowed: {', '.join(DEMOS)}")
    if seconds < demo.least_s:
        raise ConfigurationError(
            "--seconds", f"{seconds:g} are too few for this demo; allowed: {demo.least_s:g} or more"
        )
    port = demo.port()
    # Should this process be killed, its peers still end by themselves.
    until = ("--seconds", str(seconds + READY_WITHIN_S + KILL_AFTER_S))
    with tempfile.TemporaryDirectory(prefix="cardan-demo-") as folder, SessionView() as view:
        hid_path = str(Path(folder) / "spacemouse")
        view.console.print(demo.words)
        with contextlib.ExitStack() as peers:
            through: tuple[str, ...] = ()
            if demo.through:
                through = (sys.executable, "-m", "cardan", *demo.through)
            else:
                mouse = ("spacemouse", "--hid", hid_path, "--script", "demo", *until)
                peers.enter_context(simulated_peer(*mouse))
            peers.enter_context(simulated_peer(*demo.peer(port), *until))
            config = demo_config(name, hid_path, port)
            outcome = supervise(config, seconds, view.show, through=through)
    if outcome.exit_code == EXIT_OK or outcome.last.cycles:
        view.console.print(summary(outcome.last))
    if outcome.exit_code != EXIT_OK:
        print(f"cardan: {outcome.last.error}", file=sys.stderr)
        return outcome.exit_code
    if not outcome.last.finished or outcome.last.ending == STOPPED_ON_REQUEST:
        view.console.print("ended before its time: not judged")
        return EXIT_OK
    missing = demo.judge(outcome.last)
    for line in missing:
        print(f"cardan demo: {line}", file=sys.stderr)
    if not missing:
        view.console.print(demo.praise(outcome.last))
    return EXIT_INCOMPLETE if missing else EXIT_OK
