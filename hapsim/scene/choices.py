"""Names that a scene can choose from: holds, samplings, dampers, schemes, corrections. Help texts and errors take them
from here.

Each name is defined under the same name in `hapsim.theory` and where it runs (`hapsim/device/mock`, `hapsim/cordis`).
Holds and dampers are declared in `hapsim/holds.py` and `hapsim/dampers.py`. Nothing heavy is imported here, so that a
help text that lists names costs nothing.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

from firmware_protocol.schema import MOTION_BITS, SENSED
from hapsim.dampers import DAMPERS
from hapsim.holds import HOLDS

_SCHEMES = {
    "cordis": "by CORDIS's centred scheme",
    "semi_implicit": "by the same with the step stored itself",
    "midpoint": "by the trapezoidal rule",
    "rk4": "by the Runge-Kutta rule of fourth order",
    "exact": "by the exact solution between forces that are held",
}
if TYPE_CHECKING:
    Hold = str
    DamperScheme = str
    SchemeName = str
else:
    Hold, DamperScheme, SchemeName = (Literal[tuple(one)] for one in (HOLDS, DAMPERS, _SCHEMES))


def _each(meanings: Mapping[str, str]) -> str:
    *others, last = (f"{meaning} ({name})" for name, meaning in meanings.items())
    return f"{', '.join(others)}, or {last}"


_HOLDS = "; ".join(f"{hold.meaning} ({name})" for name, hold in HOLDS.items())
HOLD = f"Conversion of received forces by the device: {_HOLDS}"

MOTION = (
    "Motion of the device: along a line (linear: m, N, kg), or about an axis (rotary: rad, N·m, kg·m², and N·m/rad "
    "for every N/m below)"
)

Law = Literal["host", "board"]
LAW = (
    "Who evaluates the force between two samples: nobody, the host's force is held (host); or the board, along the "
    "line that the host sends (board)"
)

Sampling = Literal["ideal", "average"]
SAMPLING = "Position that the device reads: at the instant (ideal), or as the mean over the period (average)"

Decimation = Literal["last", "mean"]
DECIMATION = (
    "Which of the forces of a sample's substeps the hand gets: the last one (last), or the mean of all (mean), which "
    "weakens what vibrates faster than half the rate"
)

DAMPER = f"Source of the damper's velocity: {_each({name: one.meaning for name, one in DAMPERS.items()})}"
#: The dampers that have a cutoff, and those that read the device's own velocity sensor.
WITH_CUTOFF = tuple(name for name, damper in DAMPERS.items() if damper.has_cutoff)
WITH_SENSOR = tuple(name for name, damper in DAMPERS.items() if damper.senses)

DetentShape = Literal["sine", "snap", "notch"]
DETENT_SHAPE = (
    "How the force of a detent runs from one rest to the next: as a sine (sine); straight up, and down again more "
    "steeply (snap); or in narrow notches with nothing between them (notch)"
)
#: The shapes of a detent that have a sharpness.
WITH_SHARPNESS: tuple[DetentShape, ...] = ("snap", "notch")

SCHEME = f"Integration of the masses from sample to sample: {_each(_SCHEMES)}"

SENSORS = tuple(part.name for part in SENSED if part.bit & MOTION_BITS)
"""Quantities of its motion that a device may sense beside the position, in the wire's order."""
SENT = tuple(part.name for part in SENSED)
"""Values per channel that a device may send beside its position, in that order."""

CorrectionName = Literal["none", "poles", "predictor", "adaptive", "sensed"]
BY_SENSORS = ("sensed",)
"""Corrections that take the motion ahead from sensors."""
PREDICTS = ("predictor", "adaptive")
"""Corrections that compute it from a mass."""
AHEAD = (*PREDICTS, *BY_SENSORS)
"""Corrections with which the links answer an expected motion, not the one that was read."""
CORRECTION = (
    "What is done so that the hand feels the stiffness and damping of the scene, and not what sampling, hold and delay "
    "make of them: nothing (none); the links at the device are given those that feel so (poles); their force answers "
    "the state that the mass will have when it acts (predictor); the same for a mass that is estimated (adaptive); "
    "every link answers the motion that velocity and acceleration sensors expect by then (sensed)"
)
