"""All topics and services of a session, used through the Foxglove server."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("foxglove", reason="foxglove-sdk: pip install ./plugins/cardan-foxglove")

from cardan.gateway.bus.arm_parameters import PARAMETERS
from foxglove_pair import foxglove_client
from tests.serving import served
from tests.sweep import conftest, test_sweep as shared
from tests.sweep.plan import NODE
from tests.sweep.test_sweep import check, reported
from tests.waiting import until

pytestmark = pytest.mark.matrix

session, judgment = conftest.session, shared.judgment  # Fixtures.

FOXGLOVE = (sys.executable, str(Path(__file__).with_name("foxglove_judge.py")))


@pytest.fixture(scope="module")
def foxglove(session):
    """The Foxglove server for the session, in a separate process."""
    with served(
        "net", "server", "foxglove", "--router", session.endpoint, "--port", "0"
    ) as endpoint:
        yield SimpleNamespace(port=int(endpoint.rpartition(":")[2]))


# Foxglove's protocol has no actions; its services use CDR only.
@pytest.mark.shown_on(
    transport="Foxglove",
    by="own client",
    kinds=("published", "taken", "service"),
    but=("~/raw/device", "imu/data_raw"),
)
def test_everything_by_foxglove(session, judgment, foxglove):
    check(judgment, reported(session, [*FOXGLOVE, str(foxglove.port), "cdr"], judgment))


@pytest.mark.shown_on(transport="Foxglove", by="own client", kinds=("taken",))
def test_commands_in_json_by_foxglove(session, judgment, foxglove):
    check(judgment, reported(session, [*FOXGLOVE, str(foxglove.port), "json"], judgment))


def test_every_parameter_is_read_and_set_by_foxglove(session, foxglove):
    with foxglove_client(foxglove) as client:
        client.service(f"{NODE}/set_parameters_atomically")
        found = [each for each in client.get() if each["name"].startswith(f"{NODE}.")]
        names = {f"{NODE}.{each.name}" for each in PARAMETERS}
        # This one is read-only.
        assert {each["name"] for each in found} == names | {f"{NODE}.use_sim_time"}
        found = [each for each in found if each["name"] in names]

        def all_are_set():
            client.heard.clear()
            for each in found:
                assert client.set(**each) == [each]
            return not [said for said in client.heard if said["op"] == "status"]

        # The previous client keeps its authority until the end of the lease.
        until(all_are_set, "every parameter is set")
