"""Files in the order of the numbers in their names; IMG_2 and img_3 are of one kind."""

import re
from pathlib import Path


def in_natural_order(paths: list[Path]) -> list[Path]:
    """Numbers by value: 2 before 10. A dot between digits is a decimal point if some fraction begins with a zero and is
    longer than another, as seconds are: 0.05 before 0.4; else it parts two numbers: 1.9 before 1.10."""
    fractions = [fraction for path in paths for fraction in re.findall(r"\d\.(\d+)", path.stem)]
    shortest = min(map(len, fractions), default=0)
    decimal = any(fraction.startswith("0") and len(fraction) > shortest for fraction in fractions)
    number = re.compile(r"(\d+(?:\.\d+)?)" if decimal else r"(\d+)")

    def key(path: Path) -> list[tuple[float, str]]:
        parts = number.split(path.stem)
        return [(float(part), "") if place % 2 else (-1.0, part.casefold()) for place, part in enumerate(parts)]

    return sorted(paths, key=lambda path: (key(path), path.name))
