"""Text and JSON that a user wrote, in what editors save: UTF-8 with or without a mark, UTF-16 with one."""

import codecs
import json
from pathlib import Path
from typing import Any

from haustra.core.errors import HaustraError

MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


def read_text(path: Path | str) -> str:
    """A file's text. HaustraError, one sentence, if it cannot be read or is no text."""
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise HaustraError(f"cannot read {path}: {error.strerror}") from error
    encoding = next((name for mark, name in MARKS if data.startswith(mark)), "utf-8")
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        raise HaustraError(f"{path} is no text in {encoding}: byte {error.start} is none; save it as UTF-8") from error


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
