"""Diagnosis of common EGM problems."""

from __future__ import annotations

import math
from typing import Protocol

from cardan.common.histogram import LatencyHistogram
from cardan.drivers.abb_egm.counters import EgmCounters
from cardan.drivers.abb_egm.options import AbbEgmOptions
from cardan.drivers.abb_egm.slow_motion import SpeedCapDetector
from cardan.drivers.abb_egm.states import ADVICE
from cardan.protocols.egm.messages import EgmRobot
from cardan.types import RobotState

_REPORTED_WAITING_S = 0.5
"""Shortest wait for the first datagram that is reported."""
_REPORTED_LOSS = 0.001
"""Smallest share of lost datagrams that is reported."""

OLDEST = "before 6.07.01"


def robotware(message: EgmRobot) -> str:
    """Return the oldest RobotWare version whose messages have all the fields of `message`."""
    feedback = message.feed_back
    force = message.measured_force
    if message.torque_ref is not None or (feedback and feedback.time_stamp_ns is not None):
        return "7.16 or a little earlier"
    if message.rapid_from_robot is not None:
        return "7.7 or later"
    if message.move_index is not None or message.collision_info is not None:
        return "7.6 or later"
    if force is not None and force.fc_active is not None:
        return "7"
    if message.utilization_rate is not None:
        return "6.10 or later"
    if feedback and feedback.time_us is not None:
        return "6.07.01 or later"
    return OLDEST


class Diagnosed(Protocol):
    """Attributes of a session that `diagnose` reads."""

    counters: EgmCounters
    slow_motion: SpeedCapDetector
    reply_latency: LatencyHistogram
    port: int
    last_cause: str
    last_malformed: str
    last_foreign: str
    last_foreign_counts_on: bool
    last_send_error: str

    @property
    def options(self) -> AbbEgmOptions: ...

    @property
    def peer(self) -> tuple[str, int] | None: ...

    @property
    def state(self) -> RobotState | None: ...

    @property
    def message(self) -> EgmRobot | None: ...

    @property
    def sessions(self) -> int: ...

    @property
    def hold_reason(self) -> str: ...

    @property
    def silent(self) -> bool: ...

    def silence_s(self, now_s: float) -> float: ...


def diagnose(session: Diagnosed, now_s: float) -> tuple[str, ...]:
    """Return all findings about `session`, worst first."""
    # Before a controller is heard, the user can still change this; afterwards it is no news.
    caution = session.options.caution
    words = [caution] if caution and session.state is None else []
    words += _silence(session, now_s)
    if session.state is not None and not session.silent:
        words += _standing(session)
    words += _refused(session)
    words += _quality(session)
    words += _setup(session)
    if caution and session.state is not None:
        words.append(caution)
    return tuple(words)


def _silence(session: Diagnosed, now_s: float) -> list[str]:
    options = session.options
    silence_s = session.silence_s(now_s)
    port = session.port
    if session.state is None:
        if silence_s < _REPORTED_WAITING_S:
            return []
        words = (
            f"no EGM datagram on UDP port {port} of {options.listen_host} for {silence_s:.1f} s: "
            "check that RAPID runs EGM (EGMSetupUC, EGMActPose or EGMActJoint, EGMRun...), that "
            "Remote Address and Remote Port Number of the UdpUc device are this computer's "
            f"address and {port}, and the firewalls of the controller and of this computer; "
            "a virtual OmniCore controller sends to 127.0.0.1 only"
        )
        if options.listen_host == "localhost" or options.listen_host.startswith("127."):
            words += (
                f"; {options.listen_host} receives from programs of this computer only: for a real "
                "controller set listen_host to this computer's address on its network"
            )
        return [words]
    if not session.silent:
        return []
    where = f"{session.peer[0]}:{session.peer[1]}" if session.peer else "the controller"
    words = f"no EGM datagram from {where} for {silence_s:.1f} s: "
    message = session.message
    if message is not None and message.mci_convergence_met and not session.hold_reason:
        words += (
            "the run ended by itself while the robot stood inside its convergence window; raise "
            "\\CondTime of EGMRunPose or EGMRunJoint, or narrow the window"
        )
    else:
        words += "the RAPID program left EGM, the controller stopped, or the network is cut"
    return [words]


def _standing(session: Diagnosed) -> list[str]:
    words = []
    reason = session.hold_reason
    if reason:
        words.append(f"datagrams arrive but commands do not act: {reason}; {ADVICE[reason]}")
    watch = session.slow_motion
    if watch.capped:
        if session.options.mode == "joint":
            speeds = f"{math.degrees(watch.done):.2f} of {math.degrees(watch.commanded):.2f} deg/s"
        else:
            speeds = f"{1e3 * watch.done:.1f} of {1e3 * watch.commanded:.1f} mm/s"
        words.append(
            f"the robot moves much slower than commanded ({speeds}): \\MaxSpeedDeviation of "
            "EGMActPose or EGMActJoint caps joint speed and is 1 deg/s unless set; "
            "PosCorrGain and the position gain slow it as well"
        )
    return words


def _refused(session: Diagnosed) -> list[str]:
    counters = session.counters
    words = []
    if counters.foreign:
        if session.peer is not None:
            answered = f"{session.peer[0]}:{session.peer[1]}"
        else:
            answered = f"controller_host {session.options.controller_host}"
        found = f"{counters.foreign} datagrams from other addresses were refused, the last from "
        if session.last_foreign == answered:
            found += f"{answered} before the controller had that port"
        elif session.last_foreign_counts_on:
            found += (
                f"{session.last_foreign}; only {answered} is answered. "
                "Its sequence began before the controller fell silent: it is another program on "
                "the controller's address, or the controller itself, counting on from another "
                "port; if it is the controller, open the driver again"
            )
        else:
            found += (
                f"{session.last_foreign}; only {answered} is answered. "
                "If that is the wrong one, set controller_host to the right one's address and "
                "open the driver again"
            )
        words.append(found)
    malformed = sum(counters.malformed.values())
    if malformed:
        kinds = ", ".join(f"{n} {kind}" for kind, n in counters.malformed.most_common())
        words.append(
            f"{malformed} datagrams were malformed ({kinds}), the last because "
            f"{session.last_malformed}"
        )
    if counters.send_errors:
        words.append(f"{counters.send_errors} answers could not be sent: {session.last_send_error}")
    return words


def _quality(session: Diagnosed) -> list[str]:
    counters = session.counters
    words = []
    latency = session.reply_latency
    p99_s = latency.percentile(99.0)
    if counters.late_commands or p99_s > session.options.period_s:
        words.append(
            f"the application is slow: half of the answers left within "
            f"{1e3 * latency.percentile(50.0):.1f} ms of their datagram, 99 % within "
            f"{1e3 * p99_s:.1f} ms, the slowest after {1e3 * latency.max:.0f} ms; "
            f"{counters.late_commands} times it was too late and the robot was braked. "
            "Shorten the loop, or let stream() answer for it"
        )
    expected = counters.accepted + counters.lost
    if counters.lost > _REPORTED_LOSS * expected:
        words.append(
            f"{counters.lost} of {expected} datagrams were lost "
            f"({100.0 * counters.lost / expected:.1f} %)"
        )
    if session.sessions > 1:
        words.append(
            f"the controller has begun {session.sessions} sessions; the last because of "
            f"{session.last_cause}"
        )
    if counters.ended_by_convergence and not session.silent:
        words.append(
            f"{counters.ended_by_convergence} runs ended by themselves while the robot stood "
            "inside its convergence window; raise \\CondTime or narrow the window"
        )
    return words


def _setup(session: Diagnosed) -> list[str]:
    options = session.options
    message = session.message
    words = []
    cap = options.max_speed_deviation_deg_s
    if cap is not None and options.mode == "joint":
        fastest = math.degrees(max(options.joint_speeds_rad_s))
        if fastest > cap:
            words.append(
                f"joints may be commanded at up to {fastest:g} deg/s, but \\MaxSpeedDeviation is "
                f"{cap:g} deg/s: faster commands will lag behind"
            )
    if message is None:
        return words
    profile = robotware(message)
    words.append(f"the controller's messages look like RobotWare {profile}")
    if profile == OLDEST:
        words.append(
            "such a controller mixes degrees and radians in its joint values: do not trust them"
        )
    return words
