"""A small good scene, and the faults of a bad one."""

from collections.abc import Callable

import pytest

from hapsim.errors import SceneError
from hapsim.scene import parse_scene

GOOD = """\
version: 1
rate: 1000
device: {mass: 0.2}
modules:
  hand:  {type: device, channel: 0}
  wall:  {type: ground}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 2000}
"""


@pytest.fixture
def good() -> str:
    """The smallest scene with a hand and something to touch."""
    return GOOD


@pytest.fixture
def faults() -> Callable[[str], list[str]]:
    """The lines of the error of a text, each without the name of the text."""

    def faults_of(text: str) -> list[str]:
        with pytest.raises(SceneError) as caught:
            parse_scene(text, "s.yaml")
        lines = str(caught.value).splitlines()
        assert all(line.startswith("s.yaml:") for line in lines)
        return [line.removeprefix("s.yaml:") for line in lines]

    return faults_of


@pytest.fixture
def only_fault(faults: Callable[[str], list[str]]) -> Callable[[str, str], str]:
    """The one fault of the good scene after one piece of it was replaced."""

    def fault_of(old: str, new: str) -> str:
        assert GOOD.count(old) == 1
        (fault,) = faults(GOOD.replace(old, new))
        return fault

    return fault_of
