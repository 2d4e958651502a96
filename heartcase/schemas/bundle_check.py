"""Checking a case bundle to the last byte: what ``heartcase validate`` does."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.bundle import MANIFEST_NAME, CaseManifest, FileRole
from heartcase.schemas.bundle_reader import OpenBundle, open_bundle, read_manifest
from heartcase.schemas.errors import BundleError, Problem
from heartcase.schemas.files import sha256_of_file
from heartcase.schemas.lattice import cell_nodes, lattice_keys

__all__ = ["check_bundle"]

REST_TOLERANCE_MM = 1e-2
"""How far the mapping may put a vertex from where the surface has it, at rest."""

_MAGIC = {FileRole.RENDER: b"glTF", FileRole.LABELS: b"NRRD"}


def check_bundle(path: Path | str) -> tuple[Problem, ...]:
    """Check everything about a case, hashes and values included; returns every problem, none when it is sound."""
    directory = Path(path)
    problems: list[Problem] = []
    try:
        bundle = open_bundle(directory)
    except BundleError as error:
        problems += error.problems
        try:
            problems += _hash_problems(directory, read_manifest(directory))
        except BundleError:
            problems += _raw_problems(directory)
        return tuple(dict.fromkeys(problems))
    problems += _hash_problems(directory, bundle.manifest)
    problems += _manifest_problems(bundle.manifest)
    loaded: dict[FileRole, dict[str, npt.NDArray[Any]]] = {}
    for role in bundle.headers:
        try:
            loaded[role] = bundle.arrays(role)
        except BundleError as error:
            problems += error.problems
    for role, magic in _MAGIC.items():
        if bundle.has(role):
            problems += _container_problems(bundle.path(role), role, magic)
    if FileRole.GRID in loaded:
        problems += _grid_problems(bundle, loaded[FileRole.GRID])
        if FileRole.SURFACE in loaded and FileRole.MAPPING in loaded:
            problems += _rest_problems(bundle, loaded)
    return tuple(dict.fromkeys(problems))


def _manifest_problems(manifest: CaseManifest) -> Iterable[Problem]:
    geometry = manifest.grid_geometry
    spacing = np.array(geometry.spacing_mm)
    if not geometry.is_right_handed:
        yield Problem("grid_geometry.direction", "must be right-handed")
    if np.ptp(spacing) > 1e-6 * spacing[0] or abs(spacing[0] - manifest.simulation.cell_mm) > 1e-6 * spacing[0]:
        yield Problem("grid_geometry.spacing_mm", "must be the cell's edge, simulation.cell_mm, along every axis")
    if manifest.simulation.step_default_s > manifest.simulation.step_limit_s:
        yield Problem("simulation.step_default_s", "is beyond simulation.step_limit_s")
    for landmark in manifest.landmarks:
        if np.abs(landmark.points_mm).max() > 1e5:
            yield Problem(f"landmarks.{landmark.name}", "lies more than 100 m away")


def _grid_problems(bundle: OpenBundle, grid: dict[str, npt.NDArray[Any]]) -> Iterable[Problem]:
    if (np.diff(lattice_keys(grid["cells"])) <= 0).any():
        yield Problem("grid.cells", "must ascend by k, j, i without repeats")
    if not np.array_equal(cell_nodes(grid["cells"])[0], grid["nodes"]):
        yield Problem("grid.nodes", "are not the corners of the cells, in order")
    size = np.array(bundle.manifest.grid_geometry.size)
    if len(grid["cells"]) and ((grid["cells"] < 0).any() or (grid["cells"] >= size).any()):
        yield Problem("grid.cells", "lie outside grid_geometry.size")
    known = {material.label for material in bundle.manifest.materials}
    missing = sorted(set(np.unique(grid["cell_label"]).tolist()) - known)
    if missing:
        yield Problem("materials", f"the labels {missing} of the grid have none")
    if grid["fixed"].all():
        yield Problem("grid.fixed", "every node is held: nothing can move")


def _rest_problems(bundle: OpenBundle, loaded: dict[FileRole, dict[str, npt.NDArray[Any]]]) -> Iterable[Problem]:
    """The mapping must give back the surface at rest (thesis 9.3.3, equations 9.4 to 9.7)."""
    mapping, nodes = loaded[FileRole.MAPPING], loaded[FileRole.GRID]["nodes"]
    if not len(mapping["weights"]):
        return
    weight_gap = float(np.abs(mapping["weights"].sum(axis=1, dtype=np.float64) - 1.0).max())
    if weight_gap > 1e-4:
        yield Problem("mapping.weights", f"must sum to one; they miss it by up to {weight_gap:.2g}")
    positions = bundle.manifest.grid_geometry.index_to_world(nodes - 0.5)[mapping["triangle_nodes"]]
    first, second = positions[:, 1] - positions[:, 0], positions[:, 2] - positions[:, 0]
    normal = np.cross(first, second)
    lengths = np.linalg.norm(normal, axis=1)
    if not (lengths > 0.0).all():
        yield Problem("mapping.triangle_nodes", "some are three nodes on one line")
        return
    T, N = first / np.linalg.norm(first, axis=1, keepdims=True), normal / lengths[:, None]
    basis = np.stack([T, N, np.cross(N, T)], axis=1)
    rest = np.einsum("vi,vix->vx", mapping["weights"].astype(float), positions)
    rest += np.einsum("vb,vbx->vx", mapping["offset"].astype(float), basis)
    gap = float(np.abs(rest - loaded[FileRole.SURFACE]["vertices"]).max())
    if gap > REST_TOLERANCE_MM:
        yield Problem("mapping", f"puts vertices up to {gap:.3g} mm from where the surface has them")


def _container_problems(file: Path, role: FileRole, magic: bytes) -> Iterable[Problem]:
    with file.open("rb") as stream:
        head = stream.read(12)
    if not head.startswith(magic):
        yield Problem(f"files.{role.value}", "is not the kind of file that its name says")
    elif role is FileRole.RENDER and int.from_bytes(head[8:12], "little") != file.stat().st_size:
        yield Problem(f"files.{role.value}", "is cut off: its header states another length")


def _hash_problems(directory: Path, manifest: CaseManifest) -> Iterable[Problem]:
    for entry in manifest.files:
        yield from _one_hash(directory / entry.name, entry.role.value, entry.sha256)


def _one_hash(file: Path, role: str, sha256: str) -> Iterable[Problem]:
    if file.is_file() and not file.is_symlink() and sha256_of_file(file) != sha256:
        yield Problem(f"files.{role}", f"the content of {file.name} was changed: build the case again")


def _raw_problems(directory: Path) -> Iterable[Problem]:
    """What can still be said of the files when the manifest itself is wrong."""
    try:
        entries = json.loads((directory / MANIFEST_NAME).read_bytes())["files"]
        listed = [(str(one["name"]), str(one["role"]), str(one["sha256"])) for one in entries]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return
    for name, role, sha256 in listed:
        if not re.fullmatch(r"[a-z0-9][a-z0-9_.-]{0,127}", name):
            continue
        if not (directory / name).is_file():
            yield Problem(f"files.{role[:32]}", f"the file {name} is missing: build the case again")
        else:
            yield from _one_hash(directory / name, role[:32], sha256)
