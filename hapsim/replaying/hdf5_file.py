"""A record as HDF5: a dataset for each column, with its unit; the rest of the record as texts in the group `record`.

The datasets are plain arrays with dimension scales, `time` and `channel`, by which xarray names their dimensions.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from hapsim.loop import ring
from hapsim.replaying.columns import Columns
from hapsim.whole_file import file_for_hdf5

FLAGS = ("LATE_FORCE", "UNSENT", "LIMITED", "BRIDGED", "OFF_GRID", "SLEWED", "WITHHELD", "FADED")


def write_hdf5(path: Path, columns: Columns) -> None:
    """Writes the record. OSError where it cannot be written."""
    with file_for_hdf5(path) as place, h5py.File(place, "w") as file:
        file["channel"] = np.arange(columns.channels)
        file["channel"].attrs.update(units="1", description="of the device")
        file["channel"].make_scale("channel")
        for column in columns.all:
            shape = (columns.count, columns.channels)[: 1 + column.by_channel]
            made = file.create_dataset(column.name, shape, column.dtype)
            made.attrs.update(units=columns.units_text(column), description=column.description)
            if column.name == "time":  # the first
                made.make_scale("time")
                continue
            for at, name in enumerate(("time", "channel")[: made.ndim]):
                made.dims[at].attach_scale(file[name])
        file["flags"].attrs["flag_masks"] = np.array([getattr(ring, name) for name in FLAGS], "u1")
        file["flags"].attrs["flag_meanings"] = " ".join(FLAGS).lower()
        first = 0
        for values in columns.pieces():
            place.require_written()
            after = first + len(values["time"])
            for name, one in values.items():
                file[name][first:after] = one
            first = after
        _write_texts(file, columns)


def _write_texts(file: Any, columns: Columns) -> None:
    file.attrs.update(rate_hz=columns.head.rate_hz, begun=columns.head.begun, ending=columns.report["ending"])
    group = file.create_group("record")
    for name, document in columns.documents.items():
        group[name] = document if isinstance(document, str) else json.dumps(document)
    for name, at, entries in (("change", "row", columns.changes), ("marker", "sample", columns.markers)):
        group[name] = np.array([text for _, text in entries], h5py.string_dtype())
        group[f"{name}_{at}"] = np.array([place for place, _ in entries], np.int64)
