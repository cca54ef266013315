#!/bin/sh
# The time stamps of btsnoop logs (Bluetooth HCI: Android's btsnoop_hci.log, btmon -w) are not what
# their description says at first: microseconds since midnight of January 1st of the year 0.
#
# One would guess: a reader subtracts the days from 0000-01-01 to 1970-01-01 in the Gregorian
# calendar, 719,528, and has Unix time.
# It is so: then every packet comes 12 days too late. Writers take the description's second sentence,
# by which 2000-01-01 is 0x00E03AB44A676000, and that is 719,540 days before 1970 counted back.
#
# One HCI reset, written by bumble's BtSnooper (a Bluetooth stack in Python, 3.11 or newer).
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check --no-deps \
    "bumble==0.0.236" "pyee==13.0.1" "typing_extensions==4.16.0"
"$folder/venv/bin/python" <<'PYTHON'
import importlib.metadata
import io
import struct
import sys
import time
from datetime import date

from bumble.snoop import BtSnooper, Snooper

RESET = bytes.fromhex("01 03 0c 00")
DAY_S = 86_400

log = io.BytesIO()
BtSnooper(log).snoop(RESET, Snooper.Direction.HOST_TO_CONTROLLER)
(stamp_us,) = struct.unpack_from(">q", log.getvalue(), 16 + 16)
# date.toordinal counts from 0001-01-01; the Gregorian year 0 is a leap year.
calendar_days = date(1970, 1, 1).toordinal() - 1 + 366
late_days = (stamp_us / 1e6 - calendar_days * DAY_S - time.time()) / DAY_S
anchor_days = 0x00E03AB44A676000 / 1e6 / DAY_S - (date(2000, 1, 1) - date(1970, 1, 1)).days
print("bumble", importlib.metadata.version("bumble"))
print(f"0000-01-01 to 1970-01-01: {calendar_days} days; by the format's stamp of 2000: {anchor_days:.0f}")
print(f"a packet of now, by the calendar: {late_days:.3f} days in the future")
sys.exit((calendar_days, anchor_days, round(late_days, 3)) != (719_528, 719_540.0, 12.0))
PYTHON
