"""The types of module that a program can have, in the order in which they act. A new one is a file and a line here."""

from __future__ import annotations

from hapsim.cordis.build_context import PartType
from hapsim.cordis.modules.buffer import BUFFER
from hapsim.cordis.modules.cell import CELL
from hapsim.cordis.modules.damper import DAMPER
from hapsim.cordis.modules.damper_backward import BACKWARD
from hapsim.cordis.modules.damper_centred import CENTRED
from hapsim.cordis.modules.damper_filtered import FILTERED
from hapsim.cordis.modules.damper_sensed import SENSED
from hapsim.cordis.modules.friction import FRICTION
from hapsim.cordis.modules.ground import GROUND
from hapsim.cordis.modules.mass import MASS
from hapsim.cordis.modules.membrane import MEMBRANE
from hapsim.cordis.modules.nonlinear import NONLINEAR_DAMPER, NONLINEAR_SPRING
from hapsim.cordis.modules.plectrum import PLECTRUM
from hapsim.cordis.modules.spring import SPRING
from hapsim.cordis.modules.stiff_string import STIFF_STRING
from hapsim.cordis.modules.string import STRING

PART_TYPES: tuple[PartType, ...] = (
    GROUND,
    MASS,
    CELL,
    STRING,
    STIFF_STRING,
    MEMBRANE,
    BACKWARD,
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
