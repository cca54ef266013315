"""Conformance report with a verdict on each requirement, as text, Markdown, JSON and JUnit."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any
from xml.etree import ElementTree

from cardan import __version__
from cardan.conform.redaction import Redaction
from cardan.conform.requirements import Level, T, V, Verdict, VerdictOutcome, not_seen
from cardan.conform.suite import Suite
from cardan.conform.timeline import Kind, WireTimeline
from cardan.errors import ConfigurationError

FORM = 1
"""Version of the JSON format; incremented when a reader of the old format would misread the new."""
DOUBTED = "not judged, perhaps not met: "
"""Prefix of the words on a requirement with incomplete evidence."""
_BYTES_SHOWN = 16
_MARKS = {
    VerdictOutcome.PASSED: "pass",
    VerdictOutcome.FAILED: "FAIL",
    VerdictOutcome.NOT_APPLICABLE: "n/a",
    VerdictOutcome.NOT_SEEN: "-",
}


@dataclass(frozen=True)
class Result:
    """Verdict on a requirement in a report."""

    id: str
    level: int
    source: str
    text: str
    outcome: VerdictOutcome
    said: str
    evidence: tuple[str, ...] = ()
    """Events of the timeline in words."""
    figure: float | None = None
    unit: str = ""


@dataclass(frozen=True)
class SuiteReport:
    """Result of checking a target once."""

    suite: str
    judges: str
    target: str
    """Redacted; without a target "simulated" with its faults."""
    simulated: bool
    level: int
    seconds: float
    """From the first event to the last."""
    events: int
    version: str
    """Version of Cardan."""
    attached: Mapping[str, str] = field(default_factory=dict, kw_only=True)
    """SHA-256 of each file beside the report, by its name."""
    results: tuple[Result, ...]

    @property
    def counts(self) -> Counter[VerdictOutcome]:
        """Number of requirements with each outcome."""
        return Counter(each.outcome for each in self.results)

    @property
    def failed(self) -> tuple[str, ...]:
        """Ids of the requirements that are not met."""
        return tuple(each.id for each in self.results if each.outcome is VerdictOutcome.FAILED)

    @property
    def doubted(self) -> list[str]:
        """Ids of requirements that fail in a capture that may lack the messages that meet them."""
        return [
            each.id
            for each in self.results
            if each.outcome is VerdictOutcome.NOT_SEEN and each.said.startswith(DOUBTED)
        ]

    def as_text(self) -> str:
        """Return text for a terminal: a line per requirement, evidence below failed ones."""
        lines = [self._title()]
        for each in self.results:
            lines.append(f"{_MARKS[each.outcome]:4} {each.id:12} {each.text}")
            lines.append(f"     {'':12} {each.said}")
            if each.outcome is VerdictOutcome.FAILED:
                lines.append(f"     {'':12} source: {each.source}")
                lines += [f"     {'':12} {line}" for line in each.evidence]
        return "\n".join([*lines, self._sum()]) + "\n"

    def as_markdown(self) -> str:
        """Return Markdown: a table, and the evidence below it."""
        lines = [
            f"# {self._title()}\n",
            f"Cardan {self.version}, level {self.level}, {self.seconds:.1f} s, "
            f"{self.events} events.\n",
            "| requirement | verdict | seen | text | source |",
            "|---|---|---|---|---|",
        ]
        for each in self.results:
            cells = (each.id, each.outcome.value, each.said, each.text, each.source)
            lines.append(f"| {' | '.join(map(_cell, cells))} |")
        for each in self.results:
            if each.evidence:
                lines += [f"\n{each.id}\n", *(f"    {line}" for line in each.evidence)]
        if self.attached:
            lines.append("")
            lines += [f"- `{name}`: SHA-256 {digest}" for name, digest in self.attached.items()]
        return "\n".join([*lines, "", self._sum()]) + "\n"

    def as_json(self) -> str:
        """Return JSON for programs, and for `read`."""
        values = {"form": FORM, **asdict(self)}
        return json.dumps(values, indent=1, ensure_ascii=False, default=_in_json) + "\n"

    def as_junit(self) -> str:
        """Return JUnit XML for continuous integration: a test case per requirement."""
        counts = self.counts
        skipped = counts[VerdictOutcome.NOT_SEEN] + counts[VerdictOutcome.NOT_APPLICABLE]
        root = ElementTree.Element(
            "testsuite",
            name=f"cardan conform {self.suite}",
            tests=str(len(self.results)),
            failures=str(counts[VerdictOutcome.FAILED]),
            errors="0",
            skipped=str(skipped),
            time=f"{self.seconds:.3f}",
        )
        for each in self.results:
            case = ElementTree.SubElement(
                root, "testcase", classname=f"conform.{self.suite}", name=f"{each.id} {each.text}"
            )
            if each.outcome is VerdictOutcome.FAILED:
                failure = ElementTree.SubElement(case, "failure", message=each.said)
                failure.text = "\n".join((f"source: {each.source}", *each.evidence))
            elif each.outcome is not VerdictOutcome.PASSED:
                why = f"{each.outcome.value}: {each.said}"
                ElementTree.SubElement(case, "skipped", message=why)
        ElementTree.indent(root)
        return f'<?xml version="1.0" encoding="utf-8"?>\n{ElementTree.tostring(root, "unicode")}\n'

    def _title(self) -> str:
        return f"{self.suite}: {self.judges} at {self.target}"

    def _sum(self) -> str:
        return ", ".join(f"{self.counts[each]} {each.value}" for each in VerdictOutcome)


def _in_json(value: VerdictOutcome) -> str:
    return value.value


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def check_timeline(
    suite: Suite[V],
    timeline: WireTimeline,
    level: Level,
    *,
    target: str = "",
    faults: Mapping[str, float] | None = None,
    version: str = __version__,
    redaction: Redaction | None = None,
) -> SuiteReport:
    """Return the report on `timeline`, recorded on `level` at `target` (empty: simulated, with
    `faults`). Without `redaction` nothing is removed."""
    clean = redaction or str
    decoded = suite.decode(timeline)
    results = []
    for each in suite.requirements:
        if each.level > level:
            verdict: Verdict = not_seen(f"level {each.level:d} was not run")
        else:
            verdict = timeline.verdict(each, decoded)
        evidence = tuple(clean(line) for line in _evidence(suite, timeline, verdict))
        results.append(
            Result(
                each.id,
                int(each.level),
                each.source,
                each.text,
                verdict.outcome,
                clean(verdict.said),
                evidence,
                verdict.figure,
                verdict.unit,
            )
        )
    simulated = f"simulated {suite.peer}"
    if faults:
        simulated += f" with {', '.join(f'{name}={value:g}' for name, value in faults.items())}"
    return SuiteReport(
        suite.name,
        suite.judges,
        clean(target) if target else simulated,
        not target,
        int(level),
        round(timeline.end_s, 6),
        len(timeline),
        version,
        tuple(results),
    )


def _evidence(suite: Suite[V], timeline: WireTimeline, verdict: Verdict) -> list[str]:
    lines = []
    for number in verdict.evidence:
        event = suite.redacted(timeline.events[number])
        way = "to" if event.sent else "from"
        words = f"#{number} at {event.time_s:.4f} s {event.kind.value} {way} it"
        if event.channel:
            words += f" on {event.channel}"
        if event.kind is Kind.DATA:
            more = " ..." if len(event.data) > _BYTES_SHOWN else ""
            words += f", {len(event.data)} B: {event.data[:_BYTES_SHOWN].hex(' ')}{more}"
        if event.note:
            words += f" ({event.note})"
        lines.append(words)
    return lines


_FROM_JSON: Mapping[str, Callable[[Any], Any]] = {
    **{kind.__name__: kind for kind in (bool, float, int, str, VerdictOutcome)},
    "float | None": lambda value: None if value is None else float(value),
    "tuple[str, ...]": lambda value: tuple(map(str, value)),
    "tuple[Result, ...]": tuple,
    "Mapping[str, str]": lambda value: {str(key): str(each) for key, each in value.items()},
}
"""Conversion of a JSON value to a field's value, by the field's type."""


def _made(kind: type[T], values: Mapping[str, Any]) -> T:
    """Return a dataclass made from the JSON values of its fields."""
    known = {each.name: _FROM_JSON[str(each.type)] for each in fields(kind)}  # type: ignore[arg-type]
    return kind(**{name: made(values[name]) for name, made in known.items()})


def read(text: str, name: str) -> SuiteReport:
    """Read a report that `as_json` wrote; `name` is the file's. Raises ConfigurationError, which
    says what is wrong with it."""
    try:
        values: dict[str, Any] = json.loads(text)
        if values["form"] != FORM:
            raise ConfigurationError(
                name, f"a report of format {values['form']}; this version reads {FORM}"
            )
        results = tuple(_made(Result, each) for each in values["results"])
        return _made(SuiteReport, {**values, "results": results})
    except ConfigurationError:
        raise
    except KeyError as error:
        why = f"it has no {error}"
    except json.JSONDecodeError as error:
        why = f"it is not JSON: {error}"
    except (ValueError, TypeError, AttributeError, RecursionError):
        why = "a value of it is of another kind"
    raise ConfigurationError(name, f"no report of `cardan conform --format json`: {why}")
