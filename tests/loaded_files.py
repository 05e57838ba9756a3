"""Modules of files that stand in no package: benches, tools, examples."""

from __future__ import annotations

import importlib.util
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any

BENCHES = Path(__file__).parents[1] / "tools" / "bench"


def module_of(file: Path) -> Any:
    """Returns the module of a file, whose name need not end in .py. It is made anew at each call."""
    loader = SourceFileLoader(file.stem, str(file))
    spec = importlib.util.spec_from_loader(file.stem, loader)
    assert spec is not None
    module = sys.modules[file.stem] = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module
