"""A camera file as text and, where it is JSON, YAML or OpenCV's storage, as names and values."""

import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import yaml

from haustra.core.errors import HaustraError
from haustra.core.text import read_text

LARGEST = 64 << 20  # bytes; transforms.json of a long film has some megabytes
OPENCV_MARKS = ("%YAML", "<?xml", "<opencv_storage")  # its YAML begins with %YAML:1.0, of OpenCV 5 with %YAML 1.2
NUMBERS = re.compile(r"(f|c|fl_)[xy]|[kp]\d|(image_?)?(width|height)|[wh]", re.IGNORECASE)  # names that hold one
MATRIX = {"rows", "cols", "dt", "data"}


@dataclass(frozen=True)
class CameraDocument:
    """text: empty for a binary file. fields: empty where the text is no mapping of names to values."""

    path: Path
    text: str = ""
    fields: dict[str, Any] = field(default_factory=dict)


def open_document(path: Path) -> CameraDocument:
    """The file's contents. HaustraError, one sentence, where it cannot be read."""
    if path.is_file() and path.stat().st_size > LARGEST:
        raise HaustraError(f"{path} is no camera file: it has {path.stat().st_size >> 20} MB")
    if path.suffix.lower() == ".mat":
        raise HaustraError(
            f"{path} holds MATLAB objects, which only MATLAB can read: save jsonencode(toStruct(params)) as a .json"
        )
    if path.suffix.lower() == ".bin":
        return CameraDocument(path)
    text = read_text(path)
    if text.lstrip().startswith(OPENCV_MARKS):
        return CameraDocument(path, text, _opencv_fields(path, text))
    return CameraDocument(path, text, _fields(path, text))


def _fields(path: Path, text: str) -> dict[str, Any]:
    if path.suffix.lower() == ".json" or text.lstrip().startswith("{"):
        try:
            found = json.loads(text)
        except (ValueError, RecursionError) as error:
            where = f" (line {error.lineno})" if isinstance(error, json.JSONDecodeError) else ""
            raise HaustraError(f"{path} is not whole JSON{where}") from error
        if not isinstance(found, dict):
            raise HaustraError(f"{path} must hold a JSON object with names, not {type(found).__name__}")
        return _without_truth(path, found)
    try:
        found = next(yaml.safe_load_all(text), None)  # ROS ends each message that it prints with ---
    except (yaml.YAMLError, RecursionError, ValueError):
        _refuse_tabs(path, text)
        return {}
    return _without_truth(path, found) if isinstance(found, dict) else {}


def _refuse_tabs(path: Path, text: str) -> None:
    """HaustraError for a YAML file that cannot be read and has a line that begins with a tab."""
    tabbed = (number for number, line in enumerate(text.splitlines(), 1) if line.lstrip(" ").startswith("\t"))
    if path.suffix.lower() in (".yaml", ".yml") and (line := next(tabbed, None)) is not None:
        raise HaustraError(f"{path} begins line {line} with a tab, where YAML has spaces alone")


def _without_truth(path: Path, fields: dict[str, Any]) -> dict[str, Any]:
    """The same. HaustraError for true and false in the place of a number, which Python would read as 1 and 0."""

    seen = set[int]()  # an alias within itself has no end

    def look(value: Any, name: str) -> None:
        if id(value) in seen or name == "flags":  # which terms a program had free
            return
        seen.add(id(value))
        parts = value.items() if isinstance(value, dict) else [(name, one) for one in value]
        among_numbers = isinstance(value, list) and any(type(one) in (int, float) for one in value)
        for inner, one in parts:
            if isinstance(one, bool) and (among_numbers or NUMBERS.fullmatch(str(inner).split(".")[-1])):
                raise HaustraError(f"{path} has {str(one).lower()} in {inner}, where a number belongs")
            if isinstance(one, dict | list):
                look(one, str(inner))

    look(fields, "")
    return fields


def _opencv_fields(path: Path, text: str) -> dict[str, Any]:
    """Of OpenCV's own YAML and XML, whose tags no other library knows; nothing where it is other XML."""
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        return {name: _value(root.getNode(name)) for name in root.keys()}  # noqa: SIM118 - a FileNode is no dict
    except (cv2.error, SystemError, UnicodeDecodeError):
        _refuse_tabs(path, text)
        return {}
    except ValueError as error:
        raise HaustraError(f"{path} has {error}") from error


def _value(node: cv2.FileNode) -> Any:
    if node.isMap():
        names = set(node.keys())
        if names >= MATRIX:
            _check_matrix(node)
            return node.mat()
        return {name: _value(node.getNode(name)) for name in names}
    if node.isSeq():
        return [_value(node.at(k)) for k in range(node.size())]
    if node.isString():
        return node.string()
    return node.real()


def _check_matrix(node: cv2.FileNode) -> None:
    """ValueError where a matrix has not as many numbers as its sides say: OpenCV would write past its memory."""
    rows, columns = (node.getNode(name).real() for name in ("rows", "cols"))
    channels = re.match(r"\d*", node.getNode("dt").string())
    numbers = node.getNode("data").size()
    if not 0 < rows * columns * int((channels and channels[0]) or 1) == numbers or rows < 0:
        raise ValueError(f"a matrix of {rows:g}x{columns:g} with {numbers} numbers")
