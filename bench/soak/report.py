"""Observations of a soak, written to files from the start, so that an aborted run has its report,
too."""

from __future__ import annotations

import csv
import json
import math
import os
import platform
import statistics
import threading
import time
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any, Final, NamedTuple

from bench.soak import rules
from bench.soak.rules import LIMITS, Drift, Violation, drifts

VIOLATIONS_SHOWN: Final = 40

MAX_OUTCOMES: Final = 8
"""Largest number of distinct outcomes counted per action."""


class Sample(NamedTuple):
    """Resources used by a process at one time."""

    time_s: float
    who: str
    pid: int
    rss_mb: float
    fds: int
    threads: int
    cpu: float
    """Share of a processor since the previous sample; NaN for the first one."""
    p50_ms: float
    p99_ms: float
    """Percentile of a session's cycle since the previous sample; NaN for other processes."""
    restarts: int


class Report:
    """Report whose files are updated regularly: report.json, report.md, samples.csv, acts.jsonl,
    violations.jsonl."""

    def __init__(self, folder: Path, seed: int, hours: float) -> None:
        self.folder, self.seed, self.hours = folder, seed, hours
        self.over = False
        """True once the run has ended and is recorded completely."""
        self.cut = ""
        """Reason why the run ended early; empty: it did not."""
        self.violations: list[Violation] = []
        self.errors: list[str] = []
        """Errors of the soak itself."""
        self._lock = threading.RLock()
        self._acts: Counter[tuple[str, str]] = Counter()
        self._outcomes: dict[str, Counter[str]] = defaultdict(Counter)
        self._samples: dict[tuple[str, int], list[tuple[float, dict[str, float]]]] = {}
        self._latest: dict[str, Sample] = {}
        self._loads: list[float] = []
        self._answers: list[float] = []
        self._began_s = time.monotonic()
        self._began = time.time()
        self._csv = (folder / "samples.csv").open("w", newline="")
        self._rows = csv.writer(self._csv)
        self._rows.writerow(Sample._fields)
        self._act_file = (folder / "acts.jsonl").open("w")
        self._violation_file = (folder / "violations.jsonl").open("w")

    def begin(self) -> None:
        """Start the clock: the lab runs."""
        self._began_s, self._began = time.monotonic(), time.time()

    @property
    def lasted_s(self) -> float:
        """Time since the start."""
        return time.monotonic() - self._began_s

    def violation(self, violation: Violation) -> None:
        """Record a violation of a rule."""
        with self._lock:
            at_s = violation.time_s - self._began_s
            self.violations.append(violation._replace(time_s=at_s))
            line = violation._replace(time_s=round(at_s, 2))._asdict()
            self._violation_file.write(json.dumps(line) + "\n")
            self._violation_file.flush()

    def broken(self, what: str) -> None:
        """Record a failure of the soak itself."""
        with self._lock:
            self.errors.append(what)

    def count(self, kind: str, what: str) -> None:
        """Record an action."""
        with self._lock:
            self._acts[kind, what] += 1

    def did(self, kind: str, what: str, who: str, outcome: str) -> None:
        """Record an action with its outcome."""
        with self._lock:
            self._acts[kind, what] += 1
            if kind == "client":
                kinds = self._outcomes[what]
                name = outcome.split(":")[0][:40]
                kinds[name if name in kinds or len(kinds) < MAX_OUTCOMES else "other"] += 1
            line = {
                "time_s": round(self.lasted_s, 2), "kind": kind, "what": what, "who": who,
                "outcome": outcome[:300],
            }  # fmt: skip
            self._act_file.write(json.dumps(line) + "\n")
            self._act_file.flush()

    def answered(self, took_s: float, paused: bool) -> None:
        """Record an answer of the daemon; `paused`: the soak had stopped it, or just resumed it."""
        if not paused:
            with self._lock:
                self._answers.append(took_s)

    def sample(self, sample: Sample) -> None:
        """Record a process's present use of resources."""
        with self._lock:
            self._rows.writerow(
                [round(x, 4) if isinstance(x, float) else x for x in
                 sample._replace(time_s=sample.time_s - self._began_s)]
            )  # fmt: skip
            self._csv.flush()
            figures = {
                name: value
                for name in LIMITS
                if not math.isnan(value := float(getattr(sample, name)))
            }
            key = sample.who, sample.pid
            self._samples.setdefault(key, []).append((sample.time_s, figures))
            self._latest[sample.who] = sample

    def load(self, load: float) -> None:
        """Record the computer's load average over a minute."""
        with self._lock:
            self._loads.append(load)

    # -- what becomes of it ----------------------------------------------------------------------

    def drifts(self) -> list[Drift]:
        """Return the drifts of every process that lived long enough, or of the longest life per
        name."""
        found = []
        for (who, pid), samples in self._samples.items():
            found += drifts(who, pid, samples)
        return found

    def table(
        self, moves: dict[str, tuple[int, float]], took: list[tuple[str, float]]
    ) -> dict[str, Any]:
        """Return the whole report."""
        rules = Counter(each.rule for each in self.violations)
        recoveries: dict[str, list[float]] = defaultdict(list)
        for who, took_s in took:
            recoveries[who].append(took_s)
        answers = sorted(self._answers) or [math.nan]
        return {
            "seed": self.seed,
            "hours_asked": self.hours,
            "lasted_s": round(self.lasted_s, 1),
            "over": self.over,
            "cut": self.cut,
            "began": time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(self._began)),
            "python": platform.python_version(),
            "processors": os.cpu_count(),
            "load_median": round(statistics.median(self._loads), 1) if self._loads else None,
            "load_max": round(max(self._loads), 1) if self._loads else None,
            "acts": {f"{kind} {what}": n for (kind, what), n in sorted(self._acts.items())},
            "outcomes": {name: dict(each) for name, each in sorted(self._outcomes.items())},
            "moves": {name: [n, round(s, 1)] for name, (n, s) in moves.items()},
            "answers": len(self._answers),
            "answer_p99_ms": round(1e3 * answers[int(0.99 * (len(answers) - 1))], 1),
            "answer_max_ms": round(1e3 * answers[-1], 1),
            "recoveries": {
                who: [len(each), round(statistics.median(each), 1), round(max(each), 1)]
                for who, each in sorted(recoveries.items())
            },
            "violations": dict(rules),
            "errors": self.errors,
            "drift": [
                {k: round(v, 2) if isinstance(v, float) else v for k, v in each._asdict().items()}
                for each in self.drifts()
            ],
            "now": {who: each._asdict() for who, each in sorted(self._latest.items())},
        }

    def close(self) -> None:
        """Close the report's files."""
        for file in (self._csv, self._act_file, self._violation_file):
            file.close()

    def write(self, moves: dict[str, tuple[int, float]], took: list[tuple[str, float]]) -> None:
        """Write report.json and report.md, each atomically."""
        with self._lock:
            table = self.table(moves, took)
            for name, text in (
                ("report.json", json.dumps(table, indent=1) + "\n"),
                ("report.md", markdown(table, self.violations)),
            ):
                part = self.folder / f"{name}.part"
                part.write_text(text)
                os.replace(part, self.folder / name)


RULES: Final = {
    "moves unasked": f"no arm moves more than {rules.AT_REST_S:g} s after the last request",
    "moves without authority": "no arm moves without a source with authority, except to brake",
    "two sources": "at most one source at a time moves an arm",
    "unknown source": "only a source that requested motion has the authority",
    "armed by itself": "a restarted session is disarmed until a new action",
    "does not recover": f"everything runs again within {rules.RECOVERED_S:g} s of a fault",
    "the daemon answers": f"the daemon answers within {rules.ANSWER_S:g} s",
    "reload": "reloading an invalid file changes nothing",
    "nothing is left": "no process, socket, shared memory or temporary file is left at the end",
}  # fmt: skip


def markdown(table: dict[str, Any], violations: list[Violation]) -> str:
    """Return the report as Markdown."""
    lasted_s = table["lasted_s"]
    hours, minutes = divmod(round(lasted_s / 60), 60)
    lines = [
        f"{hours} h {minutes} min from {table['began']}, seed {table['seed']}, Python "
        f"{table['python']}, {table['processors']} processors with a load of "
        f"{table['load_median']} (median; largest {table['load_max']})."
        + ("" if table["over"] else " The run continues.")
        + (f" It was ended {table['cut']}." if table["cut"] else ""),
        "",
        "| rule | broken |",
        "|---|---|",
        *(f"| {words} | {table['violations'].get(rule, 0)} |" for rule, words in RULES.items()),
        f"| {_limits()} | {sum(each['exceeded'] for each in table['drift'])} |",
        "",
        "| arm | moves | time in motion |",
        "|---|---|---|",
        *(f"| {arm} | {n} | {s / 60:.1f} min |" for arm, (n, s) in table["moves"].items()),
        "",
        "| action | times |",
        "|---|---|",
        *(f"| {what.replace('_', ' ')} | {n} |" for what, n in table["acts"].items()),
        "",
        "| back after a fault | times | median | longest |",
        "|---|---|---|---|",
        *(
            f"| {who} | {n} | {mid:g} s | {most:g} s |"
            for who, (n, mid, most) in table["recoveries"].items()
        ),
        "",
        f"The daemon answered {table['answers']} times, 99 % of them within "
        f"{table['answer_p99_ms']:g} ms, the slowest in {table['answer_max_ms']:g} ms.",
        "",
        "| process, longest life | memory, MB | descriptors | threads | p99 of the cycle, ms |",
        "|---|---|---|---|---|",
        *_drift_rows(table["drift"]),
        "",
    ]
    if violations:
        lines += ["| time | rule | of | what |", "|---|---|---|---|"]
        lines += [
            f"| {v.time_s:.0f} s | {v.rule} | {v.who} | {v.why.replace('|', '/')} |"
            for v in violations[:VIOLATIONS_SHOWN]
        ]
        lines.append("")
    lines += [f"The soak itself failed: {each}" for each in table["errors"]]
    return "\n".join(lines)


def _limits() -> str:
    """Describe the drift rule in words."""
    return (
        "no figure of a process that lived for 10 min or more grows by more than its limit, from "
        "the first quarter of its life to the last"
    )


def _drift_rows(drift: list[dict[str, Any]]) -> list[str]:
    """Return a row for the longest life per name; a value beyond its limit is bold."""
    longest: dict[str, tuple[float, int]] = {}
    for each in drift:
        longest[each["who"]] = max(
            longest.get(each["who"], (0.0, 0)), (each["lived_s"], each["pid"])
        )
    rows = []
    for who, (lived_s, pid) in longest.items():
        cells = []
        for figure in LIMITS:
            found = [e for e in drift if e["pid"] == pid and e["figure"] == figure]
            if not found:
                cells.append("")
                continue
            words = f"{found[0]['first']:g} to {found[0]['last']:g}"
            cells.append(f"**{words}**" if found[0]["exceeded"] else words)
        rows.append(f"| {who}, {lived_s / 60:.0f} min | {' | '.join(cells)} |")
    return rows
