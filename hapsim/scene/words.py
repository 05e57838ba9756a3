"""The digital words of a scene: names of the bits that the device reads with its positions (inputs), and of those that
it sets with its forces (outputs)."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Any

from .issue import Issue, did_you_mean, quote
from .quantity import count, counts, switch, text
from .section import ModuleContext, Section

MOST_BIT = 31
_MODULE = ("the name of a module", "[^ ]+", "no module")


class Input(Section):
    """A bit that the device reads, such as a touch or a button."""

    bit: Annotated[int, count("Its bit of the word beside the positions", 0, MOST_BIT)]
    inverted: Annotated[bool, switch("It is on while its bit is 0")] = False

    @property
    def mask(self) -> int:
        """The bit in its word, as a mask."""
        return 1 << self.bit

    def is_on(self, word: Any) -> Any:
        """Returns whether the input is on in a word, or in each of an array of words."""
        return (word & self.mask != 0) != self.inverted


class Output(Section):
    """Bits that the device sets: a number that programs set, or one that follows a module."""

    bit: Annotated[int | None, count("Its bit of the word beside the forces", 0, MOST_BIT, left_out="bits")] = None
    bits: Annotated[tuple[int, int] | None, counts("Its first and its last bit", 2, 0, MOST_BIT, "bit")] = None
    when: Annotated[str | None, text("The link that it follows: 1 while that is closed", *_MODULE)] = None
    of: Annotated[str | None, text("The detent that it follows: which of its places it is in", *_MODULE)] = None

    @property
    def ends(self) -> tuple[int, int]:
        """The first and the last bit."""
        return self.bits or (self.bit or 0, self.bit or 0)

    @property
    def shift(self) -> int:
        """Number of bits below it."""
        return self.ends[0]

    @property
    def most(self) -> int:
        """The largest value."""
        return (2 << self.ends[1] - self.ends[0]) - 1

    @property
    def mask(self) -> int:
        """The bits in their word, as a mask."""
        return self.most << self.shift

    @property
    def is_set_by_programs(self) -> bool:
        """True if it follows no module."""
        return self.when is None and self.of is None

    def value(self, word: Any) -> Any:
        """Returns its value in a word, or in each of an array of words."""
        return (word & self.mask) >> self.shift


def words_sentence(inputs: Mapping[str, Input], outputs: Mapping[str, Output]) -> str:
    """Returns a sentence that names every input and output with its bits, without a full stop."""

    def described(name: str, one: Input | Output) -> str:
        """Returns its name with its bits and what it follows."""
        first, last = (one.bit, one.bit) if isinstance(one, Input) else one.ends
        bits = f"bit {first}" if first == last else f"bits {first} to {last}"
        if isinstance(one, Input):
            return f"{name} ({bits}{', inverted' * one.inverted})"
        follows = f": 1 while {one.when} is closed" * bool(one.when) + f": the place of {one.of}" * bool(one.of)
        return f"{name} ({bits}{follows})"

    tables: dict[str, Mapping[str, Any]] = {"inputs: ": inputs, "outputs: ": outputs}
    each = [what + ", ".join(described(*one) for one in table.items()) for what, table in tables.items() if table]
    return "; ".join(each)


def inverted_mask(inputs: Iterable[Input]) -> int:
    """Returns the bits of the inputs that are on while their bit is 0."""
    return sum(one.mask for one in inputs if one.inverted)


def word_issues(scene: Mapping[str, object], mock_inputs: object, around: ModuleContext) -> Iterator[Issue]:
    """Yields the faults of inputs and outputs, as made or as written, together with the rest of the scene.
    `mock_inputs`: names of inputs, each with its times."""
    tables = {key: table for key in ("inputs", "outputs") if isinstance(table := scene.get(key, {}), Mapping)}
    written = {
        key: {name: dict(one) for name, one in table.items() if isinstance(one, Mapping | Section)}
        for key, table in tables.items()
    }
    for name, one in written.get("outputs", {}).items():
        yield from _output_issues(name, {key: value for key, value in one.items() if value is not None}, around)
    for key, table in written.items():
        yield from _shared_bits(key, table)
    for key in (key for key, table in written.items() if table and key in around.kinds):
        sentence = f"found a module called {key} in a scene with {key}, expected another name: {key}.NAME is theirs"
        yield Issue(("modules", key), sentence, at_key=True)
    for name, times in mock_inputs.items() if isinstance(mock_inputs, Mapping) and "inputs" in tables else ():
        if isinstance(times, tuple | list) and times and isinstance(times[0], int | float) and times[0] < 0.0:
            yield Issue(
                ("mock", "inputs", name, 0), f"found {times[0]:g} s, expected a time from the start on, 0 or more"
            )
        if name not in tables["inputs"]:
            expected = f"expected the name of one of the scene's inputs{did_you_mean(str(name), tables['inputs'])}"
            yield Issue(("mock", "inputs", name), f"found no such input, {expected}", at_key=True)


def _output_issues(name: str, one: Mapping[str, Any], around: ModuleContext) -> Iterator[Issue]:
    at, followed = ("outputs", name), [key for key in ("when", "of") if key in one]
    if "bit" in one and "bits" in one:
        yield Issue((*at, "bits"), "found bit and bits, expected one of the two", at_key=True)
    elif "bit" not in one and "bits" not in one:
        sentence = f"found no bit, expected bit: a number from 0 to {MOST_BIT}, or bits: [the first, the last]"
        yield Issue(at, sentence, at_key=True)
    if (ends := _ends(one)) and ends[0] > ends[1]:
        yield Issue((*at, "bits"), f"found {[*ends]}, expected the lower bit first: {[*ends[::-1]]}")
    elif ends and "when" in one and ends[0] != ends[1]:
        yield Issue((*at, "bits"), "found several bits of an output that is 0 or 1, expected bit: a single one")
    if followed[1:]:
        yield Issue(
            (*at, "of"), "found when and of, expected one of the two: an output follows one module", at_key=True
        )
    for key in followed:
        if isinstance(one[key], str) and one[key] not in around.kinds:
            expected = f"expected the name of a module of this scene{did_you_mean(one[key], around.kinds)}"
            yield Issue((*at, key), f"found {quote(one[key])}, {expected}")
        elif around.knows(one[key]) and not around.faulty.get(one[key]):
            module = around.modules[one[key]]
            follows = getattr(module, "is_contact", False) if key == "when" else hasattr(module, "is_held")
            expected = "a link that closes: without a force at some distances" if key == "when" else "a detent"
            if not follows:
                yield Issue((*at, key), f"found {one[key]}, a {module.type}; expected {expected}")


def _shared_bits(key: str, table: Mapping[str, Mapping[str, Any]]) -> Iterator[Issue]:
    owners: dict[int, str] = {}
    for name, one in table.items():
        first, last = _ends(one) or (0, -1)
        if shared := [bit for bit in range(first, last + 1) if bit in owners]:
            field = "bit" if one.get("bit") is not None else "bits"
            found = f"found bit {shared[0]}, which {owners[shared[0]]} has; expected one that no other of the {key} has"
            yield Issue((key, name, field), found)
        owners |= dict.fromkeys(range(first, last + 1), name)


def _ends(one: Mapping[str, Any]) -> tuple[int, int] | None:
    """Returns first and last bit of an input or an output, as written; None if they are no such numbers."""
    bit = one.get("bit")
    ends = one.get("bits") if bit is None else (bit, bit)
    if not isinstance(ends, list | tuple) or len(ends) != 2 or not all(type(end) is int for end in ends):
        return None
    return (ends[0], ends[1]) if min(ends) >= 0 and max(ends) <= MOST_BIT else None
