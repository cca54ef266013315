"""Events of a gamepad whose stick is pushed.

It prints:

    0.0 ((1, 304, 1), (3, 1, -16384), (0, 0, 0))
"""

from cardan.sim_peers.evdev import MODELS, SimulatedInput

pad = SimulatedInput(MODELS[0])
pad.set_controls((0.0, 0.5, 0.0, 0.0, 0.0, 0.0))
pad.press("south")
for frame in pad.reports(0.020):
    print(frame.time_s, frame.events)
