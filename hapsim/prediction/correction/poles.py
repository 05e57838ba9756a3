"""correction: poles. The links at the device are given the (K, B) whose felt (k, b) is the desired one.

By the closed form of the paper's Figure 4 (Florens et al., §5 and §6); nothing is added to the loop.
"""

from __future__ import annotations

from hapsim.prediction.correction.kind import CorrectionKind

POLES = CorrectionKind(
    name="poles",
    with_damper=None,
    predicts=False,
    adapts=False,
    seen_by_theory=lambda declared: declared,
    closed=lambda true, _declared, _observer: true,
)
