#!/bin/sh
# python-can's reader of candump logs gives most of the kernel's error messages as data frames.
#
# One would guess: a line of `candump -L -e` that SocketCAN marks as an error (bit 29 of its
# identifier) comes back with `is_error_frame`, as it does from a live bus, or is left out.
# It is so: only a "bus error" (class 0x080) comes back as an error frame. Bus off (0x040),
# controller problems (0x004) and a lost arbitration (0x002) become data frames of a node whose
# identifier is the error's class, with eight bytes that look like a measurement.
#
# Four error messages of the kernel and one frame of data, as candump writes them.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check "python-can==4.6.1"
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import importlib.metadata
import sys
from pathlib import Path

import can

LOG = """(1700000000.000000) can0 123#1122334455667788
(1700000000.100000) can0 20000002#0000000000000000
(1700000000.200000) can0 20000004#0004000000000000
(1700000000.300000) can0 20000040#0000000000000000
(1700000000.400000) can0 20000080#0000000000000000
"""
EXPECTED = [
    (0x123, False, False),
    (0x002, True, False),
    (0x004, True, False),
    (0x040, True, False),
    (0x000, True, True),
]
path = Path(sys.argv[1], "bus.log")
path.write_text(LOG)
found = [(m.arbitration_id, m.is_extended_id, m.is_error_frame) for m in can.LogReader(path)]
print("python-can", importlib.metadata.version("python-can"))
for line, (identifier, extended, error) in zip(LOG.splitlines(), found, strict=True):
    kind = "error frame" if error else "data frame"
    print(f"{line.split()[2]:26} {kind} of {identifier:#x}, {'29' if extended else '11'} bits")
sys.exit(found != EXPECTED)
PYTHON
