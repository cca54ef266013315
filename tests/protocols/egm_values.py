"""Hypothesis strategies for EGM messages as values."""

from hypothesis import strategies as st

from cardan.protocols.egm.messages import (
    EgmCollisionInfo,
    EgmHeader,
    EgmMeasuredForce,
    EgmMotion,
    EgmPose,
    EgmRapidData,
    EgmRobot,
    EgmSensor,
    EgmSensorPathCorr,
    EgmSpeedRef,
)
from cardan.types import Quaternion, Vector3

u32 = st.integers(0, 2**32 - 1)
number = st.floats(-1e3, 1e3)
six = st.tuples(*[number] * 6)
up_to_six = st.lists(number, max_size=6).map(tuple)
flag = st.none() | st.booleans()
vector = st.builds(Vector3, number, number, number)
quaternion = st.builds(Quaternion, number, number, number, number)
time = st.integers(0, 2**50) | st.integers(1_577_836_800 * 10**6, 2_000_000_000 * 10**6)


def maybe(strategy):
    return st.none() | strategy


def header(mtypes):
    return st.builds(EgmHeader, maybe(u32), maybe(u32), mtypes)


pose = st.builds(EgmPose, maybe(vector), maybe(quaternion), maybe(vector))
motion = st.builds(
    EgmMotion, maybe(up_to_six), maybe(pose), maybe(up_to_six), maybe(time), maybe(time)
)
rapid_data = st.builds(EgmRapidData, flag, st.lists(number, max_size=40).map(tuple))
later_fields = st.fixed_dictionaries(
    {
        "measured_force": maybe(st.builds(EgmMeasuredForce, up_to_six, flag)),
        "utilization_rate": maybe(number),
        "move_index": maybe(u32),
        "collision_info": maybe(st.builds(EgmCollisionInfo, flag, up_to_six)),
        "rapid_from_robot": maybe(rapid_data),
        "torque_ref": maybe(up_to_six),
    }
)
state = maybe(st.integers(-1, 5))

robot = st.builds(
    lambda later, **fields: EgmRobot(**fields, **later),
    later=later_fields,
    header=maybe(header(st.sampled_from((0, 2)))),
    feed_back=motion,
    planned=maybe(motion),
    motor_state=state,
    mci_state=state,
    mci_convergence_met=flag,
    test_signals=maybe(up_to_six),
    rapid_exec_state=state,
)


def usual_robots(euler):
    pose = st.builds(EgmPose, vector, quaternion, euler)
    motion = st.builds(EgmMotion, six, pose, st.none(), time, st.none())
    return st.builds(
        lambda later, **fields: EgmRobot(**fields, **later),
        later=later_fields,
        header=st.builds(EgmHeader, u32, u32, st.just(2)),
        feed_back=motion,
        planned=motion,
        motor_state=st.integers(0, 2),
        mci_state=st.integers(0, 3),
        mci_convergence_met=st.booleans(),
        rapid_exec_state=st.integers(0, 2),
    )


usual_robot = usual_robots(st.none()) | usual_robots(vector)
"""Messages of a six-axis robot's controller in normal cycles."""

speed_ref = st.builds(EgmSpeedRef, maybe(up_to_six), maybe(six), maybe(up_to_six))
sensor = st.builds(
    EgmSensor,
    maybe(header(st.sampled_from((0, 3)))),
    maybe(motion),
    maybe(speed_ref),
    maybe(rapid_data),
).filter(any)
path_corr = st.builds(EgmSensorPathCorr, maybe(header(st.sampled_from((0, 1, 4)))), vector, u32)
