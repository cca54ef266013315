#!/bin/sh
# scapy's TCPSession hands a protocol's tcp_reassemble bytes that were never in the capture.
#
# One would guess: where a capture lacks a TCP segment (the capturing computer dropped it), the bytes
# behind the hole are kept back, or the stream is given up, as other reassemblers do.
# It is so: the hole is filled with zero bytes of the missing length, and the whole is handed on at
# once as if it had been captured, without a mark or a warning. Of a message that lay in the hole a
# dissector reads zeros as its values.
#
# Three records of "length, payload" in three segments; the second segment is not in the capture.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check "scapy==2.8.0"
"$folder/venv/bin/python" - "$folder/hole.pcap" <<'PYTHON'
import sys

import scapy
from scapy.all import IP, TCP, Ether, Packet, TCPSession, bind_layers, sniff, wrpcap

handed = []


class Records(Packet):
    name = "Records"
    fields_desc = []

    @classmethod
    def tcp_reassemble(cls, data, metadata, session):
        handed.append(bytes(data))
        return None


bind_layers(TCP, Records, dport=7000)
segments = [b"\x04AAAA", b"\x04BBBB", b"\x04CCCC"]
sequence, packets = 1000, []
for number, payload in enumerate(segments):
    if number != 1:
        packets.append(
            Ether() / IP(src="10.0.0.1", dst="10.0.0.2")
            / TCP(sport=5000, dport=7000, flags="PA", seq=sequence) / payload
        )
    sequence += len(payload)
wrpcap(sys.argv[1], packets)
sniff(offline=sys.argv[1], session=TCPSession, store=False)
print(f"scapy {scapy.__version__}: captured {segments[0] + segments[2]}, handed on {handed[-1]}")
sys.exit(handed[-1] != segments[0] + bytes(5) + segments[2])
PYTHON
