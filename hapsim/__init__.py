"""hapsim: a real-time haptic simulator that knows what stiffness and damping the hand really feels.

    scene = hapsim.load_scene("configs/first_touch.yaml")
    hapsim.predict(scene).felt[0].k        # before it runs
    hapsim.measure(scene).k                # while it runs
    trace = hapsim.run(scene, duration=2.0)

Public are the names in `__all__` here and in `hapsim.theory`, `hapsim.scene`, `hapsim.prediction`, `hapsim.running` and
`hapsim.errors` (USING.md, "From Python"); every other room and name is private and may change with any version.

The rooms are named so that none of them hides one of these functions. Nothing heavy is imported before one of them
is called.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # as in typing, whose import would double the time in which Ctrl-C is Python's traceback
if TYPE_CHECKING:
    from typing import Any

    from hapsim.measuring.diagnosis import Diagnosis as Diagnosis
    from hapsim.measuring.diagnosis import diagnose as diagnose
    from hapsim.measuring.identify_device import DeviceIdentification as DeviceIdentification
    from hapsim.measuring.identify_device import identify_device as identify_device
    from hapsim.measuring.identify_servo import ServoIdentification as ServoIdentification
    from hapsim.measuring.identify_servo import identify_servo as identify_servo
    from hapsim.measuring.identify_transmission import TransmissionIdentification as TransmissionIdentification
    from hapsim.measuring.identify_transmission import identify_transmission as identify_transmission
    from hapsim.measuring.measure import measure as measure
    from hapsim.measuring.measure_admittance import AdmittanceMeasurement as AdmittanceMeasurement
    from hapsim.measuring.measure_hands import HandsMeasurement as HandsMeasurement
    from hapsim.measuring.measure_hands import measure_hands as measure_hands
    from hapsim.measuring.measure_impedance import MeasuredImpedance as MeasuredImpedance
    from hapsim.measuring.measure_impedance import measure_impedance as measure_impedance
    from hapsim.measuring.measure_trace import Measurement as Measurement
    from hapsim.measuring.measure_trace import identify as identify  # the former name of measure_trace
    from hapsim.measuring.measure_trace import measure_trace as measure_trace
    from hapsim.prediction import Prediction as Prediction
    from hapsim.prediction import predict as predict
    from hapsim.recording.trace import Trace as Trace
    from hapsim.recording.trace import load_trace as load_trace
    from hapsim.running import Session as Session
    from hapsim.running import run as run
    from hapsim.running import sessions as sessions
    from hapsim.running import start as start
    from hapsim.running.trials import Trials as Trials
    from hapsim.scene import Scene as Scene
    from hapsim.scene import load_scene as load_scene
    from hapsim.scene import parse_scene as parse_scene
    from hapsim.sweeping.sweep import sweep as sweep

_NAMES = {
    "hapsim.measuring.diagnosis": ("Diagnosis", "diagnose"),
    "hapsim.measuring.identify_device": ("DeviceIdentification", "identify_device"),
    "hapsim.measuring.identify_servo": ("ServoIdentification", "identify_servo"),
    "hapsim.measuring.identify_transmission": ("TransmissionIdentification", "identify_transmission"),
    "hapsim.measuring.measure": ("measure",),
    "hapsim.measuring.measure_admittance": ("AdmittanceMeasurement",),
    "hapsim.measuring.measure_hands": ("HandsMeasurement", "measure_hands"),
    "hapsim.measuring.measure_impedance": ("MeasuredImpedance", "measure_impedance"),
    "hapsim.measuring.measure_trace": ("Measurement", "identify", "measure_trace"),
    "hapsim.prediction": ("Prediction", "predict"),
    "hapsim.recording.trace": ("Trace", "load_trace"),
    "hapsim.running": ("Session", "run", "sessions", "start"),
    "hapsim.running.trials": ("Trials",),
    "hapsim.scene": ("Scene", "load_scene", "parse_scene"),
    "hapsim.sweeping.sweep": ("sweep",),
}
_HOME = {name: module for module, names in _NAMES.items() for name in names}
__all__ = list(_HOME)
__version__ = "0.1.0"


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'hapsim' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
