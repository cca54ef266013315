"""A test without its judge fails in CI, and is skipped elsewhere and for other reasons. Tests get
the same signals wherever they are started."""

import os
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

# By path, because plug-ins' tests have a conftest, too.
CONFTEST = Path(__file__).parents[1] / "conftest.py"
conftest = SimpleNamespace(**runpy.run_path(str(CONFTEST)))

TESTS = """
import pytest

judged = pytest.mark.judged(device="x", transport="y", by="z")

@pytest.fixture
def library():
    pytest.skip("libx is not installed (Debian package libx0)")

def test_no_library(library): ...

def test_no_package():
    pytest.skip("there is no x: install the Debian package x")

@judged
def test_judged_without_multicast():
    pytest.skip("no multicast here")

def test_no_page():
    pytest.skip("the page is not built: run tools/console")

@pytest.mark.shown_on(transport="y", by="z")
def test_shown_without_multicast():
    pytest.skip("no multicast today")

@judged
@pytest.mark.skipif(True, reason="no judge today")
def test_judged_and_marked(): ...

@judged
@pytest.mark.skipif(True, reason="the worked bytes are little-endian")
def test_another_machine(): ...

@judged
@pytest.mark.skipif(True, reason="the C parts were not compiled")
def test_not_compiled(): ...

def test_no_capture():
    pytest.skip("the capture is not beside the repository")

@judged
@pytest.mark.xfail(reason="not installed")
def test_expected_to_fail():
    raise AssertionError

@judged
def test_passes(): ...
"""
MODULE = """
import pytest
pytest.importorskip("no_such_package", reason="no_such_package is not installed: pip install it")

def test_never_reached(): ...
"""
MISSING = {
    "test_no_library": "libx0",
    "test_no_package": "install the Debian package x",
    "test_no_page": "run tools/console",
    "test_judged_without_multicast": "no multicast",
    "test_shown_without_multicast": "no multicast",
    "test_judged_and_marked": "no judge today",
    "test_module": "no_such_package is not installed",
}
OTHERWISE = {
    "test_another_machine": "skipped",
    "test_not_compiled": "skipped",
    "test_no_capture": "skipped",
    "test_expected_to_fail": "skipped",
    "test_passes": "passed",
}


def outcomes(folder, *more, **environment):
    """Run with `environment`; return each test's outcome and reason."""
    shutil.copy(CONFTEST, folder)
    (folder / "pytest.ini").write_text("[pytest]\nmarkers = judged\n")
    (folder / "test_tiny.py").write_text(TESTS)
    (folder / "test_module.py").write_text(MODULE)
    inherited = {
        key: value
        for key, value in os.environ.items()
        if key not in ("CI", "CARDAN_KERNEL_VM", "PYTEST_ADDOPTS")
    }
    options = ("-q", "-p", "no:cacheprovider", "--continue-on-collection-errors", *more)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, "--junitxml=report.xml"],
        cwd=folder,
        env=inherited | environment,
        capture_output=True,
        text=True,
        timeout=50,
    )
    found = {}
    for case in ElementTree.parse(folder / "report.xml").iter("testcase"):
        child = next((c for c in case if c.tag in ("skipped", "failure", "error")), None)
        kind = "passed" if child is None else child.tag
        words = "" if child is None else f"{child.get('message')} {child.text}"
        found[case.get("name")] = (kind, words)
    return done, found


@pytest.mark.parametrize("environment", [{"CI": "true"}, {"CARDAN_KERNEL_VM": "1"}])
def test_what_is_missing_fails_where_nothing_may_be(tmp_path, environment):
    done, found = outcomes(tmp_path, **environment)
    assert done.returncode == 1, done.stdout
    for name, words in MISSING.items():
        kind, said = found[name]
        assert kind in ("failure", "error"), name
        assert words in said
        assert words in done.stdout
    assert {name: found[name][0] for name in OTHERWISE} == OTHERWISE


def test_elsewhere_it_is_skipped(tmp_path):
    done, found = outcomes(tmp_path)
    assert done.returncode == 0, done.stdout
    assert {name: found[name][0] for name in MISSING} == dict.fromkeys(MISSING, "skipped")
    assert {name: found[name][0] for name in OTHERWISE} == OTHERWISE


SIGNALED = """
import os, signal, subprocess, sys

import pytest

def test_one_of_its_own():
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
        signal.pause()

@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGQUIT, signal.SIGHUP, signal.SIGTERM])
def test_one_of_a_program(number):
    program = f"import os, signal; signal.alarm(20); os.kill(os.getpid(), {int(number)})"
    done = subprocess.run([sys.executable, "-c", program], stderr=subprocess.DEVNULL)
    assert done.returncode == -number
"""


def test_signals_act_whatever_the_shell_that_starts_the_tests_ignores(tmp_path):
    shutil.copy(CONFTEST, tmp_path)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    (tmp_path / "test_signals.py").write_text(SIGNALED)
    tests = (sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider")
    done = subprocess.run(
        ["sh", "-c", "trap '' INT QUIT HUP TERM; exec \"$@\"", "sh", *tests],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("asked", "text", "left_out"),
    [
        ("matrix", "pytestmark = pytest.mark.matrix", False),
        ("matrix", "def test_matrix(): ...", True),
        ("real", "@pytest.mark.real\ndef test_it(): ...", False),
        ("real", "pytestmark = pytest.mark.matrix", True),
        ("computing", "def test_it(): ...", False),
        ("computing", "@pytest.mark.matrix\ndef test_it(): ...", False),
        ("computing", "pytestmark = pytest.mark.matrix", True),
        ("computing", "pytestmark = [pytest.mark.matrix, needs_it]", True),
        ("computing", "pytestmark = [\n    needs_it,\n    pytest.mark.matrix,\n]", True),
        (None, "def test_it(): ...", False),
    ],
)
def test_only_a_file_without_a_test_of_the_part_is_left_unread(tmp_path, asked, text, left_out):
    file = tmp_path / "test_file.py"
    file.write_text(text)
    config = SimpleNamespace(getoption={"--part": asked}.__getitem__)
    assert bool(conftest.pytest_ignore_collect(file, config)) == left_out
    assert not conftest.pytest_ignore_collect(tmp_path, config)


BROKEN = """
import time, pytest

@pytest.fixture
def begins():
    raise RuntimeError("it did not begin")

@pytest.fixture
def ends():
    yield
    raise RuntimeError("it did not end")

@pytest.fixture
def slow():
    time.sleep(0.6)

def test_setup(begins): ...
def test_teardown(ends): ...
def test_call(): raise RuntimeError("it broke")
def test_slow(slow): ...
"""


def test_a_worker_tells_all_that_fails_or_takes_long(tmp_path):
    (tmp_path / "test_broken.py").write_text(BROKEN)
    done, found = outcomes(tmp_path, "-n1", "--durations=0")
    for name, words in (("setup", "begin"), ("teardown", "end")):
        assert (
            f"ERROR test_broken.py::test_{name} - RuntimeError: it did not {words}" in done.stdout
        )
    assert "FAILED test_broken.py::test_call - RuntimeError: it broke" in done.stdout
    assert re.search(r"\ds setup +test_broken.py::test_slow", done.stdout)
    assert {name: found[name][0] for name in OTHERWISE} == OTHERWISE
    assert {name: found[name][0] for name in MISSING} == dict.fromkeys(MISSING, "skipped")


PARTED = """
import pytest

pytestmark = pytest.mark.matrix

@pytest.mark.real
def test_named(): ...

@pytest.mark.real("near")
@pytest.mark.parametrize("way", ["far", "near"])
def test_ways(way): ...

def test_other(): ...
"""
UNMARKED = "import time\ndef test_computes(): ...\n"


def collected(folder, *options):
    """Return the tests that pytest would run from a folder's files, and its whole output."""
    shutil.copy(CONFTEST, folder)
    (folder / "pytest.ini").write_text("[pytest]\ntestpaths=.\nmarkers =\n    real\n    matrix\n")
    words = ("--collect-only", "-q", "-p", "no:cacheprovider", *options)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )
    return re.findall(r"::(\S+)", done.stdout), done.stdout + done.stderr


@pytest.mark.parametrize(
    ("marks", "time_s"),
    [
        ([], None),
        ([pytest.mark.timeout(5)], 5),
        ([pytest.mark.real], conftest.WAITS_S),
        ([pytest.mark.matrix], conftest.WAITS_S),
        ([pytest.mark.matrix, pytest.mark.timeout(900)], 900),
    ],
)
def test_what_waits_for_something_real_has_the_time_for_it(request, marks, time_s):
    item = pytest.Function.from_parent(request.node.parent, name="it", callobj=lambda: None)
    for mark in marks:
        item.add_marker(mark)
    conftest.give_time([item])
    assert [each.args[0] for each in item.iter_markers("timeout")] == [time_s] * bool(time_s)


def test_each_test_runs_in_one_part(tmp_path):
    (tmp_path / "test_parted.py").write_text(PARTED)
    (tmp_path / "test_unmarked.py").write_text(UNMARKED)
    assert collected(tmp_path, "--part=real")[0] == ["test_named", "test_ways[near]"]
    assert collected(tmp_path, "--part=matrix")[0] == ["test_ways[far]", "test_other"]
    assert collected(tmp_path, "--part=computing")[0] == ["test_computes"]
    assert len(collected(tmp_path)[0]) == 5


def test_of_the_real_tests_the_longest_begin_first(tmp_path):
    later, first = tmp_path / "test_early.py", tmp_path / conftest.LONGEST[-1]
    first.parent.mkdir(parents=True)
    marked = "import pytest\n@pytest.mark.real\ndef test_{}(): ..."
    later.write_text(marked.format("short"))
    first.write_text(marked.format("long"))
    assert collected(tmp_path, "--part=real")[0] == ["test_long", "test_short"]
    assert collected(tmp_path)[0] == ["test_short", "test_long"]


@pytest.mark.parametrize("file", conftest.LONGEST)
def test_a_file_that_begins_first_has_real_tests(file):
    assert "mark.real" in (CONFTEST.parent / file).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("@pytest.mark.real\n@pytest.mark.matrix\ndef test_it(): ...", "one mark says where"),
        (
            "@pytest.mark.real\n@pytest.mark.parametrize('n', range(151))\ndef test_it(n): ...",
            "151 tests are marked real, of 150",
        ),
        (
            "@pytest.mark.real('none')\n@pytest.mark.parametrize('n', [1])\ndef test_it(n): ...",
            "marks name parameters that are not there: [('test_file.py::test_it', 'none')]",
        ),
        ("from marks import MARKED as pytestmark\ndef test_it(): ...", "write the marks {'real'}"),
    ],
)
def test_a_mark_that_misleads_is_an_error(tmp_path, text, words):
    (tmp_path / "marks.py").write_text("import pytest\nMARKED = getattr(pytest.mark, 're' 'al')\n")
    (tmp_path / "test_file.py").write_text("import pytest\n" + text)
    assert words in collected(tmp_path)[1]


def test_what_was_left_out_is_said_once(tmp_path):
    done, _ = outcomes(tmp_path)
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("LEFT OUT")]
    assert line.startswith("LEFT OUT, 4 tests; tools/debian-packages judges installs")
    assert "libx is not installed (Debian package libx0) (1)" in line
