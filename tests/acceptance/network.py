"""Network acceptance test: a rosbridge client moves a session's arm, and the session is recorded.
The record is then replayed through the control core, and published on the network."""

from __future__ import annotations

import math
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from cardan.common.text_sanitizer import printable
from cardan.demos.demo import (
    WELL_FOLLOWED_M,
    choose_demo,
    find_problems,
    simulated_hardware,
)
from cardan.demos.pauses import Pauses
from cardan.errors import CardanError
from cardan.gateway.session.recorded import recorded
from cardan.gateway.session.session import EXIT_OK
from cardan.gateway.session.subprocesses import CardanSubprocess, cardan_subprocess
from cardan.gateway.session.supervisor import SessionExit, supervise
from tests.acceptance.rosbridge_program import RosbridgeProgram, Vector

BEFORE_AND_AFTER_S = 3.0
"""Part of the session's time that the client leaves for discovering the arm and for stopping it."""

MOVED_M = 0.02
"""Least motion of the TCP."""

REPLAY_RATE = 4.0
"""Speed at which the record is published, relative to the session."""

REPLAY_WITHIN_S = 120.0
"""Longest time for a replay through the control core, which runs faster than real time."""

SEEN_SHARE = 0.9
"""Share of the poses that the client must receive again: a busy server drops some."""

_Say = Callable[[str], None]


def run_on_the_network(folder: Path, seconds: float, say: _Say = print) -> list[str]:
    """Run the network example for `seconds`, with its server, client and recorder; `say` receives
    progress messages. The record is written to `folder`. Returns a list of problems."""
    path = folder / "session.mcap"
    with simulated_hardware(choose_demo("ros2"), seconds) as (config, _):
        network = config.network
        assert network is not None
        node = "/".join(("", *filter(None, (network.namespace, network.name))))
        router = ("--router", network.router)
        with (
            cardan_subprocess("net", "server", "router", "--endpoint", network.router),
            cardan_subprocess("net", "server", "rosbridge", "--port", "0", *router) as url,
        ):
            with recorded(network, path, *router) as recorder:
                program = RosbridgeProgram(url, node, say)
                with Pauses() as pauses:
                    outcome, problems = _with_program(
                        program,
                        seconds - BEFORE_AND_AFTER_S,
                        lambda: supervise(config, seconds, lambda _: None),
                    )
            if outcome.exit_code != EXIT_OK:
                return [f"the session failed: {outcome.last.error}"]
            problems += find_problems(outcome.last, paused_s=pauses.longest_s)
            problems += _check_program(program)
            problems += _check_record(recorder, path, outcome, say)
            if not problems:
                problems += _shown_again(url, node, path, router, program.poses, say)
    return problems


def _with_program(
    program: RosbridgeProgram, seconds: float, run: Callable[[], SessionExit]
) -> tuple[SessionExit, list[str]]:
    """Run the session, and the rosbridge client in a thread."""
    problems: list[str] = []
    over = threading.Event()

    def work() -> None:
        try:
            with program:
                program.drive(seconds, over)
        except CardanError as error:
            if not over.is_set():
                problems.append(str(error))

    thread = threading.Thread(target=work, name="rosbridge-client", daemon=True)
    thread.start()
    try:
        outcome = run()
    finally:
        over.set()
        thread.join()
    return outcome, problems


def _check_program(program: RosbridgeProgram) -> list[str]:
    problems = []
    if not program.refusals():
        problems.append("a twist without a preset was not refused: ~/result told nothing")
    if not any(each["success"] and each["command"] == "twist" for each in program.results):
        problems.append("~/result did not tell that the twists were taken")
    if len(program.refusals()) > 1:
        problems.append(f"a twist was refused on the way: {program.refusals()[-1]}")
    if program.moved_m < MOVED_M:
        problems.append(f"the TCP moved by {1e3 * program.moved_m:.1f} mm only")
    if not 0.0 < program.behind_m <= WELL_FOLLOWED_M:
        problems.append(f"the TCP was {1e3 * program.behind_m:.1f} mm from where it was commanded")
    return problems


def _check_record(
    recorder: CardanSubprocess, path: Path, outcome: SessionExit, say: _Say
) -> list[str]:
    """Check that the record is complete and that the control core computes the same commands from
    it."""
    problems = []
    for line in recorder.lines:
        say(f"record: {line}")
    if recorder.code != EXIT_OK:
        problems.append(f"the record is not complete: {recorder.complaints or recorder.lines}")
    code, lines = _cardan("net", "replay", "--verify", str(path))
    for line in lines:
        say(f"replay through the control core: {line}")
    same = re.search(r": (\d+) cycles, each command bit for bit", lines[0]) if lines else None
    if code != EXIT_OK or len(lines) != 1 or same is None:
        problems.append("the record was not replayed bit for bit to its end")
    elif int(same[1]) < outcome.last.loop.cycles:
        problems.append(
            f"the record has not all of the session's {outcome.last.loop.cycles} cycles"
        )
    return problems


def _shown_again(
    url: str,
    node: str,
    path: Path,
    router: Sequence[str],
    before: dict[int, Vector],
    say: _Say,
) -> list[str]:
    """Publish the record, and compare the path that a client receives with the path `before`."""
    with RosbridgeProgram(url, node) as program:
        words = (
            "net",
            "replay",
            str(path),
            "--rate",
            str(REPLAY_RATE),
            "--topics",
            f"{node}/state/pose",
        )
        code, lines = _cardan(*words, *router)
    for line in lines:
        say(f"replay on the network: {line}")
    if code != EXIT_OK:
        return ["the record could not be published"]
    again = program.poses
    both = before.keys() & again.keys()
    if len(both) < SEEN_SHARE * len(before):
        return [f"of {len(before)} poses of the session {len(both)} were seen again"]
    apart_m = max(math.dist(before[each], again[each]) for each in both)
    say(f"{len(both)} poses seen again; path difference {1e3 * apart_m:.3f} mm")
    return [f"the path was another one, by up to {1e3 * apart_m:.3f} mm"] if apart_m else []


def _cardan(*words: str) -> tuple[int, list[str]]:
    """Exit code and output of a command that ends by itself."""
    done = subprocess.run(
        [sys.executable, "-m", "cardan", *words],
        capture_output=True,
        text=True,
        timeout=REPLAY_WITHIN_S,
        check=False,
    )
    sys.stderr.write(printable(done.stderr, "\n"))
    return done.returncode, printable(done.stdout, "\n").splitlines()
