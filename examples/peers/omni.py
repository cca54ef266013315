"""A program of HDAPI against the simulated Omni in virtual time: a force of 0.5 N.

It prints:

    2.0 s: -2.4 mm, 0.49 N
"""

import ctypes

from cardan_omni.peer import OmniSettings, SimulatedOmni
from cardan_omni.protocol import MAX_SCHEDULER_PRIORITY, CallbackCode, Capability, State

omni = SimulatedOmni(OmniSettings(virtual=True))
hd = ctypes.CDLL(str(omni.path))
hd.hdInitDevice.restype = ctypes.c_uint
hd.hdScheduleAsynchronous.restype = ctypes.c_ulong
hd.hdScheduleAsynchronous.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_ushort]
device = hd.hdInitDevice(None)
force = (ctypes.c_double * 3)(0.5, 0.0, 0.0)  # N, to the right


def tick(user: int | None) -> int:
    hd.hdBeginFrame(device)
    hd.hdSetDoublev(State.CURRENT_FORCE, force)
    hd.hdEndFrame(device)
    return CallbackCode.CONTINUE


called = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p)(tick)
hd.hdScheduleAsynchronous(called, None, MAX_SCHEDULER_PRIORITY)
hd.hdEnable(Capability.FORCE_OUTPUT)
hd.hdStartScheduler()
omni.step(2000)
truth = omni.truth()
print(f"{truth.time_s:.1f} s: {truth.position_m.y * 1e3:.1f} mm, {truth.hand_force_n.y:.2f} N")
hd.hdStopScheduler()
hd.hdDisableDevice(device)
