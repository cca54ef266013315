"""Certificates for tests, made by openssl."""

import subprocess

import pytest


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
