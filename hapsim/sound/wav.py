"""The sound of a scene in a WAV file: 24-bit frames, a value per pick-up, at the scene's steps per second.

The header counts the frames that are in the file and is written anew after each write, so the file can be played
however its writer ended. The same run writes the same bytes: there is no dither and no date.
"""

from __future__ import annotations

import errno
import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.recording.background_file import BackgroundFile, in_words, lock, require_writable

_BYTES = 3  # of a value
_FULL_SCALE = 1 << (8 * _BYTES - 1)
_MOST_BYTES = (1 << 32) - 256  # of frames: the header counts in 32 bits
_BLOCK = 1 << 16  # frames that are written at a time
_PCM, _EXTENSIBLE = 1, 0xFFFE
_PCM_GUID = bytes.fromhex("0100000000001000800000aa00389b71")


def require_writable_as_wav(path: Path, channels: int, step_rate_hz: float) -> None:
    """Raises UsageError if no sound can be written to `path`. Call it before the run."""
    most_hz = ((1 << 32) - 1) // (channels * _BYTES)  # the header counts bytes a second in 32 bits
    if not 1 <= round(step_rate_hz) <= most_hz:
        steps = f"found {step_rate_hz:g} steps a second (rate times substeps)"
        raise UsageError(f"{path}: {steps}; a WAV file of {channels} channel(s) has 1 to {most_hz} frames a second")
    require_writable(path, ".wav")


def header(channels: int, rate_hz: int, frames: int) -> bytes:
    """Returns the header of the file. More than two channels need the extensible form."""
    frame = channels * _BYTES
    form = _PCM if channels <= 2 else _EXTENSIBLE
    described = struct.pack("<HHIIHH", form, channels, rate_hz, rate_hz * frame, frame, 8 * _BYTES)
    if form == _EXTENSIBLE:
        described += struct.pack("<HHI", 22, 8 * _BYTES, 0) + _PCM_GUID  # 0: the channels have no places in a room
    described = b"WAVEfmt " + struct.pack("<I", len(described)) + described
    size = frames * frame
    riff = struct.pack("<4sI", b"RIFF", len(described) + 8 + size + size % 2)
    return riff + described + struct.pack("<4sI", b"data", size)


def in_24_bits(frames: NDArray[np.float32]) -> bytes:
    """Returns the bytes of frames in which 1.0 is full scale."""
    counts = np.clip(np.rint(frames * np.float32(_FULL_SCALE)), -_FULL_SCALE, _FULL_SCALE - 1)
    return counts.astype("<i4").view(np.uint8).reshape(-1, 4)[:, :_BYTES].tobytes()


class WavFile(BackgroundFile):
    """A sound file that is being written."""

    def __init__(self, path: Path, channels: int, rate_hz: int, on_warning: Callable[[str], None]) -> None:
        """Replaces the file if it exists. `on_warning` is called if the disk fails, in the writing thread. UsageError
        where no file can be begun."""
        super().__init__(path, on_warning, "sound file", "frame")
        self._channels, self._rate_hz, self._frames = channels, rate_hz, 0
        try:
            self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
            try:
                lock(self._descriptor, path, "sound")
                os.ftruncate(self._descriptor, 0)
                self._count(0)
            except BaseException:
                os.close(self._descriptor)
                raise
        except OSError as error:
            raise UsageError(f"{path}: the sound cannot be written: {in_words(error)}") from error
        self._start()

    @property
    def written(self) -> int:
        """Frames in the file."""
        return self._frames

    def finish(self) -> None:
        """Writes the backlog at the end of the run, and closes the file."""
        self._join()
        os.close(self._descriptor)
        if not self.failure and not self._path.exists():
            self.failure = "it was removed while the scene ran"

    def _write(self, rows: NDArray[np.float32]) -> None:
        for first in range(0, len(rows), _BLOCK):  # what a write takes beside the rows does not grow with them
            self._write_block(rows[first : first + _BLOCK])

    def _write_block(self, rows: NDArray[np.float32]) -> None:
        begin, frame = len(header(self._channels, self._rate_hz, 0)), self._channels * _BYTES
        room = _MOST_BYTES // frame - self._frames
        data = memoryview(in_24_bits(rows[:room]))
        done = 0
        try:
            while done < len(data):
                os.lseek(self._descriptor, begin + self._frames * frame + done, os.SEEK_SET)
                done += os.write(self._descriptor, data[done:])
            if done and (self._frames * frame + done) % 2:
                os.write(self._descriptor, b"\0")
        finally:
            self._count(self._frames + done // frame)
        if room < len(rows):
            raise OSError(errno.EFBIG, "a WAV file holds 4 GiB")

    def _summarize(self) -> None:
        os.fsync(self._descriptor)

    def _count(self, frames: int) -> None:
        """Writes a header for the frames that are there."""
        os.lseek(self._descriptor, 0, os.SEEK_SET)
        os.write(self._descriptor, header(self._channels, self._rate_hz, frames))
        self._frames = frames
