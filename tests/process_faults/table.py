"""Run the cases with real processes, and write the results.

python -m tests.process_faults [--labs N] [--only WORDS] [--json FILE] [--write]
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from cardan.errors import CardanError
from cardan.gateway.daemon.services import ENGAGED
from tests.foreground import signals_act
from tests.gateway.daemon.event_files import read_events
from tests.kernel.conftest import FAULT_ROW
from tests.process_faults.cases import BACK_S, GOFA, LATE_S, Case, Outcome, all_cases
from tests.process_faults.lab import PAIRS, SPEED_M_S, Lab, Motion, wait
from tests.result_tables import PROCESS_FAULTS as RESULTS

DEFAULT = Path("build/faults.json")

HIGHEST_M_S = 1.2 * SPEED_M_S
"""Bound of the highest speed. An arm that takes one step each 10 ms, as ROS 2's here, seems faster
by a sixth in means over 60 ms; tests/fault_table.py is exact."""
HAD_M_S = 0.8 * SPEED_M_S
"""Least speed at the fault; a slower arm was not moving steadily, and the case is repeated."""
TRIES = 4
"""Number of attempts at a case if other work of the computer stops the arm before the fault."""
SAID = 110
"""Greatest length of a message in the table, characters."""

NETWORK = "network"
"""Group of the rows that the kernel tests produce."""

LIVE_S = 1.0
"""Time for which a restarted session is watched while the device is still deflected."""


class Row(NamedTuple):
    """Result of a case."""

    key: str
    group: str
    name: str
    pair: str
    outcome: str
    within_s: float
    had_m_s: float
    stop_s: float | None
    distance_m: float
    peak_m_s: float
    again: bool
    said: str
    back_s: float | None
    """Time until the session was live again by itself, with its arm disarmed; None: it had not
    ended, or a user has to start it."""
    moves_s: float | None
    """Time until re-arming moved the arm again, after all killed programs were started."""
    started: list[str]
    """Programs that had to be started by hand."""
    lost: int
    """Number of events that were reported and are not in the log."""
    wrong: list[str]


def judged(case: Case, motion: Motion, lost: int, problems: Iterable[str] = ()) -> list[str]:
    """List the violations of the case's requirements as sentences."""
    wrong = list(problems)
    if motion.again:
        wrong.append(f"moved again by itself at {1e3 * motion.again_m_s:.0f} mm/s")
    if motion.peak_m_s > HIGHEST_M_S:
        wrong.append(f"{1e3 * motion.peak_m_s:.0f} mm/s")
    if case.outcome is Outcome.STOPS and motion.stop_s is None:
        wrong.append("went on")
    if case.outcome is Outcome.GOES_ON and motion.stop_s is not None:
        wrong.append("stopped")
    if case.outcome is not Outcome.GOES_ON and motion.stop_s is not None:
        longest_s = case.within(PAIRS[case.pair]) + LATE_S
        if motion.stop_s > longest_s:
            wrong.append(f"{motion.stop_s:.2f} s to rest, {longest_s:.2f} s at most")
    if lost and not case.loses:
        wrong.append(f"{lost} events are not in the log")
    return wrong


def said_of(lab: Lab, since_s: float) -> str:
    """Return the messages of the event log, or of the command, since `since_s`."""
    assert lab.daemon is not None
    words: list[str] = []
    if lab.run:
        lines = [line for line in lab.daemon.said().splitlines() if line.strip()]
        words = [re.sub(r"^\S*\s*\w*:?\s*cardan[^:]*: ", "", line) for line in lines[-2:]]
    else:
        for event in read_events(lab.log_of_events):
            if event["time_s"] >= since_s and event["why"] and event["why"] not in words:
                words.append(event["why"])
    text = "; ".join(words[:2]).replace(str(lab.folder), "").replace("|", "/")
    return text if len(text) <= SAID else text[: SAID - 1] + "…"


class Series:
    """Run the cases of one pair in sequence, in one lab."""

    def __init__(self, pair: str, run: bool) -> None:
        self._pair, self._run = pair, run
        self.lab: Lab | None = None

    def close(self) -> None:
        lab, self.lab = self.lab, None
        if lab is not None:
            lab.__exit__()

    def go(self, case: Case) -> Row:
        """Run a case; repeat it if the arm did not move steadily before the fault."""
        for _ in range(TRIES - 1):
            with contextlib.suppress(TimeoutError):
                return self._go(case)
            self.close()
        return self._go(case)

    def _go(self, case: Case) -> Row:
        if self.lab is None:
            self.lab = Lab(PAIRS[self._pair], run=self._run)
        lab = self.lab
        if lab.record != ("record" in case.name):
            lab.record = "record" in case.name
            lab.end_daemon()
        began_s = time.time()
        for attempt in range(TRIES):
            lab.revive()
            lab.engage()
            at_s, wall_s = time.monotonic(), time.time()
            problems: list[str] = []
            with contextlib.ExitStack() as stack:
                try:
                    case.act(lab, stack)
                except (AssertionError, TimeoutError, OSError, StopIteration) as error:
                    problems.append(f"{type(error).__name__}: {error}")
                lab.pause(case.watch_s)
            back_s = self._back(case, at_s, problems)
            until_s, at_s = time.monotonic(), max(at_s, lab.hit_s)
            lab.do(lab.pair.rest)  # first, before the arm runs out of space
            motion = lab.trace.motion(at_s, until_s)
            said = said_of(lab, wall_s)
            if case.dies:
                lab.died()
            # A stop caused by other work of this computer is a different fault.
            slow = case.outcome is Outcome.GOES_ON and "supervises" in said
            if motion.had_m_s > HAD_M_S and not (slow and attempt + 1 < TRIES):
                break
        else:
            raise TimeoutError("the arm was never moved steadily; is this machine very busy?")
        problems += lab.records() if lab.record else []
        moves_s, started = None, []
        try:
            started = lab.revive()
            moves_s = lab.engage()
        except (TimeoutError, RuntimeError, CardanError) as error:
            problems.append(f"it did not recover: {error}")
        if lab.hand is not None:
            lab.do(lab.pair.rest)
        lab.pause(0.2)
        lost = 0 if self._run else len(lab.lost_events(began_s))
        row = Row(
            case.key, case.group, case.name, case.pair, case.outcome.value,
            case.within(PAIRS[case.pair]), motion.had_m_s, motion.stop_s, motion.distance_m,
            motion.peak_m_s, motion.again, said, back_s, moves_s, started, lost,
            judged(case, motion, lost, problems),
        )  # fmt: skip
        lab.reported.clear()
        if moves_s is None:
            self.close()
        return row

    def _back(self, case: Case, at_s: float, problems: list[str]) -> float | None:
        """Wait for a session that restarts by itself, and a little longer."""
        lab = self.lab
        assert lab is not None
        if not case.dies or self._run:
            return None

        def live() -> bool:
            with contextlib.suppress(CardanError, OSError):
                row = lab.row()
                return row["state"] == "running" and row["robot_link"] == "live"
            return False

        try:
            wait(live, "the session", BACK_S)
        except TimeoutError:
            problems.append("the session did not come back")
            return None
        back_s = time.monotonic() - at_s
        if (phase := lab.row()["phase"]) in ENGAGED:
            problems.append(f"it came back {phase}")
        lab.pause(LIVE_S)
        return back_s


def run(
    cases: Sequence[Case], labs: int, reported: Callable[[Row], None] = lambda _row: None
) -> list[Row]:
    """All cases, in order. Cases of different pairs run in parallel in this many labs, and those
    that take a minute run in parallel with each other."""
    waiting: dict[tuple[str, bool], list[Case]] = {}
    for case in cases:
        waiting.setdefault((case.pair, case.run), []).append(case)
    series = sorted(waiting.items(), key=lambda each: -len(each[1]))
    rows: dict[str, Row] = {}
    lock = threading.Lock()

    def work() -> None:
        while True:
            with lock:
                if not series:
                    return
                (pair, with_run), mine = series.pop(0)
            one = Series(pair, with_run)
            try:
                # Cases without restarts of programs first, the stop of a minute last.
                for case in sorted(mine, key=lambda each: (each.long, each.ends)):
                    try:
                        row = one.go(case)
                    except Exception as error:
                        traceback.print_exc()
                        row = Row(
                            case.key, case.group, case.name, pair, case.outcome.value, 0.0, 0.0,
                            None, 0.0, 0.0, False, "", None, None, [], 0, [f"failed: {error!r}"],
                        )  # fmt: skip
                        one.close()
                    rows[case.key] = row
                    reported(row)
            finally:
                one.close()

    threads = [threading.Thread(target=work) for _ in range(labs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return [rows[case.key] for case in cases if case.key in rows]


# -- the tables -----------------------------------------------------------------------------------


def _cell(row: Row) -> str:
    stop = "continues" if row.stop_s is None else f"{1e3 * row.stop_s:.0f}"
    text = f"{stop}, {1e3 * row.distance_m:.1f}, {1e3 * row.peak_m_s:.0f}"
    return f"**{text}**" if row.wrong else text


def _after(row: Row) -> str:
    words = []
    if row.back_s is not None:
        words.append(f"session back after {row.back_s:.1f} s")
    if row.started:
        words.append(f"{' and '.join(row.started)} started by hand")
    words.append("no motion" if row.moves_s is None else "re-arm")
    return ", ".join(words)


def tables(rows: Sequence[Row], notes: str) -> str:
    """Markdown tables, one for each group."""
    lines = [notes, ""]
    for group in dict.fromkeys(row.group for row in rows):
        lines += [
            f"#### {group}",
            "",
            "| fault | pair | ms, mm, mm/s | again | message | to continue |",
        ]
        lines.append("|---" * 6 + "|")
        for row in rows:
            if row.group == group:
                again = "**yes**" if row.again else "no"
                cells = (row.name, row.pair, _cell(row), again, row.said or "–", _after(row))
                lines.append(f"| {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


def notes_of(found: dict[str, Any]) -> str:
    """Return the conditions of the measurement."""
    rows = found["rows"]
    wrong = sum(bool(row["wrong"]) for row in rows)
    lost = sum(row["lost"] for row in rows if "disk full" not in row["name"])
    network = sum(row["group"] == NETWORK for row in rows)
    return (
        f"{len(rows) - network} of the {len(all_cases())} cases, and {network} of the {NETWORK}; "
        f"{wrong} failed; {lost} events lost outside of full disks. "
        f"{found['processors']} processors, {found['labs']} laboratories side by side at most, "
        f"load of the computer from {min(found['loads']):.0f} to {max(found['loads']):.0f}."
    )


def taken_in(file: Path, log: Path) -> None:
    """Copy the rows from a log of the kernel tests into a file of results."""
    found = json.loads(file.read_text()) if file.exists() else {"rows": [], "loads": []}
    known = {row["key"]: row for row in found["rows"]}
    for line in log.read_text(errors="replace").splitlines():
        if line.startswith(FAULT_ROW):
            row = json.loads(line.removeprefix(FAULT_ROW))
            key = f"{NETWORK}: {row['name']} ({GOFA})"
            known[key] = Row(
                key, NETWORK, row["name"], GOFA, Outcome.EITHER.value, 0.0, row["peak_m_s"],
                row["stop_s"], row["distance_m"], row["peak_m_s"], row["again"],
                row["said"], None, 0.0, [], 0, ["moved again by itself"] if row["again"] else [],
            )._asdict()  # fmt: skip
    found["rows"] = list(known.values())
    file.write_text(json.dumps(found, indent=1) + "\n")


def _in_order(known: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows in the order of the declared cases, followed by the network's."""
    declared = [case.key for case in all_cases()]
    others = [key for key, row in known.items() if row["group"] == NETWORK]
    return [known[key] for key in (*declared, *others) if key in known]


def measured(cases: Sequence[Case], labs: int, file: Path | None) -> dict[str, Any]:
    """Run the cases; return their results and the others of `file`. The file is written after each
    case."""
    known: dict[str, dict[str, Any]] = {}
    found: dict[str, Any] = {"loads": []}
    if file is not None and file.exists():
        found = json.loads(file.read_text())
        known = {row["key"]: row for row in found["rows"]}
    lock = threading.Lock()

    def reported(row: Row) -> None:
        mark = f"  <-- {'; '.join(row.wrong)}" if row.wrong else ""
        print(f"{row.key}: {_cell(row)} | {row.said} | {_after(row)}{mark}", flush=True)
        with lock:
            known[row.key] = row._asdict()
            found["rows"] = _in_order(known)
            found["loads"].append(round(os.getloadavg()[0], 1))
            found["labs"] = max(labs, found.get("labs", 0))
            found["processors"] = os.cpu_count()
            if file is not None:
                file.write_text(json.dumps(found, indent=1) + "\n")

    run(cases, labs, reported)
    return found


def main() -> int:
    """Run the cases of the command line, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--labs", type=int, default=2, help="pairs side by side")
    parser.add_argument("--only", default="", help="cases with these words in their key (regex)")
    parser.add_argument("--json", type=Path, help="keep what is found here, with what it has")
    parser.add_argument("--kernel", type=Path, help="take in the rows of this log of test-kernel")
    parser.add_argument(
        "--from", dest="source", type=Path, help="make the tables of this JSON only"
    )
    parser.add_argument("--write", action="store_true", help=f"write {RESULTS.file}")
    parser.add_argument("--missing", action="store_true", help="only what --json has not, or wrong")
    parser.add_argument("--list", action="store_true", help="print the cases' keys")
    options = parser.parse_args()
    cases = [case for case in all_cases() if re.search(options.only, case.key)]
    if options.missing and options.json and options.json.exists():
        rows = json.loads(options.json.read_text())["rows"]
        right = {row["key"] for row in rows if not row["wrong"]}
        cases = [case for case in cases if case.key not in right]
    if options.kernel:
        taken_in(options.json or DEFAULT, options.kernel)
        options.source = options.json or DEFAULT
    if options.list:
        print("\n".join(case.key for case in cases))
        return 0
    if options.source:
        found = json.loads(options.source.read_text())
    else:
        with signals_act():
            found = measured(cases, options.labs, options.json)
    if options.write:
        RESULTS.write(tables([Row(**row) for row in found["rows"]], notes_of(found)))
    return 1 if any(row["wrong"] for row in found["rows"]) else 0


if __name__ == "__main__":
    sys.exit(main())
