"""The evaluation suite: named sequences, each a scene with some values replaced, kept in suite.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from haustra.core.errors import PhantomError
from haustra.phantom.config import PhantomConfig
from haustra.phantom.dataset.scenes import scene_config
from haustra.phantom.imaging.scopes import filmed_through

SUITE_FILE = Path(__file__).with_name("suite.yaml")
LIVING_FILE = Path(__file__).with_name("living.yaml")


def config_from(values: Mapping[str, Any]) -> PhantomConfig:
    """A config from `{scene, seed, scope, anatomy, appearance, imaging, camera, motion, events, tissue}`, all optional.

    `scene` names where to begin (default colon), `scope` the measured endoscope (1 to 18) whose lens and lamp
    replace those of `camera` and `imaging`. Raises PhantomError on unknown keys and wrong types.
    """
    rest = dict(values)
    scene, seed, scope = rest.pop("scene", "colon"), rest.pop("seed", 0), rest.pop("scope", None)
    if type(seed) is not int or seed < 0:
        raise PhantomError(f"seed: expected a whole number from 0, got {seed!r}")
    config = scene_config(scene, seed).updated(rest)
    return config if scope is None else filmed_through(config, scope)


def read_settings(path: Path) -> dict[str, Any]:
    """A YAML mapping. PhantomError if the file is missing, is no YAML or no mapping."""
    try:
        values = yaml.safe_load(Path(path).read_text())
    except OSError as error:
        raise PhantomError(f"{path}: {error.strerror}") from None
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise PhantomError(f"{path}: not a YAML file ({str(error).splitlines()[0]})") from None
    if values is None:
        raise PhantomError(f"{path}: the file is empty")
    if not isinstance(values, dict):
        raise PhantomError(f"{path}: expected a mapping of settings")
    return values


def load_suite(path: Path = SUITE_FILE) -> dict[str, PhantomConfig]:
    """Sequence names and their configs, in the file's order. Names that begin with "_" are anchors for the others."""
    films = {name: values for name, values in read_settings(path).items() if not name.startswith("_")}
    return {name: config_from(values) for name, values in films.items()}
