"""The closed surfaces of a case that can be printed: the tissue as it is, the blood as a cast, vessels on the heart.

What printers call a *hollow* model is the tissue: walls around open chambers. A *solid* model is the blood in the
chambers and vessels, filled, as if it had been cast and the heart taken off. The *vessels* are those that the case
knows as lines with a radius, such as coronary arteries: too thin for the grid, and surfaces of their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import ValidationError

from heartcase.pipeline.data import Segmentation, Structures
from heartcase.pipeline.exports.tubes import VESSEL_COLOUR, vessel_tubes
from heartcase.pipeline.fields.distance import label_distances
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.pipeline.walls.grow_walls import resolve_walls
from heartcase.schemas.arrays import Float32, Int32, UInt8
from heartcase.schemas.bundle.format import FileRole
from heartcase.schemas.bundle.reader import OpenBundle
from heartcase.schemas.bundle.surface_kinds import plain_kinds
from heartcase.schemas.errors import StageError, UsageError
from heartcase.schemas.labels import BACKGROUND, Label, LabelTable, Role
from heartcase.schemas.recipe.settings import SurfaceSettings, WallsSettings

__all__ = ["TaggedMesh", "hollow_model", "solid_model", "vessels_model", "walls_smoothing_mm"]


_VESSEL_COUNT_MAX = 250
"""Values of labels end here."""
_CAST_ROLE = {
    Role.BACKGROUND: Role.BACKGROUND,
    Role.BLOOD: Role.MYOCARDIUM,
    Role.VESSEL_LUMEN: Role.MYOCARDIUM,
}


@dataclass(frozen=True)
class TaggedMesh:
    """A closed triangle mesh that says of each triangle which structures it lies between."""

    vertices_mm: Float32
    """Patient LPS, mm, shape (vertex_count, 3)."""
    normals: Float32
    """Unit normals out of the model, shape (vertex_count, 3)."""
    triangles: Int32
    """Vertex numbers, counter-clockwise from outside the model, shape (triangle_count, 3)."""
    triangle_label: UInt8
    """Label of the cavity on one side, 0 where there is none: in front of a hollow model's triangle, behind a solid
    one's. Shape (triangle_count,)."""
    triangle_tissue: UInt8
    """Label of the tissue on the other side, 0 where it is not known, shape (triangle_count,)."""
    triangle_is_cut: UInt8
    """1 where the region of interest or a vessel's end cuts the model, shape (triangle_count,)."""
    table: LabelTable
    """What the labels stand for."""
    triangle_kind: UInt8 | None = None
    """:class:`~heartcase.schemas.bundle.surface_kinds.SurfaceKind` of each triangle of a hollow model."""
    warnings: tuple[str, ...] = ()
    """What the model lacks, in plain words."""

    @property
    def structure(self) -> UInt8:
        """Label that each triangle is named and coloured by, shape (triangle_count,): its cavity, or else its tissue.

        So the inside of a chamber looks the same in a hollow and in a solid model.
        """
        return np.where(self.triangle_label != BACKGROUND, self.triangle_label, self.triangle_tissue).astype(np.uint8)

    @property
    def structures(self) -> tuple[Label, ...]:
        """The labels that name at least one triangle, by ascending value."""
        return tuple(self.table[int(value)] for value in np.unique(self.structure))

    @property
    def colours(self) -> UInt8:
        """Red, green, blue of each triangle, shape (triangle_count, 3)."""
        palette = np.zeros((256, 3), np.uint8)
        for label in self.table:
            palette[label.value] = [int(label.colour[at : at + 2], 16) for at in (1, 3, 5)]
        coloured: UInt8 = palette[self.structure]
        return coloured


def hollow_model(bundle: OpenBundle, *, level: int = 0) -> TaggedMesh:
    """The surface of a case: its tissue, with open chambers; ``level`` is the level of detail, 0 the finest.

    Raises
    ------
    BundleError
        The case was made without a surface, or it is damaged.
    """
    surface = bundle.arrays(FileRole.SURFACE.at(level))
    void, tissue, is_cut = (np.array(surface[f"triangle_{name}"]) for name in ("label", "tissue", "is_cut"))
    kinds = surface.get("triangle_kind")
    return TaggedMesh(
        vertices_mm=np.array(surface["vertices"]),
        normals=np.array(surface["normals"]),
        triangles=np.array(surface["triangles"]),
        triangle_label=void,
        triangle_tissue=tissue,
        triangle_is_cut=is_cut,
        table=bundle.manifest.labels,
        triangle_kind=plain_kinds(void, tissue, is_cut, bundle.manifest.labels) if kinds is None else np.array(kinds),
    )


def solid_model(labels: Segmentation, *, smoothing_mm: float | None = None) -> TaggedMesh:
    """The blood of a segmentation as a cast: the fields and the extraction are those of the tissue's own surface.

    Parameters
    ----------
    labels
        Labels of a case, grown walls included.
    smoothing_mm
        Standard deviation of the blur, as in the settings of the walls; their default when left out.

    Returns
    -------
    TaggedMesh
        Closed; as many triangles as a surface has by default, at most. Where a chamber meets its grown wall,
        ``triangle_tissue`` is 0.

    Raises
    ------
    StageError
        There is no blood, or the smoothing leaves none.
    """
    table = _cast_table(labels.table)
    # The cavities' faces were found before any wall grew (walls stage): seen so, they are the same faces here.
    bare = np.where(np.isin(labels.labels, table.values), labels.labels, BACKGROUND).astype(np.uint8)
    blood = labels.table.blood_values
    if not np.isin(bare, blood).any():
        raise StageError("the case's labels hold no blood, so there is nothing to cast", place="labels")
    geometry = labels.geometry
    settings = resolve_walls(WallsSettings(smoothing_mm=smoothing_mm), geometry, table)
    distances = label_distances(
        bare,
        geometry.spacing_mm,
        smoothing_mm=settings.smoothing_mm,
        band_mm=settings.band_mm,
        blood_values=blood,
        tissue_values=labels.table.tissue_values,
    )
    if not any(value in distances for value in blood):
        raise StageError("all blood is too small for the smoothing of the outlines, so nothing is cast", place="labels")
    if BACKGROUND not in distances:
        far = float(np.linalg.norm(np.array(geometry.spacing_mm) * geometry.size))
        distances[BACKGROUND] = np.full(geometry.shape, far, np.float32)
    structures = Structures(dict(sorted(distances.items())), geometry, table, settings.band_mm, has_voxel_steps=True)
    surface = build_surface(structures, SurfaceSettings(normal_map_size=0, level_counts=()), render=False)
    return TaggedMesh(
        vertices_mm=surface.vertices_mm,
        normals=surface.normals,
        triangles=surface.triangles,
        triangle_label=surface.triangle_tissue,
        triangle_tissue=surface.triangle_label,
        triangle_is_cut=surface.triangle_is_cut,
        table=labels.table,
        warnings=tuple(
            f"the cast lacks the {labels.table[int(value)].name}, which is too small for it"
            for value in np.setdiff1d(np.intersect1d(bare, blood), surface.triangle_tissue)
        ),
    )


def vessels_model(bundle: OpenBundle) -> TaggedMesh:
    """The vessels that a case knows as lines with a radius, each closed, with a label of its own from 1 up.

    Raises
    ------
    UsageError
        It knows none, or more than labels can tell apart.
    """
    tubes = vessel_tubes(bundle.manifest.landmarks)
    if not tubes:
        raise UsageError(
            "the case has no vessels of their own: give the recipe landmarks of kind 'polyline' with a radius_mm",
            place="--model",
        )
    if len(tubes) > _VESSEL_COUNT_MAX:
        raise UsageError(
            f"the case has {len(tubes)} vessels of their own, and a file tells {_VESSEL_COUNT_MAX} apart: take some "
            "out of the recipe's landmarks",
            place="--model",
        )
    labels = [Label(value=BACKGROUND, name="background", role=Role.BACKGROUND)]
    vertices, normals, triangles, tissue = [], [], [], []
    first = 0
    for value, (name, tube) in enumerate(tubes.items(), start=1):
        labels.append(Label(value=value, name=name, role=Role.WALL, colour=VESSEL_COLOUR))
        vertices.append(tube.vertices_mm)
        normals.append(tube.normals)
        triangles.append(tube.triangles + np.int32(first))
        tissue.append(np.full(len(tube.triangles), value, np.uint8))
        first += len(tube.vertices_mm)
    tags = np.concatenate(tissue)
    return TaggedMesh(
        vertices_mm=np.concatenate(vertices),
        normals=np.concatenate(normals),
        triangles=np.concatenate(triangles),
        triangle_label=np.zeros_like(tags),
        triangle_tissue=tags,
        triangle_is_cut=np.zeros_like(tags),
        table=LabelTable(labels=tuple(labels)),
    )


def walls_smoothing_mm(bundle: OpenBundle) -> float | None:
    """Smoothing that the case's walls were made with, mm; None where the case states none that can be."""
    for record in bundle.manifest.stages:
        if record.stage == "walls":
            try:
                return WallsSettings(smoothing_mm=record.settings.get("smoothing_mm")).smoothing_mm
            except ValidationError:
                return None
    return None


def _cast_table(table: LabelTable) -> LabelTable:
    """A table in which the blood is tissue, so that it is what gets a surface; grown walls and septa are left out."""
    return LabelTable(
        labels=tuple(
            label.model_copy(update={"role": _CAST_ROLE.get(label.role, Role.BLOOD), "wall_thickness_mm": 0.0})
            for label in table
            if label.wall_of is None and label.septum_of is None
        )
    )
