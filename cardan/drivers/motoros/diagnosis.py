"""Messages about the replies and status of a MotoROS controller, with advice for the pendant."""

from __future__ import annotations

from collections.abc import Mapping

from cardan.protocols.simple_message.codes import (
    ControllerMode,
    InvalidSubcode,
    IoResult,
    MessageType,
    MotionCommand,
    MotionResult,
    NotReadySubcode,
)
from cardan.protocols.simple_message.messages import RobotStatus

_TASKS: Mapping[int, str] = {
    MotionCommand.CHECK_MOTION_READY: "the query of readiness",
    MotionCommand.CHECK_QUEUE_CNT: "the query of the queue's length",
    MotionCommand.STOP_MOTION: "stopping the motion",
    MotionCommand.START_SERVOS: "switching the servos on",
    MotionCommand.STOP_SERVOS: "switching the servos off",
    MotionCommand.RESET_ALARM: "resetting the alarm",
    MotionCommand.START_TRAJ_MODE: "starting trajectory mode",
    MotionCommand.STOP_TRAJ_MODE: "ending trajectory mode",
    MotionCommand.DISCONNECT: "closing the motion connection",
    MotionCommand.START_RT: "starting real-time mode",
    MotionCommand.STOP_RT: "ending real-time mode",
    MotionCommand.CHECK_TIMEOUT_CNT: "the query of missed real-time cycles",
    MotionCommand.START_VEL_MODE: "starting velocity mode",
    MotionCommand.STOP_VEL_MODE: "ending velocity mode",
    MessageType.JOINT_TRAJ_PT_FULL: "a point of the trajectory",
    MessageType.MOTO_JOINT_TRAJ_PT_FULL_EX: "a point of the trajectory of several groups",
    MessageType.MOTO_SELECT_TOOL: "the choice of a tool",
    MessageType.MOTO_GET_DH_PARAMETERS: "the query of the Denavit-Hartenberg parameters",
    MessageType.MOTO_JOINT_VELOCITY: "a velocity",
    MessageType.MOTO_JOINT_VELOCITY_EX: "a velocity of several groups",
    MessageType.MOTO_VELOCITY_INFO: "the query of velocity mode",
    MessageType.MOTO_READ_IO_BIT: "reading a bit",
    MessageType.MOTO_WRITE_IO_BIT: "writing a bit",
    MessageType.MOTO_READ_IO_GROUP: "reading a group",
    MessageType.MOTO_WRITE_IO_GROUP: "writing a group",
    MessageType.MOTO_READ_MREGISTER: "reading a register",
    MessageType.MOTO_WRITE_MREGISTER: "writing a register",
}

_RESULTS: Mapping[int, str] = {
    MotionResult.SUCCESS: "was accepted",
    MotionResult.BUSY: "came too early",
    MotionResult.FAILURE: "failed",
    MotionResult.INVALID: "was not understood",
    MotionResult.ALARM: "was refused because of an alarm",
    MotionResult.NOT_READY: "was refused, the robot is not ready",
    MotionResult.MP_FAILURE: "failed inside the controller's own software",
}

_BUSY: Mapping[int, str] = {
    MessageType.JOINT_TRAJ_PT_FULL: (
        "the point before it still waits for room in the queue; send the same point again"
    ),
    MessageType.MOTO_JOINT_TRAJ_PT_FULL_EX: (
        "one of the groups still waits for room in its queue, so no group took its point; "
        "send the same points again"
    ),
    MotionCommand.START_VEL_MODE: (
        "the robot still moves, or points of a trajectory are still queued; wait, or stop it first"
    ),
}
_BUSY_OTHERWISE = "the controller is busy with something else; ask again"

_FAILURES: Mapping[int, str] = {
    MotionCommand.CHECK_MOTION_READY: (
        "it is not, and this MotoROS does not say why: look at the pendant for an alarm, an "
        "emergency stop, HOLD, the servos and the key, then start trajectory mode"
    ),
    MotionCommand.CHECK_QUEUE_CNT: (
        "the controller has no such group, or could not look into its queue: check the number of "
        "the group, which counts from 0"
    ),
    MotionCommand.STOP_MOTION: (
        "the queues were not empty in time and the robot may still move: if it does, press an "
        "emergency stop"
    ),
    MotionCommand.START_SERVOS: (
        "they did not come on within 5 s: release every emergency stop, close the safety fence, "
        "and reset the alarm on the pendant"
    ),
    MotionCommand.STOP_SERVOS: (
        "they are still on: switch them off at the pendant or with an emergency stop"
    ),
    MotionCommand.RESET_ALARM: (
        "it stays: read it on the pendant and remove its cause; major alarms need the controller "
        "switched off and on"
    ),
    MotionCommand.START_TRAJ_MODE: (
        "look at the pendant for an alarm, and whether the job INIT_ROS is there and starts"
    ),
    MotionCommand.STOP_TRAJ_MODE: (
        "points are still queued; wait until they have been executed, or stop the motion first"
    ),
    MotionCommand.DISCONNECT: (
        "points are still queued, so the connection stays; stop the motion first"
    ),
    MotionCommand.START_RT: (
        "start trajectory mode on the motion port first, and close that connection"
    ),
    MotionCommand.STOP_RT: "real-time mode may still run: stop the job at the pendant",
    MotionCommand.CHECK_TIMEOUT_CNT: "no known firmware answers it",
    MotionCommand.START_VEL_MODE: (
        "look at the pendant for an alarm, and whether the job INIT_ROS starts; whether this "
        "firmware has velocity mode shows in the answer to MOTO_VELOCITY_INFO"
    ),
    MotionCommand.STOP_VEL_MODE: (
        "the mode may still be on; stop sending velocities, its watchdog then brakes the robot"
    ),
    MessageType.JOINT_TRAJ_PT_FULL: (
        "the controller could not take it in; stop the motion and begin a new trajectory"
    ),
    MessageType.MOTO_JOINT_TRAJ_PT_FULL_EX: (
        "the controller could not take it in for every group; stop the motion of all groups and "
        "begin a new trajectory"
    ),
    MessageType.MOTO_SELECT_TOOL: (
        "the tool stays as it was; see on the pendant which tools are defined"
    ),
    MessageType.MOTO_GET_DH_PARAMETERS: "this controller does not give them",
    MessageType.MOTO_JOINT_VELOCITY: "it has no effect; restart velocity mode",
    MessageType.MOTO_JOINT_VELOCITY_EX: "it affects no group; restart velocity mode",
    MessageType.MOTO_VELOCITY_INFO: "velocity mode cannot be used; use trajectory mode",
}
_FAILURE_OTHERWISE = "the controller gives no reason; look at the pendant for an alarm"

_INVALID: Mapping[int, str] = {
    InvalidSubcode.UNSPECIFIED: "the controller does not say what is wrong with the message",
    InvalidSubcode.MSGSIZE: (
        "the message arrived in pieces or has another length than its type: nothing between here "
        "and the controller may split or join messages (a tunnel, a proxy), and the MotoROS there "
        "must know this form of the message"
    ),
    InvalidSubcode.MSGHEADER: "the header of the message is wrong; check the byte order",
    InvalidSubcode.MSGTYPE: (
        "this MotoROS, or this port of it, does not know the message; a newer MotoROS may"
    ),
    InvalidSubcode.GROUPNO: (
        "the controller has no such group: groups count from 0, and the pendant's list of groups "
        "shows how many there are"
    ),
    InvalidSubcode.SEQUENCE: "the sequence number is negative",
    InvalidSubcode.COMMAND: "this MotoROS does not know the command",
    InvalidSubcode.DATA: "the controller rejects a value in the message",
    InvalidSubcode.DATA_START_POS: (
        "the first point is more than 30 pulses (about 0.03 degrees) from where the controller "
        "commands the robot to be: wait until it stands still, and begin again from there"
    ),
    InvalidSubcode.DATA_POSITION: "a position is not one the controller allows",
    InvalidSubcode.DATA_SPEED: (
        "a joint is faster than the controller allows: lower the speed limits here to those of "
        "the robot"
    ),
    InvalidSubcode.DATA_ACCEL: (
        "a joint accelerates more than the controller allows: lower the acceleration limits here"
    ),
    InvalidSubcode.DATA_INSUFFICIENT: (
        "the point lacks something: time, position and velocity must all be marked valid"
    ),
    InvalidSubcode.DATA_TIME: (
        "the trajectory has become longer than 4 hours: stop, and begin a new one"
    ),
    InvalidSubcode.DATA_TOOLNO: "there is no such tool: tools are 0 to 63",
    InvalidSubcode.VEL_SEQUENCE: (
        "the velocity is not newer than one before it and was dropped: numbers must rise, and "
        "only one program may send"
    ),
    InvalidSubcode.VEL_NOT_FINITE: (
        "the velocity is not a finite number and was dropped; the one before it stays in force"
    ),
}

_NOT_READY: Mapping[int, str] = {
    NotReadySubcode.UNSPECIFIED: (
        "the controller does not say why: look at the pendant for an alarm or a message"
    ),
    NotReadySubcode.ALARM: (
        "an alarm is active: read it on the pendant, remove its cause, reset it"
    ),
    NotReadySubcode.ERROR: (
        "the pendant shows an error: read it there, then press CANCEL or reset it from here"
    ),
    NotReadySubcode.ESTOP: (
        "an emergency stop is pressed: release it (pendant, controller door, external), then "
        "switch the servos on"
    ),
    NotReadySubcode.NOT_PLAY: "the pendant's key is on TEACH: turn it to REMOTE",
    NotReadySubcode.NOT_REMOTE: "the pendant's key is on PLAY: turn it to REMOTE",
    NotReadySubcode.SERVO_OFF: (
        "the servos are off: close the safety fence, then enable the robot again"
    ),
    NotReadySubcode.HOLD: (
        "the robot is on HOLD: release HOLD on the pendant and the external hold signal, if there "
        "is one"
    ),
    NotReadySubcode.NOT_STARTED: (
        "the job INIT_ROS does not run: start trajectory mode; if it does not start then, see "
        "that INIT_ROS is on the controller and set as the master job"
    ),
    NotReadySubcode.WAITING_ROS: (
        "the job INIT_ROS runs but has not reached its WAIT line: start trajectory mode again; if "
        "that does not help, compare INIT_ROS on the pendant with the one of MotoROS, and see "
        "that nothing else writes outputs 889 and 890"
    ),
    NotReadySubcode.SKILLSEND: (
        "the job INIT_ROS has not sent its SKILLSND (DX100): compare it on the pendant with the "
        "one of MotoROS, and start trajectory mode again"
    ),
    NotReadySubcode.PFL_ACTIVE: (
        "the robot stopped because it touched something (power and force limiting): free it, "
        "then start trajectory mode again"
    ),
    NotReadySubcode.INC_MOVE_ERROR: (
        "the controller refused to move a step, usually at a limit, too fast, or with a group "
        "that is not switched on: read the message on the pendant, then start trajectory mode "
        "again"
    ),
    NotReadySubcode.NOT_IN_VEL_MODE: "velocity mode is not on: start it first",
    NotReadySubcode.VEL_WATCHDOG: (
        "no velocity came in time, or the motion was stopped, and the robot was braked: check the "
        "network and the load of this computer, then enable the robot again"
    ),
    NotReadySubcode.OTHER_MODE_ACTIVE: (
        "velocity mode is on, where points of trajectories are not taken: end it first"
    ),
}

_IO_RESULTS: Mapping[int, str] = {
    IoResult.OK: "done",
    IoResult.READ_ADDRESS_INVALID: (
        "the controller has nothing to read at this address; the pendant's lists of inputs, "
        "outputs and registers show which exist"
    ),
    IoResult.WRITE_ADDRESS_INVALID: (
        "the controller lets nothing be written at this address; general outputs, network "
        "inputs, the interface panel and registers 0 to 559 can be written"
    ),
    IoResult.WRITE_VALUE_INVALID: (
        "the value does not fit: a bit is 0 or 1, a group 0 to 255, a register 0 to 65535"
    ),
    IoResult.READ_API_ERROR: (
        "the controller failed to read: look at the pendant for an alarm, and whether this signal "
        "exists there"
    ),
    IoResult.WRITE_API_ERROR: (
        "the controller failed to write: see on the pendant that the signal is not used by "
        "something else, and that the controller's settings let programs write it"
    ),
}


def _task(command: int) -> str:
    return _TASKS.get(command, f"message or command {command}")


def _subcode(subcode: int) -> str:
    """Message for a subcode of either table; empty if it is in neither."""
    return _NOT_READY.get(subcode) or _INVALID.get(subcode) or ""


def reply_in_words(command: int, result: int, subcode: int) -> str:
    """Explain a MotionReply: the result of `command`, its cause, and advice.

    `command` is a MotionCommand, or the type of the answered message; `result` and `subcode` are
    raw. Unknown numbers are reported as such.
    """
    outcome = _RESULTS.get(result, f"got the unknown result {result}")
    what = f"{_task(command)} {outcome}"
    if result == MotionResult.SUCCESS:
        return what
    if result == MotionResult.BUSY:
        return f"{what}: {_BUSY.get(command, _BUSY_OTHERWISE)}"
    if result == MotionResult.FAILURE:
        # CHECK_MOTION_READY replies FALSE with a subcode of NOT_READY; old versions with 0.
        if command == MotionCommand.CHECK_MOTION_READY and subcode in _NOT_READY:
            return f"the robot is not ready: {_NOT_READY[subcode]}"
        why = _subcode(subcode) or _FAILURES.get(command, _FAILURE_OTHERWISE)
        known = subcode in (0, -1) or _subcode(subcode)
        return f"{what}: {why}" if known else f"{what} (subcode {subcode}): {why}"
    why = _subcode(subcode)
    if why:
        return f"{what}: {why}"
    if subcode:
        return (
            f"{what}: subcode {subcode} is not a known one; look at the pendant for a message, "
            "and for the number in the documentation of this MotoROS"
        )
    return f"{what}: {_FAILURE_OTHERWISE}"


def io_result_in_words(result: int) -> str:
    """Explain the result of reading or writing an input, output or register."""
    return _IO_RESULTS.get(
        result, f"the controller gives the unknown result {result}; look at the pendant"
    )


def status_in_words(status: RobotStatus) -> str:
    """Explain why the robot would not move, with advice, worst first; "" if it would.

    Known faults are reported regardless of `motion_possible`; values unknown to the controller only
    while motion is not known to be possible.
    """
    words: list[str] = []
    unknown: list[str] = []
    if status.e_stopped > 0:
        words.append(_NOT_READY[NotReadySubcode.ESTOP])
    elif status.e_stopped < 0:
        unknown.append("whether an emergency stop is pressed")
    if status.in_error > 0:
        words.append(_alarm(status.error_code))
    elif status.in_error < 0:
        unknown.append("whether there is an alarm")
    if status.mode == ControllerMode.MANUAL:
        words.append(_NOT_READY[NotReadySubcode.NOT_PLAY])
    elif status.mode != ControllerMode.AUTO:
        unknown.append("whether the pendant's key is on REMOTE")
    if status.drives_powered == 0:
        words.append(
            "the servos are off or saving energy: close the safety fence, then enable the robot"
        )
    elif status.drives_powered < 0:
        unknown.append("whether the servos are on")
    if status.motion_possible <= 0:
        if unknown:
            words.append(
                f"the controller does not know {' or '.join(unknown)}: look at the pendant"
            )
        if status.motion_possible < 0:
            words.append("the controller does not know whether motion is possible")
        elif not words:
            words.append(
                "the controller is not ready for motion: enable the robot, and where that does not "
                "help turn the pendant's key to REMOTE, release HOLD and see that the job INIT_ROS "
                "starts"
            )
    return "; ".join(words)


def _alarm(code: int) -> str:
    number = f"alarm {code}" if code > 0 else "an alarm whose number the controller does not give"
    return f"{number} is active: read it on the pendant, remove its cause, reset it"
