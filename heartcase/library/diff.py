"""What changed between two builds of a library, as numbers, and which of it is more than was allowed."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from heartcase.schemas.arrays import Float64, Int32
from heartcase.schemas.bundle.format import CaseManifest, FileRole
from heartcase.schemas.errors import BundleError, MissingPathError, UsageError
from heartcase.schemas.files import is_there, sha256_of_file

if TYPE_CHECKING:
    from heartcase.schemas.bundle.reader import OpenBundle

__all__ = ["CaseChange", "Tolerances", "diff_libraries", "mesh_of", "surface_change", "warning_changes"]

Mesh = tuple[Float64, Int32]
_MANIFEST = "case.json"


@dataclass(frozen=True)
class Tolerances:
    """What a rebuild may change without being looked at."""

    surface_mm: float = 0.5
    """Hausdorff distance of the surfaces, mm."""
    volume_percent: float = 1.0
    """Volume of any structure, and of the tissue, %."""
    node_percent: float = 2.0
    """Number of nodes, %."""


@dataclass(frozen=True)
class CaseChange:
    """What became of one case."""

    name: str
    """Name of the case."""
    kind: str
    """``same`` (to the byte), ``changed``, ``added``, ``removed`` or ``unreadable``."""
    beyond: tuple[str, ...] = ()
    """What is more than was allowed, in words."""
    surface_mean_mm: float | None = None
    """Mean distance of the surfaces, from either to the other, mm."""
    surface_most_mm: float | None = None
    """Hausdorff distance of the surfaces: the largest from a vertex of either to the other, mm."""
    volume_percent: float | None = None
    """Largest change of a structure's volume, or of the tissue's, %."""
    volume_of: str | None = None
    """Which structure that is."""
    node_count: tuple[int, int] | None = None
    """Nodes before and after."""
    stages: tuple[str, ...] = ()
    """Stages of which version or settings differ."""
    new_warnings: tuple[str, ...] = ()
    """Warnings that there were not."""
    changed_warnings: tuple[str, ...] = ()
    """Warnings, as they are now, that there were with other numbers: a size, a count or a place in mm."""

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return asdict(self)


def diff_libraries(old: Path | str, new: Path | str, tolerances: Tolerances | None = None) -> tuple[CaseChange, ...]:
    """Compare the cases of two output folders, by name.

    Parameters
    ----------
    old, new
        Folders of two library builds.
    tolerances
        What may change without a word; the defaults when left out.

    Raises
    ------
    UsageError
        One of them is no folder, or neither holds a case.
    """
    old, new = Path(old), Path(new)
    for folder, place in ((old, "OLD"), (new, "NEW")):
        if not (is_there(folder) and folder.is_dir()):
            raise MissingPathError("there is no such folder: give the OUT of a library build", place=place)
    names = sorted({path.name.removesuffix(".case") for folder in (old, new) for path in folder.glob("*.case")})
    if not names:
        raise UsageError("there is no case in either folder: give the OUT of two library builds", place="OLD, NEW")
    return tuple(
        _change(name, old / f"{name}.case", new / f"{name}.case", tolerances or Tolerances()) for name in names
    )


def surface_change(one: Mesh, other: Mesh) -> tuple[float, float]:
    """Mean and largest distance from the vertices of either mesh to the other [mm]; meshes are (vertices, triangles).

    The largest is the Hausdorff distance but for what lies inside triangles.
    """
    from heartcase.pipeline.mesh.triangles.mesh_distance import mesh_distance_mm
    from heartcase.pipeline.mesh.triangles.triangle_grid import triangle_grid

    there = mesh_distance_mm(np.asarray(one[0], np.float64), triangle_grid(*other))
    back = mesh_distance_mm(np.asarray(other[0], np.float64), triangle_grid(*one))
    return 0.5 * float(there.mean() + back.mean()), float(max(there.max(), back.max()))


def _change(name: str, old: Path, new: Path, allowed: Tolerances) -> CaseChange:
    from heartcase.schemas.bundle.reader import open_bundle

    if not new.exists():
        return CaseChange(name, "removed", ("the case is gone",))
    if not old.exists():
        return CaseChange(name, "added")
    try:
        before, after = open_bundle(old), open_bundle(new)
        # A manifest states the hash of every other file.
        if sha256_of_file(old / _MANIFEST) == sha256_of_file(new / _MANIFEST):
            return CaseChange(name, "same")
        return _compared(name, before, after, allowed)
    except BundleError as error:
        return CaseChange(name, "unreadable", tuple(str(problem) for problem in error.problems))


def _compared(name: str, old: OpenBundle, new: OpenBundle, allowed: Tolerances) -> CaseChange:
    beyond = []
    mean, most = None, None
    surfaces = [mesh_of(bundle) for bundle in (old, new)]
    if surfaces[0] is not None and surfaces[1] is not None:
        mean, most = surface_change(surfaces[0], surfaces[1])
        if most > allowed.surface_mm:
            beyond.append(f"the surface moved by up to {most:.2f} mm")
    elif surfaces[0] is not None:
        beyond.append("the surface is gone")
    volume, of = _largest_volume_change(old.manifest, new.manifest)
    if volume > allowed.volume_percent:
        beyond.append(f"the volume of {of} changed by {volume:.1f}%")
    nodes = (old.manifest.simulation.node_count, new.manifest.simulation.node_count)
    if 100.0 * abs(nodes[1] - nodes[0]) > allowed.node_percent * nodes[0]:
        beyond.append(f"{nodes[1]:,} nodes instead of {nodes[0]:,}")
    warnings, renumbered = warning_changes(old.manifest.warnings, new.manifest.warnings)
    if warnings:
        beyond.append(f"{len(warnings)} new warning{'s' * (len(warnings) > 1)}")
    return CaseChange(
        name,
        "changed",
        tuple(beyond),
        surface_mean_mm=mean,
        surface_most_mm=most,
        volume_percent=volume,
        volume_of=of,
        node_count=nodes,
        stages=_differing_stages(old.manifest, new.manifest),
        new_warnings=warnings,
        changed_warnings=renumbered,
    )


def warning_changes(old: Sequence[str], new: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Warnings that are new, and those of which only numbers changed, each sorted.

    A warning has numbers that move with any rebuild. One of ``new`` is the same as one of ``old`` where they differ in
    nothing else; each of ``old`` stands for one of ``new`` only, so a second place of the same kind is new.
    """
    left = Counter(_without_numbers(text) for text in set(old) - set(new))
    appeared: list[str] = []
    renumbered: list[str] = []
    for text in sorted(set(new) - set(old)):
        shape = _without_numbers(text)
        (renumbered if left[shape] else appeared).append(text)
        left[shape] -= 1
    return tuple(appeared), tuple(renumbered)


def _without_numbers(text: str) -> str:
    return re.sub(r"(?<!\w)-?\d+(?:[.,]\d+)*", "#", text)


def mesh_of(bundle: OpenBundle) -> Mesh | None:
    """Vertices [mm] and triangles of a case's surface; None where it has none."""
    if bundle.manifest.file(FileRole.SURFACE) is None:
        return None
    arrays = bundle.arrays(FileRole.SURFACE, ["vertices", "triangles"])
    return arrays["vertices"].astype(np.float64), np.ascontiguousarray(arrays["triangles"], np.int32)


def _largest_volume_change(old: CaseManifest, new: CaseManifest) -> tuple[float, str]:
    """In %, and of which structure; one that is gone or new counts as 100."""
    before, after = (
        {"the tissue": one.simulation.tissue_volume_ml, **one.quality.get("volumes_ml", {})} for one in (old, new)
    )
    changes = {
        name: 100.0 * abs(after.get(name, 0.0) - before.get(name, 0.0)) / (before.get(name) or after.get(name) or 1.0)
        for name in (*before, *(name for name in after if name not in before))
    }
    of = max(changes, key=lambda name: changes[name])
    return float(changes[of]), of


def _differing_stages(old: CaseManifest, new: CaseManifest) -> tuple[str, ...]:
    before, after = ({one.stage: (one.version, one.settings) for one in manifest.stages} for manifest in (old, new))
    return tuple(stage for stage in {**before, **after} if before.get(stage) != after.get(stage))
