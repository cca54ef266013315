"""Compiled parts with malformed input, under the address and undefined-behavior sanitizers."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SANITIZERS = ("-g", "-Werror", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
SECONDS = 5
"""Processor time: for the servo about seven thousand arms of 60 ticks each."""


@pytest.mark.matrix
@pytest.mark.parametrize("part", ["servo", "egm", "ur"])
def test_no_nonsense_leaves_the_memory_or_the_bounds_of(part, tmp_path):
    compiler = os.environ.get("CC", "cc")
    if shutil.which(compiler) is None:
        pytest.skip(f"no C compiler {compiler!r}")
    probe = tmp_path / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    if subprocess.run(
        [compiler, *SANITIZERS, "-o", str(tmp_path / "probe"), str(probe)],
        capture_output=True,
        check=False,
    ).returncode:
        pytest.skip(f"{compiler!r} comes without sanitizers")
    program = tmp_path / "fuzz"
    built = subprocess.run(
        [ROOT / "tools/native", "--fuzz", part, str(program), *SANITIZERS],
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    done = subprocess.run(
        [program, str(SECONDS)], capture_output=True, text=True, check=False, timeout=50
    )
    assert done.returncode == 0, done.stderr
    assert "nothing wrong" in done.stdout
