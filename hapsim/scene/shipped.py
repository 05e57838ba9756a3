"""The scenes and the fault scripts that ship with hapsim."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

SCENES = Path(str(files("hapsim") / "configs"))
"""The directory of the scenes and their page."""

_BOARDS = SCENES / "boards"
_SCRIPTS = SCENES / "faults"


def shipped_scenes() -> dict[str, str]:
    """Returns the names of the scenes that ship, each with the first sentence of its file."""
    return {name: _first_sentence(shipped_scene(name)) for name in _names(SCENES)}


def shipped_scene(name: str) -> str:
    """Returns the text of the scene of this name, with or without `.yaml`."""
    return (SCENES / _file_name(name)).read_text(encoding="utf-8")


def shipped_scene_path(name: str) -> Path | None:
    """Returns the file of the scene of this name, with or without `.yaml`; None if no such scene ships."""
    stem = name.removesuffix(".yaml")
    return SCENES / f"{stem}.yaml" if stem in _names(SCENES) else None


def shipped_boards() -> list[str]:
    """Returns the names of the boards for which a first scene ships."""
    return _names(_BOARDS)


def shipped_board(name: str) -> str:
    """Returns the text of the first scene of this board."""
    return (_BOARDS / f"{name}.yaml").read_text(encoding="utf-8")


def shipped_scripts() -> list[str]:
    """Returns the names of the fault scripts that ship."""
    return _names(_SCRIPTS)


def shipped_script(name: str) -> str:
    """Returns the text of the fault script of this name."""
    return (_SCRIPTS / _file_name(name)).read_text(encoding="utf-8")


def _file_name(name: str) -> str:
    return f"{name.removesuffix('.yaml')}.yaml"


def _names(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.yaml"))


def _first_sentence(scene: str) -> str:
    comment = scene.partition("\n#\n")[0].replace("\n# ", " ").removeprefix("# ")
    return comment.partition(". ")[0].rstrip(".\n") + "."
