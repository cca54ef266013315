"""Reports of a SpaceMouse whose puck and button are pressed.

It prints:

    03 01 00
    01 00 00 51 ff 00 00
    02 00 00 00 00 00 00
    01 00 00 51 ff 00 00
"""

from cardan.protocols.connexion.devices import model_by_key
from cardan.sim_peers.spacemouse.core import SimulatedSpaceMouse

mouse = SimulatedSpaceMouse(model_by_key("spacemouse-compact"))
mouse.set_axes((0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
mouse.press("left")
for report in mouse.reports(0.020):
    print(report.hex(" "))
