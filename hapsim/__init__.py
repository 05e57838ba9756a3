"""hapsim: a real-time haptic simulator that tells what stiffness and damping the hand really feels.

    scene = hapsim.load_scene("configs/first_touch.yaml")
    hapsim.predict(scene).felt[0].k        # before it runs
    hapsim.measure(scene).k                # while it runs
    trace = hapsim.run(scene, duration=2.0)

The rooms are named so that none of them hides one of these functions. Nothing heavy is imported before one of them
is called.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hapsim.measuring.measure import measure as measure
    from hapsim.prediction import predict as predict
    from hapsim.running import run as run
    from hapsim.running import start as start
    from hapsim.scene import load_scene as load_scene

_HOME = {
    "load_scene": "hapsim.scene",
    "predict": "hapsim.prediction",
    "run": "hapsim.running",
    "start": "hapsim.running",
    "measure": "hapsim.measuring.measure",
}
__all__ = ["load_scene", "measure", "predict", "run", "start"]
__version__ = "0.1.0"


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'hapsim' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
