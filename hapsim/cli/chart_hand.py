"""`hapsim chart plane`, `felt`, `force` and `transparency`: the hand of a scene, or one described by options."""

from __future__ import annotations

import math
from dataclasses import asdict, astuple, dataclass, replace
from functools import cached_property
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated, Any, get_args

from typer import Context

from hapsim.cli.check_regions import hand_lines
from hapsim.cli.command_options import (
    Json,
    PictureOptions,
    SceneFile,
    argument,
    flag,
    hand_channel,
    load,
    numbers,
    option,
    places,
    require_positive,
    require_units,
    scene_name,
)
from hapsim.cli.option_modes import COUPLED, require_mode
from hapsim.cli.output import document, output_units, print_line, show, stdout, table, use_channel_units
from hapsim.documents import pick
from hapsim.errors import UsageError
from hapsim.number_format import number, percent
from hapsim.prediction.linear import with_device
from hapsim.scene import choices
from hapsim.scene.issue import one_of

if TYPE_CHECKING:
    from hapsim.chart.hand import Hand
    from hapsim.chart.impedance_chart import Transparency
    from hapsim.scene import Scene
    from hapsim.theory.arrays import Floats


Channel = Annotated[int | None, option(None, "Channel of the hand [default: the first]")]
Mass = Annotated[float | None, option("M", "Mass of hand and handle, such as 200g [default: the scene's]", unit="kg")]


def _kind(choice: Any) -> Any:
    first, *_ = names = get_args(choice)
    return option("KIND", f"One of {', '.join(names)} [default: the scene's, or {first}]")


@dataclass
class HandOptions:
    """The hand of a chart: of a scene, or described by options. Options take precedence."""

    scene: str | None = argument("[SCENE]", "Scene file in YAML [default: a hand described by the options]")
    channel: Channel = None
    rate: float | None = option("HZ", "Sample rate in Hz [default: the scene's]")
    friction: float | None = option("B0", "Friction of the device in N·s/m [default: the scene's, or 0]", unit="N·s/m")
    stiffness: float | None = option("K0", "Spring of the device in N/m [default: the scene's, or 0]", unit="N/m")
    delay: float | None = option("N", "Delay in sample periods [default: the scene's, or 1]")
    hold: str | None = _kind(choices.Hold)
    sampling: str | None = _kind(choices.Sampling)
    damper: str | None = _kind(choices.DamperScheme)
    cutoff: float | None = option(
        "HZ", f"Cutoff of the {one_of(choices.WITH_CUTOFF)} damper in Hz [default: the scene's]"
    )

    @cached_property
    def loaded(self) -> Scene | None:
        """The scene, read once: it may be on standard input; None without one."""
        return None if self.scene is None else load(self.scene)

    def hands(
        self, mass: float | None, K: float | None = None, B: float | None = None, *, as_written: bool = False
    ) -> tuple[Hand, list[Hand]]:
        """Returns the hand, and the other hands of the scene. `mass`: kg. `K`, `B`: simulated, N/m and N·s/m. None: the
        scene's. `as_written`: without the scene's correction, and with the force law at the host."""
        from hapsim.chart.hand import hand_of_options

        given = {name: value for name, value in asdict(self).items() if value is not None} | (
            {} if mass is None else {"mass": mass}
        )
        channel, loaded, _ = given.pop("channel", None), self.loaded, given.pop("scene", None)
        if loaded is not None:
            loaded = with_device(loaded, law="host") if as_written else loaded
            hand, others = hands_of(loaded, channel, given, as_written=as_written)
        require_units(output_units(), *given.values(), K, B)
        if loaded is None:
            hand, others = hand_of_options(given), []
        return hand.with_simulated(K, B), others

    def normalised(self, masses: list[float]) -> tuple[HandOptions, list[float]]:
        """Returns the options and masses in the paper's units: mass and rate are 1 where nothing gives them."""
        if len(masses) > 1:
            raise UsageError("--normalised: found several masses, but the unit of the axes holds for one mass only")
        if self.scene is not None:
            return self, masses
        return replace(self, rate=1.0 if self.rate is None else self.rate), masses or [1.0]


@dataclass
class SimulatedOptions:
    """The simulated spring and damper, in place of the scene's."""

    simulated_stiffness: float | None = option("K", "Simulated stiffness K in N/m [default: the scene's]", unit="N/m")
    simulated_damping: float | None = option("B", "Simulated damping B in N·s/m [default: the scene's]", unit="N·s/m")


@dataclass
class ChartOutput(PictureOptions):
    """Output of a chart: a picture, its numbers, a JSON document."""

    picture: Path | None = option(
        "FILE", "Picture: .svg, .png or .pdf [default: the command's name with .svg; none with --data or --json]"
    )
    json: Json = False

    def choose(self, otherwise: str) -> None:
        """Chooses the picture's default name. Raises UsageError where a file cannot be written."""
        if not self.wanted and not self.json:
            self.picture = Path(otherwise)
        self.require_writable()

    def close(self, summary: dict[str, Any]) -> None:
        """Prints the document, or which files were written."""
        if self.json:
            print(document(summary | pick(self, "picture data")))
        else:
            self.print_written()


def hands_of(
    loaded: Scene, channel: int | None, given: dict[str, Any], *, as_written: bool = False
) -> tuple[Hand, list[Hand]]:
    """Returns the hand on `channel` of a scene (None: the first), changed by options, and the scene's other hands."""
    from hapsim.chart.hand import hands_of_scene

    if as_written:
        loaded = loaded.model_copy(update={"device": loaded.device.model_copy(update={"correction": "none"})})
    hands = hands_of_scene(loaded, given)
    chosen = next((hand for hand in hands if channel in (None, hand.channel)), None)
    if chosen is None:
        known = ", ".join(str(hand.channel) for hand in hands)
        raise UsageError(
            f"--channel {channel}: no hand there whose links all end on grounds; such hands are on: {known}"
        )
    use_channel_units(chosen.channel or 0)
    return chosen, [hand for hand in hands if hand is not chosen]


def print_hands(drawn: list[Hand], others: list[Hand], *, with_deformation: bool = False) -> None:
    """Prints what is simulated and felt of the hands drawn, and how to draw the others."""
    for hand in drawn:
        if hand.is_simulated:
            stdout().print(_felt_sentence(hand))
            if with_deformation and hand.summary()["dominant"]:
                stdout().print(_deformation_sentence(hand))
    for other in others:
        print_line(f"{other.name} has its own plane: --channel {other.channel}")


def _felt_sentence(hand: Hand) -> str:
    """Returns what is simulated and felt, and for which K and B the loop is stable."""
    known, units = hand.summary(), output_units()
    felt = "no spring and damper is equivalent"
    if known["dominant"]:
        simulated = units.spring("KB", known["stiffness"], known["damping"], "g")
        felt = f"{simulated} is felt as {units.spring('kb', known['k'], known['b'])}"
    ends = []
    for name, which, unit, other in (("stiffness", "K", "N/m", "B"), ("damping", "B", "N·s/m", "K")):
        low, high = known[f"stable_{name}"]
        if high > 0.0:
            low = low if low > 1e-12 * high else 0.0  # a negative K or B is of no use
            ends.append(f"for {which} from {units.between(low, high, unit)} at this {other}")
    stable = f"stable {' and '.join(ends)}" if ends else "not stable with this K or B"
    return (
        f"{'' if known['stable'] else 'UNSTABLE: '}{hand.name} of {units(known['mass'], 'kg', 'g')}: {felt}; {stable}."
    )


def _deformation_sentence(hand: Hand) -> str:
    """Returns how the parameter space is deformed there."""
    of = hand.configuration.deformation(hand.stiffness, hand.damping)
    shear = 90.0 - of.crossing_deg
    sheared = "not sheared" if shear < _SHEARED else f"sheared by {shear:.3g}°"
    return (
        f"There the plane of K T²/m and B T/m is stretched by {of.stretch_k:.4g} along K and {of.stretch_b:.4g} along "
        f"B, and {sheared}."
    )


def plane(
    hand: HandOptions,
    simulated: SimulatedOptions,
    *,
    mass: list[str] | None = option(
        "M", "Mass of hand and handle. A list (0.1,0.2 or 100g,200g) draws one family per mass [default: the scene's]"
    ),
    normalised: bool = flag(
        "--normalised", "Use the paper's units, K T²/m and B T/m. --mass and --rate then default to 1."
    ),
    total_damping: bool = flag("--total-damping", "Draw over B + b0, as in the paper's Figure 9."),
    to_stiffness: float | None = option("K", "End of the K axis, in the unit of the axis [default: automatic]"),
    to_damping: float | None = option("B", "End of the B axis, in the unit of the axis [default: automatic]"),
    output: ChartOutput,
    context: Context,
) -> None:
    """Draw the K,B plane: contours of the stiffness k and damping b that the hand feels.

    These are Figures 7, 8 and 9 of Florens et al. (the paper). An option takes precedence over the scene's value. Of a
    scene with device.mode: admittance it draws the M,B plane, with contours of the mass m and damping b.
    """
    from hapsim.chart.hand import described
    from hapsim.chart.plane import draw_plane
    from hapsim.chart.plane import plane as plane_of
    from hapsim.chart.plane_curves import scale_of, view_of

    output.choose("plane.svg")
    loaded = hand.loaded
    require_mode(context, loaded)
    if loaded is not None and loaded.device.is_admittance:
        _admittance_plane(loaded, hand, require_positive("--to-damping", to_damping), output)
        return
    masses = numbers("--mass", mass, "kg")
    if normalised:
        hand, masses = hand.normalised(masses)
    chosen, others = hand.hands(masses[0] if masses else None, *astuple(simulated))
    require_units(output_units(), *masses)
    masses = masses or list(chosen.masses)
    # One hand with each of several masses, or all the hands that share the plane of the chosen one.
    alike = [other for other in others if other.configuration == chosen.configuration]
    drawn = [chosen.with_mass(mass) for mass in masses] if len(masses) > 1 else [chosen, *alike]
    scale = scale_of(chosen.configuration, normalised=normalised, total=total_damping)
    K_to, B_to = require_positive("--to-stiffness", to_stiffness), require_positive("--to-damping", to_damping)
    k_factor, b_factor = scale.in_units(output_units())
    view = view_of(
        drawn,
        from_total=total_damping,
        K_to=K_to and K_to / k_factor * scale.stiffness,
        B_to=B_to and B_to / b_factor * scale.damping - scale.offset,
    )
    chart = plane_of(drawn, view, scale)
    title = described(drawn[0].configuration, mass=len(masses) < 2, normalised=normalised, units=output_units())
    output.write(chart.columns, lambda path: draw_plane(chart, title, path))
    if not output.json:
        print_hands(drawn, [other for other in others if other not in drawn], with_deformation=True)
    output.close({"scene": hand.scene, "hands": [one.summary() for one in drawn]})


def _admittance_plane(scene: Scene, hand: HandOptions, to_damping: float | None, output: ChartOutput) -> None:
    """Draws the M,B plane of a scene in admittance."""
    from hapsim.chart.admittance_plane import admittance_plane, draw_admittance_plane
    from hapsim.prediction.felt_mass import admittance_sentences, felt_sentence
    from hapsim.prediction.verdict_words import predicted_for

    channel = next(iter(scene.device_points.values())).channel if hand.channel is None else hand.channel
    use_channel_units(channel)
    units = output_units()
    chart = admittance_plane(scene, channel, to_damping and to_damping / units.scaled(1.0, "N·s/m"))
    title = "\n".join(wrap(predicted_for(scene).removeprefix("for "), _TITLE))
    output.write(chart.columns, lambda path: draw_admittance_plane(chart, title, path))
    if not output.json:
        for sentence in (felt_sentence(chart.felt, units), *admittance_sentences(chart.felt, units)):
            print_line(f"{sentence}.")
    output.close({"scene": hand.scene, "hands": [pick(chart.felt, chart.felt.DOCUMENT)]})


def felt(
    hand: HandOptions,
    *,
    mass: Mass = None,
    normalised: bool = flag("--normalised", "Use the paper's units. --mass and --rate then default to 1."),
    over: str | None = option("PATH", "Draw the error of k and b over device.mass, .friction or .delay instead."),
    output: ChartOutput,
    context: Context,
) -> None:
    """Draw the desired stiffness and damping that the hand can feel, for each correction and the law on the board.

    Options of the hand take precedence over the scene's values (configs/README.md has an example).
    """
    require_mode(context)
    if over is not None:
        _tolerance(hand, over, output)
        return
    from hapsim.chart.felt_chart import WITHIN, draw_felt, felt_chart
    from hapsim.chart.hand import described
    from hapsim.theory.interface import BoardLaw

    output.choose("felt.svg")
    masses = [] if mass is None else [mass]
    if normalised:
        hand, masses = hand.normalised(masses)
    chosen, _ = hand.hands(masses[0] if masses else None, as_written=True)
    loaded = hand.loaded
    board = None if loaded is None else loaded.device.board(loaded.rate)
    chart = felt_chart(chosen, *([] if board is None else [BoardLaw(*board)]))
    title = described(chosen.configuration, normalised=normalised, units=output_units())
    output.write(chart.columns, lambda path: draw_felt(chart, title, path))
    if not output.json:
        headings = ("<correction or law", *(percent(within, 3) for within in WITHIN))
        rows = [(name, *(percent(felt.share(within), 3) for within in WITHIN)) for name, felt in chart.felt.items()]
        stdout().print(table("Share of the plane felt within", headings, rows))
        print_line(
            f"Limit of any controller: {percent(chart.limit, 3)}, the motions below half the rate; samples do not "
            "distinguish faster ones. Where no (K, B) is felt as desired, hapsim simulates the nearest, which counts "
            "here as not felt."
        )
    output.close({"scene": hand.scene, **chart.summary()} if output.json else {})


def _tolerance(hand: HandOptions, over: str, output: ChartOutput) -> None:
    """Draws the error of k and b of a scene's hand if the device is not the declared one."""
    from hapsim.chart.felt_chart import SHARES, draw_tolerance, tolerance_chart

    output.choose("tolerance.svg")
    chosen, _ = hand.hands(None, as_written=True)
    chart = tolerance_chart(load(hand.scene or ""), chosen.name, over)
    output.write(chart.columns, lambda path: draw_tolerance(chart, f"{chosen.name} of {hand.scene}", path))
    if not output.json:
        headings = (f"<{over}, correction", *(f"within {percent(share, 2)}" for share in SHARES))
        rows = [(name, *map(_span, of_one)) for name, of_one in chart.within.items()]
        stdout().print(table("The device may be, for k and b to be felt as desired", headings, rows))
    output.close({"scene": hand.scene, "hand": chosen.name, "over": over, "shares": SHARES, "within": chart.within})


def _span(ends: tuple[float, float] | None) -> str:
    if ends is None:
        return "–"
    low, high = ends
    return f"{number(low, 4)} to {number(high, 4) if math.isfinite(high) else 'any'}"


_TITLE = 80  # characters of a line
_SHEARED = 0.5  # degrees; less is no shear
_SPEED = {"linear": 0.05, "rotary": 2.0}


def force(
    scene: SceneFile,
    *,
    channel: Channel = None,
    speed: float | None = option(
        "V", "Speed of the hand for the loop of friction and damping [default: 0.05 m/s or 2 rad/s]", unit="m/s"
    ),
    area: str | None = option(
        "X,Y:X,Y", "With space: 2: two opposite corners of the area drawn [default: around all that the scene has]"
    ),
    output: ChartOutput,
    context: Context,
) -> None:
    """Draw force over displacement, with the stiffness that the hand feels in each region.

    The colour is the difference between felt and requested stiffness. Unstable regions are hatched. In a scene with
    space: 2, arrows show the force on the hand at rest, among shapes, guides and points.
    """
    from hapsim.chart.force import columns_of, draw_force, force_chart

    output.choose("force.svg")
    loaded = load(scene)
    require_mode(context, loaded)
    channel = hand_channel(loaded, channel)
    name = loaded.hand_on(channel)
    if loaded.space > 1:
        _force_field(scene, loaded, name, area, output)
        return
    require_positive("--speed", speed, output_units().si.name("m/s"))
    require_units(output_units(), speed)
    if speed is None:
        speed = _SPEED[loaded.device.motions(loaded.channels)[channel]]
    chart = force_chart(loaded, name, speed)
    output.write(lambda: columns_of(chart), lambda path: draw_force(chart, path))
    if not output.json:
        show(stdout(), hand_lines(name, chart.regions))
    output.close({"scene": scene, "name": name, "speed_m_s": speed, "regions": chart.regions})


def _force_field(path: str, scene: Scene, name: str, area: str | None, output: ChartOutput) -> None:
    """Draws the force on a hand of the plane."""
    from hapsim.chart.force_field import columns_of, draw_field, force_field

    field = force_field(scene, name, places("--area", area, 2))
    output.write(lambda: columns_of(field), lambda path: draw_field(field, scene, path))
    strongest = float(field.strength.max(initial=0.0))
    if not output.json:
        print_line(f"Strongest force on {name} in the area: {output_units()(strongest, 'N', 4)}")
    output.close({"scene": path, "name": name, "area_m": field.area.tolist(), "strongest_N": strongest})


def transparency(
    hand: HandOptions, simulated: SimulatedOptions, *, mass: Mass = None, output: ChartOutput, context: Context
) -> None:
    """Draw rendered, desired and felt impedance over frequency.

    This is Figure 2 of the paper, with k and b, the spring and damper of the same force. Felt is the real spring and
    damper of the hand's own motion; the band is marked where it and what is rendered agree within 5 %. Options of the
    hand take precedence over the scene's values, unless the hand moves masses or another hand.
    """
    from hapsim.chart.hand import described
    from hapsim.chart.impedance_chart import AGREES, draw_transparency
    from hapsim.chart.impedance_chart import transparency as transparency_of

    output.choose("transparency.svg")
    require_mode(context)
    if (found := _of_scene(hand, context)) is not None:
        chart, title, summary = found
    else:
        chosen, _ = hand.hands(mass, *astuple(simulated))
        if not chosen.is_simulated:
            raise UsageError("--simulated-stiffness is missing: without a SCENE, it is required")
        chart, summary = transparency_of(chosen), chosen.summary()
        pair = output_units().spring("KB", chosen.stiffness, chosen.damping, ".6g")
        title = f"{pair}; {described(chosen.configuration, units=output_units())}"
        if not output.json:
            print_hands([chosen], [])
    output.write(chart.columns, lambda path: draw_transparency(chart, title, path))
    bands, alike = chart.active_bands_hz(), chart.agreeing_bands_hz()
    if not output.json:
        if math.isfinite(chart.felt.real[0]):
            where = _bands(alike, chart.frequency) or "at no frequency"
            print_line(f"The real spring and damper that is felt is rendered within {percent(AGREES, 2)} {where}.")
            print_line(
                "No curve has the device's own mass, friction and spring; the felt b above includes the friction."
            )
        words = _bands(bands, chart.frequency)
        print_line(
            f"The scene gives the hand energy {words}." if bands else "At no frequency does the scene give energy."
        )
    output.close({"scene": hand.scene, "hand": summary, "gives_energy_hz": bands, "agrees_with_felt_hz": alike})


def _of_scene(hand: HandOptions, context: Context) -> tuple[Transparency, str, dict[str, Any]] | None:
    """Returns the chart of a hand that moves masses, moves another hand or uses a predictor; its title and its summary.
    Returns None for any other hand. Raises UsageError if an option describes another hand."""
    if hand.scene is None:
        return None
    from hapsim.chart.impedance_chart import transparency_in
    from hapsim.prediction import predict

    scene = load(hand.scene)
    prediction = predict(scene, with_margins=False)
    points = [(name, point.channel) for name, point in scene.device_points.items()]
    name, channel = next((one for one in points if hand.channel in (None, one[1])), (None, 0))
    lone = next((one for one in prediction.felt if one.name == name), None)
    if name is None or (lone is not None and lone.predictor is None):
        return None
    require_mode(context, None, COUPLED)
    use_channel_units(channel)
    part = prediction.part_on(channel)
    motion = part.own_motion if part else None
    chart = transparency_in(prediction, name, motion.frequency_hz if motion else math.nan)
    summary = {"name": name, "channel": channel, "k": motion and motion.k, "b": motion and motion.b}
    title = f"{name} of {scene_name(hand.scene)}, {scene.rate:g} Hz"
    return chart, title, summary | {"frequency_hz": chart.eigenfrequency}


def _bands(bands: list[tuple[float, float]], drawn: Floats) -> str:
    return ", ".join(_band(low, high, float(drawn[0]), float(drawn[-1])) for low, high in bands)


def _band(low: float, high: float, first: float, last: float) -> str:
    """Returns a band in words. An end of the picture is no end of the band."""
    if low <= first:
        return "at every frequency drawn" if high >= last else f"below {high:.4g} Hz"
    return f"above {low:.4g} Hz" if high >= last else f"from {low:.4g} to {high:.4g} Hz"
