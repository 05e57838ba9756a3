"""What the commands `hapsim chart …` share: the options that describe a hand, and where picture and numbers go."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

import typer

from hapsim.cli.options import Json, PictureOptions, load, option
from hapsim.cli.output import document, say, speak_of, stdout
from hapsim.errors import UsageError
from hapsim.number_format import between, number
from hapsim.scene import choices
from hapsim.scene.issue import one_of

if TYPE_CHECKING:
    from hapsim.chart.hand import Hand
    from hapsim.scene import Scene

Channel = Annotated[int | None, typer.Option(help="Channel of the hand [default: the first]")]
Mass = Annotated[float | None, option("M", "Mass of hand and handle, kg.")]


def _kind(choice: Any) -> Any:
    return typer.Option(metavar="KIND", help=f"One of {', '.join(get_args(choice))}.")


@dataclass
class HandOptions:
    """The hand that a chart is drawn for: of a scene, or described by options, which take precedence."""

    scene: Annotated[
        str | None, typer.Argument(metavar="[SCENE]", help="A scene in YAML [default: a hand described by the options]")
    ] = None
    channel: Channel = None
    rate: Annotated[float | None, option("HZ", "Sample rate, Hz.")] = None
    friction: Annotated[float | None, option("B0", "Friction of the device, N·s/m.")] = None
    stiffness: Annotated[float | None, option("K0", "Spring of the device, N/m.")] = None
    delay: Annotated[float | None, option("N", "Delay, sample periods.")] = None
    hold: Annotated[str | None, _kind(choices.Hold)] = None
    sampling: Annotated[str | None, _kind(choices.Sampling)] = None
    damper: Annotated[str | None, _kind(choices.DamperScheme)] = None
    cutoff: Annotated[float | None, option("HZ", f"Cutoff of the {one_of(choices.WITH_CUTOFF)} damper, Hz.")] = None

    def hands(
        self,
        mass: float | None,
        simulated: tuple[float | None, float | None] = (None, None),
        *,
        as_written: bool = False,
    ) -> tuple[Hand, list[Hand]]:
        """Returns the hand, with the K and B `simulated` for it, and the other hands of the scene.

        `mass`: kg; None: the scene's. `as_written`: without the scene's correction.
        """
        from hapsim.chart.hand import hand_of_options

        given = {name: value for name, value in asdict(self).items() if value is not None} | (
            {} if mass is None else {"mass": mass}
        )
        scene, channel = given.pop("scene", None), given.pop("channel", None)
        if scene is not None:
            hand, others = hands_of(load(scene), channel, given, as_written=as_written)
            return hand.with_simulated(*simulated), others
        if channel is not None:
            raise UsageError("--channel: without a SCENE there is one hand only")
        return hand_of_options(given).with_simulated(*simulated), []

    def normalised(self, masses: list[float]) -> tuple[HandOptions, list[float]]:
        """Returns the options and masses in the paper's units: mass and rate are 1 where nothing gives them."""
        if len(masses) > 1:
            raise UsageError("--normalised: the unit of the axes holds for one mass only, found several; leave it out")
        if self.scene is not None:
            return self, masses
        return replace(self, rate=1.0 if self.rate is None else self.rate), masses or [1.0]


@dataclass
class SimulatedOptions:
    """The spring and damper that are simulated, where not those of the scene."""

    simulated_stiffness: Annotated[float | None, option("K", "Simulated K, N/m [default: the scene's]")] = None
    simulated_damping: Annotated[float | None, option("B", "Simulated B, N·s/m [default: the scene's]")] = None

    @property
    def pair(self) -> tuple[float | None, float | None]:
        """(K in N/m, B in N·s/m)."""
        return self.simulated_stiffness, self.simulated_damping


@dataclass
class ChartOutput(PictureOptions):
    """Where a chart goes: a picture, its numbers, a JSON document."""

    picture: Annotated[
        Path | None,
        option(
            "FILE",
            "Picture: .svg, .png or .pdf [default: the command's name with .svg, unless --data or --json is given]",
        ),
    ] = None
    json: Json = False

    def choose(self, otherwise: str) -> None:
        """Chooses the picture's default name. Raises UsageError where a file cannot be written."""
        if not self.wanted and not self.json:
            self.picture = Path(otherwise)
        self.require_writable()

    def close(self, summary: dict[str, Any]) -> None:
        """Prints the document, or which files were written."""
        if self.json:
            files = {name: path and str(path) for name, path in (("picture", self.picture), ("data", self.data))}
            print(document(summary | files))
        else:
            self.say_written()


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
    speak_of(chosen.channel or 0)
    return chosen, [hand for hand in hands if hand is not chosen]


def print_hands(drawn: list[Hand], others: list[Hand]) -> None:
    """Prints what is simulated and felt of the hands drawn, and how to draw the others."""
    for hand in drawn:
        if hand.is_simulated:
            stdout().print(_felt_sentence(hand))
    for other in others:
        say(f"{other.name} has a plane of its own: --channel {other.channel}")


def _felt_sentence(hand: Hand) -> str:
    """Returns what is simulated and felt, and for which K and B the loop is stable."""
    known = hand.summary()
    felt = "no spring and damper is equivalent"
    if known["dominant"]:
        felt = (
            f"K = {known['stiffness']:g} N/m, B = {known['damping']:g} N·s/m is felt as "
            f"k = {number(known['k'])} N/m, b = {number(known['b'])} N·s/m"
        )
    ends = []
    for name, which, unit, other in (("stiffness", "K", "N/m", "B"), ("damping", "B", "N·s/m", "K")):
        low, high = known[f"stable_{name}"]
        if high > 0.0:
            low = low if low > 1e-12 * high else 0.0  # a negative K or B is of no use
            ends.append(f"for {which} from {between(low, high)} {unit} at this {other}")
    stable = f"stable {' and '.join(ends)}" if ends else "not stable with this K or B"
    return f"{'' if known['stable'] else 'UNSTABLE: '}{hand.name} of {known['mass']:g} kg: {felt}; {stable}."
