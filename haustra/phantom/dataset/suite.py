"""The evaluation suite: named sequences, each a scene with some values replaced, kept in suite.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from haustra.core.errors import PhantomError
from haustra.phantom.config import PhantomConfig
from haustra.phantom.dataset.scenes import scene_config

SUITE_FILE = Path(__file__).with_name("suite.yaml")


def config_from(values: Mapping[str, Any]) -> PhantomConfig:
    """A config from `{scene, seed, anatomy, appearance, imaging, camera, motion, events}`, all optional.

    `scene` names where to begin (default colon). Raises PhantomError on unknown keys and wrong types.
    """
    rest = dict(values)
    scene, seed = rest.pop("scene", "colon"), rest.pop("seed", 0)
    if type(seed) is not int or seed < 0:
        raise PhantomError(f"seed: expected a whole number from 0, got {seed!r}")
    return scene_config(scene, seed).updated(rest)


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
    """Sequence names and their configs, in the file's order."""
    return {name: config_from(values) for name, values in read_settings(path).items()}
