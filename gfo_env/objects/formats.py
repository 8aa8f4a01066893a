"""Readers of the formats whose faces may have any number of corners: OBJ, OFF and PLY.

Only geometry is read: where vertices are, and which of them are the corners of a face. Colours,
normals, textures, materials and groups say nothing about a solid.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers.arrays import Array

from .polygons import Polygons, triangulate


def read_polygons(path: Path) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (v, 3) and triangles (m, 3) of a file in one of the formats of `READERS`.

    Vertices that no face has are left out.

    Raises:
        OSError: the file cannot be read.
        ValueError: its content is not what its suffix says.
    """
    vertices, polygons = READERS[path.suffix.lower()](path.read_bytes())
    triangles = triangulate(vertices, polygons)
    used, corners = np.unique(triangles, return_inverse=True)
    return vertices[used], corners.reshape(-1, 3)


def _obj(content: bytes) -> tuple[Array, Polygons]:
    """Wavefront OBJ; corners are numbered from 1, or backwards from the last vertex so far."""
    text = content.decode("utf-8", "replace").replace("\\\r\n", " ").replace("\\\n", " ")
    vertices: list[list[str]] = []
    polygons: list[list[int]] = []
    for line in text.splitlines():
        key, *words = line.split() or [""]
        if key == "v":
            vertices.append(words[:3])
        elif key == "f":
            numbers = [int(word.split("/", 1)[0]) for word in _uncommented(words)]
            if 0 in numbers:
                raise ValueError(f"no vertex has the number 0 of {line.strip()!r}")
            polygons.append([n - 1 if n > 0 else len(vertices) + n for n in numbers])
    return _coordinates(vertices), polygons


def _uncommented(words: list[str]) -> list[str]:
    start = next((k for k, word in enumerate(words) if word.startswith("#")), len(words))
    return words[:start]


def _off(content: bytes) -> tuple[Array, Polygons]:
    """Object File Format, in text, with colours and normals perhaps."""
    lines = [
        words
        for line in content.decode("utf-8", "replace").splitlines()
        if (words := line.split("#", 1)[0].split())
    ]
    kind = re.fullmatch(r"(ST)?C?N?OFF", lines[0][0].upper()) if lines else None
    if kind is None or "BINARY" in lines[0]:
        raise ValueError("it does not begin like a text file of the Object File Format")
    # the counts may stand beside the keyword
    rows = [lines[0][1:], *lines[1:]] if lines[0][1:] else lines[1:]
    if not rows or len(rows[0]) < 2:
        raise ValueError("the numbers of its vertices and faces are missing")
    count, faces = (int(word) for word in rows[0][:2])
    body = rows[1:]
    if min(count, faces) < 0 or len(body) < count + faces:
        raise ValueError(f"it ends before its {count} vertices and {faces} faces do")
    vertices = _coordinates([row[:3] for row in body[:count]])
    polygons = []
    for row in body[count : count + faces]:
        corners = [int(word) for word in row[1 : int(row[0]) + 1]]
        if len(corners) != int(row[0]):
            raise ValueError(f"a face lacks corners: {' '.join(row)!r}")
        polygons.append(corners)
    return vertices, polygons


def _coordinates(words: list[list[str]]) -> Array:
    if any(len(row) != 3 for row in words):
        raise ValueError("a vertex has fewer than three coordinates")
    return np.array(words, dtype=np.float64).reshape(-1, 3)


# -- PLY -------------------------------------------------------------------------------------------

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2"},
    **{"int": "i4", "uint": "u4", "float": "f4", "double": "f8"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2"},
    **{"int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8"},
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class _Property:
    """A column of numbers, or of lists if `length` is the type of their lengths."""

    name: str
    kind: str
    length: str | None = None


@dataclass(frozen=True)
class _Element:
    """What a PLY header says of a kind of rows: "vertex", "face", or others."""

    name: str
    rows: int
    properties: list[_Property] = field(default_factory=list)


def _ply(content: bytes) -> tuple[Array, Polygons]:
    """Polygon File Format, in text or binary."""
    head = re.match(rb"ply\s.*?\bend_header[ \t]*\r?\n", content, re.DOTALL)
    if head is None:
        raise ValueError("it does not begin like a PLY file")
    order, elements = _ply_header(head[0].decode("ascii", "replace"))
    data, at = content[head.end() :], 0
    if not order:  # numbers of one type take the place of words
        data, order = np.array(data.split(), dtype=np.float64).tobytes(), "="
        elements = [replace(e, properties=[_as_double(p) for p in e.properties]) for e in elements]
    columns: dict[str, dict[str, Any]] = {}
    for element in elements:
        columns[element.name], at = _rows(data, at, element, order)
    try:
        vertices = np.stack([np.asarray(columns["vertex"][axis]) for axis in "xyz"], axis=1)
    except KeyError as error:
        raise ValueError("its vertices have no x, y and z") from error
    faces = columns.get("face", {})
    polygons = next((faces[n] for n in ("vertex_indices", "vertex_index") if n in faces), ())
    return vertices.astype(np.float64), polygons


def _ply_header(text: str) -> tuple[str, list[_Element]]:
    """The byte order, "" for text, and what follows."""
    order: str | None = None
    elements: list[_Element] = []
    for line in text.splitlines():
        match line.split():
            case ["format", name, *_] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, rows] if rows.isdecimal():
                elements.append(_Element(name, int(rows)))
            case ["property", "list", length, kind, name] if elements and {length, kind} <= {
                *_TYPES
            }:
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind]))
            case ["format" | "element" | "property", *_]:
                raise ValueError(f"a line of its header makes no sense: {line!r}")
    if order is None:
        raise ValueError("its header names no format")
    return order, elements


def _as_double(column: _Property) -> _Property:
    return _Property(column.name, "f8", None if column.length is None else "f8")


def _rows(data: bytes, at: int, element: _Element, order: str) -> tuple[dict[str, Any], int]:
    """The columns of an element whose first row begins at byte `at`, and where its last one ends.

    Raises:
        ValueError: the data end before that.
    """
    least = sum(np.dtype(p.length or p.kind).itemsize for p in element.properties)
    if element.rows * least > len(data) - at:
        raise ValueError(f"it ends before its {element.rows} rows of {element.name!r} do")
    if element.rows == 0 or least == 0:
        return {}, at

    def take(kind: str, count: int) -> NDArray[Any]:
        nonlocal at
        if not 0 <= count <= len(data):
            raise ValueError(f"a list of {element.name!r} has {count} entries")
        numbers = np.frombuffer(data, order + kind, count, at)
        at += numbers.nbytes
        return numbers

    def row() -> list[Any]:
        return [
            take(p.kind, 1)[0] if p.length is None else take(p.kind, int(take(p.length, 1)[0]))
            for p in element.properties
        ]

    start, first = at, row()
    # rows whose lists are as long as those of the first are a table
    layout: list[Any] = []
    for number, (column, value) in enumerate(zip(element.properties, first, strict=True)):
        if column.length is None:
            layout.append((f"{number}", order + column.kind))
        else:
            layout += [(f"{number} length", order + column.length)]
            layout += [(f"{number}", order + column.kind, (len(value),))]
    table_type = np.dtype(layout)
    if element.rows * table_type.itemsize <= len(data) - start:
        table = np.frombuffer(data, table_type, element.rows, start)
        lists = [n for n, column in enumerate(element.properties) if column.length is not None]
        if all((table[f"{n} length"] == len(first[n])).all() for n in lists):
            found = {p.name: table[f"{n}"] for n, p in enumerate(element.properties)}
            return found, start + table.nbytes
    rows = [first, *(row() for _ in range(element.rows - 1))]
    return {p.name: [r[n] for r in rows] for n, p in enumerate(element.properties)}, at


READERS: dict[str, Callable[[bytes], tuple[Array, Polygons]]] = {
    ".obj": _obj,
    ".off": _off,
    ".ply": _ply,
}
"""What each suffix is read by: from the content of a file to vertices and polygons."""
