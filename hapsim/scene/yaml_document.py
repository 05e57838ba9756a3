"""YAML text -> plain values that know where they stand in the file, or the errors of the text.

The YAML is version 1.2 in how plain words become numbers. YAML 1.1, which PyYAML reads by itself, takes ``1e-9`` for
text, ``yes`` for true, ``010`` for eight and ``12:30:45`` for 45045. Here ``1e-9`` is a number; ``yes``, ``on``,
``010``, ``0o17``, ``0x1F``, ``1_000``, ``12:30:45`` and dates are text, so that where a number is meant they are
reported rather than guessed at.

The text is composed to YAML nodes and these are read here, rather than by PyYAML's constructor: that one keeps no
positions, and lets the last of two equal keys win without a word.
"""

import re
from collections.abc import Callable, Iterator
from typing import Any

import yaml

from .issue import LocatedIssue, Path, Place, quote

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

_CUT_OFF = re.compile(r"[0-9]+(\.[0-9]*)?\Z")  # behind a comma
_NO_COMMA = "expected a number without a comma: leave out one for thousands, write a point for decimals"


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
    """The value of a scalar node. Raises ValueError: the node carries a tag that a scene has no use for, or one that
    its text does not fit."""
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
    return f"{quote(text)} (text)" if node.tag == STRING else quote(text)


def number_hint(node: yaml.Node) -> str:
    """Returns the advice for a text in place of a number: the end of a sentence, or ""."""
    if not isinstance(node, yaml.ScalarNode) or node.tag != STRING:
        return ""
    text = node.value.strip()
    if _PATTERNS[INTEGER].match(text) or _PATTERNS[FLOAT].match(text):
        return "; remove the quotes"
    if re.match(r"[-+]?\.?[0-9]", text):
        return "; write plain decimals without a unit, such as 2000, 0.5 or 1e-9"
    return ""


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
    "<block end>": "; do the lines of one mapping start in one column?",
    "'<stream end>'": "; is a bracket or a quote left open?",
    "unexpected end of stream": "; is a bracket or a quote left open?",
    "cannot start any token": "; put the text in quotes",
}


# `key:value` at the beginning of a line.
_UNSPACED = re.compile(r"^[ ]*(?:- )?([A-Za-z_][A-Za-z0-9_-]*):(?=[^\s:])(?!//)", re.MULTILINE)


class YamlSyntaxError(Exception):
    """The text is not YAML; its argument, a `LocatedIssue`, says where and why."""


def compose(text: str) -> yaml.Node | None:
    """Returns the top node of the text; None where the text holds nothing. Raises YamlSyntaxError: the text is not
    YAML."""
    loader = None
    try:
        loader = SceneLoader(text)
        root = loader.get_single_node()
    except yaml.reader.ReaderError as error:
        found = f"found the character U+{ord(text[error.position]):04X}"
        raise _fault_at(place_in(text, error.position), f"{found}, expected printable text") from None
    except yaml.MarkedYAMLError as error:
        _require_spaces(text)
        mark = error.problem_mark or error.context_mark
        raise _fault_at(_place_of_mark(mark) if mark else Place(1, 1), _sentence(error)) from None
    except (ValueError, OverflowError):  # PyYAML on \U followed by digits beyond Unicode
        place = _place_of_mark(loader.get_mark()) if loader else Place(1, 1)
        raise _fault_at(place, "not YAML: found an escape such as \\U… that names no character") from None
    if isinstance(root, yaml.ScalarNode) and root.tag == STRING and root.style is None:
        _require_spaces(text)
    return root


def _fault_at(place: Place, sentence: str) -> YamlSyntaxError:
    return YamlSyntaxError(LocatedIssue(place, sentence))


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
        raise _fault_at(place_in(text, first.end()), f"found {quote(entry)}{space_hint(entry)}")


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

#: What stands under a key with nothing behind it, or ``null``: a value that no field takes. None would do for a field
#: that may be omitted, and an emptied limit would be the default without a word. (pydantic looks for the fields of a
#: part in an object of any class but the built-in ones.)
NOTHING = ...

_UNFINISHED = object()  # a node that is being read: an alias to it leads in a circle


class Document:
    """The values of a YAML text, and the position of each.

    Attributes:
        data: the values as dicts, lists, str, float, int and bool, `NOTHING` under a key without a value; faulty
            values are missing or None.
        faults: errors of this level, such as a key that stands twice.
    """

    def __init__(self, root: yaml.Node) -> None:
        self._root = root
        self._read: dict[tuple[int, bool], Any] = {}
        self.faults: list[LocatedIssue] = []
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
        """Returns what to do about the value at ``path`` if it is a text and a number is meant."""
        return number_hint(self._nodes(path)[1])

    def _entries_at(self, node: yaml.Node) -> Entries:
        entries: Entries = self._read.get((id(node), True)) or {}
        return entries

    def _nodes(self, path: Path) -> tuple[yaml.Node, yaml.Node]:
        key = node = self._root
        for step in path:
            entries = self._entries_at(node)
            if isinstance(step, str) and step in entries:
                key, node = entries[step]
            elif isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
                key = node = node.value[step]
            else:
                break
        return key, node

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
        number: yaml.Node | None = None  # that the next key may be cut off
        end = -1
        for key, value in node.value:
            if value.value or key.start_mark.index != end + 1 or not _CUT_OFF.match(str(key.value)):
                yield key, value
                number = value if value.tag in (INTEGER, FLOAT) else None
                end = value.end_mark.index if number else -1
                continue
            if number is not None:
                self._fault(number, f"found {quote(f'{number.value},{key.value}')}, {_NO_COMMA}")
            number, end = None, key.end_mark.index  # the second comma of 1,000,000 is no further fault

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
