"""The spacenavd-compatible socket: the I/O around the core."""

from __future__ import annotations

import contextlib
import math
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence

from cardan.common.context import enter, leave
from cardan.common.realtime import ask_for_real_time
from cardan.common.serving import interruptible
from cardan.common.sockets import EVERYBODY, OWNER_ONLY, Advice, UnixSocket
from cardan.drivers.base import OperatorDevice
from cardan.errors import DriverError
from cardan.types import ButtonEvent, DeviceFeedback, DeviceLink, DeviceState
from cardan_spnav_server.core import MOTION_PERIOD_S, SpnavServerCore
from cardan_spnav_server.identity import DEFAULT_NAME, DeviceIdentity, identity_of
from cardan_spnav_server.options import SpnavServerOptions

POLL_PERIOD_S = 0.004
"""Period of reading a served device while a program is connected."""

IDLE_PERIOD_S = 0.05
"""Period of checks of device and stop request while no program is connected."""

READS_PER_STEP = 8
"""Most reads from all programs together in one step of some ms: limits the load by a flood of
requests, of up to 16 a read."""

MAX_EDGES = 4096
JOIN_TIMEOUT_S = 2.0

_REQUESTS_BYTES = 512
_BACKLOG = 8
_SMALLEST_BUFFER = 1
"""Minimizes the kernel buffer (about six records): newer motion waits here, where it is merged."""

_MODES = {"owner": OWNER_ONLY, "everybody": EVERYBODY}
_ADVICE = Advice(served="end that (spacenavd?), or choose another path")


class SpnavServer:
    """Serves `core` at a Unix socket. Call `step` often; it does all the work."""

    def __init__(self, core: SpnavServerCore, options: SpnavServerOptions) -> None:
        self._core = core
        self._options = options
        self._listener: socket.socket | None = None
        self._offered: UnixSocket | None = None
        self._selector: selectors.BaseSelector | None = None
        self._sockets: dict[int, socket.socket] = {}
        self._numbers: dict[socket.socket, int] = {}

    @property
    def endpoint(self) -> str:
        """The socket's path."""
        return self._options.socket

    __enter__ = enter
    __exit__ = leave

    def open(self) -> None:
        """Create the socket, in place of an abandoned one. May be called twice.

        Raises AddressError if another program serves there, or it cannot be created.
        """
        if self._listener is not None:
            return
        options = self._options
        selector = selectors.DefaultSelector()
        try:
            offered = UnixSocket(
                options.socket, socket.SOCK_STREAM, _MODES[options.access], _ADVICE
            )
        except BaseException:
            selector.close()
            raise
        listener = offered.sock
        listener.listen(_BACKLOG)
        selector.register(listener, selectors.EVENT_READ)
        self._offered, self._listener, self._selector = offered, listener, selector

    def step(self, until_s: float) -> None:
        """Serve until the monotonic time `until_s`."""
        selector = self._selector
        if selector is None:
            return
        reads = 0
        while True:
            now_s = time.monotonic()
            self._core.advance(now_s)
            self._flush(now_s)
            if now_s >= until_s:
                return
            wait_s = max(0.0, min(until_s, self._core.next_due_s()) - now_s)
            if reads >= READS_PER_STEP:
                time.sleep(wait_s)
                continue
            for key, ready in selector.select(wait_s):
                if key.fileobj is self._listener:
                    self._accept()
                elif ready & selectors.EVENT_READ:
                    assert isinstance(key.fileobj, socket.socket)
                    self._read(key.fileobj)
                else:
                    continue
                reads += 1

    def close(self) -> None:
        """Disconnect all programs and remove the socket. Never raises; may be called twice."""
        for sock in tuple(self._numbers):
            self._drop(sock)
        if self._selector is not None:
            self._selector.close()
            self._selector = None
        offered, self._offered, self._listener = self._offered, None, None
        if offered is not None:
            offered.close()

    def _accept(self) -> None:
        assert self._listener is not None
        assert self._selector is not None
        try:
            sock, _ = self._listener.accept()
        except OSError:
            return
        number = self._core.connect(time.monotonic())
        if number is None:
            sock.close()
            return
        sock.setblocking(False)
        with contextlib.suppress(OSError):
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SMALLEST_BUFFER)
        self._sockets[number] = sock
        self._numbers[sock] = number
        self._selector.register(sock, selectors.EVENT_READ)

    def _read(self, sock: socket.socket) -> None:
        number = self._numbers.get(sock)
        if number is None:
            return
        try:
            data = sock.recv(_REQUESTS_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(sock)
            return
        try:
            self._core.receive(number, data, time.monotonic())
        except Exception as error:  # An error of this program's request; the others continue.
            self._core.give_up(number, f"its request failed: {error!r}")

    def _flush(self, now_s: float) -> None:
        """Send as much as the clients' buffers have room for."""
        core = self._core
        for number, _ in core.given_up():
            if number in self._sockets:
                self._drop(self._sockets[number])
        for number, sock in tuple(self._sockets.items()):
            blocked = False
            try:
                while record := core.outgoing(number, now_s):
                    core.sent(number, sock.send(record))
            except BlockingIOError:
                blocked = True
            except OSError:
                self._drop(sock)
                continue
            except Exception as error:  # An error of this program's settings; the others continue.
                core.give_up(number, f"its data could not be sent: {error!r}")
            self._watch(sock, selectors.EVENT_READ | (selectors.EVENT_WRITE if blocked else 0))

    def _watch(self, sock: socket.socket, events: int) -> None:
        assert self._selector is not None
        if self._selector.get_key(sock).events != events:
            self._selector.modify(sock, events)

    def _drop(self, sock: socket.socket) -> None:
        number = self._numbers.pop(sock)
        del self._sockets[number]
        self._core.disconnect(number)
        assert self._selector is not None
        self._selector.unregister(sock)
        sock.close()


class SpnavService:
    """Server in a separate thread for a control loop that offers it states.

    `buttons` are the device's, in the order of their numbers, and `identity` is that for programs;
    either may be a function, called from the thread once the device is plugged in. The loop owns
    the device and its LED; programs only observe.
    """

    def __init__(
        self,
        buttons: Sequence[str] | Callable[[], Sequence[str]],
        options: SpnavServerOptions | None = None,
        identity: DeviceIdentity | Callable[[], DeviceIdentity] | None = None,
    ) -> None:
        options = options or SpnavServerOptions()
        reported = identity or DeviceIdentity(options.name or DEFAULT_NAME)
        self._buttons = buttons if callable(buttons) else lambda: buttons
        self._identify = reported if callable(reported) else lambda: reported
        self._core = SpnavServerCore(full_scale=options.full_scale)
        self._server = SpnavServer(self._core, options)
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._failure = ""
        self._state: DeviceState | None = None
        self._edges: deque[ButtonEvent] = deque(maxlen=MAX_EDGES)
        self._offers = 0

    def start(self) -> None:
        """Create the socket and begin to serve. May be called twice. Raises AddressError."""
        if self._thread is not None:
            return
        self._server.open()
        self._stop = threading.Event()
        self._failure = ""
        self._thread = threading.Thread(
            target=self._run, args=(self._stop,), name="cardan-spnav", daemon=True
        )
        self._thread.start()

    def offer(self, state: DeviceState, events: Sequence[ButtonEvent]) -> None:
        """Pass on the device's newest state, and its button events since the last offer. Never
        blocks or raises."""
        if events:
            self._edges.extend(events)
        self._state = state
        self._offers += 1

    def stop(self) -> None:
        """Stop, and remove the socket. Never raises; may be called twice."""
        if self._thread is None:
            return
        self._stop.set()
        self._thread.join(JOIN_TIMEOUT_S)
        self._thread = None

    def metrics(self) -> dict[str, float]:
        """Programs connected now, and counts."""
        return self._core.metrics()

    def diagnosis(self) -> tuple[str, ...]:
        """Return the warnings, worst first."""
        return (*((self._failure,) if self._failure else ()), *self._core.diagnosis())

    def _run(self, stop: threading.Event) -> None:
        offers = 0
        try:
            while not stop.is_set():
                now_s = time.monotonic()
                newest = self._offers
                edges = self._taken_edges()
                if self._state is not None and (newest != offers or edges):
                    _offer(self._core, self._state, edges, now_s, self._buttons, self._identify)
                    offers = newest
                period_s = MOTION_PERIOD_S if self._core.clients else IDLE_PERIOD_S
                self._server.step(now_s + period_s)
        except BaseException as error:
            self._failure = f"the socket for spacenavd's programs is not served: {error!r}"
            raise
        finally:
            self._server.close()

    def _taken_edges(self) -> list[ButtonEvent]:
        edges: list[ButtonEvent] = []
        with contextlib.suppress(IndexError):
            while True:
                edges.append(self._edges.popleft())
        return edges


def serve_device(
    device: OperatorDevice,
    options: SpnavServerOptions | None = None,
    seconds: float | None = None,
    identity: DeviceIdentity | None = None,
) -> None:
    """Serve `device` to spacenavd's programs until `seconds` are over or a signal ends it.

    Opens it, prints READY and the socket's path, and closes it in the end. Programs may switch its
    LED, and get `identity`; None: that of its model. Raises DriverError if the device cannot be
    opened or the socket cannot be served.
    """
    end_s = math.inf if seconds is None else time.monotonic() + seconds
    with interruptible() as stop:
        serve_until(device, options, _print_ready, stop, end_s, identity)


def _print_ready(endpoint: str) -> None:
    print(f"READY {endpoint}", flush=True)


def serve_until(
    device: OperatorDevice,
    options: SpnavServerOptions | None,
    ready: Callable[[str], None],
    stop: threading.Event,
    end_s: float = math.inf,
    identity: DeviceIdentity | None = None,
) -> None:
    """Serve `device` until `stop` is set, or the monotonic time `end_s`; `ready` is called with the
    socket's path."""
    options = options or SpnavServerOptions()
    with contextlib.ExitStack() as stack:
        stack.enter_context(device)
        capabilities = device.capabilities

        def show(on: bool) -> None:
            with contextlib.suppress(DriverError):  # a device that is unplugged shows nothing
                device.feedback(DeviceFeedback(led=on))

        def buttons() -> Sequence[str]:
            return device.capabilities.buttons

        def identify() -> DeviceIdentity:
            return identity or options.identity or identity_of(device, options.name)

        core = SpnavServerCore(
            full_scale=options.full_scale,
            on_led=show if "led" in capabilities.feedback else None,
        )
        server = stack.enter_context(SpnavServer(core, options))
        # A program takes a pause for a loss, or sees it as a jerk.
        ask_for_real_time()
        ready(server.endpoint)
        while not stop.is_set() and (now_s := time.monotonic()) < end_s:
            _offer(core, device.state(), device.button_events(), now_s, buttons, identify)
            server.step(min(end_s, now_s + (POLL_PERIOD_S if core.clients else IDLE_PERIOD_S)))


def _offer(
    core: SpnavServerCore,
    state: DeviceState,
    edges: Sequence[ButtonEvent],
    now_s: float,
    buttons: Callable[[], Sequence[str]],
    identify: Callable[[], DeviceIdentity],
) -> None:
    """Offer `state`; model and buttons of the device may be known only once it is plugged in."""
    if not core.present and state.link not in (DeviceLink.CLOSED, DeviceLink.LOST):
        core.identify(identify())
        core.name_buttons(buttons())
    core.offer(state, edges, now_s)
