"""Reports of a Wii Remote that is tilted.

It prints:

    30 00 08
    20 00 08 00 00 00 c0
    31 20 48 91 82 9c
    31 20 48 91 82 9c
    31 20 48 91 82 9c
    49 False
"""

from cardan_wiimote.peer import SimulatedWiimote
from cardan_wiimote.protocol import DataMode, StatusRequest, encode_output

remote = SimulatedWiimote()
remote.connect(0.0)
remote.set_attitude(0.5, 0.0)  # roll, rad: right side down
remote.press("a")
remote.output(encode_output(StatusRequest()), 0.005)
remote.output(encode_output(DataMode(0x31)), 0.005)
for report in remote.reports(0.025):
    print(report.hex(" "))
print(remote.mode, remote.rumble)
