"""A count in words; JSON that every program reads; text files replaced as wholes; text and JSON that a user wrote, in
what editors and shells save: UTF-8 and UTF-16, with a mark or without.
"""

import codecs
import json
import math
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from haustra.core.errors import HaustraError

PARTIAL = ".partial"  # ends the name of a text file that is being written
MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


def counted(number: int, noun: str, plural: str | None = None) -> str:
    """The number with its noun in singular or plural: 1 submap, 2 submaps. plural: where an s does not make it."""
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def check_name(path: Path) -> None:
    """HaustraError for a path whose bytes are no UTF-8, as those of old file systems may be: OpenCV crashes at it, and
    no report could name it."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        shown = os.fsencode(path).decode(errors="replace")
        raise HaustraError(f"the name {shown} has bytes that are no UTF-8; give it another name") from None


def first_few(items: Sequence[str]) -> str:
    """Three of a list for a person, and dots for the rest."""
    return ", ".join([*items[:3], "..."] if len(items) > 3 else items)


def write_text(path: Path, text: str) -> None:
    """Replace a text file as a whole."""
    partial = path.with_name(path.name + PARTIAL)
    try:
        partial.write_text(text)
        os.replace(partial, path)
    except BaseException:
        with suppress(OSError):
            partial.unlink()
        raise


def read_text(path: Path | str) -> str:
    """A file's text. HaustraError, one sentence, if it cannot be read or is no text."""
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise HaustraError(f"cannot read {path}: {error.strerror}") from error
    encoding = next((name for mark, name in MARKS if data.startswith(mark)), None) or _unmarked(data)
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        raise HaustraError(
            f"{path} is no text in {encoding}: byte {error.start} is none; give a text file, saved as UTF-8"
        ) from error
    if "\0" in text:
        raise HaustraError(
            f"{path} is no text in {encoding}: character {text.index(chr(0))} is zero; give one in UTF-8"
        )
    return text


def _unmarked(data: bytes) -> str:
    """UTF-16 without a mark shows by its zeros: every other byte of Latin letters and digits is one."""
    first, second = data[:256:2].count(0), data[1:256:2].count(0)
    if max(first, second) > 32 * min(first, second) and 4 * max(first, second) > len(data[:256]):
        return "utf-16-be" if first > second else "utf-16-le"
    return "utf-8"


def read_json(path: Path | str) -> dict[str, Any]:
    """The JSON object of a file. HaustraError, one sentence, if it holds none."""
    text = read_text(path)
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:  # also of a number with thousands of digits
        where = f" (line {error.lineno})" if isinstance(error, json.JSONDecodeError) else ""
        raise HaustraError(f"{path} is not whole JSON{where}") from error
    if not isinstance(found, dict):
        raise HaustraError(f"{path} must hold a JSON object with names, not {type(found).__name__}")
    return found


def json_text(value: Any) -> str:
    """`value` as indented JSON, which has no NaN and no infinity: null is in their place."""
    return json.dumps(_finite(value), indent=2, allow_nan=False)  # NumPy's own numbers are refused


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
