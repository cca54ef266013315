"""Simulated libHD in this process: for tests, benches, and programs that step it. A process has a
single libHD, as with the real one, and therefore one simulated device at a time."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

from cardan.errors import DeviceNotFoundError, ScriptError
from cardan.sim_peers.base import check_faults
from cardan.spatial import from_euler_zyx, to_euler_zyx
from cardan.types import ZERO3, Vector3
from cardan_omni.peer.settings import FAULTS, OmniSettings
from cardan_omni.protocol import rotation_to_device, to_device, to_hand

SETTINGS_VARIABLE = "CARDAN_OMNI"
"""Environment variable with the settings file, for a program that loads the library without knowing
that it is simulated."""
LIBRARY_VARIABLE = "CARDAN_LIBHD"
"""Environment variable in which Cardan's driver looks for libHD first."""
LIBRARY_NAMES = ("libHD.so", "libHD.so.3.0", "libHD.so.3.4")
"""Names of the real library."""


def library_path() -> Path:
    """Return the path of the simulated libHD. Raises DeviceNotFoundError if it was not compiled."""
    path = Path(__file__).with_name("libHD.so")
    if not path.exists():
        raise DeviceNotFoundError(
            f"the simulated libHD ({path}) was not compiled: install a C compiler (Debian: "
            "apt-get install gcc libc6-dev) and reinstall cardan-omni, or run tools/native in "
            "its sources"
        )
    return path


def available() -> bool:
    """Return True if the library was compiled."""
    try:
        library_path()
    except DeviceNotFoundError:
        return False
    return True


class OmniTruth(NamedTuple):
    """True state of the simulated device at the end of its newest tick; hand frame."""

    time_s: float
    """Time of the library's clock: monotonic, or virtual from 0."""
    ticks: int
    position_m: Vector3
    """True position of the gimbal's center, before the encoders."""
    velocity_m_s: Vector3
    hand_target_m: Vector3
    hand_force_n: Vector3
    """Force of the hand on the stylus."""
    commanded_n: Vector3
    """Force sent by the last frame."""
    delivered_n: Vector3
    """Force of the motors after clamp, ramp, amplifier and converter."""
    delivered_j: float
    """Work done by the motors on the stylus since the start."""
    hand_j: float
    """Work done on the stylus by the hand, pushes, and the droop."""
    lost_j: float
    """Energy lost in the mechanism's friction, damping and stops."""
    kinetic_j: float
    """Kinetic energy of the stylus: delivered_j + hand_j = lost_j + kinetic_j."""
    temperature: Vector3
    """Temperatures of the three motors; above 1 they are overheated."""
    buttons: int
    docked: bool
    gripped: bool
    amplifier: bool
    """True while the amplifier outputs force."""
    calibrated: bool
    script_done: bool


_Double3 = ctypes.c_double * 3
_C_TYPES: dict[type, Any] = {
    float: ctypes.c_double,
    Vector3: _Double3,
    int: ctypes.c_int32,
    bool: ctypes.c_int32,
}
_TRUTH = get_type_hints(OmniTruth)
_read = attrgetter(*_TRUTH)
_MADE: list[tuple[int, Callable[[Any], Any]]] = [
    (index, bool if kind is bool else Vector3._make if name == "temperature" else to_hand)
    for index, (name, kind) in enumerate(_TRUTH.items())
    if kind in (bool, Vector3)
]
"""Conversions of C's fields to OmniTruth's, by index; other fields are unchanged."""


class _SimTruth(ctypes.Structure):
    """SimTruth of sim.h; device frame."""

    _fields_ = [
        (name, ctypes.c_uint64 if name == "ticks" else _C_TYPES[kind])
        for name, kind in _TRUTH.items()
    ]


@functools.cache
def _load(path: Path) -> ctypes.CDLL:
    library = ctypes.CDLL(str(path))
    double3 = ctypes.POINTER(ctypes.c_double)
    signatures: dict[str, tuple[object, Sequence[object]]] = {
        "simConfigure": (ctypes.c_int, (ctypes.c_char_p,)),
        "simProblem": (ctypes.c_char_p, ()),
        "simStep": (ctypes.c_int, (ctypes.c_int,)),
        "simNow": (ctypes.c_double, ()),
        "simTruth": (None, (ctypes.POINTER(_SimTruth),)),
        "simHand": (
            None,
            (double3, double3, ctypes.c_int, double3, ctypes.c_int, ctypes.c_int),
        ),
        "simPush": (None, (double3,)),
        "simFault": (ctypes.c_int, (ctypes.c_char_p, ctypes.c_double)),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


class SimulatedOmni:
    """Side channel of the simulated libHD. Creating one resets the device and ends the activity of
    an earlier one; no device may be initialized at that time.

    Vectors are in the hand frame: x forward, y left, z up. Raises ScriptError for settings that the
    library does not take, DeviceNotFoundError when it was not compiled.
    """

    def __init__(self, settings: OmniSettings | None = None) -> None:
        self.path = library_path()
        self._library = _load(self.path)
        self._truth = _SimTruth()
        self.configure(settings or OmniSettings(virtual=True))

    def configure(self, settings: OmniSettings) -> None:
        """Restart as after power-on, with these settings; refused settings change nothing."""
        if self._library.simConfigure(settings.text.encode()):
            problem = self._library.simProblem().decode(errors="replace")
            raise ScriptError(f"the simulated Omni: {problem}")
        self.settings = settings

    def step(self, ticks: int = 1) -> int:
        """Run ticks in virtual time, with a started scheduler; return the number of ticks run."""
        return int(self._library.simStep(ticks))

    @property
    def now_s(self) -> float:
        """Return the library's time."""
        return float(self._library.simNow())

    def truth(self) -> OmniTruth:
        """Return the device's true state, not the measured one."""
        it = self._truth
        self._library.simTruth(ctypes.byref(it))
        values = list(_read(it))
        for index, make in _MADE:
            values[index] = make(values[index])
        return OmniTruth._make(values)

    def hand(
        self,
        target_m: Sequence[float] = ZERO3,
        turn_rad: Sequence[float] = ZERO3,
        *,
        gripped: bool = True,
        push_n: Sequence[float] = ZERO3,
        buttons: int = 0,
        docked: bool = False,
    ) -> None:
        """Hold the stylus in this way from now on; ends the script. Angles are about the fixed axes
        x, y, z in turn; `push_n` is in addition to the hand's spring."""
        turn = to_euler_zyx(rotation_to_device(from_euler_zyx(*turn_rad)))
        self._library.simHand(
            _Double3(*to_device(target_m)),
            _Double3(*turn),
            gripped,
            _Double3(*to_device(push_n)),
            buttons,
            docked,
        )

    def push(self, force_n: Sequence[float] = ZERO3) -> None:
        """Apply an external force to the stylus, in addition to the hand, until the next call."""
        self._library.simPush(_Double3(*to_device(force_n)))

    def fault(self, name: str, value: float = 1.0) -> None:
        """Start a fault of FAULTS; value 0 ends it."""
        check_faults({name: value} if value else {}, FAULTS)
        if self._library.simFault(name.encode(), value):
            raise ScriptError(f"the simulated Omni knows no fault {name!r}")

    def address(self, name: str) -> int:
        """Return the address of a function of the library ("hdBeginFrame", "simNow")."""
        address = ctypes.cast(getattr(self._library, name), ctypes.c_void_p).value
        assert address is not None
        return address
