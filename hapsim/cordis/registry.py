"""The types of module that a program can have, in the order in which they act. A new one is a file and a line here."""

from __future__ import annotations

from hapsim.cordis.build_context import PartType
from hapsim.cordis.modules.linear_links import CENTRED, DAMPER, FILTERED, SENSED, SPRING, VISCOELASTIC
from hapsim.cordis.modules.membrane import MEMBRANE
from hapsim.cordis.modules.nonlinear_links import BUFFER, FRICTION, NONLINEAR_DAMPER, NONLINEAR_SPRING, PLECTRUM
from hapsim.cordis.modules.points import CELL, GROUND, MASS
from hapsim.cordis.modules.string import STIFF_STRING, STRING

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
