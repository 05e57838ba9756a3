"""The YAML that hapsim reads: version 1.2 in how plain words become numbers, and nothing that surprises.

YAML 1.1, which PyYAML reads by itself, takes ``1e-9`` for text, ``yes`` for true, ``010`` for eight and
``12:30:45`` for 45045. Here ``1e-9`` is a number; ``yes``, ``on``, ``010``, ``0o17``, ``0x1F``, ``1_000``,
``12:30:45`` and dates are text, so that where a number is meant they are reported rather than guessed at.
"""

import re
from typing import Any

import yaml

from .issue import quote

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


NO_COMMA = "expected a number without a comma: leave out one for thousands, write a point for decimals"


def is_behind_comma(before: yaml.Node, key: yaml.Node, value: yaml.Node) -> bool:
    """Whether a key with nothing behind it is what a comma cut off a number, or off what is cut off already."""
    if not all(isinstance(node, yaml.ScalarNode) for node in (before, key, value)) or value.value:
        return False
    numbers = _CUT_OFF.match(key.value) and (before.tag in (INTEGER, FLOAT) or _CUT_OFF.match(before.value))
    return bool(numbers) and key.start_mark.index == before.end_mark.index + 1


def _integer(text: str) -> int | float:
    try:
        return int(text)
    except ValueError:  # more digits than Python converts; far outside every bound as a float too
        return float(text)
