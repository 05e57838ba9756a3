"""What the commands `hapsim chart …` share: the options that describe a hand, where picture and numbers go, and what is
said of hands."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from hapsim.cli.arguments import stdout
from hapsim.cli.sentences import say
from hapsim.errors import UsageError
from hapsim.scene import choices
from hapsim.scene.issue import one_of

if TYPE_CHECKING:
    from hapsim.chart.hand import Hand
    from hapsim.scene.choices import CorrectionName

SceneFile = Annotated[str, typer.Argument(metavar="SCENE", help="A scene in YAML.")]
MaybeScene = Annotated[
    str | None, typer.Argument(metavar="[SCENE]", help="A scene in YAML; left out: a hand as the options describe it.")
]
Channel = Annotated[int | None, typer.Option(help="The channel whose hand it is; left out: the first.")]
Rate = Annotated[float | None, typer.Option(metavar="HZ", help="Sample rate, Hz.")]
Friction = Annotated[float | None, typer.Option(metavar="B0", help="Real friction of the device, N·s/m.")]
Stiffness = Annotated[float | None, typer.Option(metavar="K0", help="Real spring of the device, N/m.")]
Delay = Annotated[float | None, typer.Option(metavar="N", help="Delay, sample periods.")]
Hold = Annotated[str | None, typer.Option(metavar="KIND", help=one_of(get_args(choices.Hold)) + ".")]
Sampling = Annotated[str | None, typer.Option(metavar="KIND", help=one_of(get_args(choices.Sampling)) + ".")]
Damper = Annotated[str | None, typer.Option(metavar="KIND", help=one_of(get_args(choices.DamperScheme)) + ".")]
Cutoff = Annotated[
    float | None, typer.Option(metavar="HZ", help=f"Cutoff of the {one_of(choices.WITH_CUTOFF)} damper, Hz.")
]
SimulatedK = Annotated[
    float | None, typer.Option("--simulated-stiffness", metavar="K", help="The stiffness K that is simulated, N/m.")
]
SimulatedB = Annotated[
    float | None, typer.Option("--simulated-damping", metavar="B", help="The damping B that is simulated, N·s/m.")
]
Picture = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Where to draw: .svg, .png, .pdf; left out: the command's name with .svg, here, unless only --data or "
        "--json is asked for.",
    ),
]
Data = Annotated[Path | None, typer.Option(metavar="FILE", help="Write the numbers that are drawn: .csv.")]


def writable(picture: Path | None, data: Path | None, json: bool, otherwise: str) -> Path | None:
    """Where the picture goes; UsageError where it or its numbers cannot be written."""
    from hapsim.chart.figure import require_writable

    if picture is None and data is None and not json:
        picture = Path(otherwise)
    require_writable(picture)
    require_writable(data, (".csv",))
    return picture


def in_paper_units(
    masses: list[float], rate: float | None, described_by_options: bool
) -> tuple[list[float], float | None]:
    """Mass and rate are 1 in the paper's units where nothing says otherwise."""
    if len(masses) > 1:
        raise UsageError("--normalised: the unit of the axes holds for one mass only, found several; leave it out")
    if not described_by_options:
        return masses, rate
    return masses or [1.0], 1.0 if rate is None else rate


def loop_options(context: typer.Context, **more: Any) -> dict[str, Any]:
    """The options that describe hand, device and loop, of those that were given; a command only has to declare them."""
    names = ("friction", "stiffness", "delay", "hold", "sampling", "damper", "cutoff")
    options = more | {name: context.params[name] for name in names}
    return {name: value for name, value in options.items() if value is not None}


def hands_asked_for(
    scene: str | None,
    channel: int | None,
    given: dict[str, Any],
    stiffness: float | None = None,
    damping: float | None = None,
    *,
    as_written: bool = False,
) -> tuple[Hand, list[Hand]]:
    """The hand that is asked for, with what is simulated for it, and the other hands of the scene.

    ``as_written``: without the scene's correction, on the device that it describes.
    """
    from hapsim.chart.hand import hand_of_options, hands_of_scene
    from hapsim.scene import load_scene

    if scene is None:
        if channel is not None:
            raise UsageError("--channel: without a SCENE there is one hand only")
        return hand_of_options(given).with_simulated(stiffness, damping), []
    loaded = load_scene(scene)
    if as_written:
        loaded = loaded.model_copy(update={"device": loaded.device.model_copy(update={"correction": "none"})})
    hands = hands_of_scene(loaded, given)
    chosen = next((hand for hand in hands if channel in (None, hand.channel)), None)
    if chosen is None:
        known = ", ".join(str(hand.channel) for hand in hands)
        raise UsageError(
            f"--channel {channel}: no hand there whose links all end on grounds; such hands are on: {known}"
        )
    return chosen.with_simulated(stiffness, damping), [hand for hand in hands if hand is not chosen]


def correction_asked_for(given: str | None, scene: str | None) -> CorrectionName:
    """By the option, or by what the scene of a file says; "none" without either."""
    from hapsim.scene import load_scene

    known = get_args(choices.CorrectionName)
    if given is None:
        return "none" if scene is None else load_scene(scene).device.correction
    if given not in known:
        raise UsageError(f"--correction: found '{given}', expected {one_of(known)}")
    return given  # type: ignore[return-value]


def save_rows(columns: dict[str, list[Any]], path: Path | None) -> None:
    from hapsim.chart.figure import save_rows

    if path is not None:
        save_rows(columns, path)


def print_json(summary: dict[str, Any], picture: Path | None, data: Path | None) -> None:
    from hapsim.cli.as_json import document

    files = {"picture": picture, "data": data}
    print(document(summary | {name: None if path is None else str(path) for name, path in files.items()}))


def tell_of_hands(drawn: list[Hand], others: list[Hand]) -> None:
    """What is simulated and felt of what is drawn, and where the others are."""
    for hand in drawn:
        if hand.is_simulated:
            stdout().print(_felt_sentence(hand))
    for other in others:
        say(f"{other.name} has a plane of its own: --channel {other.channel}")


def _felt_sentence(hand: Hand) -> str:
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


def _not_below_zero(low: float, high: float) -> float:
    return low if low > 1e-12 * high else 0.0
