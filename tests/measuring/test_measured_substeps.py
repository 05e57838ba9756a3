"""Random scenes with substeps: k and b measured as predicted, and the stiffness that makes them shake."""

from __future__ import annotations

import pytest

import hapsim
from tests import thorough
from tests.substep_scenes import errors, growth, random_scene, with_factor

SCENES = thorough.points(4, 8)


@pytest.mark.parametrize("seed", range(SCENES))
def test_k_and_b_are_measured_as_predicted(seed: int) -> None:
    assert max(errors(random_scene(seed))) < 1e-6


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("seed", range(4, 4 + SCENES // 2))
def test_below_its_margin_a_scene_comes_to_rest_and_above_it_shakes(seed: int) -> None:
    scene = random_scene(seed)
    margin = next(one for one in hapsim.predict(scene).margins if one.name == "touch").stiffness_factor
    below, above = (growth(with_factor(scene, "touch", by * margin)) for by in (0.999, 1.001))
    assert below[0] < 0.0 < above[0]
    assert [below[0], above[0]] == pytest.approx([below[1], above[1]], abs=1e-6)
