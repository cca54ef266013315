"""What a Universal Robots controller must do with the lines and programs that its users send beside
a driver: level 1."""

from __future__ import annotations

from cardan.conform.requirements import (
    Verdict,
    failed,
    met,
    must,
    none_wrong,
    not_seen,
    passed,
    some,
)
from cardan.conform.timeline import Kind
from cardan.conform.ur_rtde.decoded import Upload, UrSeen
from cardan.conform.ur_rtde.programs import NO_PROGRAM, RUNTIME, SCRIPT, after, first
from cardan.conform.ur_rtde.requirements import CLIENT, requires
from cardan.conform.ur_rtde.scenario import (
    ANSWER,
    CALLS,
    LINE,
    RAISES,
    RAISES_AT,
    SAYS,
    TOKEN,
)
from cardan.protocols.ur.primary import MessageKind
from cardan.protocols.ur.states import RuntimeState


def _uploads(seen: UrSeen, *phases: str) -> list[Upload]:
    """Programs with a token, in these phases."""
    return [each for each in seen.uploads if each.token and seen.inside(each.number, *phases)]


def _texts(seen: UrSeen, phase: str) -> list[str]:
    return [
        each.message.text
        for each in seen.told
        if each.message is not None
        and each.message.kind == MessageKind.TEXT
        and seen.inside(each.number, phase)
    ]


@requires(120, f"{CLIENT}: a line that is sent alone is run")
def a_line_is_a_program_of_its_own(seen: UrSeen) -> Verdict:
    """What is sent in one line, without `def` and `end`, is done: its text comes over the primary
    interface."""
    lines = [each for each in seen.uploads if not each.token and seen.inside(each.number, "lines")]
    some(lines, NO_PROGRAM)
    found = [text for text in _texts(seen, "lines") if LINE in text]
    return passed(repr(found[0])) if found else failed("no text came", [lines[0].number])


@requires(121, f"{CLIENT}: lines and programs on one connection")
def lines_spoil_no_program(seen: UrSeen) -> Verdict:
    """After lines, comments and `stop program` the next program of the connection is begun."""
    found = some(_uploads(seen, "lines"), NO_PROGRAM)
    state = first(after(seen, found[0].time_s), TOKEN, found[0].token)
    return passed("it was") if state else failed("it was not", [found[0].number])


@requires(122, f"{CLIENT}: runtime exception message")
def runtime_exceptions_are_told(seen: UrSeen) -> Verdict:
    """A program that fails while it runs ends, and a runtime exception on the primary interface
    says in which line."""
    found = _uploads(seen, "raise")
    if not found or first(seen.during("raise"), TOKEN, found[0].token) is None:
        return not_seen("none was begun")
    last = seen.during("raise")[-1]
    must(last.values[RUNTIME] == RuntimeState.STOPPED, "it still runs", [last.number])
    told = [
        each.message
        for each in seen.told
        if each.message is not None
        and each.message.kind == MessageKind.RUNTIME_EXCEPTION
        and seen.inside(each.number, "raise")
    ]
    must(told, f"nothing was said of {RAISES}", [found[0].number])
    said = f"line {told[0].line}: {told[0].text!r}"
    return met(told[0].line == RAISES_AT, said)


@requires(123, f"{SCRIPT}: socket_open, socket_send_line, socket_read_line")
def programs_open_sockets(seen: UrSeen) -> Verdict:
    """A program opens a socket to a port of ours, sends a line, and hears what is answered."""
    uploads = [each for each in _uploads(seen, "call") if each.name == CALLS]
    if not uploads or first(seen.during("call"), TOKEN, uploads[0].token) is None:
        return not_seen("none was begun")
    if not any(event.kind is Kind.OPENED for _, event in seen.called):
        return failed("it did not come", [uploads[0].number])
    number = seen.called[0][0]
    wanted = f"{SAYS} {uploads[0].token}"
    line = b"".join(event.data for _, event in seen.called).decode("utf-8", "replace")
    must(line.strip() == wanted, f"it sent {line!r}", [number])
    if not any(ANSWER in text for text in _texts(seen, "call")):
        return failed("it did not hear the answer", [number])
    return passed("it did")


@requires(124, f"{CLIENT}: the secondary and the real-time interface take programs, too")
def other_interfaces_take_programs(seen: UrSeen) -> Verdict:
    """Programs that are sent over the secondary and over the real-time interface are begun."""
    found = _uploads(seen, "elsewhere")
    wrong = [
        (each.number, f"over the {each.channel} interface")
        for each in found
        if first(after(seen, each.time_s), TOKEN, each.token) is None
    ]
    said = ", ".join(each.channel for each in found)
    return none_wrong(wrong, len(found), said, NO_PROGRAM)
