"""The scenes and the scripts of faults that ship: beside the sources in a clone, in the scheme's share/ elsewhere."""

from __future__ import annotations

import sysconfig
from collections.abc import Iterator
from pathlib import Path

from hapsim.errors import HapsimError

_PACKAGES = Path(__file__).parents[2]
_INSTALLED = Path("share") / "hapsim" / "configs"
_SCRIPTS = "faults"


def shipped_scene(name: str) -> str:
    """The text of a shipped scene. HapsimError where the installation lacks it."""
    places = list(dict.fromkeys(_places()))
    for place in places:
        if (place / name).is_file():
            return (place / name).read_text(encoding="utf-8")
    looked = ", ".join(map(str, places))
    raise HapsimError(f"{name}: not among the files of this installation of hapsim; looked in {looked}")


def shipped_scripts() -> list[str]:
    """The names of the scripts of faults that ship."""
    return sorted({path.stem for place in _places() for path in (place / _SCRIPTS).glob("*.yaml")})


def shipped_script(name: str) -> str:
    """The text of one of them. HapsimError where the installation lacks it."""
    return shipped_scene(f"{_SCRIPTS}/{name}.yaml")


def _places() -> Iterator[Path]:
    """Where they may be: a clone, then what pip makes of a wheel's data for everybody, for one user, in a folder."""
    yield _PACKAGES / "configs"
    yield Path(sysconfig.get_path("data")) / _INSTALLED
    yield Path(sysconfig.get_path("data", sysconfig.get_preferred_scheme("user"))) / _INSTALLED
    yield _PACKAGES / _INSTALLED
