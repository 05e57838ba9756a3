"""What a scene can be simulated by: the schemes that it may name, and how long its numbers are."""

from __future__ import annotations

from typing import Any

from hapsim.scene import Scene

PRECISIONS = ("double", "single")
_DEFAULT = "cordis"


def schemes() -> tuple[str, ...]:
    """The schemes for simulated masses."""
    if "scheme" not in Scene.model_fields:
        return (_DEFAULT,)
    from hapsim.cordis.schemes import SCHEMES

    return tuple(SCHEMES)


def scene_with(method: str, precision: str, **parts: Any) -> Scene:
    """The scene of these parts by this scheme; where it has no masses, that makes no difference."""
    scheme = {"scheme": method} if "scheme" in Scene.model_fields else {}
    return Scene(version=1, precision=precision, **scheme, **parts)  # type: ignore[arg-type]
