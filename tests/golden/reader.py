"""A reader of bundles that knows docs/bundle.md and nothing of heartcase, in plain Python, with the slips one can make.

Every ``slip`` is a mistake that a reader of the format could make. The tests show that the golden case finds each one.
"""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path
from typing import Any

__all__ = ["MOTION_SLIPS", "SURFACE_SLIPS", "PlainCase"]

Vector = tuple[float, float, float]

MOTION_SLIPS = (
    "mirror x",
    "mirror the grid",
    "transpose direction",
    "cells as k, j, i",
    "swap i and j",
    "no half cell",
    "no coverage",
    "one material",
    "one density",
    "no diagonals",
    "equal springs",
    "contributions not added",
    "diagonals as long as edges",
    "stiffness in MPa",
    "nothing held",
    "no damping",
    "damping before the kick",
    "no gravity",
    "gravity along grid axes",
    "start half a step later",
    "positions before velocities",
    "neighbours already moved",
)

SURFACE_SLIPS = (
    "no curvature",
    "curvature everywhere",
    "N the other way",
    "B the other way",
    "bases not normalised",
    "offsets as (T, B, N)",
    "triangle nodes turned",
    "curved offset not turned",
    "normals of edges only",
)

_FORMATS = {"int32": "i", "float32": "f", "uint8": "B", "int16": "h"}
_SHARES = {1: 1 / 4, 2: 1 / 2}


def _add(a: Vector, b: Vector, times: float = 1.0) -> Vector:
    return (a[0] + times * b[0], a[1] + times * b[1], a[2] + times * b[2])


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _unit(a: Vector) -> Vector:
    length = math.sqrt(_dot(a, a))
    return (a[0] / length, a[1] / length, a[2] / length) if length > 0 else a


class PlainCase:
    """A case read from its files: manifest, arrays as lists of rows, rest positions in LPS mm."""

    def __init__(self, directory: Path, slip: str = "") -> None:
        self.slip = slip
        self.manifest: dict[str, Any] = json.loads((directory / "case.json").read_text())
        self.arrays: dict[str, dict[str, list[Any]]] = {}
        for entry in self.manifest["files"]:
            content = (directory / entry["name"]).read_bytes()
            self.arrays[entry["role"]] = {one["name"]: _rows(content, one) for one in entry["arrays"]}
        grid = self.arrays["grid"]
        self.cells, self.nodes = grid["cells"], grid["nodes"]
        if slip == "cells as k, j, i":
            self.cells, self.nodes = ([row[::-1] for row in rows] for rows in (self.cells, self.nodes))
        if slip == "swap i and j":
            self.cells, self.nodes = ([(j, i, k) for i, j, k in rows] for rows in (self.cells, self.nodes))
        self.rest = [self.place(node) for node in self.nodes]

    def place(self, node: Any) -> Vector:
        """A node's rest position, LPS mm."""
        geometry = self.manifest["grid_geometry"]
        index = [n - (0.0 if self.slip == "no half cell" else 0.5) for n in node]
        if self.slip == "mirror the grid":
            index[0] = -index[0]
        steps = [s * n for s, n in zip(geometry["spacing_mm"], index, strict=True)]
        rows = geometry["direction"]
        if self.slip == "transpose direction":
            rows = list(zip(*rows, strict=True))
        x, y, z = (o + _dot(row, steps) for o, row in zip(geometry["origin_mm"], rows, strict=True))
        return (-x if self.slip == "mirror x" else x, y, z)

    def springs(self) -> dict[tuple[int, int], float]:
        """Stiffness in N/m of the spring of each pair of node numbers."""
        number = {tuple(node): n for n, node in enumerate(self.nodes)}
        grid, h = self.arrays["grid"], self.manifest["simulation"]["cell_mm"] / 1000
        stiffness: dict[tuple[int, int], float] = {}
        for cell, c, modulus in zip(self.cells, grid["cell_coverage"], grid["cell_stiffness"], strict=True):
            modulus = 30.0 if self.slip == "one material" else modulus
            k = 0.4 * modulus * h * (1e6 if self.slip == "stiffness in MPa" else 1e3)
            k *= 1.0 if self.slip == "no coverage" else c
            for a in range(8):
                for b in range(a + 1, 8):
                    share = _SHARES.get((a ^ b).bit_count())
                    if share is None or (self.slip == "no diagonals" and share == 1 / 2):
                        continue
                    share = 1 / 4 if self.slip == "equal springs" else share
                    pair = tuple(number[tuple(n + (q >> x & 1) for x, n in enumerate(cell))] for q in (a, b))
                    sum_so_far = 0.0 if self.slip == "contributions not added" else stiffness.get(pair, 0.0)
                    stiffness[pair] = sum_so_far + k * share
        return stiffness

    def masses(self) -> list[float]:
        """Mass of each node, kg."""
        number = {tuple(node): n for n, node in enumerate(self.nodes)}
        grid, h = self.arrays["grid"], self.manifest["simulation"]["cell_mm"] / 1000
        mass = [0.0] * len(self.nodes)
        for (i, j, k), c, density in zip(self.cells, grid["cell_coverage"], grid["cell_density"], strict=True):
            for corner in range(8):
                node = number[i + (corner & 1), j + (corner >> 1 & 1), k + (corner >> 2 & 1)]
                density = 1060.0 if self.slip == "one density" else density
                mass[node] += (1.0 if self.slip == "no coverage" else c) * density * h**3 / 8
        return mass

    def after(self, step_count: int, expected: dict[str, Any]) -> list[Vector]:
        """Positions of the nodes after some steps from the golden start, LPS mm."""
        slip, s, c = self.slip, expected["step_s"], expected["damping_per_s"]
        gravity = tuple(expected["gravity_m_s2"])
        if slip == "gravity along grid axes":
            rows = self.manifest["grid_geometry"]["direction"]
            gravity = tuple(_dot(column, gravity) for column in zip(*rows, strict=True))
        gravity = (0.0, 0.0, 0.0) if slip == "no gravity" else gravity
        q = 0.0 if slip == "no damping" else c * s / 2
        u: list[Vector] = [(0.0, 0.0, 0.0)] * len(self.nodes)
        for node, offset in expected["start"]["displacement_mm"]:
            u[node] = tuple(x / 1000 for x in offset)
        v: list[Vector] = [(0.0, 0.0, 0.0)] * len(u)
        held = [0] * len(u) if slip == "nothing held" else self.arrays["grid"]["fixed"]
        springs, mass, rest = self.springs(), self.masses(), self.rest
        straight = {pair: math.dist(rest[pair[0]], rest[pair[1]]) / 1000 for pair in springs}
        if slip == "diagonals as long as edges":
            straight = dict.fromkeys(springs, self.manifest["simulation"]["cell_mm"] / 1000)
        beside: list[list[tuple[int, int]]] = [[] for _ in u]
        for a, b in springs:
            beside[a].append((a, b))
            beside[b].append((a, b))
        at = [_add((x / 1000, y / 1000, z / 1000), d) for (x, y, z), d in zip(rest, u, strict=True)]
        for step in range(step_count):
            kick = s / 2 if slip == "start half a step later" and step == 0 else s
            if slip == "positions before velocities":
                at = [_add(p, w, s) for p, w in zip(at, v, strict=True)]
            force: list[Vector] = [(0.0, 0.0, 0.0)] * len(u)
            if slip != "neighbours already moved":
                for (a, b), stiffness in springs.items():
                    pull = _pull(at[a], at[b], stiffness, straight[a, b])
                    force[a], force[b] = _add(force[a], pull), _add(force[b], pull, -1.0)
            for n in range(len(u)):
                if held[n]:
                    continue
                if slip == "neighbours already moved":
                    for a, b in beside[n]:
                        pull = _pull(at[a], at[b], springs[a, b], straight[a, b])
                        force[n] = _add(force[n], pull, 1.0 if n == a else -1.0)
                acceleration = _add(gravity, force[n], 1 / mass[n])
                if slip == "damping before the kick":
                    v[n] = _add(_add(v[n], v[n], -c * s), acceleration, kick)
                else:
                    x, y, z = _add(_add(v[n], v[n], -q), acceleration, kick)
                    v[n] = (x / (1 + q), y / (1 + q), z / (1 + q))
                if slip == "neighbours already moved":
                    at[n] = _add(at[n], v[n], s)
            if slip not in ("positions before velocities", "neighbours already moved"):
                at = [_add(p, w, s) for p, w in zip(at, v, strict=True)]
        return [(1000 * x, 1000 * y, 1000 * z) for x, y, z in at]

    def surface(self, nodes_mm: list[Vector]) -> tuple[list[Vector], list[Vector]]:
        """Vertices (LPS mm) and normals over nodes at these positions."""
        mapping = self.arrays["mapping"]
        self.beside: list[list[int]] = [[] for _ in self.nodes]
        for a, b in self.springs():
            is_edge = sum(abs(m - n) for m, n in zip(self.nodes[a], self.nodes[b], strict=True)) == 1
            if is_edge or self.slip != "normals of edges only":
                self.beside[a].append(b)
                self.beside[b].append(a)
        names = ("triangle_nodes", "weights", "offset", "normal", "curvature")
        out = [self._vertex(nodes_mm, *row) for row in zip(*(mapping[name] for name in names), strict=True)]
        return [vertex for vertex, _ in out], [normal for _, normal in out]

    def _vertex(self, p: list[Vector], three: Any, w: Any, o: Any, n: Any, curved: int) -> tuple[Vector, Vector]:
        slip = self.slip
        if slip == "triangle nodes turned":
            three = (three[1], three[2], three[0])
        if slip == "offsets as (T, B, N)":
            o, n = (o[0], o[2], o[1]), (n[0], n[2], n[1])
        basis = self._flat(*(p[node] for node in three))
        if (curved and slip != "no curvature") or slip == "curvature everywhere":
            basis = self._curved(p, three, w)
            if slip != "curved offset not turned":
                flat, bent = self._flat(*(self.rest[node] for node in three)), self._curved(self.rest, three, w)
                o, n = (tuple(_dot(row, _mix(flat, one)) for row in bent) for one in (o, n))
        reference: Vector = _mix([p[node] for node in three], w)
        return _add(reference, _mix(basis, o)), _mix(basis, n)

    def _flat(self, p1: Vector, p2: Vector, p3: Vector) -> list[Vector]:
        unit = (lambda a: a) if self.slip == "bases not normalised" else _unit
        T, N = unit(_add(p2, p1, -1.0)), unit(_cross(_add(p2, p1, -1.0), _add(p3, p1, -1.0)))
        N = _mix([N], (-1.0,)) if self.slip == "N the other way" else N
        return [T, N, _cross(T, N) if self.slip == "B the other way" else _cross(N, T)]

    def _curved(self, p: list[Vector], three: Any, w: Any) -> list[Vector]:
        normals = []
        for node in three:
            total: Vector = (0.0, 0.0, 0.0)
            for other in self.beside[node]:
                total = _add(total, _unit(_add(p[node], p[other], -1.0)))
            normals.append(_unit(total))
        N = _unit(_mix(normals, w))
        B = _unit(_cross(N, _unit(_add(p[three[1]], p[three[0]], -1.0))))
        return [_cross(B, N), N, B]


def _pull(a: Vector, b: Vector, stiffness: float, length_m: float) -> Vector:
    d = _add(b, a, -1.0)
    now = math.sqrt(_dot(d, d))
    factor = stiffness * (now - length_m) / now if now > 0 else 0.0
    return (factor * d[0], factor * d[1], factor * d[2])


def _mix(vectors: list[Vector], weights: Any) -> Vector:
    total: Vector = (0.0, 0.0, 0.0)
    for vector, weight in zip(vectors, weights, strict=True):
        total = _add(total, vector, weight)
    return total


def _rows(content: bytes, listed: dict[str, Any]) -> list[Any]:
    """An array by what the manifest says of it: numbers, or tuples along the last axis."""
    count = math.prod(listed["shape"])
    flat = struct.unpack_from(f"<{count}{_FORMATS[listed['dtype']]}", content, listed["offset"])
    width = listed["shape"][-1]
    return list(flat) if len(listed["shape"]) == 1 else [flat[n : n + width] for n in range(0, count, width)]
