"""Chromium by the DevTools protocol, as far as the demo of the console and its tests need it to
read and operate a page."""

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
"""Longest wait for a browser's answer on a busy computer."""

LEAVE_S = 10.0
"""Longest time for an orderly end; then the browser is killed."""

PROGRAMS = ("chromium", "chromium-headless-shell", "chromium-browser", "google-chrome")

ENDS_WITH_PARENT = 'exec 3<&0; (cat <&3 >/dev/null; kill 0) & "$@" </dev/null'
"""Shell command that runs a command as a process group and ends the group together with the parent
process, when the kernel closes standard input. Debian's browsers are started by scripts."""

REBOUND = "rebound.example"
"""A foreign host name that resolves to this computer in the browser, as in DNS rebinding."""

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
    # The tests check the page's own rules about hidden pages, not the browser's about idle pages.
    "--disable-background-timer-throttling",
    # A foreign host name that resolves to this computer.
    f"--host-resolver-rules=MAP {REBOUND} 127.0.0.1",
    "--remote-debugging-port=0",
)


def find_chromium() -> str | None:
    """Path of a browser; None if there is none."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


class Tab:
    """A page in the browser."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self._ids = itertools.count(1)
        self.events: list[dict[str, Any]] = []

    def tell(self, method: str, **parameters: Any) -> int:
        """Send a command without waiting for its result; return its number."""
        number = next(self._ids)
        self._connection.send(json.dumps({"id": number, "method": method, "params": parameters}))
        return number

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Result of a command. Raises RuntimeError if the browser refuses it."""
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
        """Value of an expression in the page. Raises RuntimeError for its exceptions."""
        answer = self.ask(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def until(self, expression: str, within_s: float = WAIT_S) -> Any:
        """Wait until an expression of the page is true; return its value. Raises DriverError after
        a time limit."""
        end_s = time.monotonic() + within_s
        while not (value := self.value(expression)):
            if time.monotonic() > end_s:
                raise DriverError(f"in the page this was not true in time: {expression}")
            time.sleep(0.05)
        return value

    def resize(self, width: int, height: int) -> None:
        """Show the page on a screen of this size; a narrow one emulates a phone."""
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
        """Scroll an element into view and return the place of its center."""
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
        """Send mousePressed, mouseReleased or mouseMoved of one button. `buttons` is the bit mask
        of pressed buttons, as in browsers: 1 left, 2 right, 4 middle; default: left, unless
        released."""
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
        """Press and release the left button on an element."""
        at = self.center(selector)
        self.mouse("mousePressed", at)
        self.mouse("mouseReleased", at)

    def key(self, kind: str, key: str, code: str = "") -> None:
        """Send keyDown or keyUp."""
        text = {"text": key} if kind == "keyDown" and len(key) == 1 else {}
        self.ask("Input.dispatchKeyEvent", type=kind, key=key, code=code or key, **text)

    def touch(self, kind: str, *points: tuple[float, float]) -> None:
        """Send touchStart, touchMove, touchEnd or touchCancel."""
        touched = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
        self.ask("Input.dispatchTouchEvent", type=kind, touchPoints=touched)

    def fingers(self, kind: str, points: dict[int, tuple[float, float]]) -> None:
        """Send touchStart or touchMove with these fingers on the screen, after another one was
        lifted."""
        touched = [{"x": x, "y": y, "id": number} for number, (x, y) in points.items()]
        self.ask("Input.dispatchTouchEvent", type=kind, touchPoints=touched)

    def picture(self) -> bytes:
        """Screenshot of the page as a WebP file."""
        shot = self.ask("Page.captureScreenshot", format="webp", quality=80)
        return base64.b64decode(shot["data"])

    def complaints(self) -> list[str]:
        """Return the console messages, policy violations and exceptions of the page so far."""
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
    """A running browser. Each page is shown in a separate window."""

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
        """Stop all processes of the browser, as a suspended computer does, and continue them."""
        os.killpg(self._process, signal.SIGSTOP)
        try:
            time.sleep(seconds)
        finally:
            os.killpg(self._process, signal.SIGCONT)

    def hang(self, seconds: float) -> None:
        """Stop the main process alone: its pages keep running but receive no input."""
        main = self._main()
        os.kill(main, signal.SIGSTOP)
        try:
            time.sleep(seconds)
        finally:
            os.kill(main, signal.SIGCONT)

    def _main(self) -> int:
        """Main process: the one of the process group with a debugging port, not a child process."""
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
        """Open `address` in a page of this size. `scripts` run before the page's own scripts;
        `asks` are commands sent before it loads."""
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
                with contextlib.suppress(RuntimeError):  # already closed
                    control.ask("Target.closeTarget", targetId=target)

    @contextlib.contextmanager
    def in_front(self) -> Iterator[None]:
        """Open another tab in front of the page that was shown last."""
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
    """Run a browser with an empty profile in `folder`; it ends with the context, and with this
    process. `flags`: additional flags. Raises DriverError if the browser cannot be started."""
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
            # after an orderly end, the browser has released its profile
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
