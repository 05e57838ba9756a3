"""Nothing that is predicted unstable runs unless that is asked for: it shakes the hand with all the force there is.

What was not worked out, or is at the very limit, is no reason to refuse: `hapsim.prediction.surely_shaken_by`.
"""

from __future__ import annotations

from hapsim.errors import UsageError
from hapsim.number_format import between, rounded_down
from hapsim.prediction import Prediction, is_surely_unstable, surely_shaken_by
from hapsim.scene import Scene


def require_startable(scene: Scene) -> None:
    """UsageError where `scene` is surely unstable, before anything is armed."""
    shaken = surely_shaken_by(scene)
    if shaken is not None:
        raise UsageError(f"not armed: the scene is predicted unstable: {shaken.sentence}")


def require_followable(before: Scene, scene: Scene) -> None:
    """UsageError where `scene` is surely unstable, and more so than `before`, which runs: what is unstable may be made
    less so."""
    shaken = surely_shaken_by(scene)
    if shaken is None:
        return
    now = surely_shaken_by(before)
    if now is None or shaken.growth > now.growth:
        raise UsageError(f"the scene is predicted unstable: {shaken.sentence}")


def why_not_armed(path: str, scene: Scene, prediction: Prediction) -> str:
    """Why `scene`, of which this was predicted, is not armed, and what to do, in sentences; "" where it may be. `path`:
    its file."""
    if not is_surely_unstable(prediction):
        return ""
    shaken = surely_shaken_by(scene)
    grows = "" if shaken is None else f": {shaken.sentence}"
    return (
        f"{path}: not armed: the scene is predicted unstable (spectral radius {prediction.spectral_radius:.6g}, stable "
        f"below 1){grows}.{_what_is_stable(prediction)} `hapsim check` tells more; with --unstable it runs all the "
        f"same, and the hand is shaken with up to the force limit of {scene.device.force_limit:g} N until the "
        "energy guard ends the run, or that of the swing at the limit (hapsim/STABILITY.md tells what they find)"
    )


def _what_is_stable(prediction: Prediction) -> str:
    """Of hands that are systems of their own: with how much of its stiffness, or with which damping, each would be
    stable, in a sentence."""
    ways = []
    for one in prediction.felt:
        least, most = one.stable_damping
        if 0.0 < one.stiffness_factor < 1.0:
            ways.append(f"{one.name} with less than {rounded_down(one.stiffness_factor)} of its stiffness")
        if not one.stable and least < most:
            ways.append(f"{one.name} with a damping between {between(max(least, 0.0), most, ' and ')} N·s/m")
    return f" Stable by itself: {'; or '.join(ways)}." if ways else ""
