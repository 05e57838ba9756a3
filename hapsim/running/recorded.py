"""What a run leaves on the disk: its record, written while it runs; a report where something ended it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from firmware_protocol.description import Description
from hapsim.device.connection import Connection
from hapsim.errors import RecordError, RunError
from hapsim.loop import endings
from hapsim.loop.buffers import last_bytes
from hapsim.recording.recorder import RecordFile
from hapsim.recording.report_file import WireBytes, write_report
from hapsim.recording.stream import Head
from hapsim.recording.trace import columns_of
from hapsim.running.report import report_of, statistics_of, trace_of
from hapsim.running.session import Session


@contextlib.contextmanager
def recorded(session: Session, path: str | Path | None, on_warning: Callable[[str], None] | None) -> Iterator[None]:
    """While open, the rows are written to `path`; the report that it is closed with stands at the end."""
    if path is None:
        yield
        return
    scene, loop = session.scene, session._loop
    io, used = loop.record.io, slice(loop.wire.channels)
    head = Head(
        rate_hz=scene.rate,
        position_scale=io.position_scale[used].tolist(),
        force_scale=io.force_scale[used].tolist(),
        scene=scene.path or "",
        begun=datetime.now(UTC).isoformat(),
    )
    file = RecordFile(
        Path(path),
        head,
        lambda: (report_of(scene, loop, "running"), statistics_of(loop)),
        on_warning or (lambda _: None),
    )
    session._recorder.file = file
    try:
        yield
    finally:
        trace = session._trace or trace_of(scene, loop, session._recorder, endings.STOPPED)
        session._trace = replace(trace, report=file.finish(trace.report, trace.statistics))


def with_record(failure: RunError | None, name: str, session: Session) -> RunError | None:
    """The error of a run, or None, with what became of its record where that is not as it was asked for."""
    file, trace = session._recorder.file, session.trace
    if file is None or not file.problem:
        return failure
    if failure is not None:
        return _with_more(failure, f". And {file.problem}")
    told = RecordError(f"{name}: the run ended as asked after {trace.report.ticks} ticks, and {file.problem}")
    told.trace = trace
    return told


def with_report(
    failure: RunError | None,
    directory: Callable[[], Path | None],
    opened: Connection,
    session: Session,
    description: Description,
    spoken: bytes,
) -> RunError | None:
    """The error of a run, or None, with where its report file is, which is written here; no file where `directory`
    returns None. `spoken`: what was said to the device before the loop began. Whatever becomes of the file, the error
    stays."""
    if failure is None:
        return failure
    try:
        where = directory()
    except OSError as error:
        return _with_more(failure, f". No report of it could be written: {error.strerror or error}")
    if where is None:
        return failure
    loop = session._loop
    io, inbox = loop.record.io, loop.inbox
    wire = WireBytes(
        from_device=last_bytes(inbox.last, inbox.bytes),
        to_device=spoken + last_bytes(io.sent, io.outbox) + opened.take_written(),
    )
    last = replace(session.trace, **columns_of(session._recorder.last_rows()))
    try:
        path = write_report(where, opened.name, failure, last, session.scene, description, wire)
    except Exception as error:  # of the disk; or a defect, which must not hide what ended the run
        why = getattr(error, "strerror", None) or error
        return _with_more(failure, f". No report of it could be written in {where}: {why}")
    return _with_more(failure, f". The last frames and the last second are in {path} (`hapsim frames` reads it)")


def _with_more(failure: RunError, sentence: str) -> RunError:
    told = type(failure)(f"{failure}{sentence}")
    told.trace = failure.trace
    return told
