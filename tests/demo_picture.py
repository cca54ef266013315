"""Generator of docs/images/demo.webp, the animated picture of `make demo` (make demo-picture).

It runs the demo's own simulated SpaceMouse, session and simulated GoFa with their motion script,
and records the session. It draws ten snapshots per second: deflections of the device, the arm by
its joints, the path of its TCP, and the messages of the session.
"""

from __future__ import annotations

import itertools
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from mcap.reader import make_reader
from PIL import Image, ImageColor, ImageDraw, ImageFont

from cardan.demos.examples import find_demos
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.robots import load_arm
from tests.serving import free_endpoint, free_udp_port, served

TARGET = Path(__file__).parents[1] / "docs" / "images" / "demo.webp"
LARGEST_BYTES = 300_000
SECONDS = 21.0
FRAME_S = 0.1
"""Time between snapshots of the session."""

WIDTH, HEIGHT = 680, 360
FINER = 2
"""Supersampling factor, for lines without steps."""

SHADES = (1.0, 0.75, 0.5, 0.25, 0.0)
"""Shades of each color on paper, for the edges: areas of few colors make a small lossless file."""

SHORTEST_MM = 300.0
"""Least length of the TCP's path if the demo armed, which needs a device at rest first."""
INK, FAINT, PAPER = "#1f2937", "#cbd5e1", "#ffffff"
ARM, JOINT, PATH, HAND = "#475569", "#f8fafc", "#0d9488", "#d97706"
PHASES = {"moving": "#0d9488", "holding": "#2563eb"}
AXES = ("x", "y", "z", "roll", "pitch", "yaw")

SCALE = 250.0
"""Pixels per meter."""
ORIGIN = (390.0, 298.0)
"""Position of the arm's base in the picture, pixels."""
TURN = math.radians(-28.0)
TILT = math.radians(18.0)
"""Elevation of the viewpoint, which is to the right of the arm."""


def recorded(folder: Path) -> list[dict[str, Any]]:
    """Run a session with the demo's configuration; return its snapshots."""
    demo = find_demos()["gofa"]
    port, endpoint = free_udp_port(), free_endpoint()
    text = demo.file.read_text(encoding="utf-8").replace(
        "listen_port = 6510", f"listen_port = {port}"
    )
    text = text.replace('"spacemouse.sock"', f'"{folder}/spacemouse.sock"\nwait_for_device = true')
    file, record = folder / "demo.toml", folder / "demo.mcap"
    file.write_text(f'{text}\n[network]\nrouter = ""\nlisten = ["{endpoint}"]\n', encoding="utf-8")
    words = ["run", str(file), "--record", str(record), "--seconds", str(SECONDS)]
    said = folder / "said"
    with said.open("w") as printed, served("sim", "abb-gofa", "--to", f"127.0.0.1:{port}"):
        session = subprocess.Popen([sys.executable, "-m", "cardan", *words], stdout=printed)
        while "robot live" not in said.read_text(encoding="utf-8") and session.poll() is None:
            time.sleep(FRAME_S)
        # The device appears when the session is ready: a deflection held before does not move the
        # arm.
        with served("sim", "spacemouse", "--hid", f"{folder}/spacemouse.sock", "--script", "demo"):
            if session.wait():
                sys.exit("the session failed")
    with record.open("rb") as opened:
        return [
            json.loads(message.data[8:].rstrip(b"\0"))  # std_msgs/String in CDR
            for _, channel, message in make_reader(opened).iter_messages()
            if channel.topic.endswith("/state/snapshot")
        ]


class Drawing:
    """Draws the snapshots in their order."""

    def __init__(self) -> None:
        kinematics = ArmKinematics(load_arm("gofa_crb15000_5"))
        self._model, self._data = kinematics.model, kinematics.model.createData()
        self._path: list[tuple[float, float]] = []

    def frame(self, snapshot: dict[str, Any]) -> Image.Image:
        """Draw a snapshot, and the path up to it."""
        picture = Image.new("RGB", (FINER * WIDTH, FINER * HEIGHT), PAPER)
        self._draw = ImageDraw.Draw(picture)
        self._write(16, 12, "cardan demo", 17, INK)
        reported = "simulated SpaceMouse (HID)  >  gateway  >  simulated ABB GoFa (EGM, 250 Hz)"
        self._write(140, 15, reported, 13, ARM)
        self._device(snapshot)
        self._arm(snapshot)
        self._draw.rectangle((0, FINER * 328, FINER * WIDTH, FINER * HEIGHT), fill=PAPER)
        phase = snapshot["arm"]["phase"]
        self._write(16, 334, phase, 16, PHASES.get(phase, HAND))
        why = (
            snapshot["arm"]["message"]
            or snapshot["device"]["reason"]
            or snapshot["robot"]["hold_reason"]
        )
        self._write(110, 336, why if phase != "moving" else "", 13, INK)
        way = f"{1e3 * snapshot['tracking']['path_m']:.0f} mm in {snapshot['elapsed_s']:.1f} s"
        self._write(530, 336, way, 13, ARM)
        return picture.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS)

    def _device(self, snapshot: dict[str, Any]) -> None:
        """Draw the six deflections as bars, and the held button."""
        self._write(16, 52, "device", 14, INK)
        for at, (name, value) in enumerate(zip(AXES, snapshot["device"]["axes"], strict=True)):
            y = 84 + 30 * at
            self._write(16, y - 9, name, 13, ARM)
            self._line([(70, y), (190, y)], FAINT, 6)
            if abs(value) > 0.01:
                self._line([(130, y), (130 + 60 * value, y)], HAND, 8)
            self._dot((130, y), 3, INK)
        held = bool(snapshot["device"]["buttons"])
        self._dot((25, 276), 8, HAND if held else FAINT)
        self._write(42, 267, "dead-man held" if held else "dead-man not held", 13, ARM)

    def _arm(self, snapshot: dict[str, Any]) -> None:
        """Draw base, joints and TCP from the side, and the path of the TCP."""
        pin.forwardKinematics(self._model, self._data, np.array(snapshot["robot"]["joints_rad"]))
        joints = [np.zeros(3), *(np.array(each.translation) for each in self._data.oMi[1:])]
        tcp = np.array(snapshot["robot"]["pose"][:3])
        self._line([self._seen((x, -0.45, 0.0)) for x in (-0.3, 0.8)], FAINT, 1)
        for y in (-0.45, -0.15, 0.15, 0.45):
            self._line([self._seen((x, y, 0.0)) for x in (-0.3, 0.8)], FAINT, 1)
        for x in (-0.3, 0.07, 0.43, 0.8):
            self._line([self._seen((x, y, 0.0)) for y in (-0.45, 0.45)], FAINT, 1)
        points = [self._seen(each) for each in (*joints, tcp)]
        for at, (one, other) in enumerate(itertools.pairwise(points)):
            self._line([one, other], ARM, 24 - 2.5 * at)
        for at, point in enumerate(points[:-1]):
            self._dot(point, 11.5 - 1.2 * at, ARM)
            self._dot(point, 6 - 0.6 * at, JOINT)
        self._path.append(points[-1])
        if len(self._path) > 1:
            self._line(self._path, PATH, 2.5)
        self._dot(points[-1], 5, PATH)

    def _seen(self, point: Sequence[float]) -> tuple[float, float]:
        """Project a point in the robot's base frame into the picture."""
        x, y, z = point
        across = x * math.cos(TURN) - y * math.sin(TURN)
        away = x * math.sin(TURN) + y * math.cos(TURN)
        return (
            ORIGIN[0] + SCALE * across,
            ORIGIN[1] - SCALE * (z * math.cos(TILT) + away * math.sin(TILT)),
        )

    def _line(self, points: Sequence[tuple[float, float]], color: str, width: float) -> None:
        finer = [(FINER * x, FINER * y) for x, y in points]
        self._draw.line(finer, fill=color, width=round(FINER * width), joint="curve")

    def _dot(self, at: tuple[float, float], radius: float, color: str) -> None:
        x, y, r = FINER * at[0], FINER * at[1], FINER * radius
        self._draw.ellipse((x - r, y - r, x + r, y + r), fill=color)

    def _write(self, x: float, y: float, text: str, size: int, color: str) -> None:
        font = ImageFont.load_default(FINER * size)
        self._draw.text((FINER * x, FINER * y), text, fill=color, font=font)


def alike(frames: Sequence[Image.Image]) -> list[Image.Image]:
    """Reduce the pictures to the same few colors."""
    palette, plain = Image.new("P", (1, 1)), Image.Dither.NONE
    paper = ImageColor.getrgb(PAPER)
    palette.putpalette(
        [
            round(share * one + (1.0 - share) * other)
            for color in (INK, FAINT, ARM, JOINT, PATH, HAND, PHASES["holding"])
            for share in SHADES
            for one, other in zip(ImageColor.getrgb(color), paper, strict=False)
        ]
    )
    return [each.quantize(palette=palette, dither=plain).convert("RGB") for each in frames]


def main() -> None:
    """Record, draw and store the picture."""
    with tempfile.TemporaryDirectory() as folder:
        snapshots = recorded(Path(folder))
    drawing = Drawing()
    if (way_mm := 1e3 * snapshots[-1]["tracking"]["path_m"]) < SHORTEST_MM:
        sys.exit(f"the arm has moved by {way_mm:.0f} mm only: is this machine busy? Try again")
    frames = [
        drawing.frame(each)
        for each in snapshots
        if each["robot"]["joints_rad"] and each["device"]["link"] != "lost" and not each["finished"]
    ]
    first, *others = alike(frames)
    first.save(
        TARGET,
        save_all=True,
        append_images=others,
        duration=round(1000 * FRAME_S),
        loop=0,
        lossless=True,
        quality=60,
        method=4,
        minimize_size=True,
    )
    size = TARGET.stat().st_size
    print(f"{TARGET.name}: {len(others) + 1} pictures, {size} bytes")
    if size > LARGEST_BYTES:
        sys.exit(f"{TARGET.name} is larger than {LARGEST_BYTES} bytes")


if __name__ == "__main__":
    main()
