"""The scenes that ship with hapsim: beside the sources in a clone, under the prefix's share/ when installed."""

from __future__ import annotations

import sys
from pathlib import Path

from hapsim.errors import HapsimError


def shipped_scene(name: str) -> str:
    """The text of a shipped scene. HapsimError where the installation lacks it."""
    places = (Path(__file__).parent.parent / "configs", Path(sys.prefix) / "share" / "hapsim" / "configs")
    for place in places:
        if (place / name).is_file():
            return (place / name).read_text(encoding="utf-8")
    raise HapsimError(f"{name}: not among the files of this installation of hapsim; looked in {places[0]}, {places[1]}")
