#!/bin/sh
# A Zenoh client whose certificate the router refuses is told the same as one that finds no router.
#
# One would guess: a router that is reached and refuses the client's certificate (TLS, mutual) gives
# another error than a port where nothing listens; a handshake that fails is known at once.
# It is so: zenoh.open() ends with the same words in both cases, a timeout that names neither the
# certificate nor TLS, and only once connect/timeout_ms has passed. With the right one it opens.
#
# Certificates of two authorities are made anew by trustme; all on loopback.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    "eclipse-zenoh==1.10.2" "trustme==1.2.1"
"$folder/venv/bin/python" - "$folder" <<'PYTHON'
import importlib.metadata
import json
import os
import socket
import sys
import time

import trustme
import zenoh

LONGEST_MS = 3000
folder = sys.argv[1]


def written(name, data):
    path = os.path.join(folder, name)
    with open(path, "wb") as file:
        file.write(data)
    return path


def issued(authority, name):
    made = authority.issue_cert("127.0.0.1")
    key = written(f"{name}.key", made.private_key_pem.bytes())
    chain = b"".join(each.bytes() for each in made.cert_chain_pems)
    return key, written(f"{name}.pem", chain)


ours, others = trustme.CA(), trustme.CA()
root = written("root.pem", ours.cert_pem.bytes())
server = issued(ours, "server")
certificates = {"ours": issued(ours, "ours"), "others": issued(others, "others")}


def free_place():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"tls/127.0.0.1:{free.getsockname()[1]}"


def opened(mode, tls, **more):
    config = zenoh.Config()
    values = {"mode": mode, "scouting/multicast/enabled": False, "transport/link/tls": tls, **more}
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


place = free_place()
router = opened(
    "router",
    {
        "root_ca_certificate": root,
        "listen_private_key": server[0],
        "listen_certificate": server[1],
        "enable_mtls": True,
    },
    **{"listen/endpoints": [place], "connect/endpoints": []},
)


def joined(certificate, at):
    """The words with which a client that has this certificate fails there, and how long it took."""
    key, chain = certificates[certificate]
    tls = {
        "root_ca_certificate": root,
        "connect_private_key": key,
        "connect_certificate": chain,
        "enable_mtls": True,
    }
    begin_s = time.monotonic()
    try:
        opened(
            "client",
            tls,
            **{"connect/endpoints": [at], "connect/timeout_ms": LONGEST_MS},
        ).close()
        words = "opened"
    except zenoh.ZError as error:
        words = str(error).replace(at, "PLACE")
    return words, time.monotonic() - begin_s


nobody = free_place()
seen = {
    "the router's own authority": joined("ours", place),
    "another authority": joined("others", place),
    "nothing listens": joined("ours", nobody),
}
print("eclipse-zenoh", importlib.metadata.version("eclipse-zenoh"))
for case, (words, took_s) in seen.items():
    print(f"{case}, after {took_s:.1f} s: {words}")
right, refused, absent = seen.values()
good = (
    right[0] == "opened"
    and refused[0] == absent[0] != "opened"
    and "ertificate" not in refused[0]
    and min(refused[1], absent[1]) > 0.9e-3 * LONGEST_MS
)
sys.stdout.flush()
os._exit(not good)
PYTHON
