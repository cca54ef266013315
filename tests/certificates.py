"""Certificates for tests: made by openssl, and those of a pair of computers."""

import subprocess

import pytest

from cardan.common.certificates import make_certificate, make_key


def make(folder, days=365, names="DNS:lab,IP:192.0.2.1", more=()):
    """Paths of a certificate and its key."""
    paths = folder / "cert.pem", folder / "key.pem"
    words = ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256"]
    words += ["-nodes", "-days", str(days), "-subj", "/CN=somebody", *more]
    words += ["-addext", f"subjectAltName={names}"] if names else []
    words += ["-out", str(paths[0]), "-keyout", str(paths[1])]
    try:
        made = subprocess.run(words, capture_output=True, check=False)
    except FileNotFoundError:
        pytest.skip("openssl is not installed")
    assert made.returncode == 0, made.stderr
    return paths


def pair(folder, names=("127.0.0.1",), robot_days=1, operator_days=1, issuer="Cardan pair"):
    """Return the paths that a pair of computers has: authority, then certificate and key of each.

    `names` are names of the robot's computer. With 0 days its certificate has expired. "expired"
    expires the operator's, too.
    """
    folder.mkdir()
    root, _ = make_key()

    def signed(subject, key, hosts, days, client=False):
        more = {"issuer": issuer, "issuer_key": root, "days": days, "client": client}
        return make_certificate(subject, key.public_key(), hosts, **more)

    robot, robot_key = make_key()
    operator, operator_key = make_key()
    made = {
        "authority": signed(issuer, root, (), 1),
        "robot": signed("robot", robot, names, robot_days),
        "robot-key": robot_key,
        "operator": signed("operator", operator, ["operator"], operator_days, client=True),
        "operator-key": operator_key,
        "expired": signed("operator", operator, ["operator"], 0, client=True),
    }
    for name, data in made.items():
        (folder / name).write_bytes(data)
    return {name: folder / name for name in made}
