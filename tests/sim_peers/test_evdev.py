"""Simulated gamepad and keyboard in virtual time, and their backends."""

import errno
import fcntl
import math
import os
import socket
import stat

import pytest
from hypothesis import given, strategies as st

from cardan.errors import AddressError, ConfigurationError, OptionError, ScriptError
from cardan.protocols.evdev import (
    codes as c,
    events as evdev_events,
    requests as evdev_requests,
    uinput,
)
from cardan.sim_peers.base import parse_script
from cardan.sim_peers.evdev import (
    FAULTS,
    MODELS,
    SCRIPT_VERBS,
    SCRIPTS,
    EvdevPeer,
    EvdevPeerOptions,
    ScriptedInput,
    SimulatedInput,
)
from cardan.sim_peers.evdev.backends import UinputBackend
from cardan.sim_peers.scripted import play
from tests.serving import in_a_thread
from tests.sim_peers.backend_shell import BareShell
from tests.waiting import until

BY_KEY = {model.key: model for model in MODELS}
PUSHED = (0.0, 1.0, 0.0, 0.0, 0.0, 0.0)
REST = (0.0,) * 6


def make(model="xbox-360", **settings):
    return SimulatedInput(BY_KEY[model], **settings)


@pytest.fixture
def device():
    return make()


def values(frames, kind):
    return [(code, value) for f in frames for t, code, value in f.events if t == kind]


def test_rests_in_silence(device):
    assert device.reports(0.1) == []
    assert device.reports(3600.0) == []
    assert device.next_due_s == math.inf


def test_reports_changes_only_at_its_polls(device):
    device.reports(0.010)
    device.set_controls(PUSHED)
    (frame,) = device.reports(5.0)
    assert frame.time_s == pytest.approx(0.012)
    assert frame.events == ((3, c.ABS_Y, -32768), (0, 0, 0))
    device.set_controls(PUSHED)
    assert device.reports(9.0) == []


@pytest.mark.parametrize(
    ("model", "pushed", "half"), [("xbox-360", -32768, 64), ("dualshock-4", 0, 64)]
)
def test_ranges_are_the_models(model, pushed, half):
    device = make(model)
    device.set_controls((0.0, 1.0, 0.0, 0.0, 0.25, 0.0))
    frames = device.reports(0.1)
    assert (c.ABS_Y, pushed) in values(frames, evdev_events.EV_ABS)
    assert (c.ABS_Z, half) in values(frames, evdev_events.EV_ABS)
    pressed = values(frames, evdev_events.EV_KEY)
    assert pressed == ([(c.BTN_TL2, 1)] if model == "dualshock-4" else [])


def test_an_xbox_pad_exchanges_north_and_west_as_the_kernel_does():
    for model, code in (("xbox-360", c.BTN_NORTH), ("dualshock-4", c.BTN_WEST)):
        device = make(model)
        device.press("west")
        assert values(device.reports(0.1), evdev_events.EV_KEY) == [(code, 1)]


def test_a_press_between_two_polls_is_not_lost(device):
    device.press("south")
    device.release("south")
    assert values(device.reports(1.0), evdev_events.EV_KEY) == [(c.BTN_SOUTH, 1), (c.BTN_SOUTH, 0)]


def test_dpad_is_a_hat(device):
    device.press("dpad-left")
    assert values(device.reports(0.1), evdev_events.EV_ABS) == [(c.ABS_HAT0X, -1)]
    device.press("dpad-right")
    device.release("dpad-left")
    assert values(device.reports(0.2), evdev_events.EV_ABS) == [(c.ABS_HAT0X, 1)]


def test_keys_are_repeated_as_the_kernel_does():
    device = make("keyboard")
    device.press("a")
    frames = device.reports(0.5)
    assert frames[0].events == ((4, 4, 30), (1, 30, 1), (0, 0, 0))
    repeats = [frame.time_s for frame in frames if (1, 30, 2) in frame.events]
    assert repeats[0] == pytest.approx(0.25, abs=0.01)
    assert len(repeats) == 1 + int((0.5 - repeats[0]) / 0.033)
    device.release("a")
    assert values(device.reports(2.0), evdev_events.EV_KEY)[-1] == (30, 0)
    assert device.next_due_s == math.inf
    assert not make("keyboard", uinput=True).reports(1.0)


def test_noise_is_filtered_as_the_kernel_does():
    quiet, noisy = make(jitter_lsb=5), make(jitter_lsb=200)
    for device in (quiet, noisy):
        device.set_controls((0.0, 0.5, 0.0, 0.0, 0.0, 0.0))
    assert len(quiet.reports(1.0)) <= 3, "less than half of the fuzz"
    assert len(noisy.reports(1.0)) > 100
    noisy.set_controls(REST)
    noisy.reports(1.1)
    assert noisy.reports(2.0) == [], "a stick at rest is quiet"


def call(device, request, argument=b"", client="me", now_s=0.0):
    return device.call(client, request, argument, now_s)


def test_answers_what_it_is_and_holds():
    device = make("xbox-one")
    device.set_controls(PUSHED)
    device.press("east")
    device.reports(0.1)
    assert (
        evdev_requests.decode_id(call(device, evdev_requests.EVIOCGID).argument).product == 0x02EA
    )
    assert call(device, evdev_requests.EVIOCGNAME).argument.startswith(
        b"Microsoft Xbox One S pad\0"
    )
    assert evdev_requests.decode_bits(call(device, evdev_requests.EVIOCGKEY).argument) == {
        c.BTN_EAST
    }
    info = evdev_requests.decode_absinfo(call(device, evdev_requests.eviocgabs(c.ABS_Y)).argument)
    assert info == (-32768, -32768, 32767, 16, 128, 0)
    assert (
        evdev_requests.decode_absinfo(
            call(device, evdev_requests.eviocgabs(c.ABS_RZ)).argument
        ).maximum
        == 1023
    )
    assert evdev_events.EV_FF in evdev_requests.decode_bits(
        call(device, evdev_requests.eviocgbit(0)).argument
    )
    assert call(device, evdev_requests.eviocgabs(c.ABS_GAS)).result == -errno.EINVAL
    assert call(device, 0x12345678).result == -errno.EINVAL
    device.unplug()
    assert call(device, evdev_requests.EVIOCGID).result == -errno.ENODEV


def test_only_one_may_grab():
    device = make("keyboard")
    on, off = evdev_requests.encode_int(1), evdev_requests.encode_int(0)
    assert call(device, evdev_requests.EVIOCGRAB, on).result == 0
    assert call(device, evdev_requests.EVIOCGRAB, on, "you").result == -errno.EBUSY
    assert call(device, evdev_requests.EVIOCGRAB, off, "you").result == -errno.EINVAL
    device.gone("me")
    assert call(device, evdev_requests.EVIOCGRAB, on, "you").result == 0


def upload(device, effect_id=-1, client="me", now_s=0.0, strong=0x8000):
    effect = evdev_requests.Rumble(effect_id, strong, 0x4000, 400)
    return call(
        device, evdev_requests.EVIOCSFF, evdev_requests.encode_rumble(effect), client, now_s
    )


def start(device, effect_id, now_s, value=1, client="me"):
    event = evdev_events.InputEvent(0, 0, evdev_events.EV_FF, effect_id, value)
    device.write(client, evdev_events.encode_events([event]), now_s)


def test_effects_play_for_their_time(device):
    effect_id = evdev_requests.decode_rumble(upload(device).argument).id
    assert device.rumble(0.0) == (0.0, 0.0)
    start(device, effect_id, 1.0)
    assert device.rumble(1.3) == pytest.approx((0.5, 0.25), abs=1e-4)
    assert device.rumble(1.5) == (0.0, 0.0)
    start(device, effect_id, 2.0)
    assert upload(device, effect_id, now_s=2.3, strong=0xFFFF).result == 0
    assert device.rumble(2.6)[0] == 1.0, "an upload restarts a playing effect"
    start(device, effect_id, 2.6, value=0)
    assert device.rumble(2.6) == (0.0, 0.0)


def test_effects_belong_to_the_client_that_uploaded_them(device):
    effect_id = evdev_requests.decode_rumble(upload(device).argument).id
    start(device, effect_id, 0.0, client="you")
    assert device.rumble(0.0) == (0.0, 0.0)
    assert upload(device, effect_id, "you").result == -errno.EACCES
    assert upload(device, 9).result == -errno.EINVAL
    erase = evdev_requests.encode_int(effect_id)
    assert call(device, evdev_requests.EVIOCRMFF, erase, "you").result == -errno.EACCES
    start(device, effect_id, 0.0)
    device.gone("me")
    assert device.rumble(0.0) == (0.0, 0.0)
    for _ in range(16):
        assert upload(device).result == 0
    assert upload(device).result == -errno.ENOSPC
    assert upload(make("keyboard")).result == -errno.EINVAL


@given(st.integers(0, 2**32 - 1), st.binary(max_size=60), st.binary(max_size=60))
def test_nonsense_never_raises(request_number, argument, written):
    device = make()
    device.call("me", request_number, argument, 0.0)
    device.write("me", written, 0.0)


# ---------------------------------------------------------------------------------------------
# Scripts and faults


LONG_LATER = [
    f"{model}-gamepad-{name}"
    for model in BY_KEY
    for name in ("demo", "strokes")
    if model != "xbox-360"
]
"""Cases of the matrix: the long scripts with the other models."""


@pytest.mark.matrix(*LONG_LATER)
@pytest.mark.parametrize(("kind", "name"), [(k, n) for k, v in SCRIPTS.items() for n in v])
@pytest.mark.parametrize("model", BY_KEY)
def test_built_in_scripts_play_to_their_end_and_let_everything_go(kind, name, model):
    device = make(model)
    if device.model.is_gamepad != (kind == "gamepad"):
        return
    motion = ScriptedInput(parse_script(SCRIPTS[kind][name], SCRIPT_VERBS), device)
    frames = play(device, motion, 60.0)
    assert frames
    assert [f.time_s for f in frames] == sorted(f.time_s for f in frames)
    if "loop" not in SCRIPTS[kind][name]:
        assert device.controls == REST
        assert device.held == ()
        assert motion.next_due_s == math.inf


def test_taps_go_on_for_ever():
    device = make("keyboard")
    motion = ScriptedInput(parse_script(SCRIPTS["keyboard"]["taps"], SCRIPT_VERBS), device)
    presses = [
        pair for pair in values(play(device, motion, 21.0), evdev_events.EV_KEY) if pair[1] == 1
    ]
    assert len(presses) >= 30


@pytest.mark.parametrize(
    ("model", "line", "words"),
    [
        ("xbox-360", "1 sticks 0 0 0", "RY is missing"),
        ("xbox-360", "1 sticks 0 0 0 2", "must be a number from -1 to 1"),
        ("xbox-360", "1 triggers 0 0 over", "SECONDS is missing"),
        ("xbox-360", "1 press turbo", "no button 'turbo'"),
        ("xbox-360", "1 hold south", "'for' is missing"),
        ("xbox-360", "0 loop", "must be the last step"),
        ("xbox-360", "1 unplug now", "'now' is too much"),
        ("keyboard", "1 sticks 0 0 0 0", "no sticks"),
    ],
)
def test_scripts_that_make_no_sense(model, line, words):
    with pytest.raises(ScriptError, match=words):
        ScriptedInput(parse_script(line, SCRIPT_VERBS), make(model))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"kind": "mouse"}, "it must be one of gamepad, keyboard"),
        ({"model": "keyboard"}, "it must be one of xbox-360"),
        ({"script": "nowhere"}, "neither a file"),
        ({"jitter_lsb": -1}, "it must be 0 to"),
        ({"faults": {"fire": 1.0}}, "no fault 'fire'"),
        ({"faults": {"replug": 1.0}}, "needs the fault unplug"),
        ({"kind": "keyboard", "faults": {"drift": 0.1}}, "neither sticks nor motors"),
        ({"path": "", "uinput": True, "faults": {"dropped": 5.0}}, "the kernel does not let"),
    ],
)
def test_peers_that_make_no_sense(options, words):
    error = OptionError if "it must be" in words else ScriptError
    with pytest.raises(error, match=words):
        EvdevPeer(EvdevPeerOptions(**{"path": "socket", **options}))


@pytest.mark.parametrize("options", [{"path": ""}, {"path": "socket", "uinput": True}])
def test_it_is_a_socket_or_a_device_of_the_kernel(options):
    with pytest.raises(ConfigurationError, match="either the path of a socket or uinput"):
        EvdevPeer(EvdevPeerOptions(**options))


def test_every_fault_can_be_had_by_some_device():
    for switch in FAULTS:
        faults = {switch.name: switch.default}
        if switch.name == "replug":
            faults["unplug"] = 1.0
        assert make(faults=faults)


@pytest.mark.parametrize("fault", ["silence", "unplug"])
def test_silence_and_unplugging_end_the_events(fault):
    device = make(faults={fault: 0.5})
    device.set_controls(PUSHED)
    assert device.reports(0.4)
    device.set_controls(REST)
    device.press("south")
    device.reports(0.6)
    device.release("south")
    assert device.reports(9.0) == []
    assert device.plugged == (fault == "silence")
    assert device.next_due_s == math.inf


# ---------------------------------------------------------------------------------------------
# The socket


def connect(path):
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    sock.settimeout(5.0)
    sock.connect(path)
    return sock


def test_a_client_that_does_not_read_loses_events_as_with_the_kernel(tmp_path):
    script = tmp_path / "script"
    script.write_text("0.0 swing 1 1 1 1 over 0.2 times 20")
    path = str(tmp_path / "s")
    options = EvdevPeerOptions(path=path, script=str(script))
    with in_a_thread(EvdevPeer(options)) as peer, connect(path) as sock:
        until(lambda: peer.backend.lost, "a loss")
        seen = []
        while (0, 3, 0) not in seen:
            packet = sock.recv(4096)
            seen += [event[2:] for event in evdev_events.decode_events(packet)]
        assert seen[seen.index((0, 3, 0)) + 1] == (0, 0, 0)


def test_grabbed_events_reach_one_client_alone(tmp_path):
    path = str(tmp_path / "s")
    script = tmp_path / "script"
    script.write_text("0.3 hold a for 0.1")
    options = EvdevPeerOptions(kind="keyboard", path=path, script=str(script))
    with in_a_thread(EvdevPeer(options)), connect(path) as mine, connect(path) as other:
        request = evdev_requests.IoctlCall(
            evdev_requests.EVIOCGRAB, 0, evdev_requests.encode_int(1)
        )
        mine.send(evdev_requests.encode_call(request))
        assert evdev_requests.decode_call(mine.recv(4096)).result == 0
        assert len(evdev_events.decode_events(mine.recv(4096))) == 3
        other.settimeout(0.05)
        with pytest.raises(TimeoutError):
            other.recv(4096)


# ---------------------------------------------------------------------------------------------
# uinput, with a file for /dev/uinput


@pytest.fixture
def fake_uinput(tmp_path, monkeypatch):
    """Replace /dev/uinput by a FIFO; return the requests to it."""
    (tmp_path / "dev").mkdir()
    os.mkfifo(tmp_path / "dev/uinput")
    (tmp_path / "sys/devices/virtual/input/input9/event5").mkdir(parents=True)
    asked = []

    def ioctl(fd, request, argument=0, mutate=False):
        assert stat.S_ISFIFO(os.fstat(fd).st_mode)
        asked.append((request, argument if isinstance(argument, int) else bytes(argument)))
        if request == uinput.UI_GET_SYSNAME:
            argument[:7] = b"input9\0"
        elif request == uinput.UI_BEGIN_FF_UPLOAD:
            argument[8:56] = evdev_requests.encode_rumble(evdev_requests.Rumble(2, 0xFFFF, 0, 400))
        elif request == uinput.UI_BEGIN_FF_ERASE:
            argument[8:12] = evdev_requests.encode_int(2)
        return 0

    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    return tmp_path, asked


def test_uinput_makes_the_device_and_serves_the_kernel(fake_uinput):
    root, asked = fake_uinput
    device = make(uinput=True)
    shell = BareShell()
    shell.now_s = 1.0
    backend = UinputBackend(device, root)
    with shell.selector as selector:
        backend.open(shell)
        backend.appear()
        assert backend.endpoint == "/dev/input/event5"
        requests = [request for request, _ in asked]
        assert requests[-3:] == [uinput.UI_DEV_SETUP, uinput.UI_DEV_CREATE, uinput.UI_GET_SYSNAME]
        assert (uinput.UI_SET_FFBIT, c.FF_RUMBLE) in asked
        assert (uinput.UI_SET_KEYBIT, c.BTN_SOUTH) in asked
        setup = dict(asked)[uinput.UI_DEV_SETUP]
        assert setup[:8] == bytes.fromhex("0300 5e04 8e02 1001")
        assert setup[8:].startswith(b"Microsoft X-Box 360 pad\0")

        def kernel_says(*events):
            """Send events to the creator of the device, like the kernel."""
            fd = os.open(root / "dev/uinput", os.O_RDWR | os.O_NONBLOCK)
            os.write(
                fd,
                evdev_events.encode_events(
                    evdev_events.InputEvent(0, 0, *event) for event in events
                ),
            )
            for key, _ in selector.select(1.0):
                key.data()
            os.close(fd)

        kernel_says((evdev_events.EV_UINPUT, uinput.UI_FF_UPLOAD, 77))
        assert asked[-1][0] == uinput.UI_END_FF_UPLOAD
        assert asked[-1][1][:8] == bytes.fromhex("4d000000 00000000")
        kernel_says((evdev_events.EV_FF, 2, 1))
        assert device.rumble(1.1) == (1.0, 0.0)
        kernel_says((evdev_events.EV_UINPUT, uinput.UI_FF_ERASE, 78))
        assert device.rumble(1.1) == (0.0, 0.0)

        device.press("south")
        backend.send(device.reports(0.1))
        backend.vanish()
        assert asked[-1][0] == uinput.UI_DEV_DESTROY
        assert not backend.there


def test_without_uinput(tmp_path):
    shell = BareShell()
    with shell.selector:
        backend = UinputBackend(make(uinput=True), tmp_path)
        backend.open(shell)
        with pytest.raises(AddressError, match="modprobe uinput"):
            backend.appear()
        assert not backend.there
