"""The device of a session, served through the bus, and its model."""

import socket
import threading
import time

import pytest

from cardan.bus.node import BusNode
from cardan.bus.options import BusOptions
from cardan.demos.examples import free_ports
from cardan.drivers.spacemouse import SpaceMouse
from cardan.errors import OptionError
from cardan.gateway.bus.device_topics import DeviceTopics
from cardan.gateway.servers import registry
from cardan.protocols.connexion.devices import MODELS
from cardan.protocols.spnav.records import Button, MotionEvent, encode_handshake
from cardan.protocols.spnav.streams import ServerReader
from cardan.types import NEUTRAL, Axes, DeviceLink, DeviceState
from cardan_spnav_server import SpnavServerOptions, identity_of
from cardan_spnav_server.bus_server import DeviceTopic, SpnavBusServer, SpnavBusServerOptions
from tests.test_server_command import said

PUSH = Axes(0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
WITHIN_S = 10.0


def state(axes=NEUTRAL, buttons=(), link=DeviceLink.LIVE):
    return DeviceState(time.monotonic(), link, axes, frozenset(buttons))


@pytest.mark.matrix
def test_a_session_serves_programs_that_use_libspnav(tmp_path):
    """Programs receive motion, buttons by spacenavd's numbers, and the end of both."""
    pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
    port, path = free_ports(), tmp_path / "spnav.sock"
    labels = SpaceMouse(model="spacemouse-pro").capabilities.buttons
    options = SpnavBusServerOptions(
        bus=BusOptions(router=f"tcp/127.0.0.1:{port}"),
        device=DeviceTopic(topic="/left/spacenav/joy"),
        server=SpnavServerOptions(socket=str(path), model="spacemouse-pro"),
    )
    ready, stop, begun_s = threading.Event(), threading.Event(), time.monotonic()
    node = BusNode(BusOptions(router="", listen=(f"tcp/127.0.0.1:{port}",)), "session", "/left")
    serving = threading.Thread(
        target=SpnavBusServer.serve, args=(options, lambda endpoint: ready.set(), stop)
    )
    with node, socket.socket(socket.AF_UNIX) as program:
        topics = DeviceTopics(node, labels)
        serving.start()
        try:
            assert ready.wait(WITHIN_S)
            program.connect(str(path))
            program.sendall(encode_handshake(1))
            program.setblocking(False)
            reader, values = ServerReader(), []

            def until(wanted, device_of):
                while True:
                    assert time.monotonic() - begun_s < WITHIN_S, values[-5:]
                    topics.offer(device_of(), time.monotonic(), time.time_ns())
                    time.sleep(0.004)
                    try:
                        values.extend(reader.feed(program.recv(4096)))
                    except BlockingIOError:
                        continue
                    if found := [each for each in values if wanted(each)]:
                        values.clear()
                        return found[0]

            def pushed():
                return state(PUSH)

            # The device becomes active after a deflection and a return to rest.
            until(lambda each: isinstance(each, Button), lambda: state(PUSH, ["esc"]))
            added = until(
                lambda each: isinstance(each, Button) and not each.pressed, lambda: state()
            )
            rest_s = time.monotonic() + 0.3
            while time.monotonic() < rest_s:
                topics.offer(state(), time.monotonic(), time.time_ns())
                time.sleep(0.004)
            assert added == Button(11, False)  # spacenavd's number of the key esc
            motion = until(lambda each: isinstance(each, MotionEvent) and any(each[:6]), pushed)
            assert motion.z == pytest.approx(0.5 * 350, abs=1)
            button = until(lambda each: isinstance(each, Button), lambda: state(PUSH, ["menu"]))
            assert button == Button(4, True)
            released = until(
                lambda each: isinstance(each, Button), lambda: state(link=DeviceLink.STALE)
            )
            assert released == Button(4, False)
        finally:
            stop.set()
            serving.join()
    assert not path.exists()


def test_the_server_tells_what_its_options_mean():
    assert registry.load("spnav") is SpnavBusServer
    reported = said("spnav", "--help")
    for words in ("--socket", "--topic", "--model", "--domain", SpnavBusServer.epilog):
        assert words in reported


@pytest.mark.parametrize("model", [m for m in MODELS if m.buttons], ids=lambda m: m.key)
def test_a_model_behind_the_bus_is_reported_as_one_that_is_open(model):
    mouse = SpaceMouse(model=model.key)
    known, reported = identity_of(mouse), SpnavServerOptions(model=model.key).identity
    assert reported._replace(button_numbers={}) == known._replace(button_numbers={})
    for place, label in enumerate(mouse.capabilities.buttons):
        assert reported.button_numbers[f"button-{place}"] == known.button_numbers[label]


def test_a_model_has_the_name_that_is_given():
    assert SpnavServerOptions(model="spacemouse-pro", name="Left").identity.name == "Left"
    assert SpnavServerOptions(name="Left").identity is None


def test_a_model_that_nobody_knows_is_refused():
    words = r"model: 'x' is not allowed; it must be empty or one of .*pro"
    with pytest.raises(OptionError, match=words):
        SpnavServerOptions(model="x")
    with pytest.raises(OptionError, match=r"; did you mean 'spacemouse-pro'\?$"):
        SpnavServerOptions(model="SpaceMouse_Pro")
