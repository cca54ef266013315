"""Robot states for the filters' tests."""

from cardan.types import IDENTITY, Pose, RobotLink, RobotState, Vector3


def robot_at(stamp_s, orientation=IDENTITY, pose=True):
    """A live robot seen at `stamp_s`, its TCP turned by `orientation`."""
    return RobotState(
        stamp_s=stamp_s,
        link=RobotLink.LIVE,
        session=1,
        sequence=0,
        period_s=0.004,
        joints=(0.0,) * 6,
        external_axes=(),
        pose=Pose(Vector3(0.5, 0.0, 0.8), orientation) if pose else None,
        hold_reason="",
    )
