"""A record as MCAP, with JSON messages: one for each row, which has a number for each quantity of each channel.

Times are those of the device's samples, counted from when the record was begun.
"""

from __future__ import annotations

import json
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer

from hapsim.number_format import plain
from hapsim.replaying.columns import Columns

_TEXT = {"text": {"type": "string"}}


def write_mcap(path: Path, columns: Columns) -> None:
    """Writes the record. OSError where it cannot be written."""
    begun, rate = columns.head.begun, columns.head.rate_hz
    begun_ns = round(datetime.fromisoformat(begun).timestamp() * 1e9) if begun else 0
    fields = {
        name: {"type": "number", "description": f"{column.description} ({unit})"}
        for column in columns.all
        for name, unit in zip(columns.names_of(column), columns.units_of(column), strict=True)
    }
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("", "hapsim")
        samples = _channel(writer, "samples", fields)
        changes, markers = (_channel(writer, name, _TEXT) for name in ("changes", "markers"))
        first_row, first_sample = 0, int(next(columns.pieces())["sample"][0])

        def add(channel: int, sample: int, message: dict[str, Any]) -> None:
            at = begun_ns + round((sample - first_sample) * 1e9 / rate)
            writer.add_message(channel, at, json.dumps(message).encode(), at)

        for values in columns.pieces():
            for row, text in columns.changes:
                if first_row <= row < first_row + len(values["time"]):
                    add(changes, int(values["sample"][row - first_row]), {"text": text})
            first_row += len(values["time"])
            finite = np.isfinite(values["asked_force"]).all()
            each = [one for column in columns.all for one in np.atleast_2d(values[column.name].T).tolist()]
            for row_values in zip(*each, strict=True):
                message = dict(zip(fields, row_values, strict=True))
                add(samples, message["sample"], message if finite else plain(message))
        for sample, text in columns.markers:
            add(markers, sample, {"text": text})
        texts = columns.documents.items()
        writer.add_metadata("record", {name: one if isinstance(one, str) else json.dumps(one) for name, one in texts})
        writer.finish()


def _channel(writer: Writer, name: str, fields: dict[str, Any]) -> int:
    schema = json.dumps({"type": "object", "properties": fields}).encode()
    return writer.register_channel(f"/hapsim/{name}", "json", writer.register_schema(name, "jsonschema", schema))
