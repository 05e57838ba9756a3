"""The kinds of module that a program can have, in the order in which they act. A new one is a file and a line here."""

from __future__ import annotations

from hapsim.cordis.buffer import BUFFER
from hapsim.cordis.cell import CELL
from hapsim.cordis.damper import DAMPER
from hapsim.cordis.damper_backward import BACKWARD
from hapsim.cordis.damper_centred import CENTRED
from hapsim.cordis.damper_filtered import FILTERED
from hapsim.cordis.damper_sensed import SENSED
from hapsim.cordis.friction import FRICTION
from hapsim.cordis.ground import GROUND
from hapsim.cordis.kind import Kind
from hapsim.cordis.mass import MASS
from hapsim.cordis.membrane import MEMBRANE
from hapsim.cordis.nonlinear import NONLINEAR_DAMPER, NONLINEAR_SPRING
from hapsim.cordis.plectrum import PLECTRUM
from hapsim.cordis.spring import SPRING
from hapsim.cordis.stiff_string import STIFF_STRING
from hapsim.cordis.string import STRING

KINDS: tuple[Kind, ...] = (
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
