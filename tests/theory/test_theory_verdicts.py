"""Verdicts on random scenes of the kinds that are hard to judge, against the mock that is pushed: a few of those of
`tools/bench/verdicts`."""

from __future__ import annotations

import pytest

from hapsim import predict
from tests import thorough
from tests.verdict_scenes import KINDS, as_scene, is_shaken, pushes, verdict_scene

SCENES, PUSHES = thorough.points(2, 4), 4


@pytest.mark.parametrize("kind", KINDS)
def test_no_scene_that_is_called_stable_swings_on_and_few_are_refused_that_rest(kind: str) -> None:
    at_rest = []
    for seed in range(SCENES):
        document = verdict_scene(kind, seed)
        prediction = predict(as_scene(document), with_margins=False)
        tried = pushes(seed, PUSHES if prediction.stable else 10 * PUSHES)
        is_swinging = any(is_shaken(document, push) for push in tried)
        assert not (prediction.stable and is_swinging), seed
        if not prediction.stable and not is_swinging:
            at_rest.append(seed)
    assert len(at_rest) <= 1, at_rest
