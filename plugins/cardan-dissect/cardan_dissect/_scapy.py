"""Only import of scapy, with the parts that the layers need.

scapy is GPL-2.0 and therefore an optional extra. Its import can emit deprecation warnings of other
libraries, which are suppressed.
"""

from __future__ import annotations

import warnings

from cardan.common.extras import missing_extra

try:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from scapy.fields import (
            BitEnumField as BitEnumField,
            BitField as BitField,
            ByteEnumField as ByteEnumField,
            ByteField as ByteField,
            ConditionalField as ConditionalField,
            EnumField as EnumField,
            Field as Field,
            FieldLenField as FieldLenField,
            FieldListField as FieldListField,
            LEIntField as LEIntField,
            LEShortField as LEShortField,
            LESignedIntField as LESignedIntField,
            LESignedShortField as LESignedShortField,
            PacketListField as PacketListField,
            ShortField as ShortField,
            SignedShortField as SignedShortField,
            StrField as StrField,
            StrFixedLenField as StrFixedLenField,
            StrLenField as StrLenField,
            X3BytesField as X3BytesField,
            XByteEnumField as XByteEnumField,
            XByteField as XByteField,
            XShortField as XShortField,
        )
        from scapy.layers.inet import TCP as TCP, UDP as UDP
        from scapy.packet import (
            Packet as Packet,
            bind_bottom_up as bind_bottom_up,
            bind_top_down as bind_top_down,
        )
        from scapy.utils import EDecimal as EDecimal

except ImportError as error:
    raise missing_extra("the layers of scapy", "scapy", "dissect", error) from error
