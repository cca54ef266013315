"""Messages about the state of a MotoROS session."""

from __future__ import annotations

from cardan.drivers.motoros.diagnosis import status_in_words
from cardan.drivers.motoros.feedback import StateFeed
from cardan.drivers.motoros.motion_control import MotionControl
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.tcp_robot import ConnectionState


def no_motion_connection(options: MotorosOptions, link: ConnectionState, end_reason: str) -> str:
    """Explain why there is no motion connection, and why earlier motion ended."""
    end = f"{end_reason}; " if end_reason else ""
    port = options.motion_port
    return f"{end}no connection to port {port}" + (f": {link.reason}" if link.reason else "")


def silence(options: MotorosOptions, feed: StateFeed, link: ConnectionState, now_s: float) -> str:
    """Explain why there is no fresh state; `link` is the state port's."""
    if link.reason:
        return f"no connection to port {options.state_port}: {link.reason}"
    if not link.up:
        return f"connecting to {options.host}:{options.state_port}"
    heard_s = max(min(feed.status_s, feed.feedback_s), link.since_s)
    # If the status comes and the feedback does not, the controller lacks the group.
    missing = "state"
    if feed.status_s > feed.feedback_s:
        missing = f"feedback of group {options.group}"
    return f"no {missing} for {now_s - heard_s:.1f} s"


def findings(control: MotionControl, quiet: str, hold_reason: str) -> tuple[str, ...]:
    """Return problems and other warnings, worst first.

    `quiet` is the reason why there is no fresh state; empty if there is one.
    """
    found: list[str] = []
    feed = control.feed
    if quiet:
        found.append(quiet)
    else:
        status = feed.status
        if hold_reason:
            found.append(hold_reason)
        words = "" if status is None or control.enabled else status_in_words(status)
        if words and words not in found:
            found.append(words)
    if control.answer:
        found.append(control.answer)
    underruns = control.counters.underruns
    if underruns:
        found.append(
            f"the controller's queue ran empty in motion {underruns} times: this computer is "
            "late; raise queue_low"
        )
    found += [f"{count} messages ignored: {why}" for why, count in feed.ignored.most_common(5)]
    found += [f"motion ended {n} times: {why}" for why, n in control.ends.most_common(3) if n > 1]
    return tuple(found)
