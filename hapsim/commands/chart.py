"""The commands `hapsim chart …`. They parse, call, and show; pictures are worked out and drawn in `hapsim/chart`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapsim.commands.arguments import Json, say_written, stderr, stdout
from hapsim.commands.chart_options import (
    Channel,
    Cutoff,
    Damper,
    Data,
    Delay,
    Friction,
    Hold,
    MaybeScene,
    Picture,
    Rate,
    Sampling,
    SceneFile,
    SimulatedB,
    SimulatedK,
    Stiffness,
    correction_asked_for,
    hands_asked_for,
    in_paper_units,
    loop_options,
    print_json,
    save_rows,
    writable,
)
from hapsim.console.options import names, numbers
from hapsim.console.sentences import say
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from hapsim.chart.hand import Hand
    from hapsim.chart.scale import Scale
    from hapsim.chart.view import View

app = typer.Typer(
    name="chart",
    help="Draw what the hand feels: pictures as a paper prints them, and their numbers.",
    no_args_is_help=True,
)

_OBJECTS = "spring, contact, string-10, string-100, string-1000, stiff-string-100"


@app.command()
def plane(
    context: typer.Context,
    scene: MaybeScene = None,
    channel: Channel = None,
    mass: Annotated[
        list[str] | None,
        typer.Option(
            metavar="M",
            help="Hand and moving part, kg; several, 0.1,0.2,0.4, for a hand that nobody knows.",
        ),
    ] = None,
    rate: Rate = None,
    friction: Friction = None,  # noqa: ARG001
    stiffness: Stiffness = None,  # noqa: ARG001
    delay: Delay = None,  # noqa: ARG001
    hold: Hold = None,  # noqa: ARG001
    sampling: Sampling = None,  # noqa: ARG001
    damper: Damper = None,  # noqa: ARG001
    cutoff: Cutoff = None,  # noqa: ARG001
    simulated_stiffness: SimulatedK = None,
    simulated_damping: SimulatedB = None,
    normalised: Annotated[
        bool, typer.Option("--normalised", help="The paper's units, K T²/m and B T/m; --mass and --rate default to 1.")
    ] = False,
    total_damping: Annotated[
        bool, typer.Option("--total-damping", help="B + b0 on the axis, as in the paper's Figure 9.")
    ] = False,
    to_stiffness: Annotated[
        float | None, typer.Option(metavar="K", help="Where the K axis ends, in its unit; left out: found.")
    ] = None,
    to_damping: Annotated[
        float | None, typer.Option(metavar="B", help="Where the B axis ends, in its unit; left out: found.")
    ] = None,
    picture: Picture = None,
    data: Data = None,
    json: Json = False,
) -> None:
    """Draw the K,B plane: curves of equal k and b that the hand feels (the paper's Figures 7, 8 and 9).

    The options of the loop are in place of what SCENE says.
    """
    from hapsim.chart.scale import scale_of

    picture = writable(picture, data, json, "plane.svg")
    masses = numbers("--mass", mass)
    if normalised:
        masses, rate = in_paper_units(masses, rate, described_by_options=scene is None)
    given = loop_options(context, mass=masses[0] if masses else None, rate=rate)
    chosen, others = hands_asked_for(scene, channel, given, simulated_stiffness, simulated_damping)
    masses = masses or list(chosen.masses)
    drawn = _in_one_plane(chosen, others, masses)
    scale = scale_of(chosen.configuration, normalised=normalised, total=total_damping)
    view = _view(drawn, scale, total_damping, to_stiffness, to_damping)
    _draw_plane(drawn, len(masses) > 1, view, scale, normalised, picture, data)
    if json:
        print_json({"scene": scene, "hands": [hand.summary() for hand in drawn]}, picture, data)
        return
    _tell_of(drawn, [other for other in others if other not in drawn])
    say_written(picture, data)


@app.command()
def transparency(
    context: typer.Context,
    scene: MaybeScene = None,
    channel: Channel = None,
    mass: Annotated[float | None, typer.Option(metavar="M", help="Hand and moving part, kg.")] = None,
    rate: Rate = None,
    friction: Friction = None,  # noqa: ARG001
    stiffness: Stiffness = None,  # noqa: ARG001
    delay: Delay = None,  # noqa: ARG001
    hold: Hold = None,  # noqa: ARG001
    sampling: Sampling = None,  # noqa: ARG001
    damper: Damper = None,  # noqa: ARG001
    cutoff: Cutoff = None,  # noqa: ARG001
    simulated_stiffness: SimulatedK = None,
    simulated_damping: SimulatedB = None,
    picture: Picture = None,
    data: Data = None,
    json: Json = False,
) -> None:
    """Draw the rendered impedance beside the desired one, from frequency to frequency (Figure 2).

    The options of the loop are in place of what SCENE says.
    """
    from hapsim.chart.figure import save_columns
    from hapsim.chart.hand import described
    from hapsim.chart.transparency import draw_transparency
    from hapsim.chart.transparency import transparency as transparency_of

    picture = writable(picture, data, json, "transparency.svg")
    given = loop_options(context, mass=mass, rate=rate)
    hand, _ = hands_asked_for(scene, channel, given, simulated_stiffness, simulated_damping)
    if not hand.is_simulated:
        raise UsageError("--simulated-stiffness is missing: without a SCENE, it says what is simulated")
    worked_out = transparency_of(hand)
    if data is not None:
        save_columns(worked_out.columns(), data)
    if picture is not None:
        simulated = f"K = {hand.stiffness:.6g} N/m, B = {hand.damping:.6g} N·s/m"
        draw_transparency(worked_out, f"{simulated}; {described(hand.configuration)}", picture)
    bands = worked_out.gives_energy()
    if json:
        print_json({"scene": scene, "hand": hand.summary(), "gives_energy_hz": bands}, picture, data)
        return
    _tell_of([hand], [])
    frequency = worked_out.frequency
    words = ", ".join(_band(low, high, frequency[0], frequency[-1]) for low, high in bands)
    said = f"The wall gives the hand energy {words}." if bands else "At no frequency does the wall give energy."
    stdout().print(said)
    say_written(picture, data)


@app.command()
def table1(
    scene: SceneFile,
    channel: Channel = None,
    as_scene: Annotated[
        bool,
        typer.Option(
            "--as-scene", help="With the scene's hold, delay, friction and damping, in place of the paper's ideal loop."
        ),
    ] = False,
    correction: Annotated[
        str | None,
        typer.Option(metavar="KIND", help="poles, predictor; left out: none, with --as-scene the scene's own."),
    ] = None,
    picture: Picture = None,
    data: Data = None,
    json: Json = False,
) -> None:
    """Couple the hand's mass with real and simulated springs (the paper's Table 1), predicted and run on the mock."""
    from hapsim.chart.hand import described
    from hapsim.chart.table1 import draw_table1
    from hapsim.chart.table1 import table1 as table1_of
    from hapsim.console.live import live_line

    picture = writable(picture, data, json, "table1.svg")
    hand, _ = hands_asked_for(scene, channel, {}, as_written=True)
    corrected = correction_asked_for(correction, scene if as_scene else None)
    with live_line(stderr()) as tell:
        worked_out = table1_of(hand, as_scene=as_scene, correction=corrected, on_progress=tell)
    save_rows(worked_out.columns(), data)
    if picture is not None:
        tuned = f"K = {worked_out.K:.6g} N/m, k = {worked_out.k:.6g} N/m, correction: {corrected}"
        draw_table1(worked_out, f"{tuned}; {described(worked_out.configuration)}", picture)
    if json:
        columns = worked_out.columns()
        rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        found = {"scene": scene, "correction": corrected, "k": worked_out.k, "K": worked_out.K, "couplings": rows}
        print_json(found, picture, data)
        return
    stdout().print(_table(worked_out))
    say_written(picture, data)


@app.command("speed-accuracy")
def speed_accuracy(
    objects: Annotated[
        list[str] | None,
        typer.Option("--object", metavar="NAME", help=f"{_OBJECTS}; several, spring,contact; left out: all."),
    ] = None,
    schemes: Annotated[
        list[str] | None,
        typer.Option("--scheme", metavar="NAME", help="Schemes: several, cordis,exact; left out: all."),
    ] = None,
    rates: Annotated[
        list[str] | None,
        typer.Option("--rates", metavar="HZ", help="Sample rates, Hz: several, 1000,10000; left out: 500 to 50000."),
    ] = None,
    rounds: Annotated[int, typer.Option(metavar="N", help="How often each is timed; all take turns.")] = 5,
    peers: Annotated[
        Path | None,
        typer.Option("--with", metavar="FILE.json", help="Peers on the same axes, as tools/bench/schemes kept them."),
    ] = None,
    picture: Picture = None,
    data: Data = None,
    json: Json = False,
) -> None:
    """Draw what a simulated second costs against how far it is from the continuous object: objects, schemes, rates."""
    from hapsim.chart.speed_accuracy import draw_speed_accuracy
    from hapsim.console.live import live_words
    from hapsim.speed_accuracy.compare import RATES, compare
    from hapsim.speed_accuracy.front import fronts
    from hapsim.speed_accuracy.methods import schemes_named
    from hapsim.speed_accuracy.objects import objects_named
    from hapsim.speed_accuracy.rows import columns, peers_in
    from hapsim.speed_accuracy.verdict import verdict

    chosen, by = objects_named(names(objects)), schemes_named(names(schemes))
    at = _rates(numbers("--rates", rates)) or RATES
    if rounds < 1:
        raise UsageError(f"--rounds: found {rounds}, expected a whole number of at least 1")
    picture = writable(picture, data, json, "speed-accuracy.svg")
    rows = [] if peers is None else peers_in(peers, [one.name for one in chosen])
    with live_words(stderr()) as tell:
        rows = compare(chosen, at, rounds, tell, by) + rows
    save_rows(columns(rows, [row for front in fronts(rows).values() for row in front]), data)
    if picture is not None:
        draw_speed_accuracy(chosen, rows, picture)
    told = {one.name: verdict(one, rows) for one in chosen}
    if json:
        print_json({"objects": told, "rows": [row.as_document() for row in rows]}, picture, data)
        return
    for sentence in told.values():
        say(sentence)
    say_written(picture, data)


def _rates(found: list[float]) -> list[float]:
    for rate in found:
        if not 0.0 < rate < float("inf"):
            raise UsageError(f"--rates: found {rate:g}, expected a finite number above 0")
    return found


def _in_one_plane(chosen: Hand, others: list[Hand], masses: list[float]) -> list[Hand]:
    """One hand of several masses; or all the hands that stand in the plane of the one that is asked for."""
    if len(masses) > 1:
        return [chosen.with_mass(mass) for mass in masses]
    return [chosen, *(other for other in others if other.configuration == chosen.configuration)]


def _view(
    drawn: list[Hand], scale: Scale, from_total: bool, to_stiffness: float | None, to_damping: float | None
) -> View:
    """The part of the plane that is drawn; its ends in the unit of `scale`, None where they are to be found."""
    from hapsim.chart.view import view_of

    return view_of(
        drawn,
        from_total=from_total,
        K_to=_end("--to-stiffness", to_stiffness, scale.stiffness),
        B_to=_end("--to-damping", to_damping, scale.damping, scale.offset),
    )


def _end(option: str, value: float | None, unit: float, offset: float = 0.0) -> float | None:
    """The end of an axis in SI units."""
    if value is None:
        return None
    if not 0.0 < value < float("inf"):
        raise UsageError(f"{option}: found {value:g}, expected a finite number above 0")
    return value * unit - offset


def _draw_plane(
    drawn: list[Hand],
    several_masses: bool,
    view: View,
    scale: Scale,
    normalised: bool,
    picture: Path | None,
    data: Path | None,
) -> None:
    """The plane, or the planes of several masses in one, to where they are asked for."""
    from hapsim.chart.family import draw_family, family
    from hapsim.chart.hand import described
    from hapsim.chart.plane import draw_plane
    from hapsim.chart.plane import plane as plane_of

    worked_out: Any = family(drawn, view, scale) if several_masses else plane_of(drawn, view, scale)
    save_rows(worked_out.columns(), data)
    if picture is not None:
        title = described(drawn[0].configuration, mass=not several_masses, normalised=normalised)
        (draw_family if several_masses else draw_plane)(worked_out, title, picture)


def _tell_of(drawn: list[Hand], others: list[Hand]) -> None:
    """What is simulated and felt of what is drawn, and where the others are."""
    for hand in drawn:
        if hand.is_simulated:
            stdout().print(_told(hand))
    for other in others:
        say(f"{other.name} has a plane of its own: --channel {other.channel}")


def _told(hand: Hand) -> str:
    """What is simulated and felt, and how far each may go, in a sentence."""
    known = hand.summary()
    who = f"{hand.name} of {known['mass']:g} kg"
    who = who if known["stable"] else f"UNSTABLE: {who}"
    felt = (
        f"{who}: K = {known['stiffness']:g} N/m, B = {known['damping']:g} N·s/m is felt as "
        f"k = {known['k']:.6g} N/m, b = {known['b']:.6g} N·s/m"
        if known["dominant"]
        else f"{who}: no spring and damper is equivalent"
    )
    ends = []
    for name, unit, other in (("stiffness", "N/m", "B"), ("damping", "N·s/m", "K")):
        low, high = known[f"stable_{name}"]
        if high > 0.0:  # nobody writes a negative one
            which = "K" if other == "B" else "B"
            ends.append(f"for {which} from {_not_below_zero(low, high):.4g} to {high:.4g} {unit} at this {other}")
    return f"{felt}; stable {' and '.join(ends)}." if ends else f"{felt}; not stable with this K or B."


def _band(low: float, high: float, first: float, last: float) -> str:
    """Where a band begins or ends with the picture, that is no property of the wall."""
    if low <= first:
        return "at every frequency drawn" if high >= last else f"below {high:.4g} Hz"
    return f"above {low:.4g} Hz" if high >= last else f"from {low:.4g} to {high:.4g} Hz"


def _not_below_zero(low: float, high: float) -> float:
    return low if low > 1e-12 * high else 0.0


def _table(worked_out: Any) -> Any:
    from rich.table import Table

    table = Table(title="Table 1: a mass on real springs k and simulated springs K", title_justify="left")
    for heading in ("", "k  N/m", "K  N/m", "predicted  Hz", "measured  Hz", "off by", "of I"):
        table.add_column(heading, justify="right" if heading else "left")
    for one in worked_out.couplings.values():
        table.add_row(
            one.numeral,
            f"{one.configuration.stiffness:.6g}",
            f"{one.K:.6g}",
            f"{one.predicted_hz:.9g}",
            f"{one.measured_hz:.9g}",
            f"{one.off_by:+.0e}",
            f"{worked_out.relative(one.numeral):.7f}",
        )
    return table
