"""Channels and types of the action, in addition to those of the arm."""

from __future__ import annotations

from cardan.protocols.ros2.actions import CANCEL_TYPE, STATUS_TYPE
from cardan.protocols.ros2.interfaces import action_type
from cardan_conform_arms.ros2_arm.names import DESCRIPTION, STATES, TOPICS, Channel

ACTION = "/joint_trajectory_controller/follow_joint_trajectory"
"""Default name of the action."""
TYPE = action_type("control_msgs/action/FollowJointTrajectory")
GOAL, CANCEL, RESULT = "send_goal", "cancel_goal", "get_result"
FEEDBACK, STATUS = "feedback", "status"
"""Channels of timelines, with ROS 2's names below the action's."""


def channels_of(action: str) -> dict[str, Channel]:
    """Return all channels of the suite for an action of this name: the arm is in its controller's
    namespace."""
    base = f"{action}/_action"
    namespace = action.rpartition("/")[0].rpartition("/")[0]
    return {
        **{
            each: TOPICS[each]._replace(name=namespace + TOPICS[each].name)
            for each in (STATES, DESCRIPTION)
        },
        GOAL: Channel(f"{base}/{GOAL}", TYPE.send_goal.name, "called"),
        CANCEL: Channel(f"{base}/{CANCEL}", CANCEL_TYPE, "called"),
        RESULT: Channel(f"{base}/{RESULT}", TYPE.get_result.name, "called"),
        FEEDBACK: Channel(f"{base}/{FEEDBACK}", TYPE.feedback),
        STATUS: Channel(f"{base}/{STATUS}", STATUS_TYPE, "latched"),
    }
