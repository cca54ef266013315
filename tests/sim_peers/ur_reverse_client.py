"""Client of Universal Robots' external control: it expands and uploads the vendor's program,
accepts the connections of the program, and sends commands over them.

Source: Universal_Robots_Client_Library, its script reader and its interfaces of the reverse
connections: big-endian words of 32 bits; a command is a time-out in ms, 6 values and the mode.
"""

from __future__ import annotations

import re
import socket
import struct
import threading
import time
from enum import IntEnum

SCALE = 1_000_000
TIME_SCALE = 1000
COMMAND_WORDS = 8
SCRIPT_WORDS = 28
PERIOD_S = 0.002
PATIENT_MS = 5000
"""Time-out of commands for tests that keep a connection on a busy computer."""
ANSWER_S = 60.0


class Mode(IntEnum):
    """Control modes of the reverse connection."""

    STOPPED = -2
    IDLE = 0
    SERVOJ = 1
    SPEEDJ = 2
    FORWARD = 3
    SPEEDL = 4
    POSE = 5
    FREEDRIVE = 6
    TORQUE = 8


class Point(IntEnum):
    """Kinds of points of a trajectory."""

    MOVEJ = 0
    MOVEL = 1
    MOVEP = 2
    MOVEC = 3
    OPTIMOVEJ = 4
    OPTIMOVEL = 5
    MOVEJ_POSE = 6
    MOVEL_JOINT = 7
    SPLINE = 51


class Command(IntEnum):
    """Commands of the script command connection."""

    ZERO_FTSENSOR = 0
    SET_PAYLOAD = 1
    SET_TOOL_VOLTAGE = 2
    START_FORCE_MODE = 3
    END_FORCE_MODE = 4
    START_TOOL_CONTACT = 5
    END_TOOL_CONTACT = 6
    SET_FRICTION_COMPENSATION = 7
    FT_RTDE_INPUT_ENABLE = 8
    SET_GRAVITY = 9
    SET_TCP_OFFSET = 10


_TAG = re.compile(r"\{%\s*(if|elif|else|endif)\s*(.*?)\s*%\}")
_TEST = re.compile(r"ROBOT_SOFTWARE_VERSION\s*(<|>=)\s*v([\d.]+)")
_CUBIC, _QUINTIC = 1, 2


def expanded(text, version, values):
    """Return the program for a software version of the controller, with the driver's values."""
    text = re.sub(r"\{\{\s*([\w-]+)\s*\}\}", lambda found: str(values[found[1]]), text)
    lines, blocks = [], []
    for line in text.splitlines():
        tag = _TAG.search(line)
        if tag is None:
            if all(shown for shown, _ in blocks):
                lines.append(line)
        elif tag[1] == "if":
            held = _holds(tag[2], version)
            blocks.append((held, held))
        elif tag[1] == "endif":
            blocks.pop()
        else:
            _, before = blocks.pop()
            held = not before and (tag[1] == "else" or _holds(tag[2], version))
            blocks.append((held, before or held))
    return "\n".join(lines)


def _holds(condition, version):
    sign, number = _TEST.fullmatch(condition).groups()
    wanted = tuple(map(int, number.split(".")))
    return version < wanted if sign == "<" else version >= wanted


def scaled(values):
    """Scale values to words of the wire."""
    return [round(each * SCALE) for each in values]


class ReverseClient:
    """Driver's end of the three connections."""

    def __init__(self, text, version, host="127.0.0.1"):
        names = ("SERVER_PORT", "TRAJECTORY_SERVER_PORT", "SCRIPT_COMMAND_SERVER_PORT")
        self._listeners = [socket.create_server((host, 0)) for _ in names]
        self._links = []
        self._sending = None
        values = {
            "BEGIN_REPLACE": "",
            "JOINT_STATE_REPLACE": SCALE,
            "TIME_REPLACE": TIME_SCALE,
            "SERVO_J_REPLACE": "lookahead_time=0.03, gain=2000",
            "SERVER_IP_REPLACE": host,
        }
        for name, each in zip(names, self._listeners, strict=True):
            values[f"{name}_REPLACE"] = each.getsockname()[1]
        body = expanded(text, version, values).replace("\n", "\n\t")
        self.program = f"stop program\ndef externalControl():\n\t{body}\nend\n"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def upload(self, port, host="127.0.0.1"):
        """Send the program to a client interface, and accept its connections."""
        with socket.create_connection((host, port)) as to:
            to.sendall(self.program.encode())
            for each in self._listeners:
                each.settimeout(ANSWER_S)
                link, _ = each.accept()
                link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                link.settimeout(ANSWER_S)
                self._links.append(link)

    def close(self):
        """Close like a killed process."""
        self.pause()
        for each in (*self._links, *self._listeners):
            each.close()

    # -- commands, repeated like those of a control loop --

    def stream(self, mode, values=(), timeout_ms=PATIENT_MS):
        """Repeat a command; numbers are scaled, and a function is called for each repetition."""
        self.pause()
        ended = threading.Event()

        def send():
            while not ended.is_set():
                self.command(mode, values() if callable(values) else values, timeout_ms)
                time.sleep(PERIOD_S)

        thread = threading.Thread(target=send, daemon=True)
        thread.start()
        self._sending = (ended, thread)

    def pause(self):
        """Stop sending."""
        if self._sending is not None:
            ended, thread = self._sending
            self._sending = None
            ended.set()
            thread.join()

    def command(self, mode, values=(), timeout_ms=PATIENT_MS):
        """Send a command once."""
        self.words(mode, scaled(values), timeout_ms)

    def words(self, mode, words=(), timeout_ms=PATIENT_MS):
        """Send a command with unscaled words."""
        padded = [*words, *[0] * (COMMAND_WORDS - 2 - len(words))]
        self._send(0, [timeout_ms, *padded, mode])

    def freedrive(self, on):
        """Begin or end freedrive."""
        self.words(Mode.FREEDRIVE, [1 if on else -1])

    # -- trajectories --

    def trajectory(self, points):
        """Forward points, each with its words and kind; `result` returns the outcome."""
        self.words(Mode.FORWARD, [1, len(points)])
        for each in points:
            self._send(1, each)

    def cancel(self):
        self.words(Mode.FORWARD, [-1, 0])

    def keep(self):
        """Keep a trajectory's connection open."""
        self.words(Mode.FORWARD)

    def result(self):
        """Return the word that the program sends after a trajectory."""
        return self._answer(1)

    def contact(self):
        """Return the word that the program sends about a contact of the tool."""
        return self._answer(2)

    def script(self, command, words=()):
        """Send a single command with unscaled words."""
        self._send(2, [command, *words, *[0] * (SCRIPT_WORDS - 1 - len(words))])

    def _send(self, link, words):
        self._links[link].sendall(struct.pack(f">{len(words)}i", *words))

    def _answer(self, link):
        data = b""
        while len(data) < 4:
            more = self._links[link].recv(4 - len(data))
            assert more, "the program has closed the connection"
            data += more
        return struct.unpack(">i", data)[0]


def moved(kind, goal, speed=1.0, acceleration=1.0, time_s=0.0, blend_m=0.0, via=(0.0,) * 6, mode=0):
    """Return a point of the controller's own motions."""
    third = scaled([speed, acceleration, mode, 0, 0, 0])
    times = [round(time_s * TIME_SCALE), round(blend_m * TIME_SCALE)]
    return [*scaled(goal), *scaled(via), *third, *times, kind]


def splined(goal, speeds, time_s, accelerations=None):
    """Return a point of a cubic spline, or with accelerations of a quintic one."""
    kind = _CUBIC if accelerations is None else _QUINTIC
    third = scaled(accelerations or [0.0] * 6)
    times = [round(time_s * TIME_SCALE), kind]
    return [*scaled(goal), *scaled(speeds), *third, *times, Point.SPLINE]
