"""`hapsim check`: about ten lines, everything with --explain (`check_details`), or a JSON document."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from itertools import chain
from typing import TYPE_CHECKING, Any

import typer
from rich.markup import escape
from typer import Context

from hapsim.cli import check_details as details
from hapsim.cli import check_hands, check_plane, check_ports, check_regions
from hapsim.cli.check_correction import correction_lines, tolerance_sentences, unreached_sentences
from hapsim.cli.command_options import (
    At,
    Json,
    SceneFile,
    flag,
    lines_of_mock,
    load,
    option,
    place_at,
    places,
    print_next,
    scene_name,
)
from hapsim.cli.live import at_work
from hapsim.cli.option_modes import require_mode
from hapsim.cli.output import Line, document, show, stderr, stdout
from hapsim.documents import pick
from hapsim.errors import GuardError, UsageError
from hapsim.prediction import (
    Felt,
    Prediction,
    host_silence,
    partials_of,
    predict,
    predict_on_wire,
    warnings_about,
)
from hapsim.prediction.board_words import board_sentences
from hapsim.prediction.drives import drive_sentences, plays_of
from hapsim.prediction.felt_alone import SHARES
from hapsim.prediction.force_bounds import (
    guard_sentence,
    run_bounds,
    slew_problems,
    travel_document,
    travel_error,
)
from hapsim.prediction.linear import with_device
from hapsim.prediction.predict_ports import PortsPrediction
from hapsim.prediction.turning import turnings_of
from hapsim.prediction.verdict_words import (
    margin_sentences,
    next_command,
    predicted_for,
    verdict_sentences,
    verdict_words,
)
from hapsim.scene.scaled_links import scale_sentences
from hapsim.scene.words import words_sentence

if TYPE_CHECKING:
    from rich.console import Console

    from hapsim.cordis.offline import Explanation
    from hapsim.scene import Scene


def check(
    scene: SceneFile,
    json: Json = False,
    at: At = None,
    line: str | None = option(
        "X,Y:X,Y", "With space: 2: what the first hand feels along this line, stretch by stretch.", "--along"
    ),
    explain: bool = flag(
        "--explain", "Print every mode, margin and bound. Also compile the scene, and time its parts."
    ),
    hand_mass: str | None = option(
        "LOW:HIGH", "Check stability in any hand that adds a mass in this range, such as 100g:2kg.", "--hand-mass"
    ),
    hand_stiffness: str | None = option(
        "LOW:HIGH", "Range of the stiffness that such a hand adds, such as 0:500 (N/m) [default: 0]", "--hand-stiffness"
    ),
    require_stable: bool = flag("--require-stable", "Exit with status 2 unless the scene is predicted stable."),
    *,
    context: Context,
) -> None:
    """Predict stability, gain margins, and the stiffness and damping that the hand feels. Nothing is run."""
    loaded = load(scene)
    require_mode(context, loaded)
    if loaded.ports:
        _check_devices(scene, loaded, json, explain, require_stable)
        return
    place = place_at(loaded, at)
    if line is not None:
        _show_along(scene, loaded, line, json)
        return
    hands = check_hands.hand_ranges(loaded, hand_mass, hand_stiffness)
    if why := travel_error(loaded):
        raise UsageError(f"{scene_name(scene)}: {why}")
    with at_work(stderr(), "working out modes and gain margins"):
        prediction = predict(loaded, at=place)
        is_shown = json or explain or prediction.wire_of != "none"
        on_wire = predict_on_wire(loaded) if is_shown else None
        partials = partials_of(loaded, prediction) if loaded.sound else {}
        prediction.work_out()
    explanation = _explanation(loaded) if explain else None
    peaks = _sound_peaks(loaded) if explain and loaded.sound else {}
    of_slew = slew_problems(loaded, prediction)
    warnings = [*of_slew, *(one for one in warnings_about(loaded, prediction) if one not in of_slew)]
    if json:
        timed = explanation and pick(explanation, "* share")
        some = {"compiled": timed, "sound_peaks": peaks, "partials_hz": partials}
        about = {"scene": scene, "motion": loaded.device.motions(loaded.channels), "warnings": warnings}
        about |= _document(prediction, on_wire, hands)
        print(document(about | {name: one for name, one in some.items() if one}))
    else:
        lines = check_lines(loaded, prediction, on_wire, explanation, explain=explain, partials=partials, peaks=peaks)
        _show_verdict(stdout(), scene_name(scene), _stability(prediction, bool(of_slew)), prediction.rate)
        show(stdout(), [predicted_for(loaded), *lines])
        with at_work(stderr(), "trying hands"):
            of_hands = [*check_hands.worst_hand_sentences(prediction, hands)]
        show(stdout(), [*of_hands, *(f"[yellow]Warning:[/yellow] {escape(warning)}" for warning in warnings)])
        _print_next(scene, prediction, at, explain)
    if require_stable and not prediction.stable:
        raise typer.Exit(UsageError.exit_status)


def _check_devices(path: str, scene: Scene, json: bool, explain: bool, require_stable: bool) -> None:
    """Prints the prediction of a scene of several devices, section by section."""
    for port in scene.ports:
        if why := travel_error(scene.with_others_held(port)):
            raise UsageError(f"{scene_name(path)}: {port}: {why}")
    with at_work(stderr(), "working out modes and gain margins"):
        prediction = PortsPrediction(scene)
        prediction.work_out()
    warnings = warnings_about(scene, prediction)
    if json:
        about = {"scene": path, "motion": scene.motions, "warnings": warnings, "version": VERSION}
        print(document(about | check_ports.document(scene, prediction)))
    else:
        _show_verdict(stdout(), scene_name(path), _stability(prediction.worst, False), prediction.rate)
        for ports, one in prediction.sections.items():
            if isinstance(one, check_ports.AcrossPorts):
                lines = check_ports.across_lines(scene, one, explain)
            else:
                words = f"[bold]{escape(ports[0])}[/bold]: {escape(predicted_for(one.scene))}"
                lines = chain([words], check_lines(one.scene, one, predict_on_wire(one.scene), explain=explain))
            show(stdout(), lines)
        show(stdout(), (f"[yellow]Warning:[/yellow] {escape(warning)}" for warning in warnings))
        if not explain:
            print_next(*(("run", path) if prediction.shaking is None else ("check", path, "--explain")))
    if require_stable and not prediction.stable:
        raise typer.Exit(UsageError.exit_status)


def _print_next(path: str, prediction: Prediction, at: str | None, explain: bool) -> None:
    """Prints the command to try next."""
    command, *options = next_command(prediction, at is not None)
    if command == "check":
        options = ["--explain"]
    elif command == "measure" and at is not None:
        options.append(f"--at={at}")
    if command != "check" or not explain:
        print_next(command, path, *options)


def _document(
    prediction: Prediction, on_wire: Prediction | None, hands: tuple[check_hands.Range, check_hands.Range] | None
) -> dict[str, Any]:
    """Returns the keys of `hapsim check --json` that are worked out; arguments as of `prediction_document`, and the
    ranges of what hands add."""
    whole, scene = prediction_document(prediction, on_wire=on_wire), prediction.scene
    for one, part in zip(whole["parts"], prediction.parts, strict=True):
        one["any_hand"] = check_hands.any_hand_document(part.any_hand, hands)
    words = {key: scene.document[key] for key in ("inputs", "outputs") if scene.has_words}
    return whole | {"force_bounds": run_bounds(scene), "travel": travel_document(scene)} | words


def _show_along(path: str, scene: Scene, line: str, json: bool) -> None:
    """Prints what the hand feels along a line."""
    ends = places("--along", line, 2) or ()
    with at_work(stderr(), "working out stretches"):
        found = check_plane.along(scene, ends, json)
    if isinstance(found, dict):
        print(document({"scene": path, **found}))
    else:
        stdout().print(f"[bold]{escape(scene_name(path))}[/bold] along {escape(line)}")
        show(stdout(), found)


def _explanation(scene: Scene) -> Explanation:
    from hapsim.cordis.offline import explain

    with at_work(stderr(), "compiling") as show:
        return explain(scene, lambda part: show(f"compiling and timing {part}"))


def _sound_peaks(scene: Scene) -> dict[str, float]:
    """Returns the peak of each pick-up on the mock, in virtual time, with no hand moving it."""
    from hapsim.running import start

    with at_work(stderr(), "rendering the sound"):
        session = start(with_device(scene, port=None, clock="lockstep"), duration=details.RENDERED_S, keep=False)
        session.wait()
        with contextlib.suppress(GuardError):
            session.close()
    return session.sound_peaks


def _show_verdict(out: Console, scene: str, stability: str, rate: float) -> None:
    title, verdict = f"[bold]{escape(scene)}[/bold]", f"at {rate:g} Hz: {stability}"
    if len(scene) < out.width:
        out.print(title, verdict)
    else:
        out.print(title, soft_wrap=True)  # unbroken, so that it can be copied
        out.print(verdict)


def _stability(prediction: Prediction, is_slewed: bool) -> str:
    """`is_slewed`: the slew limit is too slow for the scene."""
    verdict, note, words = verdict_words(prediction, is_slewed)
    colour = "yellow" if note else {"stable": "green"}.get(verdict, "red")
    return f"[{colour}]{verdict}[/{colour}]{escape(note)}{f' ({escape(words)})' if words else ''}"


BRIEF, EXPLAIN, BOTH = {False}, {True}, {False, True}
"""The values of `explain` with which a line is printed."""


def check_lines(
    scene: Scene,
    prediction: Prediction,
    on_wire: Prediction | None,
    explanation: Explanation | None = None,
    *,
    explain: bool,
    partials: dict[str, tuple[float, ...]] | None = None,
    peaks: dict[str, float] | None = None,
) -> Iterator[Line]:
    """Yields the prediction: about ten lines, or everything with `explain`. `on_wire`: the result of `predict_on_wire`.
    Lines that are not printed are not computed."""
    every: tuple[tuple[set[bool], Iterable[Line]], ...] = (
        (EXPLAIN, details.assumption_lines(prediction.assumptions)),
        (EXPLAIN, details.felt_lines(prediction)),
        (BOTH, drive_sentences(prediction)),
        (BOTH, check_plane.place_lines(prediction)),
        (BOTH, check_hands.admittance_lines(prediction)),
        (BRIEF, check_hands.felt_lines(prediction, with_alone=True)),
        (BOTH, check_regions.region_lines(scene, prediction)),
        (BOTH, map(_coloured, verdict_sentences(prediction))),
        (BOTH, map(escape, scale_sentences(scene))),
        (EXPLAIN, correction_lines(prediction)),
        (EXPLAIN, check_hands.felt_lines(prediction, with_alone=False)),
        (EXPLAIN, check_hands.any_hand_sentences(prediction)),
        (BOTH, map(escape, board_sentences(prediction, lines_of_mock(scene), explain))),
        (EXPLAIN, details.mode_lines(prediction)),
        (BOTH, map(escape, margin_sentences(prediction, explain))),
        (EXPLAIN, details.margin_lines(prediction)),
        (EXPLAIN, [""]),
        (BOTH, details.wire_lines(prediction, on_wire, explain)),
        (BRIEF, [guard_sentence(scene)]),
        (EXPLAIN, details.force_sentences(scene, prediction)),
        (BOTH, details.travel_sentences(scene)),
        (BOTH, details.count_sentences(scene, prediction)),
        (BOTH, [f"Digital {words_sentence(scene.inputs, scene.outputs)}."] if scene.has_words else []),
        (EXPLAIN, details.device_sentences(scene, prediction)),
        (BRIEF, tolerance_sentences(prediction, SHARES[:1])),
        (BRIEF, unreached_sentences(prediction)),
        (BRIEF, details.assumption_lines(prediction.assumptions)),
        (EXPLAIN, details.explanation_lines(explanation) if explanation else []),
        (BOTH, details.partials_sentences(partials or {})),
        (EXPLAIN, details.sound_sentences(scene, peaks or {})),
    )
    return (line for level, lines in every if explain in level for line in lines)


def _coloured(sentence: str) -> str:
    """Returns a sentence about states of contacts, with a colour for those that are not stable."""
    for words, colour in (("Unstable", "red"), ("Not judged", "yellow")):
        if sentence.startswith(words):
            return f"[{colour}]{words}[/{colour}]{escape(sentence.removeprefix(words))}"
    return escape(sentence)


VERSION = 2
"""Version of the documents with a prediction: it grows when a key moves, or means something else."""
_SILENCE = tuple(
    f"time_to_live_samples watchdog_samples {name}zero_force_after_s latched_after_s"
    for name in ("", "brakes_after_s=")
)
_TOLERANCE = "share mass_kg=mass friction delay_samples=delay"
_CORRECTED = (
    "written.K=written.0 written.B=written.1 simulated.K=rendered.0 simulated.B=rendered.1 made_for_kg=made_for reached"
)
_PLAY = "backlash_m=backlash motor_m=swing.motor handle_m=swing.handle not_worked_out=reason"
_SWING = "least_m=least most_m=most force_n=force push_n=push"


def prediction_document(
    prediction: Prediction, channel: int | None = None, on_wire: Prediction | None = None
) -> dict[str, Any]:
    """Returns the document of `hapsim check --json`. `predicted` and `dominant` are of `channel` (None: the first).
    `on_wire`: the result of `predict_on_wire`."""
    felt, rendering = felt_on(prediction, channel), prediction.rendering
    modes = [
        pick(mode, "pole frequency_hz damping_ratio")
        | {"participation": dict(zip(prediction.points, mode.participation, strict=True))}
        for mode in prediction.modes
    ]
    corrected: dict[str, Any] = {}
    if rendering is not None and rendering.kind is not None:
        desired = [one for one in prediction.desired if channel in (None, one.channel)]
        corrected = {
            "desired": desired[0] if desired else None,
            "tolerances": {
                one.names[0]: [pick(each, _TOLERANCE) for each in one.tolerances()]
                for one in prediction.parts
                if one.hand is not None and (one.wanted is not None or one.alone is None)
            },
            "correction": {
                "name": rendering.kind.name,
                "device_points": {port.name: pick(port, _CORRECTED) for port in rendering.ports},
                "desired": _by_name(prediction.desired),
                "desired_modes": [pick(mode, "root frequency_hz damping_ratio") for mode in prediction.desired_modes],
                "notes": rendering.notes,
            },
        }
    board = prediction.scene.device.board(prediction.scene.rate)
    # Of the wire, `predicted` and `stable` are those at the delay that results, null where it costs one sample.
    on_wire = prediction if prediction.wire_delay else on_wire
    late = on_wire and felt_on(on_wire, channel)
    gated = {state: pick(one, "stable verdict spectral_radius") for state, one in prediction.with_inputs_off.items()}
    of_wire = {"of": prediction.wire_of, "predicted": late, "stable": on_wire and on_wire.stable}
    return {
        "version": VERSION,
        **pick(prediction, "stable verdict spectral_radius assumptions rate_hz=rate nominal_rate_hz=rate"),
        "here": check_plane.here_document(prediction),
        "dominant": felt is not None and felt.dominant,
        "predicted": felt,
        **corrected,
        **({} if board is None else {"board": board._asdict()}),
        **({"admittance": check_hands.admittance_document(prediction)} if prediction.felt_masses else {}),
        "parts": [check_hands.part_document(prediction, one) for one in prediction.parts],
        "swings": {name: swing and pick(swing, _SWING) for name, swing in prediction.judge.swings.items()},
        "plays": {name: pick(one, _PLAY) for name, one in plays_of(prediction).items()},
        "branches": {name: pick(one, one.DOCUMENT) for name, one in turnings_of(prediction.scene).items()},
        "contact_states": {
            **pick(prediction.states, "found=count complete=is_complete not_judged=unjudged"),
            "unstable": [pick(one, "state growth module") for one in prediction.states.growing],
        },
        "modes": modes,
        "margins": _by_name(prediction.margins),
        "margins_method": prediction.margins_method or ("every link" if prediction.margins else "none"),
        "wire_time": pick(prediction.wire_time, "* exchange_s fits delay_samples highest_rate_hz") | of_wire,
        "host_silence": pick(host_silence(prediction.rate), _SILENCE[prediction.scene.device.is_admittance]),
        **({"with_inputs_off": gated} if gated else {}),
    }


def _by_name(items: Iterable[Any]) -> dict[str, Any]:
    return {one.name: one for one in items}


def felt_on(prediction: Prediction, channel: int | None) -> Felt | None:
    """Returns the prediction for one channel (None: the first), if the hand there is a system of its own."""
    return next((felt for felt in prediction.felt if channel in (None, felt.channel)), None)
