"""The protocols that ``cardan dissect`` reads: where their bytes are in a packet, and the codec of
:mod:`cardan.protocols` that decodes them."""
