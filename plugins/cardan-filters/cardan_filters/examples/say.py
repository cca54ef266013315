"""Send a constant reading to a filter of shared control twenty times a second, like a sensor's
program.

python say.py proximity.sock 20 python say.py camera.sock 0.4 -0.3
"""

import socket
import sys
import time

PERIOD_S = 0.05

path, *words = sys.argv[1:]
reading = " ".join(words).encode()
with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sensor:
    while True:
        try:
            sensor.sendto(reading, path)
        except OSError as error:
            print(f"no program listens at {path}: {error.strerror}")
            time.sleep(1.0)
        time.sleep(PERIOD_S)
