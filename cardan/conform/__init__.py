"""Conformance: numbered requirements, judged on recorded wire traffic.

The same requirements judge a simulated peer in virtual time and a real target at ``--target``. The
`Suite` of a protocol holds them and decodes a `Timeline` of wire events. Its `Scenario` makes the
traffic: it listens, holds, moves by a millimeter, or asks an operator to make faults by hand.
"""

from cardan.conform.report import Report as Report, judged as judged
from cardan.conform.requirements import (
    Level as Level,
    Outcome as Outcome,
    Requirement as Requirement,
    Requirements as Requirements,
    Verdict as Verdict,
    failed as failed,
    not_applicable as not_applicable,
    not_seen as not_seen,
    passed as passed,
)
from cardan.conform.runner import (
    Act as Act,
    Exchange as Exchange,
    Scenario as Scenario,
    Wait as Wait,
    ask as ask,
    close as close,
    mark as mark,
    open_ as open_,
    send as send,
)
from cardan.conform.suite import Suite as Suite, Transport as Transport
from cardan.conform.timeline import Event as Event, Kind as Kind, Timeline as Timeline
