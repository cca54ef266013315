"""Mapping of the controller's three states to whether commands act."""

from __future__ import annotations

from cardan.protocols.egm.messages import MCIState, MotorState, RapidState

FIRST_ANSWER = "a session begins: its first answer is the measured position"
MOTORS_OFF = "the motors are off"
RAPID_STOPPED = "the RAPID program is stopped"
EGM_ERROR = "EGM reports an error"
EGM_STOPPED = "EGM is stopped: positions are only streamed"
EGM_UNDEFINED = "the controller does not report that EGM runs"

ADVICE = {
    FIRST_ANSWER: "commands act from the next answer on",
    MOTORS_OFF: "switch them on and start the RAPID program",
    RAPID_STOPPED: "start it; it must reach EGMRunPose, EGMRunJoint or EGMMoveL",
    EGM_ERROR: "read the controller's event log; RAPID must call EGMReset and set EGM up again",
    EGM_STOPPED: "the RAPID program must reach EGMRunPose, EGMRunJoint or EGMMoveL",
    EGM_UNDEFINED: "the RAPID program must reach EGMRunPose, EGMRunJoint or EGMMoveL",
}
"""Advice for each of these states."""


def hold_reason(motors: int | None, mci: int | None, rapid: int | None) -> str:
    """Return why commands would not act in these raw states; empty when they do.

    UNDEFINED counts as a running RAPID program, because controllers report it after a restart.
    """
    if motors == MotorState.OFF:
        return MOTORS_OFF
    if rapid == RapidState.STOPPED:
        return RAPID_STOPPED
    if mci == MCIState.RUNNING:
        return ""
    if mci == MCIState.ERROR:
        return EGM_ERROR
    return EGM_STOPPED if mci == MCIState.STOPPED else EGM_UNDEFINED
