"""The codec compared with public Python clients' own EGM, byte for byte and field for field."""

import importlib
import subprocess
import sys

import pytest
from hypothesis import given, settings, strategies as st

from cardan.protocols.egm import schema
from cardan.protocols.egm.decode import decode_from_pc
from cardan.protocols.egm.encode import encode_path_corr, encode_robot, encode_sensor
from tests.examples import examples
from tests.protocols.worked import C1, F7, R0, R1, S1, S2, S3, S4

from . import egm_values as values

pytestmark = pytest.mark.matrix

egm_pb2 = importlib.import_module("ABBRobotEGM._egm_protobuf.egm_pb2")
bounded = settings(max_examples=examples(100), derandomize=True)

NAMES = {
    "EgmRobot": schema.Robot,
    "EgmSensor": schema.Sensor,
    "EgmSensorPathCorr": schema.SensorPathCorr,
}
ENUM, INT32 = 14, 5


def assert_same_fields(ours, theirs, path):
    assert set(ours.fields_by_number) == set(theirs.fields_by_number), path
    for number, field in ours.fields_by_number.items():
        other = theirs.fields_by_number[number]
        where = f"{path}.{field.name}"
        assert field.name == other.name, where
        # Cardan's enums are plain numbers, which have the same encoding.
        assert field.type == (INT32 if other.type == ENUM else other.type), where
        assert field.is_required == other.is_required, where
        assert field.is_repeated == other.is_repeated, where
        assert field.is_packed == other.is_packed, where
        if field.message_type is not None:
            assert_same_fields(field.message_type, other.message_type, where)


@pytest.mark.parametrize("name", NAMES)
def test_the_schema_is_the_one_that_robots_are_driven_with(name):
    assert_same_fields(NAMES[name].DESCRIPTOR, getattr(egm_pb2, name).DESCRIPTOR, name)


def same_bytes(message_class, data):
    """Assert that their class knows every field of `data` and writes the same bytes."""
    message = message_class.FromString(data)
    assert message.IsInitialized()
    fields_only = message_class()
    fields_only.CopyFrom(message)
    fields_only.DiscardUnknownFields()
    assert fields_only.SerializeToString(deterministic=True) == data


robot7 = (values.robot | values.usual_robot).filter(
    lambda r: r.measured_force is None or r.measured_force.fc_active is not None
)


@bounded
@given(robot7, st.tuples(*[st.integers(0, 2)] * 3))
def test_abb_robot_egm_knows_every_byte_of_a_robot(robot, states):
    motor, mci, rapid = states
    robot = robot._replace(motor_state=motor, mci_state=mci, rapid_exec_state=rapid)
    same_bytes(egm_pb2.EgmRobot, encode_robot(robot))


@bounded
@given(values.sensor)
def test_abb_robot_egm_knows_every_byte_of_guidance(sensor):
    same_bytes(egm_pb2.EgmSensor, encode_sensor(sensor))


@bounded
@given(values.path_corr)
def test_abb_robot_egm_knows_every_byte_of_a_path_correction(path_corr):
    same_bytes(egm_pb2.EgmSensorPathCorr, encode_path_corr(path_corr))


@bounded
@given(values.u32, values.six, values.vector, values.quaternion, values.six)
def test_what_abb_robot_egm_sends_is_read(seqno, six, position, orient, speed):
    message = egm_pb2.EgmSensor()
    message.header.seqno = seqno
    message.header.mtype = egm_pb2.EgmHeader.MSGTYPE_CORRECTION
    message.planned.joints.joints.extend(six)
    pos, quaternion = message.planned.cartesian.pos, message.planned.cartesian.orient
    pos.x, pos.y, pos.z = position
    quaternion.u0, quaternion.u1, quaternion.u2, quaternion.u3 = orient
    message.speedRef.cartesians.value.extend(speed)
    found = decode_from_pc(message.SerializeToString())
    assert found.header == (seqno, None, 3)
    assert found.planned.joints == pytest.approx([v * 0.017453292519943295 for v in six])
    assert found.planned.cartesian.pos == pytest.approx([v / 1000 for v in position])
    assert found.planned.cartesian.orient == orient
    assert found.speed_ref.cartesians[:3] == pytest.approx([v / 1000 for v in speed[:3]])


ABB_ROBOT_CLIENT = """
import sys
{first}
from abb_robot_client._egm_protobuf import egm_pb2
for line in sys.stdin:
    name, data = line.split()
    message = getattr(egm_pb2, name).FromString(bytes.fromhex(data))
    print(message.SerializeToString(deterministic=True).hex(), message.IsInitialized())
"""
WORKED = {"EgmRobot": (R0, R1, R0 + F7), "EgmSensor": (S1, S2, S3, S4), "EgmSensorPathCorr": (C1,)}


def run(program, text=""):
    """Run code in another interpreter, because one process cannot load both clients."""
    done = subprocess.run(
        [sys.executable, "-c", program], input=text, capture_output=True, text=True, timeout=50
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.parametrize("ours_first", [True, False])
def test_abb_robot_client_writes_the_same_bytes_in_one_process_with_us(ours_first):
    ours = "import cardan.protocols.egm.decode"
    program = ABB_ROBOT_CLIENT.format(first=ours if ours_first else "")
    if not ours_first:
        program += ours
    lines = [f"{name} {data.hex()}" for name, all_ in WORKED.items() for data in all_]
    expected = [f"{data.hex()} True" for all_ in WORKED.values() for data in all_]
    assert run(program, "\n".join(lines)) == expected


@pytest.mark.parametrize("ours_first", [True, False])
def test_abb_robot_egm_lives_in_one_process_with_us(ours_first):
    imports = [
        "from cardan.protocols.egm import decode",
        "from ABBRobotEGM._egm_protobuf import egm_pb2",
    ]
    if not ours_first:
        imports.reverse()
    program = "; ".join(
        [
            *imports,
            f"data = bytes.fromhex('{R1.hex()}')",
            "assert egm_pb2.EgmRobot.FromString(data).moveIndex == 1",
            "print(decode.decode_robot(data).move_index)",
        ]
    )
    assert run(program) == ["1"]
