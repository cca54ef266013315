"""Fields read from a certificate, compared with openssl and Python's own reader."""

import contextlib
import datetime
import ssl

import pytest
from hypothesis import given, strategies as st

from cardan.common.certificates import decode_certificate, read_certificate
from tests import certificates


@pytest.mark.parametrize(
    ("names", "read"),
    [
        ("DNS:lab,IP:192.0.2.1,DNS:*.lab.example", ("lab", "192.0.2.1", "*.lab.example")),
        ("IP:2001:db8::1,email:a@b.example,DNS:x", ("2001:db8::1", "x")),
        ("", ()),
    ],
)
def test_certificates_of_openssl(tmp_path, names, read):
    path, _ = certificates.make(tmp_path, 30, names)
    found = read_certificate(path.read_text())
    assert found.names == read
    assert found.ends - found.begins == datetime.timedelta(days=30)
    # Self-signed certificates count as an authority's, which Python can show.
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(path)
    (same,) = context.get_ca_certs()
    for key, time in (("notBefore", found.begins), ("notAfter", found.ends)):
        assert ssl.cert_time_to_seconds(same[key]) == time.timestamp()


def test_a_certificate_of_the_next_centuries(tmp_path):
    path, _ = certificates.make(tmp_path, 40_000)  # times beyond 2050 have another encoding
    assert read_certificate(path.read_text()).ends.year > 2050


def test_what_is_no_certificate(tmp_path):
    path, key = certificates.make(tmp_path)
    with pytest.raises(ValueError, match="no certificate in it"):
        read_certificate(key.read_text())
    der = ssl.PEM_cert_to_DER_cert(path.read_text())
    for end in range(len(der)):
        with pytest.raises(ValueError, match=r"\w"):
            decode_certificate(der[:end])


@given(st.binary(max_size=80))
def test_no_bytes_raise_anything_else(data):
    with pytest.raises(ValueError, match=r"\w"):
        decode_certificate(data)


@given(st.data())
def test_a_certificate_with_wrong_bytes(data):
    at = data.draw(st.integers(0, len(SAMPLE) - 1))
    wrong = SAMPLE[:at] + bytes((data.draw(st.integers(0, 255)),)) + SAMPLE[at + 1 :]
    with contextlib.suppress(ValueError):
        decode_certificate(wrong)


SAMPLE = bytes.fromhex(
    "303c" "303a" "020101" "3000" "3000"
    "301e" "170d3236303130313030303030305a" "170d3237303130313030303030305a"
    "3000" "3000" "a30e" "300c" "300a" "0603551d11" "0403" "300182"
)  # fmt: skip
"""A minimal certificate, whose list of names is truncated."""
