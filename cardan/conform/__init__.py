"""Conformance: numbered requirements, checked on recorded wire traffic.

The same requirements check a simulated peer in virtual time and a real target at ``--target``. The
`Suite` of a protocol holds them and decodes a `WireTimeline` of events. Its `Scenario` makes the
traffic: it listens, holds, moves by a millimeter, or asks an operator to make faults by hand.
"""

from cardan.conform.report import SuiteReport as SuiteReport, check_timeline as check_timeline
from cardan.conform.requirements import (
    Level as Level,
    Requirement as Requirement,
    Requirements as Requirements,
    Verdict as Verdict,
    VerdictOutcome as VerdictOutcome,
    failed as failed,
    not_applicable as not_applicable,
    not_seen as not_seen,
    passed as passed,
)
from cardan.conform.runner import (
    Exchange as Exchange,
    Pause as Pause,
    Scenario as Scenario,
    Step as Step,
    ask as ask,
    close as close,
    mark as mark,
    open_ as open_,
    send as send,
)
from cardan.conform.suite import Suite as Suite, SuiteTransport as SuiteTransport
from cardan.conform.timeline import (
    Kind as Kind,
    WireEvent as WireEvent,
    WireTimeline as WireTimeline,
)
