"""The command line that all benchmarks share.

A measurement is a module with `add_arguments(parser)`, and `measure(arguments)`, which prints its rows and returns what
the JSON record shall hold. The module's docstring is the protocol, and what `--help` prints.
"""

import argparse
import ast
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from benchmarks.common.record import write
from haustra.core.errors import HaustraError


class _Help(argparse.ArgumentDefaultsHelpFormatter, argparse.RawDescriptionHelpFormatter):
    """Docstrings as they are; defaults where there is one to tell."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        return action.help if action.default in (None, False, []) else super()._get_help_string(action)


def run(module: ModuleType, entry: str, argv: Sequence[str] | None = None) -> None:
    """Measure by `python -m entry ARGUMENTS` and write the record to `--json`; argv: None for the command line's own.

    A measurement that returns None has written its record itself.
    """
    parser = argparse.ArgumentParser(f"python -m {entry}", description=module.__doc__, formatter_class=_Help)
    module.add_arguments(parser)
    parser.add_argument("--json", type=Path, help="file for every run's figures, with commit and machine")
    arguments = parser.parse_args(argv)
    try:
        result = module.measure(arguments)
    except HaustraError as error:  # a known failure is one sentence, here too
        raise SystemExit(f"error: {error}") from error
    if result is not None:
        write(arguments.json, result)


def choose(package: str, about: str | None, measurements: Sequence[str], argv: Sequence[str] | None = None) -> None:
    """`python -m package MEASUREMENT ARGUMENTS`: measurements are modules of the package, `-` in place of `_`.

    Only the chosen one is imported, so that no measurement runs beside another's libraries and their threads.
    """
    modules = {name.replace("_", "-"): f"{package}.{name}" for name in measurements}
    lines = [f"  {name:20} {_first_line(module)}" for name, module in modules.items()]
    parser = argparse.ArgumentParser(
        f"python -m {package}", description=about, epilog="\n".join(["measurements:", *lines]), formatter_class=_Help
    )
    parser.add_argument("measurement", choices=modules, metavar="MEASUREMENT")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, help="its own; MEASUREMENT --help lists them")
    chosen = parser.parse_args(argv)
    run(import_module(modules[chosen.measurement]), f"{package} {chosen.measurement}", chosen.arguments)


def _first_line(module: str) -> str:
    """Of a module's docstring, without importing the module."""
    spec = find_spec(module)
    assert spec is not None, module
    assert spec.origin is not None, module
    return (ast.get_docstring(ast.parse(Path(spec.origin).read_text())) or "").split("\n")[0]


def add_folders(parser: argparse.ArgumentParser, about: str = "RGB-D folders") -> None:
    parser.add_argument("folders", type=Path, nargs="+", help=about)


def add_folder(parser: argparse.ArgumentParser, about: str = "RGB-D folder") -> None:
    parser.add_argument("folder", type=Path, help=about)


def add_seeds(parser: argparse.ArgumentParser, default: int) -> None:
    parser.add_argument("--seeds", type=int, default=default, help="as many runs of each: seed 0, 1, ...")
