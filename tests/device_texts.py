"""Text of a scene whose device and mock are to be filled in, and the faults of such a text."""

from __future__ import annotations

from hapsim.errors import SceneError
from hapsim.scene import parse_scene

TEXT = """version: 1
rate: 1000
device: {DEVICE}
mock: {MOCK}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 2000, damping: 5DAMPER}
"""


def text_of(device: str, mock: str = "seed: 1", damper: str = "") -> str:
    return TEXT.replace("DEVICE", device).replace("MOCK", mock).replace("DAMPER", damper)


def faults_in(text: str) -> list[str]:
    """Returns the faults of a text, without their lines and columns."""
    try:
        parse_scene(text)
    except SceneError as error:
        return [line.split(": ", 1)[1] for line in str(error).splitlines()]
    return []
