"""Output lines of a process, as the daemon reads them."""

import pytest

from cardan.gateway.daemon.processes import LINE_BYTES, LINES_A_SECOND, LINES_AT_ONCE, Lines


class Bench:
    def __init__(self):
        self.now_s = 5.0
        self.said = []
        self.lines = Lines(self.said.append, lambda: self.now_s)


@pytest.fixture
def bench():
    return Bench()


def test_lines_are_put_together(bench):
    for data in (b"a", b"b\nc", b"\r\n\n \n", b"end"):
        bench.lines.take(data)
    assert bench.said == ["ab", "c"]
    bench.lines.end()
    assert bench.said == ["ab", "c", "end"]


def test_binary_garbage_and_a_line_without_end_are_cut_in_pieces(bench):
    bench.lines.take(b"\xff\0" * LINE_BYTES)
    bench.lines.end()
    assert len(bench.said) == 2
    assert bench.said[0].startswith("\\xff\0")


def test_one_that_babbles_is_cut_short_and_says_how_much(bench):
    for _ in range(10):
        bench.lines.take(b"x\n" * LINES_AT_ONCE)
    assert bench.said == ["x"] * LINES_AT_ONCE
    bench.now_s += 1.0
    bench.lines.take(b"y\n" * LINES_AT_ONCE)
    more = bench.said[LINES_AT_ONCE:]
    assert more[0] == f"<4>{9 * LINES_AT_ONCE} lines were left out: they came too fast"
    assert more[1:] == ["y"] * LINES_A_SECOND
    bench.lines.end()
    assert f"<4>{LINES_AT_ONCE - LINES_A_SECOND} lines were left out" in bench.said[-1]
