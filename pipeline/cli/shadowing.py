"""Whether another installed distribution takes one of our import names. Loads nothing of ours but the errors.

`pipeline` and `completion` are common words: pip lets two distributions write into one folder of that name, or puts one
before the other on the import path, and says nothing.
"""

import re
from importlib.machinery import ModuleSpec
from importlib.metadata import Distribution, distributions
from importlib.util import find_spec
from pathlib import Path

from haustra.core.errors import HaustraError

OURS = "haustra"
IMPORT_NAMES = ("pipeline", "completion", "reconstruction", "haustra")
ROOT = Path(__file__).resolve().parents[2]  # the folder that holds our packages


def shadowing_distributions() -> dict[str, str]:
    """Our import names that another distribution has too, or that are found elsewhere: the distribution or the folder.

    Reads names only, not `importlib.metadata.packages_distributions`, which takes a quarter of a second.
    """
    owners = _other_owners()
    found = {}
    for name in IMPORT_NAMES:
        if name in owners:
            found[name] = f"the distribution '{owners[name]}'"
        elif (elsewhere := _elsewhere(find_spec(name))) is not None:
            found[name] = f"a package in {elsewhere}"
    return found


def refuse_shadowed_names() -> None:
    """Raise `HaustraError`, which names what shadows us, if anything does."""
    found = shadowing_distributions()
    if not found:
        return
    shadowed = " and ".join(f"'{name}' is also the import name of {other}" for name, other in found.items())
    raise HaustraError(f"{shadowed}: install haustra in an environment of its own, or remove the other")


def _other_owners() -> dict[str, str]:
    """Import name of ours: name of another distribution that claims it."""
    owners = {}
    for distribution in distributions():
        for name in _claimed(distribution):
            other = distribution.metadata["Name"]
            if _normal(other) != OURS:
                owners[name] = other
    return owners


def _claimed(distribution: Distribution) -> set[str]:
    """Our import names among a distribution's own: of `top_level.txt`, or of its list of files where it has none."""
    listed = distribution.read_text("top_level.txt")
    if listed is not None:
        return set(listed.split()) & set(IMPORT_NAMES)
    return set(_FILE_OF_OURS.findall(distribution.read_text("RECORD") or ""))


_FILE_OF_OURS = re.compile(rf"^({'|'.join(IMPORT_NAMES)})(?:/|\.py,)", re.MULTILINE)


def _elsewhere(spec: ModuleSpec | None) -> Path | None:
    """The folder that an import name leads to, if that is not ours."""
    places = [] if spec is None else [Path(place).resolve() for place in spec.submodule_search_locations or ()]
    if spec is not None and not places and spec.origin is not None:
        places = [Path(spec.origin).resolve()]
    return None if ROOT in [place.parent for place in places] else next((place.parent for place in places), None)


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
