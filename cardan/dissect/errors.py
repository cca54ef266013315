"""What dissecting can raise besides :class:`cardan.errors.CaptureError`."""

from __future__ import annotations

from cardan.errors import CardanError


class ScapyMissingError(CardanError):
    """scapy, the optional extra that dissecting needs, is not installed."""
