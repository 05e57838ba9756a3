"""Contents of /sys, /proc and /dev, which describe a Linux system."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class SystemFiles:
    """A file system with /sys, /proc and /dev in it; tests make one of their own."""

    root: Path = Path("/")

    def text(self, path: str) -> str:
        """Returns the text of a file, without the white space around it; "" if it is missing or cannot be read."""
        try:
            return (self.root / path).read_text(encoding="utf-8", errors="replace").strip()
        except (OSError, ValueError):
            return ""

    def texts(self, pattern: str) -> list[str]:
        """Returns the texts of every file of a pattern, in the order of their names, without empty ones."""
        try:
            paths = sorted(path.relative_to(self.root).as_posix() for path in self.root.glob(pattern))
        except OSError:
            return []
        return [text for text in map(self.text, paths) if text]

    def fields(self, path: str) -> dict[str, str]:
        """Returns the `name : value` lines of a file; of a name that comes once for each core, the first."""
        lines = [line.partition(":") for line in self.text(path).splitlines()]
        return {name.strip(): value.strip() for name, colon, value in reversed(lines) if colon}

    def resolve(self, path: str) -> Path:
        """Returns where a path such as /dev/serial/by-id/… leads to, as seen from this root: /dev/ttyUSB0."""
        target = (self.root / path.lstrip("/")).resolve()
        root = self.root.resolve()
        return Path("/") / target.relative_to(root) if target.is_relative_to(root) else target

    def group_limits(self, controller: str, files: Sequence[str], version_1: Sequence[str]) -> Iterator[str]:
        """Yields what these files say, of this process's control group and of each that it is in. `version_1`: the
        files of a controller of version 1."""
        for line in self.text("proc/self/cgroup").splitlines():
            _, controllers, group = line.split(":", 2)
            if not controllers or controller in controllers.split(","):
                mount, names = (f"sys/fs/cgroup/{controller}", version_1) if controllers else ("sys/fs/cgroup", files)
                own = Path(group.lstrip("/"))
                # A container may see its own group as the mount, under the name that its host has for it.
                for folder in (own, *own.parents):
                    yield " ".join(self.text(f"{mount}/{folder}/{name}") for name in names)


def cores_in(text: str) -> set[int]:
    """Returns the cores that a list such as 0-3,6 names; none if it is no such list."""
    try:
        ranges = [part.split("-") for part in text.split(",") if part]
        return {core for ends in ranges for core in range(int(ends[0]), int(ends[-1]) + 1)}
    except ValueError:
        return set()
