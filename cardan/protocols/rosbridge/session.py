"""Session of a client: frames to operations, within limits, and the selection of status
messages."""

from __future__ import annotations

from cardan.protocols.rate import MAX_PUBLICATIONS_PER_S, RateLimit
from cardan.protocols.rosbridge.forms import Frame, object_text
from cardan.protocols.rosbridge.fragments import Defragmenter
from cardan.protocols.rosbridge.operations import (
    LEVELS,
    Authenticate,
    Fragment,
    Id,
    Operation,
    Publish,
    RefusedOperation,
    SetLevel,
    parse_operation,
)


class RosbridgeSession:
    """Protocol state of a client at the server. Time is monotonic, s."""

    def __init__(self, max_characters: int) -> None:
        """Limit operations in fragments to `max_characters`."""
        self._defragmenter = Defragmenter(max_characters)
        self._level = "none"
        self._publications = RateLimit(MAX_PUBLICATIONS_PER_S)

    def receive(self, frame: Frame, now_s: float) -> Operation | RefusedOperation | None:
        """Return the operation of a frame; None: incomplete, or handled by this session."""
        if isinstance(frame, bytes):
            return RefusedOperation("binary frames are not read: send operations as JSON text")
        asked = parse_operation(frame)
        if isinstance(asked, Fragment):
            whole = self._defragmenter.add(asked, now_s)
            if not isinstance(whole, str):
                return whole
            asked = parse_operation(whole)
            if isinstance(asked, Fragment):
                return RefusedOperation(
                    "a fragment cannot consist of fragments", "fragment", asked.id
                )
        if isinstance(asked, SetLevel):
            self._level = asked.level
            return None
        if isinstance(asked, Authenticate):
            return None
        if isinstance(asked, Publish) and self._publications.exceeded(now_s):
            reason = f"more than {MAX_PUBLICATIONS_PER_S} messages in a second; this one is lost"
            return RefusedOperation(reason, "publish", asked.id, asked.topic)
        return asked

    def status(self, level: str, identity: Id, text: str) -> str | None:
        """Make a status message; None if the client did not request this level: roslibpy treats one
        as an error of its own."""
        if self._level == "none" or LEVELS.index(level) > LEVELS.index(self._level):
            return None
        return object_text(op="status", id=identity, level=level, msg=text)
