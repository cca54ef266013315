"""Finding nodes, opening them, and the drivers against simulated devices over their sockets."""

import errno
import fcntl
import os
import socket
import time

import pytest

from cardan.drivers import packet_socket, reader_thread
from cardan.drivers.access import open_error
from cardan.drivers.evdev import device as shell, links, nodes
from cardan.drivers.evdev.core import UNREAD_AFTER_S
from cardan.drivers.gamepad import Gamepad, GamepadOptions
from cardan.drivers.keyboard import Keyboard, KeyboardOptions
from cardan.errors import CommandError, DeviceAccessError, DeviceNotFoundError, NotOpenError
from cardan.protocols.evdev import codes as c, events as evdev_events, requests
from cardan.protocols.evdev.events import encode_events
from cardan.protocols.evdev.requests import BUS_VIRTUAL, AbsInfo, InputId, encode_bits
from cardan.sim_peers.evdev import EvdevPeer, EvdevPeerOptions, SimulatedInput
from cardan.types import DeviceFeedback, DeviceLink
from tests.drivers.evdev_bench import BY_KEY
from tests.serving import in_a_thread
from tests.waiting import until

pytestmark = pytest.mark.matrix


# ---------------------------------------------------------------------------------------------
# Device nodes of the system


def words_of(codes):
    """Return a mask in the format of /sys: words of 64 bits, highest first."""
    mask = int.from_bytes(encode_bits(codes, 96), "little")
    words = []
    while mask:
        words.insert(0, f"{mask & 0xFFFFFFFFFFFFFFFF:x}")
        mask >>= 64
    return " ".join(words) or "0"


def add_node(root, number, model, name=None):
    device = root / f"sys/class/input/event{number}/device"
    (device / "capabilities").mkdir(parents=True)
    (device / "id").mkdir()
    (device / "name").write_text((name or model.name) + "\n")
    (device / "id/vendor").write_text(f"{model.id.vendor:04x}\n")
    (device / "id/product").write_text(f"{model.id.product:04x}\n")
    (device / "capabilities/key").write_text(words_of(model.codes.values()) + "\n")
    (device / "capabilities/abs").write_text(words_of(model.axes) + "\n")
    return device


def test_nodes_are_found_by_what_they_can_do(tmp_path):
    add_node(tmp_path, 11, BY_KEY["dualshock-4"])
    add_node(tmp_path, 2, BY_KEY["keyboard"])
    pad = add_node(tmp_path, 3, BY_KEY["xbox-360"])
    power = BY_KEY["keyboard"]._replace(name="Power Button", codes={"power": 116})
    add_node(tmp_path, 0, power)
    (tmp_path / "sys/class/input/js0").mkdir()
    (tmp_path / "drivers/xpad").mkdir(parents=True)
    (pad / "device").mkdir()
    (pad / "device/driver").symlink_to(tmp_path / "drivers/xpad")

    found = nodes.find_nodes(tmp_path)
    assert [node.path for node in found] == [f"/dev/input/event{n}" for n in (0, 2, 3, 11)]
    kinds = [(nodes.is_gamepad(n.keys, n.axes), nodes.is_keyboard(n.keys, n.axes)) for n in found]
    assert kinds == [(False, False), (False, True), (True, False), (True, False)]
    assert (found[2].name, found[2].identity) == ("Microsoft X-Box 360 pad", "045e:028e")
    assert nodes.kernel_driver("/dev/input/event3", tmp_path) == "xpad"
    assert nodes.kernel_driver("/dev/input/event2", tmp_path) == ""


def test_a_system_without_input_devices(tmp_path):
    assert nodes.find_nodes(tmp_path) == []


def test_garbled_capabilities_are_none(tmp_path):
    device = add_node(tmp_path, 1, BY_KEY["keyboard"])
    (device / "capabilities/key").write_text("not a mask")
    assert nodes.find_nodes(tmp_path)[0].keys == frozenset()


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.EACCES, "no permission for /dev/input/event3: do this"),
        (errno.ENOENT, "is gone: plug it in again"),
        (errno.ENODEV, "is gone: plug it in again"),
        (errno.EIO, "Input/output error"),
    ],
)
def test_what_stands_in_the_way(number, words):
    error = OSError(number, os.strerror(number))
    assert words in open_error("/dev/input/event3", error, "do this")


def test_nothing_plugged_in(monkeypatch):
    monkeypatch.setattr(shell, "find_nodes", list)
    with pytest.raises(DeviceNotFoundError, match="no gamepad is plugged in"):
        Gamepad().open()
    assert Gamepad.find() == []
    with pytest.raises(DeviceAccessError, match="/nowhere/event1 is gone"):
        Keyboard(KeyboardOptions(path="/nowhere/event1")).open()


# ---------------------------------------------------------------------------------------------
# A node, with the kernel's answers from the simulated device


class FakeKernel:
    """FIFO in place of a device node, and its ioctls."""

    def __init__(self, tmp_path, monkeypatch, model):
        self.path = str(tmp_path / "event7")
        os.mkfifo(self.path)
        self.device = SimulatedInput(BY_KEY[model])
        self.writer = os.open(self.path, os.O_RDWR | os.O_NONBLOCK)
        self.now_s = 0.0
        self.requests = []
        self.gone = False
        monkeypatch.setattr(fcntl, "ioctl", self.ioctl)

    def ioctl(self, fd, request, argument, mutate=False):
        if self.gone:
            raise OSError(errno.ENODEV, "No such device")
        self.requests.append(request)
        data = requests.encode_int(argument) if isinstance(argument, int) else bytes(argument)
        answer = self.device.call("client", request, data, self.now_s)
        if answer.result < 0:
            raise OSError(-answer.result, os.strerror(-answer.result))
        if mutate:
            argument[:] = answer.argument
        return 0

    def run(self, seconds):
        self.now_s += seconds
        for frame in self.device.reports(self.now_s):
            os.write(self.writer, encode_events(frame.stamped(0.0)))

    def tap(self, label):
        self.device.press(label)
        self.run(0.02)
        self.device.release(label)
        self.run(0.02)


@pytest.fixture
def kernel(tmp_path, monkeypatch):
    made = []

    def make(model):
        made.append(FakeKernel(tmp_path, monkeypatch, model))
        return made[0]

    yield make
    for fake in made:
        os.close(fake.writer)


def test_a_pad_read_from_a_node(kernel):
    fake = kernel("xbox-360")
    with Gamepad(GamepadOptions(path=fake.path)) as pad:
        fake.tap("start")
        until(lambda: pad.state().link is DeviceLink.LIVE, "not live")
        fake.device.set_controls((0.0, 1.0, 0.0, 0.0, 0.0, 0.0))
        fake.run(0.02)
        until(lambda: pad.state().axes[0] == 1.0, "not deflected")
        assert pad.diagnosis() == ()
    assert pad.state().link is DeviceLink.CLOSED
    assert requests.EVIOCGRAB not in fake.requests


def test_a_keyboard_is_grabbed_only_while_no_key_is_down(kernel):
    fake = kernel("keyboard")
    fake.device.press("enter")  # Enter that started the session's command
    fake.run(0.02)
    os.read(fake.writer, 1000)
    with Keyboard(KeyboardOptions(path=fake.path, grab=True)) as keyboard:
        until(lambda: keyboard.metrics()["checked_age_s"] < 1.0, "not read")
        assert fake.device.grabbed_by is None
        fake.device.release("enter")
        fake.run(0.02)
        until(lambda: fake.device.grabbed_by, "not grabbed")
        fake.device.press("esc")
        fake.run(0.02)
        until(lambda: not fake.device.grabbed_by, "not given back")
        fake.device.release("esc")
        fake.tap("f12")
        until(lambda: fake.device.grabbed_by, "not taken again")
    assert fake.device.grabbed_by is None


def test_a_keyboard_that_another_program_has_grabbed(kernel):
    fake = kernel("keyboard")
    fake.device.grabbed_by = "another"
    with Keyboard(KeyboardOptions(path=fake.path, grab=True)) as keyboard:
        until(lambda: "another program has grabbed" in str(keyboard.diagnosis()), "not said")
    assert fake.device.grabbed_by == "another"


def test_a_node_of_another_kind_is_refused(kernel):
    fake = kernel("keyboard")
    with pytest.raises(DeviceNotFoundError, match=r"Set 2 keyboard .* is not a gamepad"):
        Gamepad(GamepadOptions(path=fake.path)).open()


def test_a_third_partys_pad_by_xone(kernel, tmp_path, monkeypatch):
    """/sys names the driver of the node."""
    fake = kernel("xbox-one")
    pdp = InputId(BUS_VIRTUAL, 0x0E6F, 0x02C6, 0x0101)
    model = BY_KEY["xbox-one"]._replace(name="Microsoft X-Box One pad", id=pdp)
    fake.device = SimulatedInput(model)
    device = add_node(tmp_path, 7, model)
    (tmp_path / "drivers/xone-gip-gamepad").mkdir(parents=True)
    (device / "device").mkdir()
    (device / "device/driver").symlink_to(tmp_path / "drivers/xone-gip-gamepad")
    monkeypatch.setattr(shell, "kernel_driver", lambda path: nodes.kernel_driver(path, tmp_path))
    with Gamepad(GamepadOptions(path=fake.path)) as pad:
        fake.tap("start")
        until(lambda: pad.state().link is DeviceLink.LIVE, "not live")
        for label in ("north", "west"):
            fake.device.press(label)
            fake.run(0.02)
            until(lambda: pad.state().buttons, "not pressed")
            assert pad.state().buttons == {label}
            fake.device.release(label)
            fake.run(0.02)
            until(lambda: not pad.state().buttons, "not released")


# -- devices that only resemble gamepads

JOYSTICK = BY_KEY["logitech-f310-d"]
SWITCH = "set the switch on its back to X"


def sold_as(name, vendor, product, axes=None):
    return JOYSTICK._replace(
        name=name,
        id=JOYSTICK.id._replace(vendor=vendor, product=product),
        axes=JOYSTICK.axes | dict.fromkeys(axes or (), AbsInfo(0, 0, 255, 0, 0, 0)),
    )


MISFITS = {
    "Logitech Logitech Dual Action": (JOYSTICK, f"a Logitech F310 in its mode D: {SWITCH}"),
    "Logitech Logitech Cordless RumblePad 2": (
        sold_as("Logitech Logitech Cordless RumblePad 2", 0x046D, 0xC219),
        f"a Logitech F710 in its mode D: {SWITCH}",
    ),
    "Logitech Logitech RumblePad 2 USB": (
        sold_as("Logitech Logitech RumblePad 2 USB", 0x046D, 0xC218),
        f"a Logitech F510 in its mode D: {SWITCH}",
    ),
    "DragonRise Inc. Generic USB Joystick": (
        sold_as("DragonRise Inc. Generic USB Joystick", 0x0079, 0x0006),
        "numbered as a joystick's, so that nothing says where they are: switch a pad to XInput",
    ),
    "Logitech Logitech Extreme 3D": (
        sold_as("Logitech Logitech Extreme 3D", 0x046D, 0xC215, {c.ABS_THROTTLE}),
        "a flight stick, which cannot be used",
    ),
    "Logitech MOMO Racing": (
        sold_as("Logitech MOMO Racing", 0x046D, 0xCA03, {c.ABS_GAS, c.ABS_BRAKE}),
        "a steering wheel, which cannot be used",
    ),
}


@pytest.mark.parametrize("name", MISFITS)
def test_a_joystick_is_said_to_be_one(kernel, monkeypatch, name):
    model, words = MISFITS[name]
    fake = kernel("xbox-360")
    fake.device = SimulatedInput(model)
    with pytest.raises(DeviceNotFoundError) as refused:
        Gamepad(GamepadOptions(path=fake.path)).open()
    assert f"{name} ({fake.path}) is not a gamepad: " in str(refused.value)
    assert words in str(refused.value)

    plugs = Plugs(monkeypatch)
    plugs.models["/dev/input/event5"] = model
    with pytest.raises(DeviceNotFoundError) as refused:
        Gamepad().open()
    assert f"no gamepad is plugged in: see `cardan devices`; {name}" in str(refused.value)
    assert words in str(refused.value)
    with pytest.raises(DeviceNotFoundError, match=r"no keyboard .* see `cardan devices`$"):
        Keyboard().open()


def test_a_pad_whose_switch_is_wrong_is_listed_with_that(monkeypatch):
    plugs = Plugs(monkeypatch)
    plugs.models |= {
        f"/dev/input/event{number}": model for number, (model, _) in enumerate(MISFITS.values())
    }
    found = Gamepad.find()
    assert [device.identity for device in found] == ["046d:c216", "046d:c219", "046d:c218"]
    assert all(SWITCH in device.obstacle for device in found)
    plugs.models["/dev/input/event9"] = BY_KEY["xbox-360"]
    with Gamepad() as pad:
        assert pad._core.description.name == "Microsoft X-Box 360 pad"


def test_a_simulated_pad_in_mode_d_is_refused_as_a_real_one(tmp_path):
    with (
        in_a_thread(peer(tmp_path, model="logitech-f310-d")),
        pytest.raises(DeviceNotFoundError, match=SWITCH),
    ):
        gamepad(tmp_path).open()


def test_a_file_that_is_no_input_device(tmp_path):
    path = str(tmp_path / "fifo")
    os.mkfifo(path)
    with pytest.raises(DeviceAccessError, match="does not identify itself"):
        Gamepad(GamepadOptions(path=path)).open()


class Plugs:
    """Input devices that are plugged and unplugged, each with answers for all requests."""

    def __init__(self, monkeypatch):
        self.models = {}
        monkeypatch.setattr(shell, "find_nodes", self.nodes)
        monkeypatch.setattr(shell, "NodeLink", self.open)
        monkeypatch.setattr(shell, "kernel_driver", lambda path: "")

    def nodes(self):
        return [
            nodes.Node(
                path,
                model.name,
                f"{model.id.vendor:04x}:{model.id.product:04x}",
                frozenset(model.codes.values()),
                frozenset(model.axes),
            )
            for path, model in self.models.items()
        ]

    def open(self, path):
        if path not in self.models:
            raise FileNotFoundError(errno.ENOENT, "No such file")
        return PluggedLink(self, path)


class PluggedLink(links.EvdevLink):
    def __init__(self, plugs, path):
        self.plugs, self.path, self.model = plugs, path, plugs.models[path]
        self.device = SimulatedInput(self.model)

    def read(self, timeout_s):
        time.sleep(0.002)
        if self.plugs.models.get(self.path) is not self.model:
            raise OSError(errno.ENODEV, "No such device")

    def write(self, events):
        pass

    def call(self, request, argument=b"", timeout_s=0.5):
        return self.device.call("client", request, argument, 0.0).argument

    def answers(self, timeout_s):
        return True

    def close(self):
        pass


@pytest.mark.parametrize("path", ["", "/dev/input/event3"])
def test_another_pad_does_not_take_the_place_of_one_that_was_unplugged(monkeypatch, path):
    monkeypatch.setattr(reader_thread, "RETRY_FIRST_S", 0.01)
    monkeypatch.setattr(reader_thread, "RETRY_LAST_S", 0.02)
    plugs = Plugs(monkeypatch)
    first, second = BY_KEY["xbox-360"], BY_KEY["dualshock-4"]
    plugs.models["/dev/input/event3"] = first
    pad = Gamepad(GamepadOptions(path=path))
    with pad:
        assert pad.state().link is DeviceLink.NEEDS_NEUTRAL
        plugs.models["/dev/input/event3"] = second  # the node's number is reused
        until(
            lambda: (
                f"{first.name} is not plugged in" in pad.state().reason
                and second.name in pad.state().reason
            ),
            "not named",
        )
        assert pad.state().link is DeviceLink.LOST
        if path:
            plugs.models[path] = first
        else:
            plugs.models["/dev/input/event9"] = first
        until(lambda: pad.state().link is DeviceLink.NEEDS_NEUTRAL, "not picked up again")
        assert pad._core.description.name == first.name
    plugs.models = {"/dev/input/event3": second}
    with pad:  # a new session opens the present devices
        assert pad._core.description.name == second.name


def test_a_device_without_a_name_is_known_by_its_number(tmp_path):
    model = BY_KEY["xbox-360"]
    (add_node(tmp_path, 4, model) / "name").write_text("\n")
    (node,) = nodes.find_nodes(tmp_path)
    assert node.is_of("", "045e:028e")
    assert not node.is_of("", "045e:028f")
    assert not node.is_of("another", "045e:028e")


# ---------------------------------------------------------------------------------------------
# Driver and simulated peer over the socket


def peer(tmp_path, kind="gamepad", script="0.0 neutral", **options):
    file = tmp_path / "script"
    file.write_text(script)
    return EvdevPeer(
        EvdevPeerOptions(kind=kind, path=str(tmp_path / "s"), script=str(file), **options)
    )


def gamepad(tmp_path, **options):
    return Gamepad(GamepadOptions(transport="socket", path=str(tmp_path / "s"), **options))


@pytest.mark.judged(device="Gamepad", transport="socket", by="simulated peer")
@pytest.mark.parametrize("model", ["xbox-360", "xbox-one", "dualshock-4", "dualsense-generic"])
def test_a_pad_over_its_socket(tmp_path, model):
    script = """
        0.05 hold start for 0.05
        0.20 press left-shoulder
        0.25 sticks 0 1 0 0
        0.60 release left-shoulder
        0.70 neutral
        1.00 loop
    """
    with in_a_thread(peer(tmp_path, script=script, model=model)), gamepad(tmp_path) as pad:
        state = until(lambda: any((s := pad.state()).axes) and s, "not deflected")
        assert state.axes[0] > 0.9
        assert {"west", "left-shoulder"} <= set(pad.capabilities.buttons)
        edges = []

        def both_ways():
            edges.extend(e.pressed for e in pad.button_events() if e.button == "left-shoulder")
            return len(edges) > 1

        until(both_ways, "no edges")
        assert edges[:2] == [True, False]
        assert (pad.metrics()["garbled"], pad.metrics()["dropped"]) == (0, 0)


@pytest.mark.real
@pytest.mark.judged(device="Keyboard", transport="socket", by="simulated peer")
def test_a_keyboard_over_its_socket(tmp_path):
    script = """
        0.05 hold enter for 0.05
        0.20 press space
        0.25 hold h for 0.8
        1.10 release space
        1.30 loop
    """
    options = KeyboardOptions(transport="socket", path=str(tmp_path / "s"), grab=True)
    with in_a_thread(peer(tmp_path, "keyboard", script)) as served, Keyboard(options) as keyboard:

        def yaws_while_held():
            state = keyboard.state()
            return state.axes[5] == 1.0 and state.buttons == {"space"}

        until(yaws_while_held, "no full yaw with the dead-man held")
        assert served.device.grabbed_by is not None
        until(lambda: not any(keyboard.state().axes), "not let go")


@pytest.mark.judged(device="Gamepad", transport="socket", by="simulated peer")
def test_rumble_goes_on_and_ends_with_the_driver(tmp_path):
    with in_a_thread(peer(tmp_path)) as served, gamepad(tmp_path) as pad:

        def turns():
            return served.device.rumble(served.device_s())

        assert pad.capabilities.feedback == {"rumble"}
        pad.feedback(DeviceFeedback(rumble=0.5))
        until(lambda: turns() == pytest.approx((0.5, 0.5), abs=1e-4), "does not rumble")
        pad.feedback(DeviceFeedback(rumble=1.0))
        until(lambda: turns() == (1.0, 1.0), "not harder")
        end_s = time.monotonic() + 0.6  # longer than the effect's duration
        until(lambda: time.monotonic() > end_s, "time stands still")
        until(lambda: turns() == (1.0, 1.0), "ended by itself")
        pad.feedback(DeviceFeedback(rumble=0.0))
        until(lambda: turns() == (0.0, 0.0), "does not stop")
        pad.feedback(DeviceFeedback(rumble=1.0))
        until(lambda: turns() == (1.0, 1.0), "does not rumble again")
        pad.close()
        until(lambda: turns() == (0.0, 0.0), "rumbles on after close")
        with pytest.raises(NotOpenError):
            pad.feedback(DeviceFeedback(rumble=1.0))


def test_a_pad_that_refuses_effects(tmp_path):
    with (
        in_a_thread(peer(tmp_path, faults={"refuse-rumble": 1.0})),
        gamepad(tmp_path) as pad,
    ):
        pad.feedback(DeviceFeedback(rumble=1.0))
        until(
            lambda: "rumble commands that the gamepad refused" in str(pad.diagnosis()), "not said"
        )
        with pytest.raises(CommandError, match="no led feedback"):
            pad.feedback(DeviceFeedback(led=True))


@pytest.mark.real
@pytest.mark.judged(device="Gamepad", transport="socket", by="simulated peer")
def test_unplugged_and_back(tmp_path):
    touches = "\n".join(f"{0.2 * n:.1f} hold start for 0.05" for n in range(9, 40))
    script = f"0.0 hold start for 0.03\n0.1 swing 0 0.9 0 0 over 0.3 times 4\n{touches}"
    faults = {"unplug": 1.0, "replug": 1.4}
    with in_a_thread(peer(tmp_path, script=script, faults=faults)), gamepad(tmp_path) as pad:
        until(lambda: any(pad.state().axes), "not deflected")
        state = until(lambda: (s := pad.state()).link is DeviceLink.LOST and s, "not lost")
        assert not any(state.axes)
        assert "unplugged" in state.reason

        def moves_or_lives():
            state = pad.state()
            assert not any(state.axes), "moves without having been at rest"
            return state.link is DeviceLink.LIVE

        until(moves_or_lives, "not back")


@pytest.mark.parametrize("kind", ["gamepad", "keyboard"])
def test_a_simulated_device_that_hangs_is_neutral_until_it_was_let_go(tmp_path, kind):
    if kind == "gamepad":
        script = "0.0 hold start for 0.03\n0.1 sticks 0 0.9 0 0 over 0.1"
        device = gamepad(tmp_path)
    else:
        script = "0.0 hold enter for 0.03\n0.1 hold a for 60"
        device = Keyboard(KeyboardOptions(transport="socket", path=str(tmp_path / "s"), ramp_s=0.0))
    with in_a_thread(peer(tmp_path, kind=kind, script=script)) as served, device:
        until(lambda: any(device.state().axes), "not deflected")
        served.step = lambda until_s: time.sleep(0.002)
        until(lambda: not any(device.state().axes), "not neutral")
        state = device.state()
        assert state.link is DeviceLink.STALE
        assert "hangs" in state.reason
        del served.step
        until(lambda: device.state().link is DeviceLink.NEEDS_NEUTRAL, "not heard again")
        assert not any(device.state().axes)
        assert device.metrics()["garbled"] == 0


class Slow:
    """Other end of a socket, which answers on request."""

    def __init__(self, path):
        self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.listener.bind(path)
        self.listener.listen(1)
        self.link = links.EvdevSocketLink(path)
        self.sock, _ = self.listener.accept()

    def answer(self):
        call = requests.decode_call(self.sock.recv(4096))
        self.sock.send(requests.encode_call(call))

    def close(self):
        self.link.close()
        self.sock.close()
        self.listener.close()


EVENT = encode_events([evdev_events.InputEvent(0, 0, 1, 304, 1)])


def test_late_answers_are_no_garbage(tmp_path):
    slow = Slow(str(tmp_path / "s"))
    link = slow.link
    with pytest.raises(TimeoutError):
        link.call(requests.EVIOCSFF, b"", packet_socket.FEEDBACK_TIMEOUT_S)
    assert not link.answers(0.01)
    assert not link.answers(0.01)
    slow.answer()
    slow.sock.send(EVENT)
    assert link.read(0.1) == EVENT
    assert link.answers(0.0)
    assert not link.answers(0.0)
    slow.answer()  # a single request after three calls
    assert link.answers(0.1)
    slow.sock.send(EVENT)
    assert not link.answers(0.1)
    assert link.read(0.0) == EVENT
    assert link.read(0.0) is None
    slow.sock.setblocking(False)
    slow.answer()
    with pytest.raises(BlockingIOError):
        slow.answer()
    slow.close()


def test_an_answer_that_nobody_asked_for_is_garbage(tmp_path):
    slow = Slow(str(tmp_path / "s"))
    answer = requests.encode_call(requests.IoctlCall(requests.EVIOCGID, 0, bytes(8)))
    slow.sock.send(answer)
    assert slow.link.read(0.1) == answer
    slow.close()


def test_feedback_does_not_wait_for_a_device_that_hangs():
    assert packet_socket.FEEDBACK_TIMEOUT_S <= 0.05
    waits_s = shell.READ_TIMEOUT_S + shell.ANSWER_TIMEOUT_S + packet_socket.FEEDBACK_TIMEOUT_S
    assert waits_s < UNREAD_AFTER_S


@pytest.mark.parametrize("fault", ["dropped", "short", "garbage"])
def test_mangled_packets_are_counted_and_survived(tmp_path, fault):
    script = "0.0 hold start for 0.03\n0.1 swing 0.9 0.9 0.9 0.9 over 0.1 times 20\n2.5 neutral"
    counter = "dropped" if fault == "dropped" else "garbled"
    with (
        in_a_thread(peer(tmp_path, script=script, faults={fault: 20.0})) as served,
        gamepad(tmp_path) as pad,
    ):
        until(lambda: pad.metrics()[counter] >= 3, "not counted")
        assert served.device.plugged
        assert pad.state().link is not DeviceLink.LOST
        until(lambda: pad.state().link is DeviceLink.LIVE, "not live again")


def test_nobody_serves_the_socket(tmp_path):
    with pytest.raises(DeviceAccessError, match="is its simulated device running"):
        gamepad(tmp_path).open()
    with gamepad(tmp_path, wait_for_device=True) as pad:
        assert pad.state().link is DeviceLink.LOST
        script = "0.0 hold start for 0.05"
        with in_a_thread(peer(tmp_path, script=script)):
            until(lambda: pad.state().link is DeviceLink.LIVE, "not picked up")
