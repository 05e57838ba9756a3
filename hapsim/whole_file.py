"""Files that are written completely or not at all: to a temporary file first, which then replaces them."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hapsim.errors import UsageError

_LOCKED = (5, 32, 33)  # Windows' numbers: access denied, sharing violation, lock violation


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields the path of another file to write, which at the end takes the place and the permissions of `path`; if
    writing fails, `path` stays as it is. A link stays one. UsageError where the file cannot be written.

    Where no other file can take its place, as of a device or in a directory that cannot be written, it is `path`.
    """
    place = Path(os.path.realpath(path))
    temporary = place.with_name(f".{os.urandom(8).hex()}.{place.name}")  # a name that nobody can plant a link at
    is_replaced = not place.exists() or (place.is_file() and os.access(place.parent, os.W_OK))
    try:
        yield temporary if is_replaced else place
        if is_replaced:
            if place.exists():
                shutil.copymode(place, temporary)
            os.replace(temporary, place)
    except OSError as error:
        hint = ": is it open in another program?" if getattr(error, "winerror", None) in _LOCKED else ""
        raise UsageError(f"{path}: the file cannot be written: {error.strerror or error}{hint}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


class FileForHdf5(io.FileIO):
    """A file that HDF5 writes to. Where a write fails HDF5 reports it in its own words, or crashes; so it never learns
    of one: what follows the first failure is dropped, and `require_written` raises that."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "w+")
        self._failure: OSError | None = None

    def write(self, data: Any) -> int:
        """Writes all of it, or drops it; returns its size."""
        left = memoryview(data).cast("B")
        size = len(left)
        try:
            while left and self._failure is None:
                left = left[super().write(left) :]
        except OSError as error:
            self._failure = error
        return size

    def truncate(self, size: int | None = None) -> int:
        """Makes the file that long, unless it cannot."""
        try:
            return super().truncate(size)
        except OSError as error:
            self._failure = self._failure or error
            return size or 0

    def require_written(self) -> None:
        """Raises the OSError of the first write that failed."""
        if self._failure is not None:
            raise self._failure


@contextlib.contextmanager
def file_for_hdf5(path: Path) -> Iterator[FileForHdf5]:
    """Yields a file to give to HDF5. OSError where it cannot be written, whatever HDF5 made of that."""
    with FileForHdf5(path) as file:
        try:
            yield file
        finally:
            file.require_written()
