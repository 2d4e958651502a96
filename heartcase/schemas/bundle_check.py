"""Checking a case bundle to the last byte: what ``heartcase validate`` does."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError, safe_open

from heartcase.schemas.bundle import MANIFEST_NAME, CaseManifest, FileRole
from heartcase.schemas.bundle_reader import inspect_files, read_manifest, salvaged_manifest, stated_problems
from heartcase.schemas.errors import BundleError, Problem
from heartcase.schemas.files import sha256_of_file
from heartcase.schemas.lattice import cell_nodes, lattice_keys

__all__ = ["check_bundle"]

Arrays = dict[str, npt.NDArray[Any]]

REST_TOLERANCE_MM = 1e-2
"""How far the mapping may put a vertex from where the surface has it, at rest."""

_CHECKED_ANYWAY = ("fixed", "cell_label")
"""Arrays that no wrong value in them can upset the checks against others."""

_MAGIC = {FileRole.RENDER: b"glTF", FileRole.LABELS: b"NRRD"}


def check_bundle(path: Path | str) -> tuple[Problem, ...]:
    """Check everything about a case, hashes and values included; returns every problem, none when it is sound.

    Whatever is wrong, the rest is still checked as far as it can be: a manifest with wrong keys by those that are
    right, a part with a wrong array by the others.
    """
    directory = Path(path)
    problems: list[Problem] = []
    manifest: CaseManifest | None
    try:
        manifest = read_manifest(directory)
    except BundleError as error:
        problems += error.problems
        manifest = salvaged_manifest(directory)
    if manifest is None:
        return (*problems, *_raw_problems(directory))
    bundle, found = inspect_files(directory, manifest)
    if problems:
        found = [problem for problem in found if problem.place != "files"]
        problems += _unlisted_problems(directory, manifest)
    else:
        problems += stated_problems(bundle)
    problems += [*found, *_hash_problems(directory, manifest), *_manifest_problems(manifest)]
    loaded: dict[FileRole, Arrays] = {}
    for role, header in bundle.headers.items():
        loaded[role] = {}
        for name in header.arrays:
            array, found = bundle.inspect_array(role, name)
            problems += found
            if not found or name in _CHECKED_ANYWAY:
                loaded[role][name] = array
        problems += _safetensors_problems(bundle.path(role), role)
    for role, magic in _MAGIC.items():
        if bundle.has(role) and bundle.path(role).is_file():
            problems += _container_problems(bundle.path(role), role, magic)
    if bundle.is_consistent:
        for check in (_cell_problems, _fixed_problems, _rest_problems, _winding_problems):
            problems += check(manifest, loaded)
    return tuple(dict.fromkeys(problems))


def _manifest_problems(manifest: CaseManifest) -> Iterable[Problem]:
    geometry, figures = getattr(manifest, "grid_geometry", None), getattr(manifest, "simulation", None)
    if geometry is not None and not geometry.is_right_handed:
        yield Problem("grid_geometry.direction", "must be right-handed")
    if geometry is not None and figures is not None:
        spacing = np.array(geometry.spacing_mm)
        if np.ptp(spacing) > 1e-6 * spacing[0] or abs(spacing[0] - figures.cell_mm) > 1e-6 * spacing[0]:
            yield Problem("grid_geometry.spacing_mm", "must be the cell's edge, simulation.cell_mm, along every axis")
    if figures is not None and figures.step_default_s > figures.step_limit_s:
        yield Problem("simulation.step_default_s", "is beyond simulation.step_limit_s")
    for landmark in manifest.landmarks:
        if np.abs(landmark.points_mm).max() > 1e5:
            yield Problem(f"landmarks.{landmark.name}", "lies more than 100 m away")


def _cell_problems(manifest: CaseManifest, loaded: Mapping[FileRole, Arrays]) -> Iterable[Problem]:
    grid = loaded.get(FileRole.GRID, {})
    if "cells" in grid:
        cells = grid["cells"]
        if (np.diff(lattice_keys(cells)) <= 0).any():
            yield Problem("grid.cells", "must ascend by k, j, i without repeats")
        if "nodes" in grid and not np.array_equal(cell_nodes(cells)[0], grid["nodes"]):
            yield Problem("grid.nodes", "are not the corners of the cells, in order")
        geometry = getattr(manifest, "grid_geometry", None)
        if len(cells) and ((cells < 0).any() or (geometry is not None and (cells >= np.array(geometry.size)).any())):
            yield Problem("grid.cells", "lie outside grid_geometry.size")
    materials = getattr(manifest, "materials", None)
    if "cell_label" in grid and materials is not None:
        known = {material.label for material in materials}
        missing = sorted(set(np.unique(grid["cell_label"]).tolist()) - known)
        if missing:
            yield Problem("materials", f"the labels {missing} of the grid have none")


def _fixed_problems(manifest: CaseManifest, loaded: Mapping[FileRole, Arrays]) -> Iterable[Problem]:
    fixed = loaded.get(FileRole.GRID, {}).get("fixed")
    if fixed is None:
        return
    count, figures = int(np.count_nonzero(fixed)), getattr(manifest, "simulation", None)
    if figures is not None and count != figures.fixed_node_count:
        yield Problem("simulation.fixed_node_count", f"says {figures.fixed_node_count}, but {count} nodes are held")
    if fixed.all():
        yield Problem("grid.fixed", "every node is held: nothing can move")


def _winding_problems(manifest: CaseManifest, loaded: Mapping[FileRole, Arrays]) -> Iterable[Problem]:
    """A closed surface whose triangles face outwards encloses a positive volume; mirrored, a negative one."""
    surface = loaded.get(FileRole.SURFACE, {})
    if not {"vertices", "triangles"} <= set(surface) or not len(surface["triangles"]):
        return
    points = surface["vertices"].astype(float)
    corners = (points - points[0])[surface["triangles"]]
    if np.einsum("tx,tx->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) <= 0.0:
        yield Problem("surface.triangles", "are turned inside out: the case would be shown mirrored or hollow")


def _rest_problems(manifest: CaseManifest, loaded: Mapping[FileRole, Arrays]) -> Iterable[Problem]:
    """The mapping must give back the surface at rest (thesis 9.3.3, equations 9.4 to 9.7)."""
    mapping, surface = loaded.get(FileRole.MAPPING, {}), loaded.get(FileRole.SURFACE, {})
    nodes, geometry = loaded.get(FileRole.GRID, {}).get("nodes"), getattr(manifest, "grid_geometry", None)
    if not len(mapping.get("weights", ())):
        return
    weight_gap = float(np.abs(mapping["weights"].sum(axis=1, dtype=np.float64) - 1.0).max())
    if weight_gap > 1e-4:
        yield Problem("mapping.weights", f"must sum to one; they miss it by up to {weight_gap:.2g}")
    if (
        nodes is None
        or geometry is None
        or not {"triangle_nodes", "offset"} <= set(mapping)
        or "vertices" not in surface
    ):
        return
    positions = geometry.index_to_world(nodes - 0.5)[mapping["triangle_nodes"]]
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
    gap = float(np.abs(rest - surface["vertices"]).max())
    if gap > REST_TOLERANCE_MM:
        yield Problem("mapping", f"puts vertices up to {gap:.3g} mm from where the surface has them")


def _safetensors_problems(file: Path, role: FileRole) -> Iterable[Problem]:
    """What a strict reader of the format refuses though ours can read it: holes, overlaps, unknown types."""
    try:
        with safe_open(file, framework="numpy"):
            pass
    except SafetensorError:
        yield Problem(f"files.{role.value}", "is not valid safetensors: other programs will refuse it")


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


def _unlisted_problems(directory: Path, manifest: CaseManifest) -> Iterable[Problem]:
    """Files of entries that are themselves wrong, as far as their names say anything."""
    known = {entry.name for entry in manifest.files}
    yield from (problem for name, problem in _raw_files(directory) if name not in known)


def _raw_problems(directory: Path) -> Iterable[Problem]:
    """What can still be said of the files when nothing of the manifest can be used."""
    yield from (problem for _, problem in _raw_files(directory))


def _raw_files(directory: Path) -> Iterable[tuple[str, Problem]]:
    try:
        entries = json.loads((directory / MANIFEST_NAME).read_bytes())["files"]
        listed = [(str(one["name"]), str(one["role"]), str(one["sha256"])) for one in entries]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return
    for name, role, sha256 in listed:
        if not re.fullmatch(r"[a-z0-9][a-z0-9_.-]{0,127}", name):
            continue
        if not (directory / name).is_file():
            yield name, Problem(f"files.{role[:32]}", f"the file {name} is missing: build the case again")
        else:
            yield from ((name, problem) for problem in _one_hash(directory / name, role[:32], sha256))
