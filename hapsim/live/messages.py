"""Every message of the WebSocket: what a client may send, and what it gets. `schema` has all but the binary ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic_core import to_json

from hapsim.errors import UsageError
from hapsim.live.drawn import AnyEntry
from hapsim.live.views import View
from hapsim.loop.histogram import Histogram
from hapsim.running.live_parameters import Parameter
from hapsim.running.session import Session
from hapsim.running.session_view import Event, EventKind
from hapsim.scene import Scene
from hapsim.scene.issue import did_you_mean

LONGEST, SHORT = 1 << 18, 1 << 16
"""Characters of a message with a scene, of which the worst takes seconds to read, and of any other."""
MOST_MODULES = MOST_HANDS = 64
_SHOWN = 60

Name = Annotated[str, Field(max_length=200)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Points = list[list[Number]]
Value = Number | Name | list[Number] | Points | dict[Name, Number | Points]
Values = Annotated[
    dict[Name, Value],
    Field(
        max_length=1000,
        description="an object of parameters by name, each a finite number, a word, a list of numbers, or two branches",
    ),
]
Id = Annotated[Number | Annotated[str, Field(max_length=64)] | None, Field(description="a number or a short string")]
Over = Annotated[float, Field(ge=0, le=60, allow_inf_nan=False, description="seconds of a ramp, 0 to 60")]


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    id: Id = None


class Get(_Request):
    """Asks for the model."""

    type: Literal["get"]


class Set(_Request):
    """Changes parameters, all or none."""

    type: Literal["set"]
    values: Values
    over: Over = 0.02
    held: bool = Field(False, description="true or false")
    """The values last until this client releases them or goes, and are not saved: a hand that drags."""


class Release(_Request):
    """Gives back what clients hold: values are what they were before."""

    type: Literal["release"]


class Subscribe(_Request):
    """Asks for blocks of samples; another one replaces it."""

    type: Literal["subscribe"]
    rate: float = Field(60.0, ge=0, le=1000, allow_inf_nan=False, description="blocks a second, 0 to 1000; 0: no more")
    every: int = Field(1, ge=1, le=1_000_000, description="1 for every sample, n for every n-th")
    history: float = Field(0.0, ge=0, le=60, allow_inf_nan=False, description="seconds, 0 to 60, that are sent first")
    modules: list[Name] = Field([], max_length=MOST_MODULES, description=f"a list of at most {MOST_MODULES} modules")
    picture: bool = Field(False, description="true or false")


class Marker(_Request):
    """Notes that something happened now."""

    type: Literal["marker"]
    text: str = Field("", max_length=1000, description="a text of at most 1000 characters")


class Stop(_Request):
    """Ends the run: the force goes to zero."""

    type: Literal["stop"]


class GoOn(_Request):
    """Lets the run go on that this machine's slowness ended: the device is armed again."""

    type: Literal["go_on"]


class Adopt(_Request):
    """Changes to the scene of this text; its device stays."""

    type: Literal["adopt"]
    scene: str = Field(max_length=LONGEST, description="the text of a scene")
    over: Over = 0.05


class Lease(_Request):
    """Promises to be sent again within `seconds`: begins a lease of this client's, or renews it. 0 ends it.
    Without `seconds` it renews the lease for as long as before, which anyone may once it has run out."""

    type: Literal["lease"]
    seconds: Annotated[Number, Field(ge=0, le=3600)] | None = Field(None, description="seconds, 0.005 to 3600, or 0")
    fallback: Annotated[str, Field(max_length=LONGEST)] | None = Field(None, description="the text of a scene")


class InTurn(_Request):
    """A request that the run carries out after the changes before it."""

    def make(self, session: Session) -> int:
        """Carries it out. Returns the sample in which it begins. Raises UsageError."""
        raise NotImplementedError


class Trial(InTurn):
    """Begins a trial, all of it or nothing: values, modules that begin anew, and a code on an output."""

    type: Literal["trial"]
    number: int = Field(ge=1, lt=2**31, description="a whole number from 1 to 2147483647")
    values: Values = {}
    restart: list[Name] = Field([], max_length=MOST_MODULES, description=f"a list of at most {MOST_MODULES} modules")
    code: int | dict[Name, int] | None = Field(None, description="a whole number, or an object of them by output")
    over: Over = 0.02

    def make(self, session: Session) -> int:
        return session.trial(self.number, self.values, self.restart, self.code, self.over).sample


class Pulse(InTurn):
    """Adds a pulse of force: a click, a knock, or a buzz of some periods."""

    type: Literal["pulse"]
    channel: int = Field(0, ge=0, le=1000, description="the number of a channel")
    shape: str = Field(max_length=20, description="click, knock or buzz")
    force: Number = Field(description="its largest force, N or N·m")
    seconds: Number = Field(description="its length, s")
    periods: Number | None = Field(None, description="a number, of a buzz")

    def make(self, session: Session) -> int:
        return session.pulse(self.channel, self.shape, self.force, self.seconds, self.periods).sample


class Record(_Request):
    """Begins a record, or ends it."""

    type: Literal["record"]
    on: bool = Field(description="true or false")


class Save(_Request):
    """Saves the live values in the scene's own file; with `as`, the scene in a new one."""

    type: Literal["save"]
    name: Name | None = Field(None, alias="as", description="a plain name, such as softer.yaml")


class Predict(_Request):
    """Asks what the hand would feel with these values, which are not applied."""

    type: Literal["predict"]
    values: Values = {}
    at: list[Number] = Field([], max_length=MOST_HANDS, description="a list of the position of each channel, m or rad")
    hand: int = Field(0, ge=0, le=1000, description="the number of a hand")
    plane: bool = Field(False, description="true or false")
    curve: bool = Field(False, description="true or false")


Request = Annotated[
    Get | Set | Release | Subscribe | Marker | Pulse | Stop | GoOn | Adopt | Trial | Lease | Record | Save | Predict,
    Field(discriminator="type"),
]


class _Answer(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Done(_Answer):
    """The request was carried out."""

    type: Literal["done"] = "done"
    id: Id = None
    file: str | None = None
    """File of a `record` or a `save`."""
    sample: int | None = None
    """First sample of a `trial`, counted from arming."""


class Rejected(_Answer):
    """The request changed nothing."""

    type: Literal["rejected"] = "rejected"
    id: Id = None
    reason: str


class EventMessage(_Answer):
    """Something happened to the run. Every client gets it."""

    type: Literal["event"] = "event"
    kind: EventKind
    sentence: str
    values: Mapping[str, Any]
    """New values, for `changed`. If empty, the whole scene may have changed: send `get`."""
    sample: int
    at: str


class Drag(_Answer):
    """The hand with which the page pulls a mock's channel, in its units."""

    stiffness: float
    damping: float
    reach: float
    """Initial range of the view to either side."""


class Channel(_Answer):
    """One channel of the device."""

    channel: int
    name: str
    """Name of the hand's point."""
    motion: Literal["linear", "rotary"]
    unit_position: str
    """SI unit of the values in messages."""
    unit_force: str
    force_limit: float
    travel: tuple[float | None, float | None]
    """None where the scene names no bound."""
    hand: Drag


class ParameterMessage(_Answer):
    """A live parameter."""

    name: str
    kind: Literal["number", "numbers", "word", "points"]
    value: Any
    saved: Any
    """Value in the scene's file; None where no file has it."""
    unit: str
    description: str
    least: float | None
    most: float | None
    words: tuple[str, ...]
    range: tuple[float, float] | None
    """Range that the scene's file gives it: that of a slider. The value may leave it."""
    span: tuple[float, float]
    logarithmic: bool


class ModuleMessage(_Answer):
    """Module that can be watched: a point, or a structure by one of its masses ("gut.7")."""

    name: str
    masses: int | None
    """None for a point."""
    columns: int | None
    """Masses per row of a membrane ("skin.3.4")."""


class Model(_Answer):
    """All that there is, as it is now: the answer to `get`."""

    type: Literal["model"] = "model"
    id: Id = None
    version: str
    scene: str
    title: str
    rate_hz: float
    phase: Literal["running", "waiting", "ended"]
    channels: list[Channel]
    sensed: list[str]
    """Names of the values that the device sends beside its positions: those behind the forces of a block."""
    words: list[str]
    """Names of inputs and outputs ("inputs.touch", "outputs.code"): the last columns of a block."""
    written: Mapping[str, tuple[str, float]]
    """Units that the scene's file writes, by the SI unit in whose place they stand: name, and number in one SI unit."""
    parameters: list[ParameterMessage]
    modules: list[ModuleMessage]
    space: int
    """Coordinates of each point: 1, or 2 for x and y."""
    views: list[View]
    """Views of this scene that the page shows."""
    places: Mapping[str, int]
    """Number of the place of each detent that holds; its changes are events."""
    drawn: list[AnyEntry]
    """Entries of the picture. The rows of `subscribe` with `picture` have the numbers of each, in this order."""
    has_mock: bool
    can_record: bool
    can_save: bool
    """True if this client may save the scene."""
    file: str | None
    """The scene's own file, which `save` writes; None: `save` needs a name."""
    can_go_on: bool
    """The run waits to go on: this machine was too slow for it."""
    lease: Mapping[str, Any]
    """The lease, as the values of its events: `seconds`, null if there is none, and `out`, 1 once it ran out."""
    recording: str | None
    """The file that is being written."""
    events: list[EventMessage]


class Bins(_Answer):
    """A histogram: the bins in which something was counted."""

    edges_s: list[float]
    """Lower edge of each bin, s; for `age` in samples."""
    counts: list[int]


class Counters(_Answer):
    """Counters of the run, sent once a second."""

    type: Literal["counters"] = "counters"
    progress: dict[str, Any]
    """The fields of hapsim.running.Progress."""
    exchange: Bins
    lateness: Bins
    age: Bins
    clients: int
    rejected: int
    """Messages of all clients so far."""


class Predicted(BaseModel):
    """Predicted feel at the hand: the answer to `predict`."""

    model_config = ConfigDict(extra="allow", frozen=True)

    type: Literal["predicted"] = "predicted"
    id: Id = None


def event_message(event: Event) -> EventMessage:
    values = dict(event.values)
    return EventMessage(kind=event.kind, sentence=event.sentence, values=values, sample=event.sample, at=event.at)


def parameter_message(one: Parameter, saved: Any = None) -> ParameterMessage:
    """Returns the message of a parameter. `saved`: its value in the scene's file."""
    names = ("name", "kind", "value", "unit", "description", "least", "most", "words", "range", "span")
    fields = {name: getattr(one, name) for name in names}
    return ParameterMessage(**fields, saved=saved, logarithmic=one.is_logarithmic)


def channels_of(scene: Scene) -> list[Channel]:
    motions, travels = scene.device.motions(scene.channels), scene.device.travels(scene.channels)
    names = {point.channel: name for name, point in scene.device_points.items()}
    return [
        Channel(
            channel=i,
            name=names.get(i, ""),
            motion=motion,
            unit_position=scene.units_of(i).si.name("m"),
            unit_force=scene.units_of(i).si.name("N"),
            force_limit=scene.device.force_limit,
            travel=travels[i],
            hand=Drag(stiffness=scale.drag_stiffness, damping=scale.drag_damping, reach=scale.reach),
        )
        for i, (motion, scale) in enumerate(zip(motions, scene.device.scales(scene.channels), strict=True))
    ]


def modules_of(session: Session | None) -> list[ModuleMessage]:
    if session is None:
        return []
    found = []
    for name, place in session.state().modules.items():
        columns = getattr(session.scene.modules.get(name), "columns", None)
        found.append(ModuleMessage(name=name, masses=None if isinstance(place, float) else place.size, columns=columns))
    return found


def bins_of(histogram: Histogram) -> Bins:
    there = histogram.counts.nonzero()[0]
    return Bins(edges_s=histogram.edges[there].tolist(), counts=histogram.counts[there].tolist())


_REQUESTS: TypeAdapter[Any] = TypeAdapter(Request)
_TYPES: dict[str, type[_Request]] = {
    get_args(one.model_fields["type"].annotation)[0]: one for one in get_args(get_args(Request)[0])
}


def schema() -> dict[str, Any]:
    """Returns the JSON schema of all messages: what a client sends, and what it gets."""
    answers: TypeAdapter[Any] = TypeAdapter(Done | Rejected | Model | Predicted | EventMessage | Counters)
    keys = [("requests", "validation", _REQUESTS), ("answers", "serialization", answers)]
    places, found = TypeAdapter.json_schemas(
        keys,  # type: ignore[arg-type]
        title="Messages of a running hapsim",
        description="The JSON messages of ws://HOST:7470/live: a client sends requests and gets answers and events.",
        ref_template="#/$defs/{model}",
    )
    named = {name: places[name, mode] for name, mode, _ in keys}  # type: ignore[index]
    return {**found, "anyOf": list(named.values()), "$defs": {**found["$defs"], **named}}


def text_of(message: BaseModel | dict[str, Any]) -> str:
    """Returns the JSON of a message; what is no number is null."""
    return to_json(message, inf_nan_mode="null", fallback=_plain).decode()


def request_of(text: str | bytes) -> Any:
    """Returns the request that a message makes. Raises UsageError with what is wrong with it."""
    if isinstance(text, bytes):
        raise UsageError("found a binary message, expected JSON in a text message")
    try:
        request = _REQUESTS.validate_json(text)
    except ValidationError as error:
        raise UsageError(_reason(error)) from None
    if len(text) > SHORT and not isinstance(request, Adopt):
        raise UsageError(f"found {len(text)} characters, expected at most {SHORT} of a message without a scene")
    return request


def _reason(error: ValidationError) -> str:
    """The first of pydantic's errors, in our words."""
    first = error.errors(include_url=False, include_context=True)[0]
    kind, where, found = first["type"], first["loc"], _shown(first["input"])
    if kind == "json_invalid":
        return f"found no JSON: {first['ctx']['error']}"
    if kind.startswith("union_tag"):
        tag = first["input"].get("type") if isinstance(first["input"], dict) else None
        return f"type: found {_shown(tag)}, expected one of {', '.join(_TYPES)}{did_you_mean(str(tag), list(_TYPES))}"
    if len(where) < 2:
        return f'found {found}, expected an object such as {{"type": "get"}}'
    request, key = _TYPES[str(where[0])], str(where[1])
    fields = {one.alias or name: one for name, one in request.model_fields.items()}
    if kind == "extra_forbidden":
        return f"{where[0]}: found the key {_shown(key)}, expected one of {', '.join(fields)}"
    expected = fields[key].description or next(
        (one.description for one in fields[key].metadata if getattr(one, "description", None)), "a value"
    )
    found = "nothing" if kind == "missing" else found
    inner = f".{where[2][:_SHOWN]}" if len(where) > 2 and key == "values" and isinstance(where[2], str) else ""
    return f"{where[0]}.{key}{inner}: found {found}, expected {expected}"


def _shown(value: Any) -> str:
    text = to_json(value, inf_nan_mode="strings", fallback=str).decode(errors="replace")
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…"


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)
