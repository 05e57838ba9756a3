"""What the hand would feel with other values, and the plane of K and B around them, for the panel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hapsim.errors import UsageError
from hapsim.running.parameters import Parameter
from hapsim.scene import Scene


def predicted(
    scene: Scene, parameters: Mapping[str, Parameter], values: Mapping[str, Any], hand: int, with_plane: bool
) -> dict[str, Any]:
    """Returns the fields of `predicted` for the scene with these values of its parameters. Raises UsageError."""
    raise UsageError(f"predictions are not there yet: {scene.path} {len(parameters)} {values} {hand} {with_plane}")
