"""Text -> YAML nodes, or the one fault that keeps it from being YAML."""

import yaml

from .issue import LocatedIssue, Place
from .yaml_rules import TOO_DEEP, SceneLoader

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
        return loader.get_single_node()
    except yaml.reader.ReaderError as error:
        found = f"found the character U+{ord(text[error.position]):04X}"
        raise YamlSyntaxError(
            LocatedIssue(place_in(text, error.position), f"{found}, expected printable text")
        ) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = _place_of_mark(mark) if mark else Place(1, 1)
        raise YamlSyntaxError(LocatedIssue(place, _sentence(error))) from None
    except (ValueError, OverflowError):  # PyYAML on \U followed by digits beyond Unicode
        place = _place_of_mark(loader.get_mark()) if loader else Place(1, 1)
        raise YamlSyntaxError(LocatedIssue(place, _BROKEN_ESCAPE)) from None


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
