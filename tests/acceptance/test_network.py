"""Network acceptance test: problems that it reports, and a whole run."""

import itertools
import re
import threading
from types import SimpleNamespace
from typing import ClassVar

import pytest

from cardan.errors import DriverError
from cardan.gateway.session.session import EXIT_OK
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor import SessionExit
from tests.acceptance import network, rosbridge_program
from tests.acceptance.network import run_on_the_network
from tests.acceptance.rosbridge_program import RosbridgeProgram


@pytest.mark.matrix
def test_a_program_at_rosbridge_moves_the_robot_and_the_record_is_exact(tmp_path):
    lines = []
    assert run_on_the_network(tmp_path, 8.0, lines.append) == []
    said = "\n".join(lines)
    for line in (
        r"client: result: a twist was refused: twist: zero begins no stream",
        r"client: parameter preset_streaming_cmd is twist",
        r"client: \d+ twists streamed in [56]\.\d s; TCP moved by up to 1\d\d\.\d mm, at most ",
        r"record: \d+ messages of \d+ topics",
        r"replay through the control core: .*: \d+ cycles, each command bit for bit the recorded",
        r"\d+ poses seen again; path difference 0\.000 mm",
    ):
        assert re.search(line, said), (line, said)


class Program:
    """Observations of a demo's client, without problems."""

    results: ClassVar = [
        {"command": "twist", "outcome": "refused", "success": False, "reason": "choose it"},
        {"command": "twist", "outcome": "accepted", "success": True, "reason": ""},
    ]
    moved_m, behind_m = 0.1, 0.004
    refusals = RosbridgeProgram.refusals


@pytest.mark.parametrize(
    ("lack", "words"),
    [
        ({}, None),
        ({"results": Program.results[:1]}, "did not tell that the twists were taken"),
        ({"results": Program.results[1:]}, "a twist without a preset was not refused"),
        ({"results": [*Program.results, Program.results[0]]}, "refused on the way: choose it"),
        ({"moved_m": 0.001}, "the TCP moved by 1.0 mm only"),
        ({"behind_m": 0.05}, "the TCP was 50.0 mm from where it was commanded"),
        ({"behind_m": 0.0}, "the TCP was 0.0 mm from where it was commanded"),
    ],
)
def test_what_a_program_may_find_wrong(lack, words):
    program = Program()
    vars(program).update(lack)
    found = network._check_program(program)
    assert len(found) == (words is not None)
    assert words is None or words in found[0]


class Refused(RosbridgeProgram):
    """A client whose arm refuses the stream at first."""

    def __init__(self, reasons):
        super().__init__("ws://127.0.0.1", "/arm")
        self.results = Program.results[:1]
        self._reasons = iter(reasons)

    def wait_until_seen(self):
        pass

    def _send(self, **_operation):
        pass

    def _call(self, service, _values):
        if service == "stop":
            return {"success": True}
        reason = next(self._reasons)
        return {"results": [{"successful": not reason, "reason": reason}]}


def test_a_program_asks_again_for_a_stream_that_was_refused(monkeypatch):
    silent = "no datagram for 0.2 s"
    monkeypatch.setattr(rosbridge_program, "ASK_AGAIN_S", 0.0)
    Refused([silent, silent, ""]).drive(0.0, threading.Event())
    monkeypatch.setattr(rosbridge_program, "ANSWER_WITHIN_S", 0.0)
    with pytest.raises(DriverError, match=f"no stream of twists: {silent}"):
        Refused(itertools.repeat(silent)).drive(0.0, threading.Event())


@pytest.mark.parametrize(
    ("code", "replayed", "words"),
    [
        (0, (0, ["/arm: 500 cycles, each command bit for bit the recorded one"]), None),
        (4, (0, ["/arm: 500 cycles, each command bit for bit the recorded one"]), "not complete"),
        (0, (4, ["/arm: the command of cycle 7 differs"]), "not replayed bit for bit"),
        (0, (0, ["/arm: 300 cycles, each command bit for bit", "  not replayed"]), "to its end"),
        (0, (0, ["/arm: 300 cycles, each command bit for bit"]), "not all of the session's 500"),
        (0, (2, []), "not replayed bit for bit"),
    ],
)
def test_what_a_record_may_lack(monkeypatch, tmp_path, code, replayed, words):
    monkeypatch.setattr(network, "_cardan", lambda *_: replayed)
    recorder = SimpleNamespace(code=code, lines=("9 messages dropped",), complaints="")
    outcome = SessionExit(EXIT_OK, Snapshot.of({"loop": {"cycles": 500}}))
    said = []
    found = network._check_record(recorder, tmp_path, outcome, said.append)
    assert len(found) == (words is not None), found
    assert words is None or words in found[0]
    assert said[0] == "record: 9 messages dropped"
