"""The one place that imports scapy, and only the parts the layers need.

scapy is GPL-2.0 and therefore an optional extra. Importing it can emit deprecation warnings of
the libraries below it; those are not ours to show.
"""

from __future__ import annotations

import warnings

from cardan.dissect.errors import ScapyMissingError

try:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from scapy.fields import (
            BitEnumField,
            BitField,
            ByteEnumField,
            ByteField,
            ConditionalField,
            EnumField,
            Field,
            FieldLenField,
            FieldListField,
            LEIntField,
            LEShortField,
            LESignedIntField,
            LESignedShortField,
            PacketListField,
            ShortField,
            SignedShortField,
            StrField,
            StrFixedLenField,
            StrLenField,
            X3BytesField,
            XByteEnumField,
            XByteField,
            XShortField,
        )
        from scapy.layers.inet import TCP, UDP
        from scapy.packet import Packet, bind_bottom_up, bind_top_down
        from scapy.utils import EDecimal
except ImportError as error:
    raise ScapyMissingError(
        f"reading captures needs scapy, which cannot be imported ({error}); "
        "install it with: pip install 'cardan[dissect]'"
    ) from error

__all__ = [
    "TCP",
    "UDP",
    "BitEnumField",
    "BitField",
    "ByteEnumField",
    "ByteField",
    "ConditionalField",
    "EDecimal",
    "EnumField",
    "Field",
    "FieldLenField",
    "FieldListField",
    "LEIntField",
    "LEShortField",
    "LESignedIntField",
    "LESignedShortField",
    "Packet",
    "PacketListField",
    "ShortField",
    "SignedShortField",
    "StrField",
    "StrFixedLenField",
    "StrLenField",
    "X3BytesField",
    "XByteEnumField",
    "XByteField",
    "XShortField",
    "bind_bottom_up",
    "bind_top_down",
]
