"""`hapsim check`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from hapsim.cli.arguments import Json, SceneFile, load, stderr, stdout
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from hapsim.cordis.explain import Explanation
    from hapsim.scene import Scene


def check(
    scene: SceneFile,
    json: Json = False,
    explain: Annotated[
        bool,
        typer.Option("--explain", help="Compile the scene too: what is kept of it, what that costs."),
    ] = False,
) -> None:
    """Predict, without running: stable or not, what the hand will feel, every mode, what the wire costs."""
    from hapsim.cli.wire import show_force_bounds, slew_warnings
    from hapsim.prediction import predict, predict_on_wire, warnings_about
    from hapsim.prediction.force_bounds import refused_travel, run_bounds, travel_document

    loaded = load(scene)
    if why := refused_travel(loaded):
        raise UsageError(f"{scene}: {why}")
    with stderr().status("working out the modes and how much each link may grow"):
        prediction = predict(loaded)
        on_wire = predict_on_wire(loaded)
    explanation = _explanation(loaded) if explain else None
    if json:
        from hapsim.cli.as_json import document, prediction_document

        compiled = {} if explanation is None else {"compiled": explanation.as_document()}
        bounds = {"force_bounds": run_bounds(loaded)._asdict(), "travel": travel_document(loaded)}
        warnings = slew_warnings(loaded, prediction)
        warnings += [one for one in warnings_about(loaded, prediction) if one not in warnings]
        predicted = prediction_document(prediction, on_wire=on_wire)
        print(document({"scene": scene, "warnings": warnings} | predicted | bounds | compiled))
        return
    from hapsim.cli.prediction import show_prediction

    show_prediction(stdout(), scene, loaded, prediction, on_wire)
    show_force_bounds(stdout(), loaded, prediction)
    if explanation is not None:
        from hapsim.cli.explained import show_explanation

        show_explanation(stdout(), explanation)


def _explanation(scene: Scene) -> Explanation:
    from hapsim.cordis.explain import explain

    with stderr().status("compiling") as status:
        return explain(scene, lambda part: status.update(f"compiling and timing {part}"))
