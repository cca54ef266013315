"""Repair of a record that was cut off or is damaged, into a new file."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

from cardan import __version__
from cardan.errors import CaptureError
from cardan.recording.mcap_file import OtherRecord, RecordReader

if TYPE_CHECKING:
    from mcap.records import Channel, Schema


class RepairReport(NamedTuple):
    """Summary of a file's repair."""

    path: Path
    """The new file."""
    messages: int
    problems: tuple[str, ...]
    """Problems of the old file, and the data that is lost."""

    @property
    def complete(self) -> bool:
        """True if the old file had no fault."""
        return not self.problems

    def lines(self) -> list[str]:
        """Return the summary as lines of text."""
        found = self.problems or ("nothing was wrong with the file: there was nothing to repair",)
        return [*found, f"{self.path}: {self.messages} messages, with an index"]


def repaired_name(path: Path) -> Path:
    """Default path of the repaired file."""
    return path.with_name(f"{path.stem}-repaired.mcap")


def repair(path: Path, output: Path) -> RepairReport:
    """Copy the readable messages (of any encoding), topics, attachments and metadata of `path` to a
    new file with new indexes, one record at a time.

    Raises CaptureError if `path` is not an MCAP file, or if `output` exists or cannot be written.
    """
    reader = RecordReader(path)
    records = reader.records()
    first = next(records, None)  # No file is made if `path` is no record.
    try:
        stream = output.open("xb")
    except FileExistsError:
        raise CaptureError(f"{output} exists: choose another name, or delete it") from None
    except OSError as error:
        raise CaptureError(f"{output} cannot be written: {error.strerror or error}") from None
    try:
        with stream:
            copy = _Copy(stream)
            if first is not None:
                copy.add(first)
                for record in records:
                    copy.add(record)
            copy.finish()
    except BaseException as error:
        output.unlink(missing_ok=True)
        if isinstance(error, OSError):
            why = error.strerror or error
            raise CaptureError(f"{output} cannot be written: {why}") from None
        raise
    return RepairReport(output, copy.messages, (*reader.problems, *copy.problems))


class _Copy:
    """Writer of the repaired file, record by record."""

    def __init__(self, stream: BinaryIO) -> None:
        from mcap.writer import Writer

        self.messages = 0
        self._writer: Any = Writer(stream, enable_data_crcs=True)
        self._begun = False
        self._schemas: dict[int, tuple[Schema, int]] = {}
        self._channels: dict[int, tuple[Channel, int]] = {}
        """Channel numbers of the new file by those of the old one."""
        self._strange = 0
        """Messages lost because their channel is not described."""
        self._unreadable = 0
        """Attachments and metadata that are damaged."""

    @property
    def problems(self) -> list[str]:
        """Data that could not be copied, in words."""
        said = []
        if self._strange:
            said.append(f"{self._strange} messages are lost: the descriptions of their topics are")
        if self._unreadable:
            said.append(f"{self._unreadable} attachments or metadata are damaged, and left out")
        return said

    def add(self, record: Any) -> None:
        """Copy a record. Raises OSError."""
        from mcap.opcode import Opcode
        from mcap.records import Channel, Message, Schema

        if not self._begun:
            header = isinstance(record, OtherRecord) and record.opcode == Opcode.HEADER
            self._begin(_profile(record.body) if header else "")
        if isinstance(record, Schema):
            known = self._schemas.get(record.id)
            if known is None or known[0] != record:
                new = self._writer.register_schema(record.name, record.encoding, record.data)
                self._schemas[record.id] = record, new
        elif isinstance(record, Channel):
            self._describe(record)
        elif isinstance(record, Message):
            channel = self._channels.get(record.channel_id)
            if channel is None:
                self._strange += 1
                return
            self._writer.add_message(
                channel[1], record.log_time, record.data, record.publish_time, record.sequence
            )
            self.messages += 1
        elif record.opcode != Opcode.HEADER:
            self._attach(record)

    def _begin(self, profile: str) -> None:
        self._begun = True
        self._writer.start(profile, f"cardan {__version__}")

    def _describe(self, channel: Channel) -> None:
        known = self._channels.get(channel.id)
        if known is not None and known[0] == channel:
            return
        schema = self._schemas.get(channel.schema_id)
        if schema is None and channel.schema_id:
            return
        new = self._writer.register_channel(
            channel.topic,
            channel.message_encoding,
            0 if schema is None else schema[1],
            channel.metadata,
        )
        self._channels[channel.id] = channel, new

    def _attach(self, record: OtherRecord) -> None:
        from mcap.data_stream import ReadDataStream
        from mcap.exceptions import EndOfFile
        from mcap.opcode import Opcode
        from mcap.records import Attachment, Metadata

        stream = ReadDataStream(BytesIO(record.body))
        try:
            if record.opcode == Opcode.METADATA:
                described = Metadata.read(stream)
                self._writer.add_metadata(described.name, described.metadata)
                return
            attached = Attachment.read(stream)
        except (ValueError, OverflowError, struct.error, EndOfFile):
            self._unreadable += 1
            return
        if not _is_whole(record.body):
            self._unreadable += 1
            return
        self._writer.add_attachment(
            attached.create_time,
            attached.log_time,
            attached.name,
            attached.media_type,
            attached.data,
        )

    def finish(self) -> None:
        """Write the index and close. Raises OSError."""
        if not self._begun:
            self._begin("")
        self._writer.finish()


def _is_whole(attachment: bytes) -> bool:
    """True if its CRC matches, or is 0 (none)."""
    (crc,) = struct.unpack_from("<I", attachment, len(attachment) - 4)
    return crc in (0, zlib.crc32(attachment[:-4]))


def _profile(header: bytes) -> str:
    """Profile of a header; empty if it cannot be read."""
    from mcap.data_stream import ReadDataStream
    from mcap.exceptions import EndOfFile
    from mcap.records import Header

    try:
        profile: str = Header.read(ReadDataStream(BytesIO(header))).profile
    except (ValueError, OverflowError, struct.error, EndOfFile):
        return ""
    return profile
