"""Lines of the dashboard, packages of the primary interface, and syntax trees of URScript."""

from __future__ import annotations

import pytest
from hypothesis import given, settings, strategies as st

from cardan.protocols.ur import dashboard, primary
from cardan.protocols.ur.script import DEEPEST, LARGEST, ParseFailure, Program, parse, tree
from cardan.protocols.ur.script.parser import LONGEST_CHAIN
from cardan.protocols.ur.states import RobotMode
from tests.examples import examples

# -- the dashboard ---------------------------------------------------------------------------------


def test_lines_in_pieces():
    reader = dashboard.DashboardReader()
    found = []
    for piece in (b"Conn", b"ected: x\r\nRobot", b"mode: IDLE\n", b"tr"):
        reader.feed(piece)
        while (line := reader.take()) is not None:
            found.append(line)
    assert found == ["Connected: x", "Robotmode: IDLE"]


def test_a_line_without_end():
    reader = dashboard.DashboardReader()
    reader.feed(b"x" * (dashboard.LONGEST_LINE + 1))
    assert reader.take() is None
    assert "not a dashboard server" in reader.failure
    whole = dashboard.DashboardReader()
    whole.feed(b"x" * (dashboard.LONGEST_LINE + 1) + b"\nmore\n")
    assert whole.take() is None
    assert whole.failure == reader.failure
    for each in (reader, whole):
        each.skip()
        each.feed(b"\nmore\n"[: 6 if each is reader else 0])
        assert each.take() == "more"
        assert each.failure == ""


def test_what_is_granted_and_what_is_refused():
    assert dashboard.refusal("power on", "Powering on") == ""
    late = "Cannot unlock protective stop until 5s after occurrence."
    assert dashboard.refusal("unlock protective stop", late) == late
    assert dashboard.request("power on") == b"power on\n"
    with pytest.raises(ValueError, match="more than one line"):
        dashboard.request("power on\nshutdown")


# -- the primary interface -------------------------------------------------------------------------

MODES = primary.ModeData(True, False, True, False, True, RobotMode.IDLE, 0.5)
PACKAGES = (
    primary.version_message(1.0, (5, 12, 0, 7)),
    primary.state_package(1.0, MODES),
    primary.text_message(1.5, "hello"),
    primary.key_message(2.0, "PROGRAM_XXX_STARTED", "cardan"),
    primary.exception_message(2.5, 12, "no such function"),
)


@given(st.lists(st.integers(1, 30)))
def test_packages_in_pieces(sizes):
    stream, at = b"".join(PACKAGES), 0
    reader, found = primary.PackageReader(), []
    for size in [*sizes, len(stream)]:
        reader.feed(stream[at : at + size])
        at += size
        while (each := reader.take()) is not None:
            found.append(each)
    assert primary.read_mode(found[1]) == MODES
    messages = [primary.read_message(each) for each in found]
    assert messages[1] is None
    assert [(m.kind, m.text, m.line, m.title) for m in messages if m is not None] == [
        (3, "URControl", 0, ""),
        (0, "hello", 0, ""),
        (7, "cardan", 0, "PROGRAM_XXX_STARTED"),
        (10, "no such function", 12, ""),
    ]


def test_worked_bytes_of_an_exception():
    head = "00000026" + "14" + "0000000000002710" + "fe" + "0a"
    assert PACKAGES[4][:15].hex() != head  # other time and length
    made = primary.exception_message(0.01, 3, "no such thing!!")
    assert made.hex() == head + "00000003" + "00000001" + b"no such thing!!".hex()


def test_what_is_no_package():
    reader = primary.PackageReader()
    reader.feed(b"HTTP/1.1 400")
    assert reader.take() is None
    assert "not a primary interface" in reader.failure


@settings(max_examples=examples(50))
@given(st.integers(0, 255), st.binary(max_size=60))
def test_no_package_raises(kind, content):
    primary.read_message(primary.PrimaryPackage(kind, content))
    primary.read_mode(primary.PrimaryPackage(kind, content))


# -- URScript --------------------------------------------------------------------------------------


def test_a_program():
    found = parse(
        """
        # what it does
        def move():
          global q = [0.5, -1.5e-3, .25, 1., 2, 3]
          local n = 0
          while n < 3 and not (q[0] == 2 or False):   # three times
            if n % 2 == 0:
              servoj(q, 0, 0, t=0.002, gain=300)
            elif n > 7:
              break
            else:
              sync()
            end
            q[n] = -q[n + 1] * (2 - n)
            n = n + 1
          end
          halt
        end
        """
    )
    assert isinstance(found, Program)
    assert found.name == "move"
    assert [type(each).__name__ for each in found.block] == ["Assign", "Assign", "While", "Leave"]
    first = found.block[0]
    assert isinstance(first, tree.Assign)
    assert first.line == 4


def test_the_limits_themselves_are_allowed():
    chains = "1" + "+1" * LONGEST_CHAIN, "a" + "[0]" * LONGEST_CHAIN
    for value in (*chains, "not " * 40 + "True"):
        assert isinstance(parse(f"def a():\n x = {value}\nend"), Program)
    assert isinstance(parse("def a():\n t = run f()\n run f()\nend"), Program)


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("x = 1\ny = 2", 2, "comes after the end"),
        ("def a():\n  x = 1\n", 3, "`end` is missing"),
        ("def a():\n  x = p[0,0,0]\nend", 2, "a pose has 6 numbers, not 3"),
        ("def a():\n  def b(c, c):\n  end\nend", 2, "two parameters c"),
        ("def a():\n  def b(c=1, d):\n  end\nend", 2, "d needs a default"),
        ("def a():\n  x = m[1, 2, 3]\nend", 2, "3 indices; 1 or 2 are possible"),
        ("def a():\n  for x in y:\n  end\nend", 2, "`=` is expected"),
        ("def a():\n x = 1" + "+1" * 101 + "\nend", 2, "operators in a row"),
        ("def a():\n  x = 1 2\nend", 2, "the line should end"),
        ("def a():\n  x = (1\nend", 2, "`)` is expected"),
        ("def a():\n  f(a=1, 2)\nend", 2, "without a name"),
        ("def a():\n  x = ?\nend", 2, "'?' is not understood"),
        ("def a():\n  x = " + "9" * 5000 + "\nend", 2, "a number is too large"),
        ("def a():\n  x = if\nend", 2, "a value is expected"),
        ("def a():\nend\nmore", 3, "comes after the end"),
        ("def a():\n x = " + "(" * 99 + "\nend", 2, f"more than {DEEPEST} levels"),
        ("def a():\n x = " + "not " * 99 + "True\nend", 2, f"more than {DEEPEST} levels"),
        ("def a():\n x = " + "-" * 99 + "1\nend", 2, f"more than {DEEPEST} levels"),
        ("def a():\n" + "while True:\n" * 99, 51, f"more than {DEEPEST} levels"),
        ("#" * (LARGEST + 1), 1, f"{LARGEST} are the most"),
    ],
)
def test_what_is_not_understood_is_named(text, line, reason):
    found = parse(text)
    assert isinstance(found, ParseFailure)
    assert (found.line, reason in found.reason) == (line, True), found


@settings(max_examples=examples(100))
@given(st.text(alphabet='def end()while:if x=[1,]+-*not\n"#.p', max_size=80))
def test_no_text_raises(text):
    parse("def a():\n" + text)


def test_lines_as_programs_in_use_break_them():
    found = parse(
        """def a():
    global first = # what it is for
0    global second = 1
    def f(p, factor):
      p[0] = p[0] * factor
      return (p[0] + p[1] < 1e-3)
    end
    x = p[0, 0, 0,
      0, 0, 0]
    if first == 1 or
      second == 2:
      pass
    end
    t = run f([1, 2], factor = 2)
end
"""
    )
    assert isinstance(found, Program), found
    assert [(each.name, each.line) for each in found.block[:2]] == [("first", 2), ("second", 3)]
    assert [type(each).__name__ for each in found.block[2:]] == ["Define", "Assign", "If", "Assign"]
