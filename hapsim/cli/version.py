"""What a bug report begins with: the versions of everything that decides what hapsim does."""

from __future__ import annotations

import platform
from importlib import metadata

import hapsim
from firmware_protocol import schema


def version_lines() -> list[str]:
    """One item each. Nothing of them is imported to be asked: a package that is broken has its version told too."""
    return [
        f"hapsim {hapsim.__version__}",
        f"wire protocol {schema.VERSION}, schema 0x{schema.SCHEMA_HASH:08x}",
        f"Python {platform.python_version()} ({platform.python_implementation()})",
        *(f"{package} {_version_of(package)}" for package in ("numba", "numpy")),
        f"platform {platform.platform()}",
    ]


def _version_of(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"
