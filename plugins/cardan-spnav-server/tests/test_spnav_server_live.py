"""The suite of spacenavd's socket on Debian's spacenavd, and on Cardan's own server."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from cardan.conform import Level, VerdictOutcome, registry, run
from cardan.errors import AddressError
from cardan_spnav_server.conform.scenario import ALONE, MASKED, SAME, SCALED
from tests.scripted_operator import ScriptedOperator
from tests.spacenavd import spacenavd

UNMET = {"SPNAV-112"}
"""Requirement that spacenavd 1.1 does not meet: it does not announce a changed setting."""


@pytest.mark.matrix
def test_spacenavd_meets_what_our_own_server_does():
    """Exceptions are listed in the plug-in's README."""
    hand = ScriptedOperator((*SAME, *SCALED, *MASKED, *ALONE))
    suite = registry.load("spnav")
    with tempfile.TemporaryDirectory(prefix="cardan-") as folder:  # Socket paths are short.
        daemon = spacenavd(Path(folder), "0.1 neutral", motion=hand, jitter_lsb=1)
        with daemon as (path, _):
            report, _ = run.at(suite, str(path), Level.HOLD, hand.instructions.put, seconds=1.0)
    outcomes = {each.id: each.outcome for each in report.results}
    # Timing requirements are left out: this computer may stall at any moment.
    timed = {"SPNAV-007", "SPNAV-011", "SPNAV-101", "SPNAV-102", "SPNAV-103"}
    assert {*report.failed} - timed == UNMET, report.as_text()
    unseen = {name for name, each in outcomes.items() if each is VerdictOutcome.NOT_SEEN}
    assert unseen <= timed | {"SPNAV-301", "SPNAV-302", "SPNAV-303"}, report.as_text()
    assert outcomes["SPNAV-111"] is VerdictOutcome.NOT_APPLICABLE


def test_a_socket_that_is_not_there_is_an_error(tmp_path):
    with pytest.raises(AddressError, match=r"cannot connect to .*spnav\.sock"):
        run.at(registry.load("spnav"), str(tmp_path / "spnav.sock"), Level.LISTEN, print)
