"""Peers in C and C++ for comparison, built from the sources in this folder and third-party
libraries.

    python -m bench.native          builds what is missing, and prints what cannot be built
    make bench-peers                the same, with the needed Debian packages

No third-party source is kept here: Pinocchio's headers come from the installed wheels, daqp's C
sources from the source package of the installed version (by pip), Eigen and KDL from Debian
(`tools/debian-packages peers`). Everything is built once, into build/peers. Pinocchio takes a
minute, or more on a busy computer.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import importlib.metadata
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.native.arm import PeerArm, PeerPair, PeerShape, peer_arm, peer_pairs, peer_shape
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.collision import CollisionModel
from cardan.gateway.servo.options import ServoOptions

SOURCES = Path(__file__).parent
BUILD = Path(__file__).parents[2] / "build/peers"

ADVICE = "tools/debian-packages peers, then python -m bench.native"

COMMON = ("-O2", "-DNDEBUG", "-fPIC", "-fvisibility=hidden", "-Wall", "-Wextra")
C = ("-std=c11", "-D_GNU_SOURCE", *COMMON)
CPP = ("-std=c++17", "-fno-gnu-unique", *COMMON)
"""Without -march=native: the libraries of the wheels and of Debian, and our own kernel, are built
for any processor, too."""

OURS = (f"-I{SOURCES}",)

EIGEN = "/usr/include/eigen3"

LISTS = ("-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS", "-DBOOST_MPL_LIMIT_LIST_SIZE=30")
"""Pinocchio has more kinds of joints than Boost's lists hold by default."""


WITH_DISTANCES = ("-DPINOCCHIO_WITH_COLLISION",)
DISTANCES = ("-lpinocchio_collision", "-lpinocchio_default", "-lcoal")
"""Libraries of the wheels with the compiled distances."""


class NotBuiltError(Exception):
    """A component that a peer needs is missing; the message names it and what to do."""


def _compiler(variable: str, default: str, package: str) -> str:
    name = os.environ.get(variable, default)
    if shutil.which(name) is None:
        raise NotBuiltError(f"there is no {name} (Debian: apt-get install {package})")
    return name


def _run(words: Sequence[str]) -> None:
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if "error" in line.lower()]
        said = said or done.stderr.splitlines()[-1:] or [f"it ended with {done.returncode}"]
        raise NotBuiltError(f"{Path(words[0]).name}: {said[0]}")


def _there(path: str, what: str, package: str) -> str:
    if not Path(path).exists():
        raise NotBuiltError(f"there is no {path}, a part of {what} (Debian: {package}): {ADVICE}")
    return path


def _c(name: str, *flags: str) -> Callable[[Path], None]:
    def build(target: Path) -> None:
        cc = _compiler("CC", "cc", "gcc libc6-dev")
        _run((cc, *C, *OURS, *flags, "-o", str(target), str(SOURCES / name)))

    return build


def _kdl(target: Path) -> None:
    _there("/usr/include/kdl/chain.hpp", "KDL", "liborocos-kdl-dev")
    includes = ("-isystem", _there(EIGEN, "Eigen", "libeigen3-dev"))
    cxx = _compiler("CXX", "g++", "g++")
    source = str(SOURCES / "kdl.cpp")
    _run((cxx, *CPP, *OURS, "-shared", *includes, "-o", str(target), source, "-lorocos-kdl"))


def _pinocchio_daqp(target: Path) -> None:
    prefix = Path(sysconfig.get_path("platlib"), "cmeel.prefix")
    wheels, libraries = prefix / "include", prefix / "lib"
    for header in ("pinocchio/multibody.hpp", "coal/shape/geometric_shapes.h"):
        if not (wheels / header).exists():
            raise NotBuiltError(f"there is no {header} in {wheels}: pip install pin")
    _there(EIGEN, "Eigen", "libeigen3-dev")
    cc, cxx = _compiler("CC", "cc", "gcc libc6-dev"), _compiler("CXX", "g++", "g++")
    with tempfile.TemporaryDirectory(prefix="cardan-daqp-") as folder:
        sources = _daqp(Path(folder))
        objects = []
        for each in sorted((sources / "src").glob("*.c")):
            objects.append(str(Path(folder, each.stem + ".o")))
            _run((cc, *C, "-w", f"-I{sources}/include", "-c", "-o", objects[-1], str(each)))
        includes = [
            word
            for path in (wheels, EIGEN, sources / "include")
            for word in ("-isystem", str(path))
        ]
        link = ("-shared", "-Wl,-z,defs", "-Wl,-Bsymbolic")
        theirs = (f"-L{libraries}", f"-Wl,-rpath,{libraries}", *DISTANCES)
        source = str(SOURCES / "pinocchio_daqp.cpp")
        _run(
            (
                cxx,
                *CPP,
                f"-I{SOURCES}",
                *LISTS,
                *WITH_DISTANCES,
                *link,
                *includes,
                "-o",
                str(target),
                source,
                *objects,
                *theirs,
            )
        )


def _daqp(folder: Path) -> Path:
    """Return the C sources of the installed version of daqp, unpacked below `folder`."""
    version = importlib.metadata.version("daqp")
    _run(
        (
            sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", "daqp",
            "--dest", str(folder), f"daqp=={version}",
        )
    )  # fmt: skip
    (archive,) = folder.glob("daqp-*.tar.gz")
    with tarfile.open(archive) as opened:
        if hasattr(tarfile, "data_filter"):
            opened.extractall(folder, filter="data")
        else:  # Older Pythons lack the filter argument.
            opened.extractall(folder)
    sources = folder / f"daqp-{version}/csrc"
    if not (sources / "include/api.h").exists():
        raise NotBuiltError(f"the source package of daqp {version} has no csrc/include/api.h")
    return sources


KERNEL, ECHO, TIMER, KDL, PINOCCHIO_DAQP = (
    "kernel.so", "echo", "timer", "kdl.so", "pinocchio_daqp.so",
)  # fmt: skip

PARTS: dict[str, tuple[tuple[str, ...], Callable[[Path], None]]] = {
    KERNEL: (("kernel.c", "peer.h"), _c("kernel.c", "-shared")),
    ECHO: (("echo.c",), _c("echo.c")),
    TIMER: (("timer.c",), _c("timer.c")),
    KDL: (("kdl.cpp", "peer.h"), _kdl),
    PINOCCHIO_DAQP: (("pinocchio_daqp.cpp", "peer.h"), _pinocchio_daqp),
}
"""Parts to build: the sources of each, and its build function."""


def _path(part: str) -> Path:
    """Path of a part built from the present sources."""
    stamp = hashlib.sha256(repr((C, CPP, LISTS, WITH_DISTANCES, DISTANCES)).encode())
    for each in PARTS[part][0]:
        stamp.update((SOURCES / each).read_bytes())
    if part == PINOCCHIO_DAQP:
        for name in ("libpinocchio", "daqp"):
            try:
                stamp.update(importlib.metadata.version(name).encode())
            except importlib.metadata.PackageNotFoundError as error:
                raise NotBuiltError(f"{name} is not installed: pip install {name}") from error
    return BUILD / f"{stamp.hexdigest()[:12]}-{part}"


@functools.cache
def built(part: str) -> Path:
    """Return the program or library, building it if needed. Raises NotBuiltError."""
    path = _path(part)
    if not path.exists():
        print(f"building {part} ...", file=sys.stderr, flush=True)
        BUILD.mkdir(parents=True, exist_ok=True)
        for earlier in BUILD.glob(f"????????????-{part}"):
            earlier.unlink()
        fresh = path.with_name(f"{path.name}.{os.getpid()}")
        try:
            PARTS[part][1](fresh)
            fresh.replace(path)
        finally:
            fresh.unlink(missing_ok=True)
    return path


class Peer:
    """Step function of another library, starting at an arm's home."""

    def __init__(self, part: str, arm: ArmKinematics) -> None:
        """Raises NotBuiltError."""
        library = ctypes.CDLL(str(built(part)))
        library.peer_create.restype = ctypes.c_void_p
        library.peer_create.argtypes = (ctypes.POINTER(PeerArm),)
        library.peer_step.restype = ctypes.c_double
        library.peer_step.argtypes = (
            ctypes.c_void_p, ctypes.c_char_p, ctypes.c_char_p, ctypes.c_double,
        )  # fmt: skip
        library.peer_joints.restype = None
        library.peer_joints.argtypes = (ctypes.c_void_p, ctypes.c_void_p)
        library.peer_destroy.restype = None
        library.peer_destroy.argtypes = (ctypes.c_void_p,)
        self._library, self._joints = library, arm.joints
        self._peer = library.peer_create(ctypes.byref(peer_arm(arm)))
        if not self._peer:
            raise NotBuiltError(f"{part} cannot take the arm {arm.arm.name!r}")

    def surround(self, arm: ArmKinematics, collision: CollisionModel) -> None:
        """Add the arm's bodies to the peer, with Coal's shapes; only for a peer that computes
        distances (PINOCCHIO_DAQP)."""
        library = self._library
        library.peer_surround.restype = None
        library.peer_surround.argtypes = (
            ctypes.c_void_p, ctypes.POINTER(PeerShape), ctypes.c_int32, ctypes.POINTER(PeerPair),
            ctypes.c_int32,
        )  # fmt: skip
        library.peer_distances.restype = None
        library.peer_distances.argtypes = (ctypes.c_void_p, ctypes.c_void_p)
        library.peer_rows.restype = ctypes.c_int32
        library.peer_rows.argtypes = (ctypes.c_void_p,)
        shapes = (PeerShape * len(collision.solids))(*map(peer_shape, collision.solids))
        pairs = peer_pairs(arm, collision, ServoOptions())
        library.peer_surround(self._peer, shapes, len(shapes), pairs, len(pairs))
        self._pairs = len(pairs)

    @property
    def distances(self) -> Any:
        """Distance of each pair before the last step, m."""
        found = np.zeros(self._pairs)
        self._library.peer_distances(self._peer, found.ctypes.data)
        return found

    @property
    def rows(self) -> int:
        """Number of pairs in the program of the last step."""
        count: int = self._library.peer_rows(self._peer)
        return count

    def step(self, goal: Any, dt_s: float) -> float:
        """Move towards a placement in the base; return the duration by the peer's own clock, s."""
        rotation = np.ascontiguousarray(goal.rotation).tobytes()
        took_s: float = self._library.peer_step(
            self._peer, rotation, goal.translation.tobytes(), dt_s
        )
        return took_s

    @property
    def q(self) -> Any:
        """Joint positions, rad or m."""
        found = np.zeros(self._joints)
        self._library.peer_joints(self._peer, found.ctypes.data)
        return found

    def __del__(self) -> None:
        if getattr(self, "_peer", None):
            self._library.peer_destroy(self._peer)


def kernel_step() -> Callable[[int, int, float], float]:
    """Return a function that calls our kernel's tick by the addresses of both, as a C caller would.
    The function returns its duration, s. Raises NotBuiltError."""
    function = ctypes.CDLL(str(built(KERNEL))).kernel_step
    function.restype = ctypes.c_double
    function.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double)
    step: Callable[[int, int, float], float] = function
    return step
