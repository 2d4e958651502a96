"""Opening a case bundle: checked, memory-mapped, only the parts that are asked for.

Nothing in a bundle is executed, no path in it is followed out of its directory, and a header is bounded before it is
parsed. :func:`open_bundle` reads the manifest and the headers; :meth:`OpenBundle.arrays` checks the values of what it
returns; :mod:`heartcase.schemas.bundle.check` checks everything, hashes included.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from heartcase.schemas.bundle.coordinates import Coordinates
from heartcase.schemas.bundle.format import ARRAYS, LEVEL_MAX, LEVELS, CaseManifest, FileRole
from heartcase.schemas.bundle.manifest import KNOWN_EXTENSIONS, MANIFEST_SIZE_MAX, read_manifest, stated
from heartcase.schemas.bundle.safetensors_layout import Layout, count_problems, listing_problems, map_array, read_layout
from heartcase.schemas.errors import BundleError, Problem, UsageError

__all__ = [
    "KNOWN_EXTENSIONS",
    "MANIFEST_SIZE_MAX",
    "OpenBundle",
    "inspect_files",
    "open_bundle",
    "read_manifest",
    "stated_problems",
]

_INDEX_ARRAYS: dict[tuple[FileRole, str], str] = {
    (FileRole.SURFACE, "triangles"): "vertex_count",
    (FileRole.SURFACE, "render_to_welded"): "vertex_count",
    (FileRole.MAPPING, "triangle_nodes"): "node_count",
    (FileRole.MAPPING, "nearest_node"): "node_count",
    (FileRole.PICKING, "nodes"): "node_count",
    (FileRole.PICKING, "triangles"): "picking_vertex_count",
}
_INDEX_ARRAYS |= {
    (role, name): count if count == "node_count" else f"{count}_{level}"
    for role, (finest, level) in LEVELS.items()
    for (one, name), count in _INDEX_ARRAYS.items()
    if one is finest
}
_LABEL_ARRAYS = {"cell_label", "triangle_label", "triangle_tissue", "vertex_label"}
_LARGEST = {"cell_coverage": 1.0, "cell_stiffness": 1e6, "cell_density": 2e4}
_MOMENTS_MAX = 0.5
_MOMENTS_TOLERANCE = 1e-6
"""Variances come from two float32 numbers of at most 1/4 each."""
_FLAG_ARRAYS = {"fixed", "curvature", "triangle_is_cut"}


@dataclass(frozen=True)
class OpenBundle:
    """A case that was opened: its manifest, and its arrays when asked for."""

    directory: Path
    """The bundle's directory."""
    manifest: CaseManifest
    """What the case says of itself."""
    headers: dict[FileRole, Layout]
    """Layout of each safetensors file."""
    counts: dict[str, int]
    """Sizes by name: ``node_count``, ``vertex_count`` and so on, as far as the parts are there."""
    misfits: frozenset[str] = field(default_factory=frozenset)
    """Arrays, as ``role.name``, of other sizes; only :func:`inspect_files` returns cases that have any."""

    def path(self, role: FileRole) -> Path:
        """Path of the file with this role.

        Raises
        ------
        BundleError
            The case was made without it, or the format has no such part.
        """
        role = _known(role)
        entry = self.manifest.file(role)
        if entry is None:
            raise BundleError(
                f"the case has no part '{role.value}': add it to 'parts' of the recipe and build again", place="case"
            )
        return self.directory / entry.name

    def has(self, role: FileRole) -> bool:
        """Whether the case was made with this part.

        Raises
        ------
        BundleError
            The format has no such part.
        """
        return self.manifest.file(_known(role)) is not None

    @property
    def levels(self) -> tuple[int, ...]:
        """Levels of detail of the surface that the case has, 0 being the finest; none where it has no surface."""
        return tuple(level for level in range(LEVEL_MAX + 1) if self.has(FileRole.SURFACE.at(level)))

    def surface_role(self, level: int, *, place: str = "level") -> FileRole:
        """The part that holds a level of detail of the surface.

        Parameters
        ----------
        level
            Level of detail; 0 is the finest.
        place
            What an error names.

        Raises
        ------
        UsageError
            The case does not have that level.
        """
        if level not in self.levels:
            there = ", ".join(map(str, self.levels)) or "no surface at all"
            raise UsageError(f"the case has no level of detail {level}; it has {there}", place=place)
        return FileRole.SURFACE.at(level)

    def arrays(self, role: FileRole, names: Sequence[str] | None = None) -> dict[str, npt.NDArray[Any]]:
        """Map the arrays of a part into memory, read-only, and check their values.

        Parameters
        ----------
        role
            A part stored as safetensors; see :data:`heartcase.schemas.bundle.format.ARRAYS` for its arrays.
        names
            Which arrays; all when left out.

        Raises
        ------
        BundleError
            The part or an array is absent, or values are out of range or not finite; all problems at once.
        UsageError
            The names are a text instead of a list of them.
        """
        if isinstance(names, str):
            # A text is a sequence too: of its letters.
            raise UsageError(f"is a list of names: write [{names!r}]", place="names")
        role = _known(role)
        # A case of an older version lacks what came later.
        there = self._layout_of(role).arrays
        wanted = [spec.name for spec in ARRAYS[role] if spec.name in there] if names is None else list(names)
        self._refuse_unknown(role, wanted)
        loaded = {name: self.inspect_array(role, name) for name in wanted}
        problems = [problem for _, found in loaded.values() for problem in found]
        if problems:
            raise BundleError(problems)
        return {name: array for name, (array, _) in loaded.items()}

    def inspect_array(self, role: FileRole, name: str) -> tuple[npt.NDArray[Any], list[Problem]]:
        """Map one array into memory, read-only, and say what is wrong with its values.

        Parameters
        ----------
        role
            A part stored as safetensors.
        name
            One of its arrays.

        Raises
        ------
        BundleError
            The part or the array is absent.
        """
        role = _known(role)
        self._refuse_unknown(role, [name])
        array = map_array(self.path(role), *self._layout_of(role).arrays[name])
        return array, list(self._value_problems(role, {name: array}))

    def _layout_of(self, role: FileRole) -> Layout:
        """Where the arrays of a part lie, or BundleError."""
        path = self.path(role)
        if role not in self.headers:
            raise BundleError(f"the part '{role.value}' holds no arrays: read its file, {path.name}", place="role")
        return self.headers[role]

    def _refuse_unknown(self, role: FileRole, names: Iterable[str]) -> None:
        """BundleError with each name that the part has no array of."""
        there = self._layout_of(role).arrays
        if unknown := [name for name in names if name not in there]:
            raise BundleError(
                f"the part '{role.value}' of this case has no array {', '.join(map(repr, unknown))}; "
                f"it has {', '.join(there)}",
                place="names",
            )

    def _value_problems(self, role: FileRole, loaded: dict[str, npt.NDArray[Any]]) -> Iterable[Problem]:
        known = np.zeros(256, dtype=bool)
        labels = stated(self.manifest, "labels.labels") or ()
        values = [label.value for label in labels if hasattr(label, "value")]
        # Label 0 is always there; where one has lost its value to damage, no value can be called unknown.
        known[[0, *values] if labels and len(values) == len(labels) else slice(None)] = True
        for name, array in loaded.items():
            place = f"{role.value}.{name}"
            if array.size == 0:
                continue
            limit_name = _INDEX_ARRAYS.get((role, name))
            if limit_name is not None and limit_name in self.counts:
                limit = self.counts[limit_name]
                low, high = int(array.min()), int(array.max())
                if low < 0 or high >= limit:
                    yield Problem(place, f"numbers from {low} to {high}, but only 0 to {limit - 1} exist")
            elif array.dtype.kind == "f":
                if not np.isfinite(array).all():
                    yield Problem(place, "holds values that are not finite numbers")
            elif name in _LABEL_ARRAYS:
                if not known[array].all():
                    yield Problem(place, "holds label values that the label table does not have")
            elif name in _FLAG_ARRAYS and int(array.max()) > 1:
                yield Problem(place, "must be 0 or 1")
            if name in _LARGEST:
                if not (array > 0).all():
                    yield Problem(place, "must be above zero everywhere")
                if (array > _LARGEST[name]).any():
                    yield Problem(place, f"must not be above {_LARGEST[name]:g}")
            if name == "cell_moments":
                if (np.abs(array) > _MOMENTS_MAX).any():
                    yield Problem(place, f"must be from -{_MOMENTS_MAX:g} to {_MOMENTS_MAX:g}: tissue lies in its cell")
                if (array[:, 3:6] < array[:, :3].astype(np.float64) ** 2 - _MOMENTS_TOLERANCE).any():
                    yield Problem(place, "has means of squares below the squares of the means")


def _known(role: FileRole | str) -> FileRole:
    """The part of a name, or BundleError."""
    try:
        return FileRole(role)
    except ValueError:
        raise BundleError(f"there is no part {role!r}; there are {', '.join(FileRole)}", place="role") from None


def open_bundle(path: Path | str) -> OpenBundle:
    """Open a case: manifest, file sizes and array layouts are checked; no array is read.

    Raises
    ------
    BundleError
        With every problem that was found.
    """
    directory = Path(path)
    bundle, problems = inspect_files(directory, read_manifest(directory))
    problems += stated_problems(bundle)
    if problems:
        raise BundleError(problems)
    return bundle


def why_no_file(file: Path) -> str | None:
    """Why a file of a case cannot be taken as it is there; None where it can."""
    if file.is_symlink():
        return f"the file {file.name} is a link: put the file itself in its place, or build the case again"
    return None if file.is_file() else f"the file {file.name} is missing: build the case again"


def inspect_files(directory: Path, manifest: CaseManifest) -> tuple[OpenBundle, list[Problem]]:
    """Look at the files that a manifest, perhaps a salvaged one, lists: sizes and array layouts.

    Returns
    -------
    OpenBundle, list of Problem
        The case with the arrays whose layout is sound, and what is wrong with the others or between them.
    """
    problems: list[Problem] = []
    headers: dict[FileRole, Layout] = {}
    counts: dict[str, int] = {}
    roles: set[FileRole] = set()
    names: set[str] = set()
    misfits: set[str] = set()
    for entry in manifest.files:
        place = f"files.{entry.role.value}"
        file = directory / entry.name
        if entry.role in roles or entry.name in names:
            problems.append(Problem(place, "is listed twice"))
            continue
        roles.add(entry.role)
        names.add(entry.name)
        if (reason := why_no_file(file)) is not None:
            problems.append(Problem(place, reason))
            continue
        if (size := file.stat().st_size) != entry.size:
            problems.append(
                Problem(place, f"has {size} bytes instead of {entry.size}: copy the case again, or build it anew")
            )
        if entry.role in ARRAYS:
            headers[entry.role], found = read_layout(file, entry.role, stated(manifest, "format_version"))
            # what is missing of a file that was cut off follows from that
            problems += found if size >= entry.size else []
            found = count_problems(entry.role, headers[entry.role], counts)
            misfits |= {problem.place for problem in found}
            problems += found
            problems += listing_problems(entry, headers[entry.role], stated(manifest, "format_version"))
    if FileRole.GRID not in roles:
        problems.append(Problem("files", "the case has no grid"))
    return OpenBundle(directory, manifest, headers, counts, frozenset(misfits)), problems


def stated_problems(bundle: OpenBundle) -> Iterable[Problem]:
    """What the manifest states must fit the files and the format; of a salvaged one, what is sound of it."""
    manifest = bundle.manifest
    for name in ("node_count", "cell_count"):
        number = stated(manifest, f"simulation.{name}")
        if number is not None and bundle.counts.get(name, number) != number:
            yield Problem(f"simulation.{name}", f"says {number}, but the grid has {bundle.counts[name]}")
    yield from _coordinate_problems(manifest)
    if "intensity" in bundle.headers.get(FileRole.SCAN, Layout()).arrays:
        yield from _scan_problems(manifest, bundle.headers[FileRole.SCAN])


def _coordinate_problems(manifest: CaseManifest) -> Iterable[Problem]:
    """The axes are part of the format: a case that states others would be shown turned or mirrored."""
    ours = {frame.name: frame for frame in Coordinates().frames}
    if stated(manifest, "coordinates.axes") not in (None, Coordinates().axes):
        yield Problem("coordinates.axes", "are not left, back, head: world space is patient LPS")
    for number, frame in enumerate(stated(manifest, "coordinates.frames") or (), start=1):
        said = frame.__dict__
        if (fixed := ours.get(said.get("name", ""))) and any(said[key] != getattr(fixed, key) for key in said):
            yield Problem(f"coordinates.frames[{number}]", f"are not the axes that the format fixes for {fixed.name}")
    if stated(manifest, "gltf_from_lps") not in (None, ours["gltf"].from_lps_mm):
        yield Problem("gltf_from_lps", "is not the matrix that the format fixes: the case would be turned or mirrored")


def _scan_problems(manifest: CaseManifest, layout: Layout) -> Iterable[Problem]:
    shape, size = layout.arrays["intensity"][1], stated(manifest, "scan_geometry.size")
    if size is not None and shape != tuple(reversed(size)):
        yield Problem("scan.intensity", f"has shape {list(shape)}, not {list(reversed(size))}")
    if "scan_values" in manifest.__dict__ and manifest.scan_values is None:
        yield Problem("scan_values", "are missing: the numbers of the scan part stand for nothing without them")
