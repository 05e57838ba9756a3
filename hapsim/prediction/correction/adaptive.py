"""correction: adaptive. The predictor, for the mass of the temporary hybrid system that is estimated while it runs.

Which masses it may be made for, so that no mass in the declared span is unstable, is worked out here and once;
``loop/adaptive.py`` estimates, and moves between them.
"""

from __future__ import annotations

from hapsim.prediction.correction.predictor import PREDICTOR

ADAPTIVE = PREDICTOR._replace(name="adaptive", adapts=True)
