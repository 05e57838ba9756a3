"""Options of `hapsim measure`."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from hapsim.cli.command_options import (
    At,
    DeviceOptions,
    Json,
    PictureOptions,
    RecordOptions,
    Unstable,
    flag,
    option,
    print_written,
    push_option,
    require_units,
    seconds,
)
from hapsim.cli.live import live_line
from hapsim.cli.output import stderr, warn


@dataclass
class ExcitationOptions(DeviceOptions):
    """A device, and the excitation of a hand on it by `hapsim measure`."""

    channel: int | None = option(None, "Channel to measure [default: the first, or all with --impedance]")
    at: At = None
    duration: float | None = seconds("Duration in seconds [default: about 2, or 8 per channel with --impedance]")
    push: float | None = push_option()
    branch: str | None = option(
        "BRANCH", "Measure a hand that slides along this branch of a curve with two: press or release.", "--branch"
    )
    hands: bool = flag("--hands", "Measure all linked hands: k and b of each, and of each pair.")
    mass: bool = flag("--mass", "Also measure the mass that the hand feels.")
    hand_stiffness: float | None = option(
        "KH", "With --mass: stiffness of the hand, such as 300 (N/m) [default: mock.hand.stiffness]", unit="N/m"
    )
    impedance: bool = flag("--impedance", "Measure the driving-point impedance over frequency instead of k and b.")
    travel: float | None = option(
        "M", "With --impedance: largest travel (approximate), such as 2mm [default: 0.001 m or 0.05 rad]", unit="m"
    )
    z_width: bool = flag("--z-width", "With --impedance: also measure the Z-width, against the stiffest passive wall.")

    def require_units(self, scene: Any, channels: Iterable[int]) -> None:
        """Raises UsageError where a quantity does not fit the hands on these channels."""
        for one in channels:
            require_units(scene.units_of(one), self.push, self.travel, self.hand_stiffness)


@dataclass
class MeasureOptions(RecordOptions, PictureOptions, ExcitationOptions):
    """The options of `hapsim measure`."""

    unstable: Unstable = False
    explain: bool = flag("--explain", "Also print the report of the run.")
    methods: bool = flag("--methods", "Also print a paragraph and a table for the methods section of a paper.")
    json: Json = False

    def require_writable(self) -> None:
        """Raises UsageError where a file cannot be written."""
        PictureOptions.require_writable(self)
        RecordOptions.require_writable(self)

    @contextlib.contextmanager
    def running(self) -> Iterator[dict[str, Any]]:
        """Shows the progress of measurements in the with-block. Yields the keyword arguments of each."""
        with live_line(stderr()) as show_progress:
            yield {
                "duration": self.duration,
                "push": self.push,
                "transport": self.kind(),
                "stop_on_signals": True,
                "unstable": None if self.unstable else False,
                "on_warning": partial(warn, event="unknown motor"),
                "on_progress": show_progress,
            }

    def print_files(self, channels: Sequence[int]) -> None:
        """Prints the names of the written files, with the traces of these channels."""
        self.print_written()
        for path in self.files_of(channels):
            print_written("Trace", path)
