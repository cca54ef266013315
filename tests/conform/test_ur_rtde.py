"""Suite of Universal Robots controllers: a CB3, local control, third-party programs, and real
sockets."""

from __future__ import annotations

import io

import pytest

from cardan.conform import Kind, Level, VerdictOutcome, WireEvent, check_timeline, registry, run
from cardan.conform.runner import Exchange
from cardan.conform.transports import TcpPorts
from cardan.conform.ur_rtde import scenario
from cardan.conform.ur_rtde.simulated import UrSimulation
from cardan.drivers.ur_rtde import feed
from cardan.drivers.ur_rtde.options import UrRtdeOptions
from cardan.errors import ConfigurationError
from cardan.protocols.ur import rtde
from cardan.sim_peers.ur_controller import UrControllerOptions, UrControllerPeer
from cardan_dissect import dissect_file

SUITE = registry.load("ur-rtde")
OTHER = "def other():\n  while True:\n    sync()\n  end\nend\n"


def test_it_asks_for_what_our_driver_asks_for():
    """The suite does not import the driver, and checks the features that the driver needs."""
    options = UrRtdeOptions()
    assert scenario.STATES == feed.STATES
    assert options.servoing == scenario.SERVOING
    assert options.state_timeout_s == scenario.STATE_TIMEOUT_S


def ran(level, simulation=UrSimulation, seconds=1.0, **options):
    exchange = Exchange(SUITE.scenario(level, seconds))
    made = simulation(exchange, {}, options=UrControllerOptions(**options))
    made.run()
    report = check_timeline(SUITE, exchange.timeline, level)
    return report, exchange.timeline, made


def outcomes(report):
    return {each.id: each.outcome for each in report.results}


@pytest.mark.matrix
def test_a_cb3_meets_what_concerns_it():
    report, _, _ = ran(Level.BY_HAND, robot="ur5")
    assert report.failed == ()
    found = outcomes(report)
    without = {name for name, each in found.items() if each is VerdictOutcome.NOT_APPLICABLE}
    assert without == {"UR-107", "UR-302", "UR-303"}
    assert VerdictOutcome.NOT_SEEN not in found.values()


def test_a_robot_that_runs_already_is_not_switched_on():
    report, timeline, _ = ran(Level.HOLD, running=True)
    assert report.failed == ()
    assert outcomes(report)["UR-108"] is VerdictOutcome.PASSED
    asked = [each.data for each in timeline if each.sent and each.channel == "dashboard"]
    assert b"power on\n" not in asked
    assert b"brake release\n" not in asked


@pytest.mark.matrix
@pytest.mark.parametrize(
    ("number", "fault", "value"),
    [
        (27, "no-version-1", 1.0),
        (28, "fewer-outputs", 1.0),
        (29, "interfaces-silent", 1.0),
        (30, "interfaces-garbage", 0.5),
        (31, "interfaces-cut", 0.05),
        (32, "interfaces-garbage", 0.05),
        (33, "bare-answers", 1.0),
        (102, "shared-inputs", 1.0),
        (104, "stale-inputs", 1.0),
        (120, "lines-wait", 1.0),
        (121, "lines-wait", 1.0),
        (122, "no-exceptions", 1.0),
        (123, "no-sockets", 1.0),
        (124, "no-script", 1.0),
    ],
)
def test_what_other_programs_need_fails_with_its_fault(number, fault, value):
    level = Level.HOLD if number >= 100 else Level.LISTEN
    report, _ = run.simulated(SUITE, level, {fault: value}, seconds=0.6)
    assert f"UR-{number:03}" in report.failed


def uploads(timeline):
    return [each for each in timeline if each.sent and each.channel == "primary" and each.data]


def test_in_local_control_no_program_is_sent():
    report, timeline, _ = ran(Level.HOLD, running=True, remote=False)
    assert report.failed == ("UR-107",)
    assert uploads(timeline) == []


class _Busy(UrSimulation):
    """Simulation on which another client's program runs from the start."""

    def run(self):
        self._servers.advance(0.0)
        self._controller.upload(OTHER)
        super().run()


def test_a_program_of_somebody_else_is_left_alone():
    report, timeline, made = ran(Level.MOVE, _Busy, running=True)
    assert uploads(timeline) == []
    assert made._controller.program_name == "other"
    assert outcomes(report)["UR-109"] is VerdictOutcome.NOT_SEEN


@pytest.mark.parametrize(
    ("data", "channel", "asks"),
    [
        (rtde.ask_outputs(500.0, ("timestamp",)), "rtde", True),
        (rtde.packet(rtde.PacketType.PAUSE), "rtde-2", True),
        (rtde.ask_inputs(("input_int_register_24",)), "rtde", False),
        (rtde.packet(rtde.PacketType.DATA, b"\1"), "rtde", False),
        (b"robotmode\n", "dashboard", True),
        (b"programState\n", "dashboard", True),
        (b"textmsg(1)\n", "realtime", False),
        (b"power on\n", "dashboard", False),
        (b"def x():\nend\n", "primary", False),
    ],
)
def test_what_only_asks_is_distinguished_from_what_does(data, channel, asks):
    assert SUITE.only_asks(WireEvent(0.0, Kind.DATA, True, channel, data)) is asks


@pytest.mark.matrix
def test_a_controller_is_judged_over_tcp():
    options = UrControllerOptions(rtde_port=0, primary_port=0, dashboard_port=0)
    reported = []
    with UrControllerPeer(options) as peer:
        ports = {kind: peer.port(kind) for kind in peer.kinds}
        suite = registry.load("ur-rtde")
        rtde = dict.fromkeys(("rtde-1", "rtde-2"), ports["rtde"])
        suite.wires = lambda target: TcpPorts(target, ports | rtde)
        report, _ = run.at(suite, "127.0.0.1", Level.LISTEN, reported.append, seconds=1.5)
    found = outcomes(report)
    # Requirements on timing are left out: this computer may stand still at any moment.
    for number in (1, 2, 3, 4, 6, 7, 11, 16, 17, 18, 21, 23, 24, 25, 26, 28, 30, 32, 33):
        assert found[f"UR-{number:03}"] is VerdictOutcome.PASSED, report.as_text()
    assert not report.simulated
    assert reported == []


def test_the_other_ports_lie_below_that_of_rtde():
    wires = SUITE.wires("127.0.0.1")
    assert wires._ports == {
        "rtde": 30004,
        "rtde-1": 30004,
        "rtde-2": 30004,
        "primary": 30001,
        "secondary": 30002,
        "realtime": 30003,
        "dashboard": 29999,
        "reverse": 50010,
    }
    assert [*wires._ours] == ["reverse"]
    ports = SUITE.wires("127.0.0.1:40004")._ports
    assert (ports["dashboard"], ports["reverse"]) == (39999, 50010)
    with pytest.raises(ConfigurationError, match="no port lies 5 below 5"):
        SUITE.wires("host:5")


def test_the_capture_of_a_run_is_dissected_whole(tmp_path):
    report, timeline = run.simulated(SUITE, Level.LISTEN, seconds=1.0)
    run.save(tmp_path, SUITE, report, timeline)
    out = io.StringIO()
    counts = dissect_file(tmp_path / "capture.pcap", out, summary=True)
    text = out.getvalue()
    assert counts.malformed["RTDE"] == 0
    assert counts.messages["RTDE"] > 200
    assert "remarks: REFUSED cardan_has_no_such_variable NOT_FOUND x1" in text
    assert "RTDE DATA recipe 1 x" in text
    assert "lost 0 duplicate 0 out of order 0" in text
