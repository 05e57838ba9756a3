"""The files by which a Linux system tells about itself, read under a root: any of them may be missing."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Tree:
    """A file system with /sys, /proc and /dev in it; tests give one of their own making."""

    root: Path = Path("/")

    def text(self, path: str) -> str:
        """What a file says, without the white space around it; "" where it is missing or not to be read."""
        try:
            return (self.root / path).read_text(encoding="utf-8", errors="replace").strip()
        except (OSError, ValueError):
            return ""

    def texts(self, pattern: str) -> list[str]:
        """What every file of a pattern says, in the order of their names; those that say nothing left out."""
        try:
            paths = sorted(path.relative_to(self.root).as_posix() for path in self.root.glob(pattern))
        except OSError:
            return []
        return [text for text in map(self.text, paths) if text]

    def resolve(self, path: str) -> Path:
        """Where a path such as /dev/serial/by-id/… leads to, told from this root: /dev/ttyUSB0."""
        target = (self.root / path.lstrip("/")).resolve()
        root = self.root.resolve()
        return Path("/") / target.relative_to(root) if target.is_relative_to(root) else target
