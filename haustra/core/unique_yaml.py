"""YAML that a user wrote: a name that stands twice in a section is an error, where PyYAML takes the last in silence."""

from typing import Any

import yaml


class _UniqueNames(yaml.SafeLoader):
    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        lines: dict[str, int] = {}
        for key, _ in node.value:
            line = key.start_mark.line + 1
            if isinstance(key, yaml.ScalarNode) and lines.setdefault(key.value, line) != line:
                twice = f"'{key.value}' stands twice, on lines {lines[key.value]} and {line}; keep one"
                raise yaml.constructor.ConstructorError(problem=twice)
        return super().construct_mapping(node, deep)


def load_unique(text: str) -> Any:
    """What a YAML text holds. yaml.YAMLError, whose first line says what is wrong, where it is none."""
    return yaml.load(text, _UniqueNames)
