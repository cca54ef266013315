"""Certificates (X.509, RFC 5280): made by the package cryptography; their validity and names are
read here, because Python's own module shows them for a peer's certificate only, after a handshake.
"""

from __future__ import annotations

import datetime
import ipaddress
import ssl
from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

_SEQUENCE: Final = 0x30
_OBJECT: Final = 0x06
_UTC_TIME: Final = 0x17
_VERSION: Final = 0xA0
_EXTENSIONS: Final = 0xA3
_DNS_NAME: Final = 0x82
_ADDRESS: Final = 0x87
_SUBJECT_ALTERNATIVE_NAMES: Final = bytes((0x55, 0x1D, 0x11))
"""Object identifier 2.5.29.17."""


class Certificate(NamedTuple):
    """Contents of a certificate."""

    begins: datetime.datetime
    ends: datetime.datetime
    names: tuple[str, ...]
    """Host names and addresses that it is valid for; browsers ignore its subject."""


def read_certificate(pem: str) -> Certificate:
    """Read the first certificate of a PEM file. Raises ValueError if there is none."""
    head, foot = "-----BEGIN CERTIFICATE-----", "-----END CERTIFICATE-----"
    begin, end = pem.find(head), pem.find(foot)
    if begin < 0 or end < begin:
        raise ValueError("there is no certificate in it")
    return decode_certificate(ssl.PEM_cert_to_DER_cert(pem[begin : end + len(foot)]))


def decode_certificate(der: bytes) -> Certificate:
    """Decode a certificate in DER. Raises ValueError for other bytes."""
    try:
        return _certificate(der)
    except (IndexError, StopIteration, UnicodeDecodeError, OverflowError) as error:
        raise ValueError(f"it is not a certificate: {error}") from None


def _certificate(der: bytes) -> Certificate:
    whole = next(_items(_inside(der, _SEQUENCE)))
    if whole[0] != _SEQUENCE:
        raise ValueError("it is not a certificate")
    parts = list(_items(whole[1]))
    if parts and parts[0][0] == _VERSION:
        del parts[0]
    # Serial number, algorithm, issuer, validity, subject, key.
    begins, ends = (_time(*each) for each in list(_items(parts[3][1]))[:2])
    names: tuple[str, ...] = ()
    for tag, value in parts[6:]:
        if tag == _EXTENSIONS:
            names = tuple(_names(value))
    return Certificate(begins, ends, names)


def _items(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Return tag and content of each value in `data`."""
    at = 0
    while at < len(data):
        tag, length, at = data[at], data[at + 1], at + 2
        if length & 0x80:
            size = length & 0x7F
            length = int.from_bytes(data[at : at + size], "big")
            at += size
        if at + length > len(data):
            raise ValueError("it is cut off")
        yield tag, data[at : at + length]
        at += length


def _inside(data: bytes, tag: int) -> bytes:
    found, value = next(_items(data))
    if found != tag:
        raise ValueError("it is not a certificate")
    return value


def _time(tag: int, value: bytes) -> datetime.datetime:
    text = value.decode("ascii")
    form = "%y%m%d%H%M%SZ" if tag == _UTC_TIME else "%Y%m%d%H%M%SZ"
    return datetime.datetime.strptime(text, form).replace(tzinfo=datetime.timezone.utc)


def _names(value: bytes) -> Iterator[str]:
    for _, extension in _items(_inside(value, _SEQUENCE)):
        parts = list(_items(extension))
        if parts[0] != (_OBJECT, _SUBJECT_ALTERNATIVE_NAMES):
            continue
        for tag, name in _items(_inside(parts[-1][1], _SEQUENCE)):
            if tag == _DNS_NAME:
                yield name.decode("ascii")
            elif tag == _ADDRESS:
                yield str(ipaddress.ip_address(name))


def is_address(name: str) -> bool:
    """Return whether it is an IP address without a zone, and no host name."""
    try:
        return "%" not in str(ipaddress.ip_address(name))
    except ValueError:
        return False


def make_key() -> tuple[Any, bytes]:
    """Make a private key of the package cryptography; return it, and the same in PEM. Raises
    ImportError."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key, plain = ec.generate_private_key(ec.SECP256R1()), serialization.NoEncryption()
    form = serialization.PrivateFormat.PKCS8
    return key, key.private_bytes(serialization.Encoding.PEM, form, plain)


def make_certificate(
    subject: str,
    public_key: Any,
    names: Sequence[str] = (),
    *,
    issuer: str,
    issuer_key: Any,
    days: int,
    client: bool = False,
) -> bytes:
    """Make a certificate in PEM for a key of the package cryptography, signed with the issuer's: of
    a server or `client` with `names`; without names, of an authority. It is valid from an hour ago,
    because clocks differ. Raises ImportError without the package."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.x509.oid import ExtendedKeyUsageOID as Usage

    now = datetime.datetime.now(datetime.timezone.utc)
    one, other = (
        x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, each[:64])])
        for each in (subject, issuer)
    )
    builder = (
        x509.CertificateBuilder()
        .subject_name(one)
        .issuer_name(other)
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(hours=1))
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(x509.BasicConstraints(ca=not names, path_length=None), critical=True)
    )
    if names:
        wanted = [
            x509.IPAddress(ipaddress.ip_address(each)) if is_address(each) else x509.DNSName(each)
            for each in names
        ]
        usage = x509.ExtendedKeyUsage([Usage.CLIENT_AUTH if client else Usage.SERVER_AUTH])
        builder = builder.add_extension(x509.SubjectAlternativeName(wanted), critical=False)
        builder = builder.add_extension(usage, critical=False)
    return builder.sign(issuer_key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
