"""Chromium by the DevTools protocol: enough of it to see a page and to touch it, as the demo of the
console and its tests do."""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import time
import urllib.request
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from cardan.errors import DriverError

WAIT_S = 120.0
"""Longest wait for a browser on a busy computer."""

LEAVE_S = 10.0
"""Longest time for its end in good order; then it is killed."""

PROGRAMS = ("chromium", "chromium-headless-shell", "chromium-browser", "google-chrome")

ENDS_WITH_PARENT = 'exec 3<&0; (cat <&3 >/dev/null; kill 0) & "$@" </dev/null'
"""A command and what it starts, as one group of processes, which ends with the one that launched
it: the kernel closes its standard input then. Debian's browsers are started by scripts."""

REBOUND = "rebound.example"
"""A foreign name that the browser finds at this computer, as a page of DNS rebinding is."""

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--accept-lang=en-US",
    # The page's own rules about hidden pages are judged, not the browser's about idle ones.
    "--disable-background-timer-throttling",
    # A foreign host name that resolves to this computer.
    f"--host-resolver-rules=MAP {REBOUND} 127.0.0.1",
    "--remote-debugging-port=0",
)


def find_chromium() -> str | None:
    """The path of a browser; None: there is none."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


class Tab:
    """Page of the browser."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self._ids = itertools.count(1)
        self.events: list[dict[str, Any]] = []

    def tell(self, method: str, **parameters: Any) -> int:
        """Send a command without waiting for its answer; return its number."""
        number = next(self._ids)
        self._connection.send(json.dumps({"id": number, "method": method, "params": parameters}))
        return number

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The result of a command. Raises RuntimeError where the browser refuses it."""
        number = self.tell(method, **parameters)
        end_s = time.monotonic() + WAIT_S
        while True:
            message = json.loads(self._connection.recv(timeout=max(0.0, end_s - time.monotonic())))
            if message.get("id") != number:
                self.events.append(message)
                continue
            if "error" in message:
                raise RuntimeError(f"{method}: {message['error']}")
            result: dict[str, Any] = message["result"]
            return result

    def value(self, expression: str) -> Any:
        """The value of an expression in the page. Raises RuntimeError for its exceptions."""
        answer = self.ask(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def until(self, expression: str, within_s: float = WAIT_S) -> Any:
        """Wait until an expression of the page is true; its value. Raises DriverError where it is
        not in time."""
        end_s = time.monotonic() + within_s
        while not (value := self.value(expression)):
            if time.monotonic() > end_s:
                raise DriverError(f"in the page this was not true in time: {expression}")
            time.sleep(0.05)
        return value

    def resize(self, width: int, height: int) -> None:
        """Show the page on a screen of this size, a phone's where it is narrow."""
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )

    def photograph(self, path: Path) -> None:
        """Write a screenshot of the page as a PNG file."""
        path.write_bytes(base64.b64decode(self.ask("Page.captureScreenshot")["data"]))

    def center(self, selector: str) -> tuple[float, float]:
        """Where an element is, scrolled into sight."""
        x, y = self.value(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            "e.scrollIntoView({block: 'center'}); const b = e.getBoundingClientRect();"
            "return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        return float(x), float(y)

    def mouse(
        self,
        kind: str,
        at: tuple[float, float],
        button: str = "left",
        buttons: int | None = None,
    ) -> None:
        """mousePressed, mouseReleased or mouseMoved, of one button; `buttons` are down then, as
        browsers count them: 1 left, 2 right, 4 middle; default: the left one unless released."""
        self.ask(
            "Input.dispatchMouseEvent",
            type=kind,
            x=at[0],
            y=at[1],
            button=button,
            buttons=int(kind != "mouseReleased") if buttons is None else buttons,
            clickCount=1,
        )

    def click(self, selector: str) -> None:
        """As a person does."""
        at = self.center(selector)
        self.mouse("mousePressed", at)
        self.mouse("mouseReleased", at)

    def key(self, kind: str, key: str, code: str = "") -> None:
        """keyDown or keyUp."""
        text = {"text": key} if kind == "keyDown" and len(key) == 1 else {}
        self.ask("Input.dispatchKeyEvent", type=kind, key=key, code=code or key, **text)

    def touch(self, kind: str, *points: tuple[float, float]) -> None:
        """touchStart, touchMove, touchEnd or touchCancel."""
        touched = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
        self.ask("Input.dispatchTouchEvent", type=kind, touchPoints=touched)

    def fingers(self, kind: str, points: dict[int, tuple[float, float]]) -> None:
        """touchStart or touchMove with these fingers on the screen: another one was lifted."""
        touched = [{"x": x, "y": y, "id": number} for number, (x, y) in points.items()]
        self.ask("Input.dispatchTouchEvent", type=kind, touchPoints=touched)

    def picture(self) -> bytes:
        """The page as a WebP file."""
        shot = self.ask("Page.captureScreenshot", format="webp", quality=80)
        return base64.b64decode(shot["data"])

    def complaints(self) -> list[str]:
        """Return the messages of the page's console, its policy and exceptions so far."""
        self.value("1")
        found = []
        for event in self.events:
            parameters = event.get("params", {})
            if event["method"] == "Runtime.exceptionThrown":
                found.append(str(parameters["exceptionDetails"]))
            elif event["method"] == "Log.entryAdded":
                entry = parameters["entry"]
                if entry["level"] in ("error", "warning"):
                    found.append(f"{entry['text']} {entry.get('url', '')}")
            elif event["method"] == "Runtime.consoleAPICalled" and parameters["type"] == "error":
                found.append(str(parameters["args"]))
        return found


class Browser:
    """A running browser. Each page has a window of its own, and is shown in it."""

    def __init__(self, port: int, process: int) -> None:
        self._http = f"http://127.0.0.1:{port}/json"
        self._process = process

    @contextlib.contextmanager
    def control(self) -> Iterator[Tab]:
        """Connect to the target that controls the whole browser."""
        with urllib.request.urlopen(f"{self._http}/version", timeout=WAIT_S) as answer:
            address = json.load(answer)["webSocketDebuggerUrl"]
        with _connected(address) as connection:
            yield Tab(connection)

    def stand_still(self, seconds: float) -> None:
        """Stop all of its processes, as a computer does that falls asleep, and let them go on."""
        os.killpg(self._process, signal.SIGSTOP)
        try:
            time.sleep(seconds)
        finally:
            os.killpg(self._process, signal.SIGCONT)

    def hang(self, seconds: float) -> None:
        """Stop its main process alone: its pages run on, and hear of no input."""
        main = self._main()
        os.kill(main, signal.SIGSTOP)
        try:
            time.sleep(seconds)
        finally:
            os.kill(main, signal.SIGCONT)

    def _main(self) -> int:
        """Its main process: the one of its group that debuggers connect to, and no helper of it."""
        for each in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                words = (each / "cmdline").read_bytes().split(b"\0")
                own = os.getpgid(int(each.name)) == self._process and len(words) > 1
                helps = any(word.startswith(b"--type=") for word in words)
                if own and words[1].startswith(b"--") and not helps:
                    return int(each.name)
        raise DriverError("the browser's main process is not there any more")

    @contextlib.contextmanager
    def open(
        self,
        address: str,
        width: int = 1280,
        height: int = 800,
        *,
        scripts: Sequence[str] = (),
        asks: Sequence[tuple[str, dict[str, Any]]] = (),
    ) -> Iterator[Tab]:
        """A page of this size, which loads `address`. `scripts` run before its own; `asks`:
        commands before it loads."""
        with self.control() as control:
            made = control.ask("Target.createTarget", url="about:blank", newWindow=True)
            target = made["targetId"]
            page = self._http.replace("http", "ws").replace("/json", f"/devtools/page/{target}")
            try:
                with _connected(page) as connection:
                    tab = Tab(connection)
                    for domain in ("Page", "Runtime", "Log"):
                        tab.ask(f"{domain}.enable")
                    tab.resize(width, height)
                    for source in scripts:
                        tab.ask("Page.addScriptToEvaluateOnNewDocument", source=source)
                    for method, parameters in asks:
                        tab.ask(method, **parameters)
                    tab.ask("Page.navigate", url=address)
                    yield tab
            finally:
                with contextlib.suppress(RuntimeError):  # It is closed already.
                    control.ask("Target.closeTarget", targetId=target)

    @contextlib.contextmanager
    def in_front(self) -> Iterator[None]:
        """Another tab, in front of the page that was shown last."""
        request = urllib.request.Request(f"{self._http}/new?about:blank", method="PUT")
        with urllib.request.urlopen(request, timeout=WAIT_S) as answer:
            target = json.load(answer)["id"]
        try:
            yield
        finally:
            urllib.request.urlopen(f"{self._http}/close/{target}", timeout=WAIT_S).close()


def _connected(address: str) -> ClientConnection:
    return connect(
        address, compression=None, max_size=None, open_timeout=WAIT_S, ping_interval=None
    )


@contextlib.contextmanager
def chromium(program: str, folder: Path, flags: Sequence[str] = ()) -> Iterator[Browser]:
    """A browser with a profile of its own in `folder`, which ends after, and with this process.
    `flags`: further ones. Raises DriverError where it cannot be started."""
    marker = folder / "DevToolsActivePort"
    words = [program, *FLAGS, *flags, f"--user-data-dir={folder}", "about:blank"]
    process = subprocess.Popen(
        ["sh", "-c", ENDS_WITH_PARENT, "sh", *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        end_s = time.monotonic() + WAIT_S
        while not (marker.exists() and marker.read_text().count("\n")):
            if process.poll() is not None:
                raise DriverError(f"{program} ended with {process.returncode}")
            if time.monotonic() > end_s:
                raise DriverError(f"{program} opened no DevTools within {WAIT_S:.0f} s")
            time.sleep(0.05)
        port, path = marker.read_text().split()
        try:
            yield Browser(int(port), process.pid)
        finally:
            # In good order: the browser has released its profile when its process has ended.
            with (
                contextlib.suppress(OSError, WebSocketException, subprocess.TimeoutExpired),
                connect(f"ws://127.0.0.1:{port}{path}", open_timeout=LEAVE_S) as connection,
            ):
                Tab(connection).ask("Browser.close")
                process.wait(LEAVE_S)
    finally:
        assert process.stdin is not None
        process.stdin.close()
        try:
            process.wait(LEAVE_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
