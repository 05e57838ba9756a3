"""Files that are written whole or not at all: beside their place first, then moved into it."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from hapsim.errors import UsageError


@contextlib.contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yields the path of another file to write, which at the end takes the place and the permissions of `path`; if
    writing fails, `path` stays as it is. A link stays one. UsageError where the file cannot be written.

    Where no other file can take its place, as of a device or in a directory that cannot be written, it is `path`.
    """
    place = Path(os.path.realpath(path))
    beside = place.with_name(f".{os.getpid()}.{place.name}")
    is_replaced = not place.exists() or (place.is_file() and os.access(place.parent, os.W_OK))
    try:
        yield beside if is_replaced else place
        if is_replaced:
            if place.exists():
                shutil.copymode(place, beside)
            os.replace(beside, place)
    except OSError as error:
        raise UsageError(f"{path}: the file cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            beside.unlink()
