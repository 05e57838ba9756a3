"""The partial results of a sweep: each finished batch is a file, moved into place once it is complete.

The directory OUT.parts holds these files and sweep.json, which describes the sweep. The same command resumes with the
missing points. Any other sweep is refused.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.recording.background_file import lock
from hapsim.whole_file import whole_file

Columns = Mapping[str, NDArray[Any]]

_MANIFEST, _LOCK = "sweep.json", "lock"
_NUMBER = "point_number"  # the column with the numbers of a part's points


class Parts:
    """The directory of a sweep's finished batches, locked against other processes."""

    def __init__(self, out: Path, manifest: dict[str, Any]) -> None:
        """Opens or makes the directory. `manifest`: the description of the sweep, as in JSON. Raises UsageError if OUT
        exists, if the directory belongs to another sweep, or if another process writes it."""
        if out.exists():
            raise UsageError(f"{out}: it exists, and a sweep replaces nothing: name another file, or remove it")
        self.directory = out.with_name(f"{out.name}.parts")
        flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
        try:
            self.directory.mkdir(exist_ok=True)
            self._lock = os.open(self.directory / _LOCK, flags, 0o666)
        except OSError as error:
            raise UsageError(f"{self.directory}: cannot be written: {error.strerror}") from error
        try:
            lock(self._lock, self.directory, "sweep")
            self._check(manifest)
        except UsageError:
            self.close()
            raise

    def _check(self, manifest: dict[str, Any]) -> None:
        path = self.directory / _MANIFEST
        if not path.exists():
            with whole_file(path) as file:
                file.write_text(json.dumps(manifest), encoding="utf-8")
            return
        try:
            before = json.loads(path.read_text(encoding="utf-8"))
        except ValueError as error:
            raise UsageError(
                f"{path}: it is damaged ({error}): remove {self.directory}, or name another file"
            ) from error
        if differ := [key for key in manifest if before.get(key) != json.loads(json.dumps(manifest[key]))]:
            raise UsageError(
                f"{self.directory}: it has the results of another sweep, which differs in: {', '.join(differ)}. Name "
                "another file, or remove the directory"
            )

    def add(self, numbers: NDArray[np.int64], columns: Columns) -> None:
        """Keeps the results of the points with these numbers."""
        with whole_file(self.directory / f"{numbers[0]:09d}.npz") as file, file.open("wb") as stream:
            np.savez(stream, allow_pickle=False, **{_NUMBER: numbers, **columns})

    def read(self) -> Iterator[tuple[NDArray[np.int64], Columns]]:
        """Yields the points' numbers and their results, part by part. Raises UsageError for a damaged part."""
        for path in sorted(self.directory.glob("*.npz")):
            try:
                with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
                    columns = {name: file[name] for name in file.files}
                yield columns.pop(_NUMBER), columns
            except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
                raise UsageError(f"{path}: it is damaged ({error}): remove it, and start the sweep again") from error

    def missing(self, count: int) -> NDArray[np.int64]:
        """Returns the numbers of those of `count` points that have no results yet."""
        done = np.zeros(count, bool)
        for numbers, _ in self.read():
            done[numbers] = True
        return np.flatnonzero(~done).astype(np.int64)

    def together(self, count: int, names: Iterable[str] = ()) -> dict[str, NDArray[Any]]:
        """Returns the results of all `count` points by name, (count, …); NaN for a missing one. Has each of `names`."""
        found: dict[str, NDArray[Any]] = {name: np.full(count, np.nan) for name in names}
        for numbers, columns in self.read():
            for name, column in columns.items():
                is_text = column.dtype.kind == "U"
                if name not in found or found[name].ndim < column.ndim:
                    empty = "" if is_text else np.nan
                    found[name] = np.full((count, *column.shape[1:]), empty, object if is_text else float)
                found[name][numbers] = column
        return found

    def remove(self) -> None:
        """Removes the directory: its results are in OUT."""
        self.close()
        shutil.rmtree(self.directory, ignore_errors=True)

    def close(self) -> None:
        """Unlocks the directory, so that another process can resume the sweep."""
        os.close(self._lock)
