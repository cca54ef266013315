"""Short fuzzing: every run tries the stored inputs, and gives every target some damaged input.

``make fuzz`` is the long run; docs/beyond-make-test.md defines findings.
"""

from __future__ import annotations

import ast
import json
import time
from pathlib import Path
from random import Random

import pytest

from fuzz import corpus, run as runs, servers
from fuzz.mutate import Mutator
from fuzz.run import Outcome, check_growth, outcome_of, run, shares, table_of
from fuzz.target import Form, Target, Watch, joined, split
from fuzz.targets import target_named, targets
from tests.examples import examples

PACKAGE = Path(__file__).parents[1] / "cardan"
SHORT_INPUTS, SHORT_S = examples(300), 0.001 * examples(200)
"""Limits for each target in every run of the tests, whichever is reached first: inputs, and
processor time."""


@pytest.mark.parametrize("name", targets())
def test_good_kept_and_damaged_input_is_understood_or_refused(name):
    outcome = run(target_named(name), "short", SHORT_INPUTS, SHORT_S)
    assert not outcome.findings, _words(outcome)
    assert outcome.inputs >= len(runs.population_of(target_named(name)))


GROWN_NOW = (
    "connexion_serial.peer",
    "servers.assets",
    "leap.peer",
    "recording.mcap",
    "ros2_arm.peer",
)
"""Some fast targets of bytes, text and packets; the others run in the matrix."""


@pytest.mark.matrix(*(name for name in targets() if name not in GROWN_NOW))
@pytest.mark.parametrize("name", targets())
def test_time_and_memory_grow_no_faster_than_input(name):
    grown = check_growth(target_named(name), "short", 1)
    assert not grown.findings, _words(grown)


def _words(outcome: Outcome) -> str:
    return "\n".join(f"{each.what} at {each.where}: {each.line[:500]}" for each in outcome.findings)


@pytest.mark.matrix
@pytest.mark.parametrize("name", servers.SERVERS)
def test_a_server_serves_after_garbage(name):
    outcome = servers.SERVERS[name]("short", servers.GOOD_EVERY)
    assert not outcome.findings, _words(outcome)
    assert outcome.inputs == servers.GOOD_EVERY


def test_every_corpus_file_has_a_target_and_its_inputs_names():
    for path in corpus.FOLDER.iterdir():
        assert path.suffix == ".jsonl"
        names = [each.name for each in corpus.stored(path.stem)]
        assert path.stem in targets()
        assert len(set(names)) == len(names)
        assert all(names)


# -- completeness of the list of targets ----------------------------------------------------------

TARGETS = Path(__file__).parents[1] / "fuzz" / "targets"

NOT_FUZZED = {
    "rate": "counts messages",
}
"""Protocols without a target, with the reason."""


def _imported() -> set[str]:
    """Return full names of all imports of the targets' modules."""
    found = set()
    for path in TARGETS.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                found |= {f"{node.module}.{each.name}" for each in node.names}
            elif isinstance(node, ast.Import):
                found |= {each.name for each in node.names}
    return found


def test_every_protocol_has_a_target():
    imported = _imported()
    protocols = {
        path.stem
        for path in (PACKAGE / "protocols").iterdir()
        if path.suffix == ".py" or (path / "__init__.py").exists()
    } - {"__init__"}
    without = {
        name
        for name in protocols
        if not any(f"{each}.".startswith(f"cardan.protocols.{name}.") for each in imported)
    }
    assert without == set(NOT_FUZZED)


# -- the engine -----------------------------------------------------------------------------------


def _target(function, form=Form.BYTES, seeds=(b"abcdefgh",), **more) -> Target:
    return Target("egm.robot", form, function, lambda: seeds, **more)


@pytest.mark.parametrize("form", Form)
def test_the_same_number_gives_the_same_inputs(form):
    packets = form in (Form.PACKETS, Form.JSON_PACKETS)
    seeds = ((b'{"a": [1, "b"]}', b"[2]"),) if packets else (b'{"a": [1, "b"]}',)
    made = []
    for _ in range(2):
        mutator = Mutator(_target(lambda _data: None, form, seeds), Random("7"), seeds)
        made.append([mutator.next() for _ in range(2000)])
    assert made[0] == made[1]
    assert len(set(made[0])) > 500
    assert all(isinstance(each, tuple if packets else bytes) for each in made[0])


def test_no_input_is_longer_than_its_target_allows():
    target = _target(lambda _data: None, Form.JSON, (b'{"a": 1}',), longest=300)
    mutator = Mutator(target, Random("7"), [b'{"a": 1}'])
    assert max(len(mutator.next()) for _ in range(3000)) == 300


def test_errors_that_are_documented_are_no_findings():
    def parse(data):
        raise ValueError(data) if data[:1] == b"a" else KeyError("undocumented")

    outcome = run(_target(parse, raises=(ValueError,)), "1", 300)
    assert [each.what for each in outcome.findings] == ["KeyError: 'undocumented'"]
    assert outcome.findings[0].given[:1] != b"a"


def test_an_input_that_takes_too_long_is_a_finding():
    def parse(data):
        end_s = time.process_time() + (0.03 if data[:1] == b"a" else 0.0)
        while time.process_time() < end_s:
            pass

    outcome = run(_target(parse, slow_s=0.01), "1", 3)
    assert outcome.findings[0].what.startswith("SlowError")


def test_an_input_that_does_not_end_is_a_finding(monkeypatch):
    monkeypatch.setattr("fuzz.target.HANG_S", 0.05)

    def parse(_data):
        while True:
            try:
                time.process_time()
            except Exception:  # like a parser that continues after every exception
                continue

    outcome = run(_target(parse), "1", 1)
    assert outcome.findings[0].what.startswith("HangError")
    assert Watch().count == 0


@pytest.mark.matrix
def test_time_and_memory_that_grow_faster_than_input_are_findings():
    def quadratic(data):
        return sum(1 for i in range(len(data) // 64) for j in range(len(data) // 32) if i < j)

    def greedy(data):
        return len(bytes(1000 * len(data)))

    for parse, word in ((quadratic, "times"), (greedy, "bytes of memory")):
        outcome = check_growth(_target(parse, longest=1 << 20, slow_s=10.0), "1", 3)
        assert outcome.findings
        assert word in outcome.findings[0].what


def test_inputs_with_outcomes_of_their_own_are_damaged_further():
    """Four bytes must match, in sequence: random damage alone would not find them."""
    word = b"FUZZ"

    def parse(data):
        right = 0
        while right < len(word) and data[right : right + 1] == word[right : right + 1]:
            right += 1
        assert right < len(word)
        return "r" * right

    outcome = run(_target(parse, seeds=(b"____",)), "1", 60_000)
    assert outcome.findings
    assert outcome.kinds >= len(word)


def test_packets_come_back_from_one_piece():
    packets = (b"", b"a", b"bc" * 300)
    assert split(joined(packets)) == packets
    assert split(b"\xff\xff") == (b"",)


def test_corpus_lines_come_back():
    for given in (b"text \xc3\xa9\n", b"\xff\x00", (b"", b"\xff"), b""):
        table = json.loads(corpus.line_of("a name", given))
        assert table["name"] == "a name"
        assert corpus.input_of(table) == given


def test_outcomes_come_back_from_a_worker():
    def parse(data):
        raise KeyError(len(data))

    outcome = run(_target(parse), "1", 5)
    again = outcome_of(json.loads(json.dumps(table_of(outcome))))
    assert again.findings == outcome.findings
    assert (again.inputs, again.kinds) == (outcome.inputs, outcome.kinds)


def test_slow_targets_get_more_time_and_fast_ones_more_inputs():
    found = shares(1000, {"fast": 10_000.0, "slow": 100.0})
    assert sum(found.values()) == pytest.approx(1000, abs=1)
    assert found["fast"] == pytest.approx(10 * found["slow"], rel=0.1)
    assert runs.pieces("egm.robot", 1, 250, 100) is not None
    assert [size for _, size in runs.pieces("egm.robot", 1, 250, 100)] == [100, 100, 50]
