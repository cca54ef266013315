"""Protocols of ``cardan dissect``: location of their bytes in a packet, and the codec of
:mod:`cardan.protocols` that decodes them."""
