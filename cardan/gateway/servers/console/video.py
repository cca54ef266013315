"""Pictures of a camera of this machine with JPEG output: V4L2, by the kernel's own calls.

Source: Linux Media API, part I (Video for Linux), 1.24 (capture by mmap), and videodev2.h; sizes
and numbers are those of 64-bit Linux.
"""

from __future__ import annotations

import contextlib
import errno
import mmap
import os
import select
import struct
import sys
from collections.abc import Callable, Iterator
from typing import Final

from cardan.protocols.mjpeg import MAX_PICTURE_BYTES

QUERYCAP: Final = 0x80685600
S_FMT: Final = 0xC0D05605
REQBUFS: Final = 0xC0145608
QUERYBUF: Final = 0xC0585609
QBUF: Final = 0xC058560F
DQBUF: Final = 0xC0585611
STREAMON: Final = 0x40045612
STREAMOFF: Final = 0x40045613

MJPEG: Final = int.from_bytes(b"MJPG", "little")
CAPTURE: Final = 1
"""V4L2_BUF_TYPE_VIDEO_CAPTURE, V4L2_CAP_VIDEO_CAPTURE and V4L2_MEMORY_MMAP."""
STREAMING: Final = 0x04000000

SIZE: Final = (640, 480)
"""Requested size; the driver takes its nearest."""

BUFFERS: Final = 3

LOOK_S: Final = 0.5
"""Period of checks for the end while no picture arrives."""

SILENT_S: Final = 5.0
"""Time without a picture after which the camera counts as gone."""

_CAPABILITY = struct.Struct("=84xII12x")
_FORMAT = struct.Struct("=I4xIII188x")
_REQUEST = struct.Struct("=IIII4x")
_BUFFER = struct.Struct("=IIII44xIQIIII")
"""Fields: index, type, bytesused, flags; memory, offset, length, reserved2, request_fd, padding."""

Ioctl = Callable[[int, int, bytearray], int]


class _Buffer:
    """struct v4l2_buffer."""

    def __init__(self, index: int = 0) -> None:
        self.data = bytearray(_BUFFER.size)
        _BUFFER.pack_into(self.data, 0, index, CAPTURE, 0, 0, CAPTURE, 0, 0, 0, 0, 0)

    @property
    def values(self) -> tuple[int, int, int, int]:
        """Return index, bytes used, offset and length."""
        index, _type, used, _flags, _memory, offset, length, *_ = _BUFFER.unpack(self.data)
        return index, used, offset & 0xFFFFFFFF, length


def _ioctl() -> Ioctl:
    if sys.platform != "linux" or sys.maxsize < 2**32:
        raise OSError(errno.ENOSYS, "cameras of this machine are read on 64-bit Linux alone")
    from fcntl import ioctl

    return ioctl


def pictures(path: str, ended: Callable[[], bool], ioctl: Ioctl | None = None) -> Iterator[bytes]:
    """Yield JPEG pictures of the device at `path` until `ended`. Raises OSError that names its
    subject."""
    call = ioctl or _ioctl()
    device = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    maps: list[mmap.mmap] = []
    on = bytearray(struct.pack("=i", CAPTURE))
    try:
        _prepare(call, device)
        request = bytearray(_REQUEST.pack(BUFFERS, CAPTURE, CAPTURE, 0))
        call(device, REQBUFS, request)
        for index in range(min(_REQUEST.unpack(request)[0], 32)):
            buffer = _Buffer(index)
            call(device, QUERYBUF, buffer.data)
            _, _, offset, length = buffer.values
            maps.append(mmap.mmap(device, length, offset=offset))
            call(device, QBUF, buffer.data)
        call(device, STREAMON, on)
        silent_s = 0.0
        while not ended():
            if not select.select([device], [], [], LOOK_S)[0]:
                silent_s += LOOK_S
                if silent_s >= SILENT_S:
                    raise OSError(errno.ETIMEDOUT, f"no picture for {SILENT_S:.0f} s")
                continue
            buffer = _Buffer()
            try:
                call(device, DQBUF, buffer.data)
            except BlockingIOError:
                continue
            silent_s = 0.0
            index, used, _, _ = buffer.values
            picture = maps[index][: min(used, MAX_PICTURE_BYTES)] if index < len(maps) else b""
            call(device, QBUF, buffer.data)
            if picture:
                yield picture
    finally:
        with contextlib.suppress(OSError):
            call(device, STREAMOFF, on)
        for each in maps:
            each.close()
        os.close(device)


def _prepare(call: Ioctl, device: int) -> None:
    capability = bytearray(_CAPABILITY.size)
    try:
        call(device, QUERYCAP, capability)
    except OSError as error:
        raise OSError(error.errno, "it is not a V4L2 device") from None
    _, own = _CAPABILITY.unpack(capability)
    if not own & CAPTURE or not own & STREAMING:
        raise OSError(errno.EINVAL, "it is not a camera: it captures no video")
    form = bytearray(_FORMAT.pack(CAPTURE, *SIZE, MJPEG))
    call(device, S_FMT, form)
    if _FORMAT.unpack(form)[3] != MJPEG:
        raise OSError(
            errno.EINVAL, "it gives no MJPEG: serve it by a program such as ustreamer, by its URL"
        )
