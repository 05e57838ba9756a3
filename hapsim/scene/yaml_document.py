"""YAML text -> plain values that know where they stand in the file, or the errors of the text.

Plain words become numbers as in YAML 1.2: ``1e-9`` is a number; ``yes``, ``on``, ``010``, ``0o17``, ``0x1F``,
``1_000``, ``12:30:45`` and dates are text, and an error in place of a number. PyYAML by itself reads YAML 1.1: there
``1e-9`` is text, ``yes`` is true, ``010`` is eight and ``12:30:45`` is 45045.

The text is composed to YAML nodes, which are read here: PyYAML's constructor keeps no positions, and lets the last of
two equal keys win silently.
"""

import contextlib
import re
from collections.abc import Callable, Iterator
from typing import Any

import yaml

from .issue import LocatedIssue, Path, Place, quote
from .written_units import QUANTITY

MOST_NESTING = 32
TOO_DEEP = f"found more than {MOST_NESTING} levels, one within the other; expected at most five"

_PREFIX = "tag:yaml.org,2002:"
STRING, MERGE = _PREFIX + "str", _PREFIX + "merge"
INTEGER, FLOAT, BOOLEAN, NULL = (_PREFIX + kind for kind in ("int", "float", "bool", "null"))
MAPPING, SEQUENCE = _PREFIX + "map", _PREFIX + "seq"

# What a plain word has to look like, and the characters that it can start with.
_WORDS = {
    NULL: (r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    BOOLEAN: (r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    INTEGER: (r"[-+]?(0|[1-9][0-9]*)", list("-+0123456789")),
    FLOAT: (
        r"[-+]?(\.[0-9]+|[0-9]+\.[0-9]*)([eE][-+]?[0-9]+)?"
        r"|[-+]?[0-9]+[eE][-+]?[0-9]+"
        r"|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        list("-+.0123456789"),
    ),
    MERGE: (r"<<", ["<"]),
}
_PATTERNS = {tag: re.compile(rf"(?:{pattern})\Z") for tag, (pattern, _) in _WORDS.items()}

# What a comma cuts off a number in braces, and numbers with a comma.
_CUT_OFF = re.compile(r"[0-9]+(\.[0-9]*)?([eE][-+]?[0-9]+)?( ?[^\W\d_][^,]*| ?°.*)?\Z")
_THOUSANDS = re.compile(r"[-+]?[1-9][0-9]{0,2}(,[0-9]{3})+(\.[0-9]*)?\Z")
_DECIMAL = re.compile(r"[-+]?[0-9]+,[0-9]+([eE][-+]?[0-9]+)?( ?[^\W\d_].*| ?°.*)?\Z")
_SPACED = re.compile(r"[-+]?[0-9]{1,3}( [0-9]{3})+(\.[0-9]*)?( ?[^\W\d_].*)?\Z")
_SEVERAL = re.compile(r"[-+]?[0-9.]+(,[-+]?[0-9.]+){1,9}\Z")


class SceneLoader(yaml.SafeLoader):
    """PyYAML's safe reader with the words above, and an end to nesting before Python's own."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012  (PyYAML's way; filled below)
    _nesting = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Returns the next node, or an error where it would stand too deep."""
        if self._nesting > MOST_NESTING:
            raise yaml.composer.ComposerError(None, None, TOO_DEEP, self.peek_event().start_mark)
        self._nesting += 1
        try:
            return super().compose_node(parent, index)
        finally:
            self._nesting -= 1


for _tag, (_, _starts) in _WORDS.items():
    SceneLoader.add_implicit_resolver(_tag, _PATTERNS[_tag], _starts)


def scalar_value(node: yaml.Node) -> str | float | bool | None:
    """The value of a scalar node. Raises ValueError: its tag has no use in a scene, or does not fit its text."""
    tag, text = node.tag, node.value
    if tag == STRING:
        return text
    fits = _PATTERNS[tag].match(text) if tag in _PATTERNS else None
    if tag == FLOAT and (fits or _PATTERNS[INTEGER].match(text)):
        return float(re.sub(r"\.(?=[a-zA-Z])", "", text))
    if tag == INTEGER and fits:
        return int(text) if len(text) < 300 else float(text)  # Python has a limit of digits, a float ends before it
    if tag == BOOLEAN and fits:
        return text.lower() == "true"
    if tag in (NULL, MERGE) and fits:
        return None if tag == NULL else text
    raise ValueError(f"found {quote(text)} with the tag {short_tag(tag)}, expected a plain value without a tag")


def short_tag(tag: str) -> str:
    """The tag as it is written in a file."""
    return quote("!!" + tag.removeprefix(_PREFIX) if tag.startswith(_PREFIX) else tag)


def describe(node: yaml.Node) -> str:
    """Describes a node in an error: its text in the file and its type."""
    if isinstance(node, yaml.MappingNode):
        return "a mapping" if node.value else "an empty mapping"
    if isinstance(node, yaml.SequenceNode):
        return "a list" if node.value else "an empty list"
    text: str = node.value
    if node.tag == NULL:
        return f"{text} (nothing)" if text else "nothing"
    if node.tag == BOOLEAN:
        return f"{text} (a boolean)"
    if node.tag in (INTEGER, FLOAT):
        return text if len(text) <= 40 else f"{text[:24]}… ({len(text)} characters)"
    if node.tag == STRING and QUANTITY.match(text):
        return text
    return f"{quote(text)} (text)" if node.tag == STRING else quote(text)


def number_hint(node: yaml.Node) -> str:
    """Returns the advice for a list, or a text in place of a number: the end of a sentence, or ""."""
    if isinstance(node, yaml.SequenceNode):
        return _list_hint(node)
    if not isinstance(node, yaml.ScalarNode) or node.tag != STRING:
        return ""
    text = node.value.strip()
    if hint := _comma_hint(text):
        return hint
    if _SPACED.match(text):
        return f"; remove the space: {re.sub('(?<=[0-9]) (?=[0-9])', '', text)}"
    if _PATTERNS[INTEGER].match(text) or _PATTERNS[FLOAT].match(text):
        return "; remove the quotes"
    if re.match(r"[-+]?\.?[0-9]", text):
        unit = " without a unit" if QUANTITY.match(text) else ""
        return f"; write plain decimals{unit}, such as 2000, 0.5 or 1e-9"
    return ""


def _comma_hint(text: str) -> str:
    """Returns the advice for a number with a comma; else ""."""
    decimal = _DECIMAL.match(text)
    meant = [text.replace(",", "")] if _THOUSANDS.match(text) else []
    meant += ["a decimal point: " + text.replace(",", ".")] if decimal else []
    if not meant and _SEVERAL.match(text):
        return f"; a decimal has a point, and a list has brackets: [{text.replace(',', ', ')}]"
    return f"; write {', or '.join(meant)}" if meant else ""


def _list_hint(node: yaml.SequenceNode) -> str:
    """Returns the advice for a list in which a comma parts a number, or an indentation joins items; else ""."""
    text = str(node.start_mark.buffer)[node.start_mark.pointer : node.end_mark.pointer]
    if node.flow_style and re.search(r"(?<![.0-9])[0-9]+,[0-9]+(?![.0-9])", text):
        in_pairs = all(run.count(",") % 2 for run in re.findall(r"[0-9]+(?:,[-+]?[0-9]+)+", text))
        meant = re.sub(r"([0-9]),([0-9]+)", r"\1.\2", " ".join(text.split()))
        return f"; a comma separates entries, and a decimal has a point{': ' + quote(meant)[1:-1] if in_pairs else ''}"
    is_joined = not node.flow_style and any(" - " in str(entry.value) for entry in node.value)
    return "; the items of a list must be indented alike" if is_joined else ""


# What PyYAML says, and what we say in its place,
_SENTENCES = {
    "'\\t'": "found a tab, expected spaces: YAML is indented with spaces only",
    "found another document": "found a second document, expected one scene in a file",
    "second occurrence": "found the same anchor (&name) a second time, expected each anchor once",
    TOO_DEEP: TOO_DEEP,
}
# or add to it.
_ADVICE = {
    "mapping values are not allowed": "; is a line broken or indented too far, or are quotes missing?",
    "could not find expected ':'": "; is a colon missing, or the space after it?",
    "<block end>": "; remove what follows the value, or indent the keys of a mapping alike",
    "'<stream end>'": "; is a bracket or a quote left open?",
    "cannot start any token": "; put the text in quotes",
}

# `key:value` at the beginning of a line.
_UNSPACED = re.compile(r"^[ ]*(?:- )?([A-Za-z_][A-Za-z0-9_-]*):(?=[^\s:])(?!//)", re.MULTILINE)


class YamlSyntaxError(Exception):
    """The text is not YAML; its arguments say where and why: a `Place` and a sentence."""


def compose(text: str) -> yaml.Node | None:
    """Returns the top node of the text; None if it is empty. Raises YamlSyntaxError: the text is not YAML."""
    try:
        loader = SceneLoader(text)
        root = loader.get_single_node()
    except yaml.reader.ReaderError as error:
        found = f"found the character U+{ord(text[error.position]):04X}"
        raise YamlSyntaxError(place_in(text, error.position), f"{found}, expected printable text") from None
    except yaml.MarkedYAMLError as error:
        _require_spaces(text)
        mark = error.problem_mark or error.context_mark
        if mark and re.search("<block end>|<document start>|mapping values", error.problem or ""):
            _require_no_stray_dash(text, mark.index)
            _require_alike_columns(text, mark.index)
        _require_closed(error)
        raise YamlSyntaxError(_place_of_mark(mark) if mark else Place(1, 1), _sentence(error)) from None
    except (ValueError, OverflowError):  # PyYAML on \U followed by digits beyond Unicode
        place = _place_of_mark(loader.get_mark())
        raise YamlSyntaxError(place, "not YAML: found an escape such as \\U… that names no character") from None
    if isinstance(root, yaml.ScalarNode) and root.tag == STRING and root.style is None:
        _require_spaces(text)
    return root


def _require_spaces(text: str) -> None:
    """Raises YamlSyntaxError at the first line `key:value`, if a space after these colons makes the text a mapping."""
    first = _UNSPACED.search(text)
    if first is None:
        return
    try:
        root = SceneLoader(_UNSPACED.sub(r"\g<0> ", text)).get_single_node()
    except (yaml.YAMLError, ValueError, OverflowError):
        return
    if isinstance(root, yaml.MappingNode):
        entry = text[first.start(1) :].splitlines()[0].split(" #")[0].rstrip()
        raise YamlSyntaxError(place_in(text, first.end()), f"found {quote(entry)}{space_hint(entry)}")


def _require_alike_columns(text: str, index: int) -> None:
    """Raises YamlSyntaxError if the line at ``index`` begins there, and not in the column of the last key or item."""
    start = text.rfind("\n", 0, index) + 1
    line = text[start:].partition("\n")[0]
    rule, begins = "the keys of a mapping", r"[^\s#{[-].*:(\s|$)"
    if line.lstrip().startswith("-"):
        rule, begins = "the items of a list", r"-(\s|$)"
    above = [*re.finditer(rf"(?<![,[{{]\n)^( *){begins}", text[:start], re.MULTILINE)]  # none within brackets
    width = len(line) - len(line.lstrip())
    if above and width != len(above[-1][1]) and re.fullmatch(r" *[^\s:]*", text[start:index]):
        alike = dict.fromkeys([above[-1], *[one for one in above if len(one[1]) < width][-1:]])
        places = [place_in(text, one.end(1)) for one in alike]
        expected = " or ".join(f"column {place.column} as in line {place.line}" for place in places)
        found = f"found {quote(line.strip())} in column {width + 1}, expected {expected}"
        raise YamlSyntaxError(place_in(text, start + width), f"{found}: {rule} must be indented alike")


def _require_no_stray_dash(text: str, index: int) -> None:
    """Raises YamlSyntaxError at a line with `-` at ``index`` or before it, if the text is a mapping without that."""
    for dash in [*re.finditer(r"^( *)-(?: +(\S.*:(?: .*)?))?$", text[: text.find("\n", index)], re.MULTILINE)][-2:]:
        with contextlib.suppress(yaml.YAMLError, ValueError, OverflowError):
            without = f"{text[: dash.end(1)]}{dash[2] or ''}{text[dash.end() :]}"
            if isinstance(SceneLoader(without).get_single_node(), yaml.MappingNode):
                found = f"found {quote(dash[0].strip())} in a column of keys, expected a key; remove the '-'"
                raise YamlSyntaxError(place_in(text, dash.end(1)), found)


def _require_closed(error: yaml.MarkedYAMLError) -> None:
    """Raises YamlSyntaxError at a bracket or quote that is open where the text, or another bracket, ends."""
    opened, met = error.context_mark, error.problem_mark
    ended = re.search("(end)>'|(end) of stream|got '([]}:])'", error.problem or "")
    if not (ended and opened and met and re.search("flow (mapping|sequence)|quoted", error.context or "")):
        return
    character = str(opened.buffer)[opened.pointer]
    closing = {"{": "}", "[": "]"}.get(character, character)
    if ended[3] == ":" and met.line == opened.line:
        return  # a comma is missing
    where = f" before line {met.line + 1}, or a comma in front of that line" if ended[3] == ":" else ""
    where = f" before the {ended[3]} in column {met.column + 1}" if ended[3] in ("]", "}") else where
    raise YamlSyntaxError(_place_of_mark(opened), f"found {character} without its {closing}; add it{where}")


def space_hint(text: object) -> str:
    """Returns the advice for a key, or a text in place of a mapping, without a space after its colon; else ""."""
    key, colon, value = text.partition(":") if isinstance(text, str) else ("", "", "")
    return f"; put a space after the colon: {quote(f'{key}: {value}')}" if colon and value[:1].strip() else ""


def place_of(node: yaml.Node) -> Place:
    """Returns the position of a node's first character."""
    return _place_of_mark(node.start_mark)


def place_in(text: str, index: int) -> Place:
    """The place of the character at ``index``."""
    before = text[:index]
    return Place(before.count("\n") + 1, index - (before.rfind("\n") + 1) + 1)


def _place_of_mark(mark: yaml.Mark) -> Place:
    return Place(mark.line + 1, mark.column + 1)


def _sentence(error: yaml.MarkedYAMLError) -> str:
    problem = error.problem or error.context or "this is not YAML"
    for part, sentence in _SENTENCES.items():
        if part in problem:
            return sentence
    context = ""
    if error.context and error.context != problem:
        began = f", which began in line {error.context_mark.line + 1}" if error.context_mark else ""
        context = f" ({error.context}{began})"
    advice = next((advice for part, advice in _ADVICE.items() if part in problem), "")
    return f"not YAML: {problem}{context}{advice}"


Entries = dict[str, tuple[yaml.Node, yaml.Node]]

#: The value of a key with nothing behind it, or ``null``: no field accepts it. None would become the default silently.
#: (pydantic looks for the fields of a part in an object of any class but the built-in ones.)
NOTHING = ...

_UNFINISHED = object()  # a node that is being read: an alias to it leads in a circle


class Document:
    """The values of a YAML text, and the position of each.

    Attributes:
        data: the values as dicts, lists, str, float, int and bool, `NOTHING` under a key without a value; faulty
            values are missing or None.
        faults: errors of this level, such as a key that stands twice.
        ranged: paths of the values that the text has one level deeper, under `value`, beside a `range`.
    """

    def __init__(self, root: yaml.Node) -> None:
        self._root = root
        self._read: dict[tuple[int, bool], Any] = {}
        self.faults: list[LocatedIssue] = []
        self.ranged: set[Path] = set()
        self.data = self._value(root, 0)

    def place(self, path: Path, at_key: bool = False) -> Place:
        """Returns where the value at ``path`` stands, or its key; of a path that breaks off, its last step."""
        key, value = self._nodes(path)
        return place_of(key if at_key else value)

    def found(self, path: Path) -> str:
        """Returns the value at ``path`` in words, as the file spells it."""
        return describe(self._nodes(path)[1])

    def value(self, path: Path) -> object:
        """Returns the value at ``path``."""
        return self._read.get((id(self._nodes(path)[1]), False))

    def keys(self, path: Path) -> list[str]:
        """Returns the keys of the mapping at ``path``."""
        return list(self._entries_at(self._nodes(path)[1]))

    def number_hint(self, path: Path) -> str:
        """Returns what to do about the value at ``path`` if a number is meant."""
        node = self._nodes(path)[1]
        is_part = path and isinstance(path[-1], int) and str(node.value).startswith("0")  # of 0,05
        return (number_hint(self._nodes(path[:-1])[1]) if is_part else "") or number_hint(node)

    def _entries_at(self, node: yaml.Node) -> Entries:
        entries: Entries = self._read.get((id(node), True)) or {}
        return entries

    def _nodes(self, path: Path) -> tuple[yaml.Node, yaml.Node]:
        key = node = self._root
        for step in self._in_text(path):
            entries = self._entries_at(node)
            if isinstance(step, str) and step in entries:
                key, node = entries[step]
            elif isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
                key = node = node.value[step]
            else:
                break
        return key, node

    def _in_text(self, path: Path) -> Path:
        """Returns the path in the text: it has what stands beside a range one level deeper."""
        steps = (*path, 0)
        of_values = (n for n, step in enumerate(steps) if path[:n] in self.ranged and isinstance(step, int))
        n = next(of_values, None) if self.ranged else None
        return path if n is None else (*path[:n], "value", *path[n:])

    def _once(self, node: yaml.Node, depth: int, read: Callable[[Any, int], Any], entries: bool = False) -> Any:
        """Returns `read` of a node, computed once for all its anchors; None if it is circular or too deep."""
        key = (id(node), entries)
        if key not in self._read:
            self._read[key] = _UNFINISHED
            if depth > MOST_NESTING:
                self._fault(node, TOO_DEEP)
            self._read[key] = read(node, depth) if depth <= MOST_NESTING else None
        if self._read[key] is _UNFINISHED:
            self._fault(node, f"found {describe(node)} that contains itself, expected an end to it")
            return None
        return self._read[key]

    def _value(self, node: yaml.Node, depth: int) -> object:
        return self._once(node, depth, self._plain_value)

    def _plain_value(self, node: yaml.Node, depth: int) -> object:
        if not isinstance(node, yaml.ScalarNode) and node.tag not in (MAPPING, SEQUENCE):
            self._fault(node, f"found the tag {short_tag(node.tag)}, expected a plain value without a tag")
        if isinstance(node, yaml.MappingNode):
            entries: Entries = self._once(node, depth, self._entries, entries=True) or {}
            values = {name: self._value(value, depth + 1) for name, (_, value) in entries.items()}
            return {name: NOTHING if value is None else value for name, value in values.items()}
        if isinstance(node, yaml.SequenceNode):
            return [self._value(entry, depth + 1) for entry in node.value]
        try:
            return scalar_value(node)
        except ValueError as error:
            self._fault(node, str(error))
            return None

    def _entries(self, node: yaml.MappingNode, depth: int) -> Entries:
        """The mapping's own entries, then those that it merges from elsewhere."""
        own: Entries = {}
        merged: Entries = {}
        for key, value in self._without_cut_numbers(node):
            if key.tag == MERGE:
                merged = {**self._merged(value, depth + 1), **merged}
            elif not isinstance(key, yaml.ScalarNode) or key.tag != STRING:
                self._fault(key, f"found {describe(key)} as a key, expected a name")
            elif key.value in own:
                first = place_of(own[key.value][0]).line
                self._fault(key, f"found the key {quote(key.value)} again, expected it once: it stands in line {first}")
            else:
                own[key.value] = (key, value)
        return own | {name: pair for name, pair in merged.items() if name not in own}

    def _without_cut_numbers(self, node: yaml.MappingNode) -> Iterator[tuple[yaml.Node, yaml.Node]]:
        """The entries, without what a comma cuts off a number: ``{stiffness: 2,000}`` has a key ``000``."""
        numbers: list[list[yaml.Node]] = [[]]  # each with the keys cut off it
        for key, value in node.value:
            end = numbers[-1][-1].end_mark.index if numbers[-1] else None
            if end and key.start_mark.index == end + 1 and not value.value and _CUT_OFF.match(str(key.value)):
                numbers[-1].append(key)
            else:
                yield key, value
                numbers.append([value] if value.tag in (INTEGER, FLOAT) else [])
        for first, text in ((one[0], ",".join(str(part.value) for part in one)) for one in numbers if one[1:]):
            self._fault(first, f"found {quote(text)}, expected a number without a comma{_comma_hint(text)}")

    def _merged(self, node: yaml.Node, depth: int) -> Entries:
        """Returns the entries merged by ``<<``: of one mapping, or of a list of them, where earlier ones win."""
        merged: Entries = {}
        for source in node.value if isinstance(node, yaml.SequenceNode) else [node]:
            if isinstance(source, yaml.MappingNode):
                merged = {**(self._once(source, depth, self._entries, entries=True) or {}), **merged}
            else:
                self._fault(source, f"<<: found {describe(source)}, expected a mapping to take keys from")
        return merged

    def _fault(self, node: yaml.Node, sentence: str) -> None:
        self.faults.append(LocatedIssue(place_of(node), sentence))
