"""Faults of the simulated Universal Robots controller."""

from __future__ import annotations

from cardan.sim_peers.base import FaultSwitch
from cardan.sim_peers.tcp_servers import RESET, SILENT

FAULTS: tuple[FaultSwitch, ...] = (
    FaultSwitch.at("protective-stop", "protective stop"),
    FaultSwitch.at("unlock", "the protective stop is unlocked at the pendant", 12.0)._replace(
        after="protective-stop"
    ),
    FaultSwitch.at("estop", "emergency stop, which cuts the power"),
    FaultSwitch.at("safeguard-stop", "safeguard stop"),
    FaultSwitch.at("safeguard-reset", "the safeguard stop is reset", 12.0)._replace(
        after="safeguard-stop"
    ),
    FaultSwitch.at("power-off", "power goes off"),
    FaultSwitch.at("pause", "the program is paused at the pendant"),
    FaultSwitch.at("resume", "the program is resumed at the pendant", 8.0)._replace(after="pause"),
    FaultSwitch.at("program-stop", "the program is stopped at the pendant"),
    FaultSwitch.at("other-program", "another client's program replaces the running one"),
    FaultSwitch.at("local", "remote control is switched off (e-Series)"),
    FaultSwitch.share("slider", "position of the speed slider, from the start", 0.5),
    FaultSwitch.at("slider-zero", "the speed slider goes to 0"),
    FaultSwitch.flag("in-use", "a fieldbus has the input registers"),
    FaultSwitch.flag("shared-inputs", "inputs that one client writes are given to another, too"),
    FaultSwitch.flag("stale-inputs", "inputs of a client that has gone stay in use"),
    FaultSwitch.flag("no-version-1", "RTDE clients that speak version 1 are refused"),
    FaultSwitch.flag("fewer-outputs", "output variables that a later version added are not found"),
    FaultSwitch.flag(
        "no-script", "programs are accepted and never started: the controller is busy"
    ),
    FaultSwitch.flag("lines-wait", "a line without a program waits for the next program"),
    FaultSwitch.flag("no-exceptions", "errors of a program are not reported"),
    FaultSwitch.flag("no-sockets", "the sockets of programs are not opened: a firewall"),
    FaultSwitch.flag(
        "bare-answers", "the dashboard answers with the values alone, without their labels"
    ),
    FaultSwitch.share("skip", "share of data packages left out: the controller is busy"),
    FaultSwitch("late", "every data package is sent this much later, ms", 20.0, 0.0, 60_000.0),
    FaultSwitch.flag("split", "every packet is written in two pieces"),
    FaultSwitch.share(
        "garbage", "share of data packages with a packet of an unknown type before it"
    ),
    FaultSwitch.flag("interfaces-silent", "the client interfaces are open and send nothing"),
    FaultSwitch.share("interfaces-cut", "share of the client interfaces' packets that lack an end"),
    FaultSwitch.share(
        "interfaces-garbage", "share of the client interfaces' packets with a random content"
    ),
    FaultSwitch.flag("interfaces-close", "the client interfaces close a connection at once"),
    SILENT,
    FaultSwitch.at("cut", "the RTDE connections are closed"),
    RESET,
)
