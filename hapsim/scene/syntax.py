"""Text -> YAML nodes, or the one fault that keeps it from being YAML."""

import re

import yaml

from .issue import LocatedIssue, Place, quote
from .yaml_rules import STRING, TOO_DEEP, SceneLoader

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
