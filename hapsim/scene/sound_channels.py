"""Pick-ups: output channels of the sound, each of which listens to a point."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field

from .issue import Issue, quote
from .modules.links import wrong_end
from .quantity import quantity, text
from .section import ModuleContext, Section

MOST_PICK_UPS = 16

Quantity = Literal["velocity", "position", "force"]
QUANTITIES: tuple[Quantity, ...] = ("velocity", "position", "force")
"""Quantities, in the order of their numbers in compiled code."""

POINT = text("The point that it listens to, by name", "the name of a point, such as hand or gut.7", ".+")
GAIN = quantity("1.0, full scale, over the quantity in m/s, m or N; negative for the other sign", "1/(SI unit)")
HIGHPASS = quantity("Frequency below which it gets quieter, by 6 dB an octave; 0: none", "Hz", least=0)


class PickUp(Section):
    """An output channel: a quantity of a point, times a gain. SI units."""

    model_config = ConfigDict(validate_by_name=True, validate_by_alias=True, serialize_by_alias=True)

    #: As of a module.
    live: ClassVar[tuple[str, ...]] = ("gain",)
    with_default: ClassVar[Mapping[str, str]] = {}
    crossfaded: ClassVar[tuple[str, ...]] = ("from", "of")
    type: ClassVar[str] = "pick-up"

    point: Annotated[str, POINT] = Field(alias="from")
    of: Quantity = Field(description="Quantity of the point: its velocity, its position, or the force of its links")
    gain: Annotated[float, GAIN] = 1.0
    highpass: Annotated[float, HIGHPASS] = 0.0


def sound_issues(sound: Mapping[str, Any], around: ModuleContext, scheme: object) -> Iterator[Issue]:
    """Yields the faults of pick-ups, as made or as written, together with the rest of the scene."""
    if len(sound) > MOST_PICK_UPS:
        yield Issue(("sound",), f"found {len(sound)} pick-ups, expected at most {MOST_PICK_UPS}", at_key=True)
    for name, one in sound.items():
        pick_up = {"from": one.point, "of": one.of} if isinstance(one, PickUp) else one
        if name in around.kinds:
            yield Issue(("sound", name), "found the name of a module too; expected one of its own", at_key=True)
        if not isinstance(pick_up, dict):
            continue
        point, of = pick_up.get("from"), pick_up.get("of")
        if isinstance(point, str):
            sentence = wrong_end(name, point, around) or _rests(point, around)
            if sentence:
                yield Issue(("sound", name, "from"), sentence)
        if of == "force" and scheme not in (None, "cordis"):
            expected = f"expected velocity or position: under scheme: {scheme} forces are no sums over a point's links"
            yield Issue(("sound", name, "of"), f"found force, {expected}")


def _rests(point: str, around: ModuleContext) -> str | None:
    holder = around.kinds.get(around.holder(point))
    if holder is None or holder.can_move or not holder.is_point:
        return None
    return (
        f"found {quote(point)}, a {holder.model_fields['type'].default}, which does not move; expected a point that can"
    )
