"""EGM in a capture, read by comparison with the previous datagram: equal to separate reading."""

import pytest
from hypothesis import given, settings, strategies as st

from cardan.protocols.egm.encode import encode_path_corr, encode_robot, encode_sensor
from cardan_dissect.dissectors.datagrams import Egm
from cardan_dissect.network import Endpoint, Segment
from cardan_dissect.reader import describe
from tests.examples import examples
from tests.protocols import egm_values as values, worked
from tests.protocols.egm_wire import spoilt

pytestmark = pytest.mark.matrix

CONTROLLER, PC = Endpoint("10.0.0.1", 50123), Endpoint("10.0.0.2", 6510)
NUMBERS = {"egm_ports": frozenset({PC.port})}
FROM_CONTROLLER = [worked.R0, worked.R1, worked.R0 + worked.F6, worked.R0 + worked.F7]
FROM_PC = [worked.S1, worked.S2, worked.S3, worked.S4, worked.C1]


def segment(data, to_pc, cut=False):
    source, destination = (CONTROLLER, PC) if to_pc else (PC, CONTROLLER)
    return Segment("UDP", source, destination, data, cut)


def said(egm, data, to_pc):
    decoded = egm.decode(segment(data, to_pc))
    title = decoded.title or type(decoded.value).__name__
    numbers = decoded.sequence, decoded.asks, decoded.answers
    return title, decoded.fault, numbers, "" if decoded.fault else describe(decoded)


@settings(max_examples=examples(100), derandomize=True)
@given(st.data())
def test_what_is_like_one_before_is_read_as_alone(data):
    to_pc = data.draw(st.booleans())
    one = data.draw(
        st.sampled_from(FROM_CONTROLLER if to_pc else FROM_PC)
        | spoilt(
            (values.robot | values.usual_robot).map(encode_robot)
            if to_pc
            else values.sensor.map(encode_sensor) | values.path_corr.map(encode_path_corr)
        )
    )
    taught = Egm(NUMBERS)
    said(taught, one, to_pc)
    for _ in range(5):
        other = bytearray(one)
        for _ in range(data.draw(st.integers(0, 4))):
            if other:
                at = data.draw(st.integers(0, len(other) - 1))
                other[at] = data.draw(
                    st.sampled_from((0x00, 0x7F, 0xF0, 0xFF)) | st.integers(0, 255)
                )
        found = said(taught, bytes(other), to_pc)
        assert found == said(Egm(NUMBERS), bytes(other), to_pc)


def test_values_of_what_is_known_are_decoded_when_they_are_shown():
    for data, to_pc in [(each, True) for each in FROM_CONTROLLER] + [
        (each, False) for each in FROM_PC
    ]:
        egm = Egm(NUMBERS)
        first = said(egm, data, to_pc)
        assert callable(egm.decode(segment(data, to_pc)).value)
        assert not callable(egm.decode(segment(data, to_pc, cut=True)).value)
        assert said(egm, data, to_pc) == first
