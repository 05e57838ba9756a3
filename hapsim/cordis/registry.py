"""The types of module that a program can have, in the order in which they act. A new one is a file and a line here."""

from __future__ import annotations

from hapsim.cordis.build_context import PartType
from hapsim.cordis.modules.buffer import BUFFER
from hapsim.cordis.modules.friction import FRICTION
from hapsim.cordis.modules.membrane import MEMBRANE
from hapsim.cordis.modules.nonlinear import NONLINEAR_DAMPER, NONLINEAR_SPRING
from hapsim.cordis.modules.plectrum import PLECTRUM
from hapsim.cordis.modules.points import CELL, GROUND, MASS
from hapsim.cordis.modules.string import STIFF_STRING, STRING
from hapsim.cordis.modules.viscoelastic import CENTRED, DAMPER, FILTERED, SENSED, SPRING, VISCOELASTIC

PART_TYPES: tuple[PartType, ...] = (
    GROUND,
    MASS,
    CELL,
    STRING,
    STIFF_STRING,
    MEMBRANE,
    VISCOELASTIC,
    CENTRED,
    FILTERED,
    SENSED,
    SPRING,
    DAMPER,
    BUFFER,
    NONLINEAR_SPRING,
    NONLINEAR_DAMPER,
    FRICTION,
    PLECTRUM,
)
