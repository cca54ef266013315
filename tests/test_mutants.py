"""tools/mutants: generated changes, and detection of those that tests notice."""

import ast
import collections
import json
import subprocess
import sys

import pytest

from tests.mutation import mutants
from tests.mutation.__main__ import matching, with_tests
from tests.mutation.areas import AREAS, NO_SURVIVORS, equivalents
from tests.mutation.mutants import ROOT, instrumented, mutants_of, mutated

pytestmark = pytest.mark.matrix

SOURCE = '''\
"""Words."""
LIMIT: float = 2.0


class Thing:
    def f(self, a, b):
        """More words, 1."""
        if a < b and not self.off:
            raise ValueError(f"{a + 1}")
        self.last = min(a, b)
        self.say(a, b)
        self.say(a, a)
        match a:
            case 3 | 4 if a < b:
                a = b
        return -a
'''


@pytest.fixture
def source(tmp_path, monkeypatch):
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    (tmp_path / "thing.py").write_text(SOURCE)
    return "thing.py"


def test_each_kind_of_change(source):
    assert [(each.function, each.change) for each in mutants_of(source)] == [
        ("", "LIMIT: float = 2.0 -> LIMIT: float = 4.0"),
        ("Thing.f", "if a < b and (not self.off) -> if False"),
        ("Thing.f", "if a < b and (not self.off) -> if a < b or not self.off"),
        ("Thing.f", "if a < b and (not self.off) -> if a <= b and (not self.off)"),
        ("Thing.f", "if a < b and (not self.off) -> if a >= b and (not self.off)"),
        ("Thing.f", "if a < b and (not self.off) -> if a < b and (not not self.off)"),
        ("Thing.f", "self.last = min(a, b) -> _left_out = min(a, b)"),
        ("Thing.f", "self.last = min(a, b) -> self.last = max(a, b)"),
        ("Thing.f", "self.say(a, b) -> None"),
        ("Thing.f", "self.say(a, b) -> self.say(b, a)"),
        ("Thing.f", "self.say(a, a) -> None"),
        ("Thing.f", "case 3 | 4 if a < b: -> case 3 | 4 if False:"),
        ("Thing.f", "case 3 | 4 if a < b: -> case 3 | 4 if True:"),
        ("Thing.f", "3 | 4 -> 4 | 4"),
        ("Thing.f", "3 | 4 -> 3 | 3"),
        ("Thing.f", "3 -> 4"),
        ("Thing.f", "4 -> 5"),
        ("Thing.f", "a < b -> a <= b"),
        ("Thing.f", "a < b -> a >= b"),
        ("Thing.f", "return -a -> return +a"),
    ]


def test_a_mutant_is_the_file_with_this_one_change(source):
    whole = ast.unparse(ast.parse(SOURCE))
    for each in mutants_of(source):
        before, after = each.change.split(" -> ")
        place = whole.rindex(before)
        changed = whole[:place] + after + whole[place + len(before) :]
        assert ast.unparse(mutated(each)) == changed


def test_statements_are_reported_before_they_run(source):
    hits = []
    names = {"_mutant_hit": lambda path, index: hits.append(index)}
    exec(compile(instrumented(source), "thing.py", "exec"), names)
    assert hits == []
    thing = names["Thing"]()
    thing.off, thing.say = False, lambda a, b: None
    with pytest.raises(ValueError, match="2"):
        thing.f(1, 2)
    of_the_guard, *_ = hits
    hits.clear()
    assert thing.f(2, 1) == -2
    assert thing.f.__doc__ == "More words, 1."
    there = {each.change: each.statement for each in mutants_of(source)}
    assert of_the_guard == there["if a < b and (not self.off) -> if False"]
    assert hits == [
        of_the_guard,
        there["self.last = min(a, b) -> self.last = max(a, b)"],
        there["self.say(a, b) -> None"],
        there["self.say(a, a) -> None"],
        there["3 -> 4"],
        there["return -a -> return +a"],
    ]


def test_there_are_enough_and_each_has_its_tests():
    paths = matching([])
    for test in with_tests(paths):
        assert (ROOT / test).exists(), test
    assert set(NO_SURVIVORS) < set(AREAS)


def test_each_equivalent_mutant_is_there_and_has_a_reason():
    there = collections.Counter(each.name for path in matching([]) for each in mutants_of(path))
    for name, reason in equivalents().items():
        assert there[name] == 1, f"no mutant, or several, of that name: {name}"
        assert len(reason.split()) > 3


def test_a_mutant_is_noticed_where_it_is_asserted_and_not_elsewhere(tmp_path):
    path, test = "cardan/spatial.py::towards", "tests/drivers/test_limiters.py"
    outcomes = {}
    for tests in (test, f"{test}::test_the_length_of_an_orientation_comes_back_to_one"):
        report = tmp_path / "report.json"
        words = ["--only", path, "--sample", "12", "--tests", tests, "--report", str(report)]
        ended = subprocess.run(
            [sys.executable, "-m", "tests.mutation", *words], cwd=ROOT, capture_output=True
        )
        rows = json.loads(report.read_text())
        assert len(rows) == 12
        outcomes[tests] = {row["outcome"] for row in rows}
        assert ended.returncode == (1 if "survived" in outcomes[tests] else 0)
    assert outcomes[test] == {"killed"}
    assert "survived" in outcomes[f"{test}::test_the_length_of_an_orientation_comes_back_to_one"]
