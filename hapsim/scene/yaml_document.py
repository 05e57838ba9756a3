"""YAML text -> plain values that know where they stand in the file, or the errors of the text.

The YAML is version 1.2 in how plain words become numbers. YAML 1.1, which PyYAML reads by itself, takes ``1e-9`` for
text, ``yes`` for true, ``010`` for eight and ``12:30:45`` for 45045. Here ``1e-9`` is a number; ``yes``, ``on``,
``010``, ``0o17``, ``0x1F``, ``1_000``, ``12:30:45`` and dates are text, so that where a number is meant they are
reported rather than guessed at.

The text is composed to YAML nodes and these are read here, rather than by PyYAML's constructor: that one keeps no
positions, and lets the last of two equal keys win without a word.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
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

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._nesting = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """The next node, or an error where it would stand too deep."""
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
    """The value of a scalar node.

    Raises:
        ValueError: the node carries a tag that a scene has no use for, or one that its text does not fit.
    """
    tag, text = node.tag, node.value
    if tag == STRING:
        return text
    fits = _PATTERNS[tag].match(text) if tag in _PATTERNS else None
    if tag == FLOAT and (fits or _PATTERNS[INTEGER].match(text)):
        return float(re.sub(r"\.(?=[a-zA-Z])", "", text))
    if tag == INTEGER and fits:
        return _integer(text)
    if tag == BOOLEAN and fits:
        return text.lower() == "true"
    if tag in (NULL, MERGE) and fits:
        return None if tag == NULL else text
    raise ValueError(f"found {quote(text)} with the tag {short_tag(tag)}, expected a plain value without a tag")


def short_tag(tag: str) -> str:
    """The tag as it is written in a file."""
    return quote("!!" + tag.removeprefix(_PREFIX) if tag.startswith(_PREFIX) else tag)


def describe(node: yaml.Node) -> str:
    """What a node holds, in the words of an error: as the file spells it, and of which kind."""
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
    """What to do about a text that stands where a number is meant; the end of a sentence, or nothing."""
    if not isinstance(node, yaml.ScalarNode) or node.tag != STRING:
        return ""
    text = node.value.strip()
    if _PATTERNS[INTEGER].match(text) or _PATTERNS[FLOAT].match(text):
        return "; leave out the quotes"
    if re.match(r"[-+]?\.?[0-9]", text):
        return "; write plain decimals without a unit, such as 2000, 0.5 or 1e-9"
    return ""


def _integer(text: str) -> int | float:
    try:
        return int(text)
    except ValueError:  # more digits than Python converts; far outside every bound as a float too
        return float(text)


_BROKEN_ESCAPE = "not YAML: found an escape such as \\U… that names no character"
# What PyYAML says, and what we say in its place.
_SENTENCES = {
    "'\\t'": "found a tab, expected spaces: YAML is indented with spaces only",
    "found another document": "found a second document, expected one scene in a file",
    "second occurrence": "found the same anchor (&name) a second time, expected each anchor once",
    TOO_DEEP: TOO_DEEP,
}
# What PyYAML says, and what we add to it.
_ADVICE = {
    "mapping values are not allowed": "is a line broken or indented too far, or are quotes missing?",
    "could not find expected ':'": "is a colon missing, or the space after it?",
    "<block end>": "do the lines of one mapping start in one column?",
    "'<stream end>'": "is a bracket or a quote left open?",
    "unexpected end of stream": "is a bracket or a quote left open?",
    "cannot start any token": "put the text in quotes",
}


# `key:value` at the beginning of a line.
_UNSPACED = re.compile(r"^[ ]*(?:- )?([A-Za-z_][A-Za-z0-9_-]*):(?=[^\s:])(?!//)", re.MULTILINE)


class YamlSyntaxError(Exception):
    """The text is not YAML; ``fault`` says where and why."""

    def __init__(self, fault: LocatedIssue) -> None:
        super().__init__(fault.sentence)
        self.fault = fault


def compose(text: str) -> yaml.Node | None:
    """The top node of the text; None where the text holds nothing.

    Raises:
        YamlSyntaxError: the text is not YAML.
    """
    loader = None
    try:
        loader = SceneLoader(text)
        root = loader.get_single_node()
    except yaml.reader.ReaderError as error:
        found = f"found the character U+{ord(text[error.position]):04X}"
        raise YamlSyntaxError(
            LocatedIssue(place_in(text, error.position), f"{found}, expected printable text")
        ) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = _place_of_mark(mark) if mark else Place(1, 1)
        raise YamlSyntaxError(_unspaced(text) or LocatedIssue(place, _sentence(error))) from None
    except (ValueError, OverflowError):  # PyYAML on \U followed by digits beyond Unicode
        place = _place_of_mark(loader.get_mark()) if loader else Place(1, 1)
        raise YamlSyntaxError(LocatedIssue(place, _BROKEN_ESCAPE)) from None
    unspaced = _unspaced(text) if _is_plain_text(root) else None
    if unspaced is not None:
        raise YamlSyntaxError(unspaced)
    return root


def space_hint(text: object) -> str:
    """What to do about a text where a mapping is meant, or about a key, with no space behind its colon; or nothing."""
    key, colon, value = text.partition(":") if isinstance(text, str) else ("", "", "")
    return f"; a space belongs behind the colon: {quote(f'{key}: {value}')}" if colon and value[:1].strip() else ""


def _unspaced(text: str) -> LocatedIssue | None:
    """The first line `key:value`, if the text is a mapping once there is a space behind these colons."""
    first = _UNSPACED.search(text)
    if first is None:
        return None
    try:
        root = SceneLoader(_UNSPACED.sub(r"\g<0> ", text)).get_single_node()
    except (yaml.YAMLError, ValueError, OverflowError):
        return None
    if not isinstance(root, yaml.MappingNode):
        return None
    entry = text[first.start(1) :].splitlines()[0].split(" #")[0].rstrip()
    return LocatedIssue(place_in(text, first.end()), f"found {quote(entry)}{space_hint(entry)}")


def _is_plain_text(root: yaml.Node | None) -> bool:
    return isinstance(root, yaml.ScalarNode) and root.tag == STRING and root.style is None


def place_of(node: yaml.Node) -> Place:
    """Where a node starts."""
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
    sentence = f"not YAML: {problem}"
    if error.context and error.context != problem:
        began = f", which began in line {error.context_mark.line + 1}" if error.context_mark else ""
        sentence += f" ({error.context}{began})"
    advice = next((advice for part, advice in _ADVICE.items() if part in problem), None)
    return f"{sentence}; {advice}" if advice else sentence


Entries = dict[str, tuple[yaml.Node, yaml.Node]]


#: What stands under a key with nothing behind it, or ``null``: a value that no field takes. None would do for a field
#: that may be left out, and an emptied limit would be the default without a word. (pydantic looks for the fields of a
#: part in an object of any class but the built-in ones.)
NOTHING = ...


class Document:
    """The values of a YAML text, and the position of each.

    Attributes:
        data: the values as dicts, lists, str, float, int and bool, `NOTHING` under a key without a value; what is
            faulty is left out or is nothing.
        faults: what is wrong already on this level, such as a key that stands twice.
    """

    def __init__(self, root: yaml.Node) -> None:
        self._root = root
        self._values: dict[int, object] = {}
        self._entries: dict[int, Entries] = {}
        self._open: list[int] = []
        self.faults: list[LocatedIssue] = []
        self.data = self._value(root)

    def place(self, path: Path, at_key: bool = False) -> Place:
        """Where the value at ``path`` stands, or its key; of a path that breaks off, its last step."""
        key, value = self._nodes(path)
        return place_of(key if at_key else value)

    def found(self, path: Path) -> str:
        """The value at ``path`` in words, as the file spells it."""
        return describe(self._nodes(path)[1])

    def value(self, path: Path) -> object:
        """The value at ``path``."""
        return self._values.get(id(self._nodes(path)[1]))

    def keys(self, path: Path) -> list[str]:
        """The keys of the mapping at ``path``."""
        return list(self._entries.get(id(self._nodes(path)[1]), ()))

    def number_hint(self, path: Path) -> str:
        """What to do about the value at ``path`` if it is a text and a number is meant."""
        return number_hint(self._nodes(path)[1])

    def _nodes(self, path: Path) -> tuple[yaml.Node, yaml.Node]:
        key = node = self._root
        for step in path:
            entries = self._entries.get(id(node))
            if entries is not None and isinstance(step, str) and step in entries:
                key, node = entries[step]
            elif isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
                key = node = node.value[step]
            else:
                break
        return key, node

    def _value(self, node: yaml.Node) -> object:
        if id(node) not in self._values:
            with self._opened(node) as allowed:
                self._values[id(node)] = self._read(node) if allowed else None
        return self._values[id(node)]

    def _read(self, node: yaml.Node) -> object:
        if not isinstance(node, yaml.ScalarNode) and node.tag not in (MAPPING, SEQUENCE):
            self._fault(node, f"found the tag {short_tag(node.tag)}, expected a plain value without a tag")
        if isinstance(node, yaml.MappingNode):
            values = {name: self._value(value) for name, (_, value) in self._entries_of(node).items()}
            return {name: NOTHING if value is None else value for name, value in values.items()}
        if isinstance(node, yaml.SequenceNode):
            return [self._value(entry) for entry in node.value]
        try:
            return scalar_value(node)
        except ValueError as error:
            self._fault(node, str(error))
            return None

    def _entries_of(self, node: yaml.MappingNode) -> Entries:
        """The mapping's own entries, then those that it merges from elsewhere."""
        if id(node) not in self._entries:
            own: Entries = {}
            merged: Entries = {}
            for key, value in self._own_entries(node):
                if key.tag == MERGE:
                    merged = {**self._merged(value), **merged}
                else:
                    self._add(own, key, value)
            self._entries[id(node)] = own | {name: pair for name, pair in merged.items() if name not in own}
        return self._entries[id(node)]

    def _own_entries(self, node: yaml.MappingNode) -> Iterator[tuple[yaml.Node, yaml.Node]]:
        """Those that no comma cut off a number: ``{stiffness: 2,000}`` has a key ``000``, which nobody wrote."""
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

    def _add(self, own: Entries, key: yaml.Node, value: yaml.Node) -> None:
        if not isinstance(key, yaml.ScalarNode) or key.tag != STRING:
            self._fault(key, f"found {describe(key)} as a key, expected a name")
        elif key.value in own:
            first = place_of(own[key.value][0]).line
            self._fault(key, f"found the key {quote(key.value)} again, expected it once: it stands in line {first}")
        else:
            own[key.value] = (key, value)

    def _merged(self, node: yaml.Node) -> Entries:
        """What ``<<`` brings in: one mapping, or a list of them, of which the first counts most."""
        sources = node.value if isinstance(node, yaml.SequenceNode) else [node]
        merged: Entries = {}
        for source in sources:
            if not isinstance(source, yaml.MappingNode):
                self._fault(source, f"<<: found {describe(source)}, expected a mapping to take keys from")
                continue
            with self._opened(source) as allowed:
                if allowed:
                    merged = {**self._entries_of(source), **merged}
        return merged

    @contextmanager
    def _opened(self, node: yaml.Node) -> Iterator[bool]:
        """Keep count of the nodes around a node, so that nothing runs in a circle or too deep."""
        allowed = False
        if id(node) in self._open:
            self._fault(node, f"found {describe(node)} that contains itself, expected an end to it")
        elif len(self._open) > MOST_NESTING:
            self._fault(node, TOO_DEEP)
        else:
            allowed = True
        self._open.append(id(node))
        yield allowed
        self._open.pop()

    def _fault(self, node: yaml.Node, sentence: str) -> None:
        self.faults.append(LocatedIssue(place_of(node), sentence))
