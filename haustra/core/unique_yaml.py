"""YAML that a user wrote: a name that stands twice in a section is an error, where PyYAML takes the last in silence."""

from typing import Any

import yaml

MERGE = "tag:yaml.org,2002:merge"  # of <<, which may stand twice


def load_unique(text: str) -> Any:
    """What a YAML text holds. yaml.YAMLError, whose first line says what is wrong and where, where it is none."""
    try:
        _check(yaml.compose(text, yaml.SafeLoader), set())
        return yaml.safe_load(text)
    except yaml.MarkedYAMLError as error:
        raise yaml.YAMLError(in_words(error)) from error


def in_words(error: yaml.YAMLError) -> str:
    """What is wrong with a YAML text, and on which line."""
    if not isinstance(error, yaml.MarkedYAMLError):
        return str(error).splitlines()[0]
    mark = error.problem_mark or error.context_mark
    what = "a tab, where YAML has spaces alone" if "'\\t'" in str(error.problem) else error.problem or error.context
    return f"{what}" if mark is None else f"{what} (line {mark.line + 1})"


def _check(node: yaml.Node | None, seen: set[int]) -> None:
    if node is None or id(node) in seen:  # an alias
        return
    seen.add(id(node))
    if isinstance(node, yaml.SequenceNode):
        for inner in node.value:
            _check(inner, seen)
    if isinstance(node, yaml.MappingNode):
        lines: dict[tuple[str, str], int] = {}
        for key, inner in node.value:
            _check(inner, seen)
            if not isinstance(key, yaml.ScalarNode) or key.tag == MERGE:
                continue
            name, line = (key.tag, key.value), key.start_mark.line + 1
            if name in lines:
                twice = f"'{key.value}' stands twice, on lines {lines[name]} and {line}; keep one"
                raise yaml.constructor.ConstructorError(problem=twice)
            lines[name] = line
