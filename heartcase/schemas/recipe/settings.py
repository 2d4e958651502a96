"""The settings of each stage. Defaults suit a 1-2 mm cardiac scan of a child or an adult."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from heartcase.schemas.base import Model, Name, PointMm, PositiveMm, Vector3
from heartcase.schemas.errors import Problem
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.named_materials import (
    DEFAULT_DENSITY_KG_M3,
    DEFAULT_MODULUS_KPA,
    MATERIALS,
    MaterialName,
)

__all__ = [
    "LEAST_MAP_SIZE",
    "Convention",
    "EndMarker",
    "FilterSettings",
    "GridSettings",
    "MapSettings",
    "MaterialSettings",
    "MaterialsSettings",
    "Pin",
    "RegionSettings",
    "SegmentSettings",
    "SeptumThickness",
    "Stroke",
    "SurfaceSettings",
    "ThresholdRange",
    "WallThickness",
    "WallsSettings",
]

Convention = Literal["hvsmr-2.0", "totalsegmentator-heartchambers", "totalsegmentator-total-v2"]
"""Whose values a label volume without names holds; the tables are in :mod:`heartcase.schemas.terms`."""


class RegionSettings(Model):
    """The region of interest: a box along the scan's own axes."""

    center_mm: PointMm
    """Centre of the box, LPS mm."""
    size_mm: Annotated[Vector3, Field(description="Extent along the scan's i, j, k axes, mm.")]
    """Extent along the scan's i, j and k axes, mm."""

    @model_validator(mode="after")
    def _size_is_positive(self) -> RegionSettings:
        if min(self.size_mm) <= 0.0:
            raise ValueError("every size_mm must be above zero")
        return self


class FilterSettings(Model):
    """Edge-preserving smoothing of the scan (thesis 11.1.2)."""

    method: Literal["curvature_diffusion", "gradient_diffusion", "none"] | None = None
    """Anisotropic diffusion by curvature (Whitaker and Xue), which smooths a border along itself and hardly across; by
    gradient (Perona and Malik); or no filter. By curvature for a CT and by gradient for others when left out."""
    iterations: Annotated[int, Field(ge=1, le=200)] = 5
    """Number of diffusion steps."""
    conductance: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    """Edge threshold in units of the scan's root mean square gradient: lower keeps weaker edges. From the scan's own
    noise when left out."""
    time_step: Annotated[float, Field(gt=0.0)] | None = None
    """Diffusion time step; in mm2; the stability limit of the method and the scan's spacing when left out."""


class ThresholdRange(Model):
    """Voxels of one label by intensity, for plastinated specimens (thesis 12.3.2)."""

    label: Name
    """Name of the label."""
    lower: float | None = None
    """Lowest intensity that belongs to it; no lower bound when left out."""
    upper: float | None = None
    """Highest intensity that belongs to it; no upper bound when left out."""

    @model_validator(mode="after")
    def _range_is_not_empty(self) -> ThresholdRange:
        if self.lower is None and self.upper is None:
            raise ValueError("give lower, upper or both")
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise ValueError("lower must be below upper")
        return self


class SegmentSettings(Model):
    """How each voxel gets its label (thesis 11.1.1)."""

    method: Literal["watershed", "threshold", "labels"] = "watershed"
    """Marker-based watershed on the gradient magnitude; intensity ranges; or a finished segmentation as it is."""
    gradient_sigma_mm: Annotated[float, Field(ge=0.0, le=20.0)] = 0.0
    """Watershed: scale of the Gaussian derivative; 0 takes central differences."""
    shape_sigma_mm: Annotated[float, Field(ge=0.0, le=20.0)] | None = None
    """Watershed: blur for the shape, which decides where the gradient is only noise, such as in an open valve; 0 leaves
    the shape out. 3 mm when left out."""
    noise_floor: Annotated[float, Field(ge=0.0, le=20.0)] | None = None
    """Watershed: what gradient and shape come to counts as noise below this, in tenth percentiles of the scan's
    gradient; where all is noise, labels share the blood by the shortest ways from their markers. 0 for no floor. 4 for
    a CT and 6 for others when left out."""
    ranges: tuple[ThresholdRange, ...] = ()
    """Threshold: intensity range of each label; a voxel in two ranges gets the first."""
    automatic: tuple[Literal["background", "lung"], ...] = ()
    """Watershed: background markers that the program sets under all files and strokes: ``background``, what is dark and
    reaches the scan's border, and what is more than 40 mm outside the box around all that is marked as heart; ``lung``,
    every large dark region. Needs some of the heart marked."""
    smallest_piece_ml: Annotated[float, Field(ge=0.0)] = 0.0
    """Pieces of a label that are smaller than this become background; 0 keeps all."""
    file: Annotated[str, Field(min_length=1)] | None = None
    """Labels: path of the finished segmentation, relative to the recipe: a label volume, a DICOM SEG, or a folder of
    closed STL parts."""
    names: dict[str, Name] = {}
    """Labels: segment name or value in the file -> label name; the same name when left out."""
    convention: Convention | None = None
    """Labels: what the values of a file without names stand for (see docs/labels.md)."""
    others: Literal["refuse", "ignore"] = "refuse"
    """Labels: segments, values and parts that are no label: refuse the file, or leave them out."""
    order: tuple[Name, ...] = ()
    """Labels: where segments or parts of the file overlap, label names from the lowest to the topmost. Those that are
    not named lie below, in the file's order, the later one over the earlier."""

    @property
    def finished_file(self) -> str | None:
        """Path of the segmentation that is taken as it is; None where one is made."""
        return self.file if self.method == "labels" else None

    @model_validator(mode="after")
    def _method_has_its_input(self) -> SegmentSettings:
        if self.method == "threshold" and not self.ranges:
            raise ValueError("method 'threshold' needs at least one entry in ranges")
        if self.method == "labels" and self.file is None:
            raise ValueError("method 'labels' needs file")
        return self


class Stroke(Model):
    """A painted marker: a round brush of a radius along a polyline. Or an eraser: it takes markers away."""

    label: Name | None = None
    """Name of the label that it marks; ``background`` marks what is not heart. Left out where it erases."""
    radius_mm: Annotated[float, Field(ge=0.0, le=50.0)] = 1.5
    """Radius of the brush; 0 marks the voxels that the line passes."""
    points_mm: Annotated[tuple[PointMm, ...], Field(min_length=1)]
    """The polyline, LPS mm; a single point is a dab."""
    erase: bool = False
    """Take away what marker files and earlier strokes marked here, instead of marking."""

    @model_validator(mode="after")
    def _marks_or_erases(self) -> Stroke:
        if self.label is None and not self.erase:
            raise ValueError("label is missing: name the label to mark, or set erase = true")
        if self.label is not None and self.erase:
            raise ValueError("a stroke that erases takes any label away: leave label out")
        return self


class EndMarker(Model):
    """Where a vessel is cut off: beyond this disc there is no vessel, no wall is grown over the opening."""

    label: Name
    """Label of the vessel."""
    position_mm: PointMm
    """Centre of the disc, LPS mm."""
    axis: Vector3
    """Direction out of the heart along the vessel; any length."""
    radius_mm: PositiveMm
    """Radius of the disc: more than the vessel's outer radius, less than the way to its next turn."""

    @model_validator(mode="after")
    def _axis_is_a_direction(self) -> EndMarker:
        if not any(self.axis):
            raise ValueError("the axis must not be zero")
        return self


class WallThickness(Model):
    """Thickness of one cavity's wall by a table of places, instead of one ``wall_thickness_mm`` all over."""

    label: Name
    """Name of the cavity; its label must have a ``wall_thickness_mm``, which the table replaces."""
    kind: Literal["centreline", "positions"]
    """``centreline``: the points are a line along the vessel; between two of them the thickness is linear in the way
    along the line, taken at the line's nearest point. ``positions``: the mean of all points weighted by one over the
    fourth power of the distance, so each point speaks for its surroundings."""
    points_mm: Annotated[tuple[PointMm, ...], Field(min_length=1, max_length=1000)]
    """Where the thickness is known, LPS mm; a centreline has at least two points, in order."""
    thickness_mm: Annotated[tuple[Annotated[float, Field(ge=0.0, le=50.0)], ...], Field(min_length=1)]
    """Thickness at each point, mm; where it is 0 there is no wall and the cavity is open."""

    @model_validator(mode="after")
    def _table_is_whole(self) -> WallThickness:
        problems = []
        if len(self.points_mm) != len(self.thickness_mm):
            problems.append(
                f"points_mm has {len(self.points_mm)} points and thickness_mm {len(self.thickness_mm)} numbers: give "
                "one number for each point"
            )
        if self.kind == "centreline" and len(self.points_mm) < 2:
            problems.append("a centreline needs at least two points")
        beside = zip(self.points_mm[:-1], self.points_mm[1:], strict=True)
        if self.kind == "centreline" and any(one == other for one, other in beside):
            problems.append("two points of the centreline in a row are the same: remove one of them")
        if self.kind == "positions" and len(set(self.points_mm)) < len(self.points_mm):
            problems.append("two positions are the same: remove one of them")
        if not any(self.thickness_mm):
            problems.append("all thicknesses are 0: for no wall at all set wall_thickness_mm = 0 in the label")
        if problems:
            raise ValueError("; ".join(problems))
        return self


class SeptumThickness(Model):
    """Thickness of the septum between two cavities, where it is grown."""

    between: tuple[Name, Name]
    """Names of the two cavities."""
    thickness_mm: Annotated[float, Field(gt=0.0, le=15.0)]
    """Thickness, mm: half of it is grown to either side of where their outlines touch."""


class ContactPlace(Model):
    """What a place is where the outlines of two cavities touch: a true opening, or wall."""

    between: tuple[Name, Name]
    """Names of the two cavities."""
    position_mm: PointMm
    """Middle of the place, LPS mm."""
    radius_mm: PositiveMm
    """How far it reaches: what lies within this ball is one or the other."""
    is_open: bool
    """Whether the patient has an opening there: no septum is grown between these two, and other septa stay. Where it is
    false a person looked at it, and takes it for wall: the septum that is grown there is no longer warned of."""


class WallsSettings(Model):
    """Distance fields of the structures, and walls grown outward from the cavities (thesis 11.2.3)."""

    smoothing_mm: Annotated[float, Field(ge=0.0, le=20.0)] | None = None
    """Standard deviation of the blur that takes the voxel steps off a label's border; 0.8 of the mean voxel
    spacing when left out."""
    band_mm: PositiveMm | None = None
    """Distance up to which the fields are exact; the thickest wall and three voxels when left out."""
    find_ends: bool = False
    """Find where vessels end, and cut them open there, beside those of ``ends``; what ``ends = "automatic"`` sets."""
    thickness: tuple[WallThickness, ...] = ()
    """Walls whose thickness varies, one table for each cavity."""
    septa: Literal["grown", "as segmented"] = "grown"
    """``grown``: cavities that a heart does not join get a wall where their outlines touch; ``as segmented``: they are
    open to each other there."""
    connected: tuple[tuple[Name, Name], ...] = ()
    """Pairs of cavities that are open to each other in this heart: no septum is grown between them."""
    septum: tuple[SeptumThickness, ...] = ()
    """Pairs of cavities that are kept apart, with the thickness of what is grown between them; other pairs follow
    from their names, and their thickness from the size of the heart."""
    contact: tuple[ContactPlace, ...] = ()
    """Places where outlines touch, of which a person said what they are: a true opening, or wall."""

    @property
    def septum_pairs(self) -> tuple[tuple[str, tuple[str, str]], ...]:
        """Place in the recipe and the two names of each pair of cavities that is named."""
        named = [(f"walls.connected[{n}]", pair) for n, pair in enumerate(self.connected, start=1)]
        named += [(f"walls.septum[{n}]", one.between) for n, one in enumerate(self.septum, start=1)]
        return (*named, *((f"walls.contact[{n}]", one.between) for n, one in enumerate(self.contact, start=1)))

    def septum_problems(self, table: LabelTable) -> tuple[Problem, ...]:
        """What is wrong between the named pairs and a label table; names that are no label are left out."""
        problems: list[Problem] = []
        seen: dict[frozenset[int], str] = {}
        for place, names in self.septum_pairs:
            labels = [label for name in names if (label := table.find(name)) is not None]
            if len(labels) < 2:
                continue
            pair = frozenset(label.value for label in labels)
            other = [label.name for label in labels if not label.role.is_blood]
            if other:
                problems.append(Problem(place, f"{other[0]!r} is no cavity: name two labels of blood or vessel_lumen"))
            elif len(pair) == 1:
                problems.append(Problem(place, f"{labels[0].name!r} is named twice: name two cavities"))
            elif place.startswith("walls.contact"):
                # two that are kept apart may touch at many places
                continue
            elif pair in seen:
                problems.append(Problem(place, f"these two are named in {seen[pair]} already: remove one of the two"))
            seen.setdefault(pair, place)
        return tuple(problems)

    def thickness_problems(self, table: LabelTable) -> tuple[Problem, ...]:
        """What is wrong between the tables of thickness and a label table; names that are no label are left out."""
        problems: list[Problem] = []
        seen: set[int] = set()
        for number, one in enumerate(self.thickness, start=1):
            label, place = table.find(one.label), f"walls.thickness[{number}]"
            if label is None:
                continue
            if label.wall_thickness_mm == 0.0:
                message = f"{label.name!r} grows no wall: give its label a wall_thickness_mm, or remove this table"
                problems.append(Problem(place, message))
            if label.value in seen:
                problems.append(Problem(place, f"{label.name!r} has a table already: put all its points into one"))
            seen.add(label.value)
        return tuple(problems)

    def thickest_mm(self, table: LabelTable) -> float:
        """Thickness of the thickest wall that a label table and the tables of thickness ask for, mm; 0 for none."""
        thickness = {label.value: label.wall_thickness_mm for label in table}
        for one in self.thickness:
            label = table.find(one.label)
            if label is not None:
                thickness[label.value] = max(one.thickness_mm)
        return max(thickness.values(), default=0.0)


class GridSettings(Model):
    """Down-sampling of the tissue to cells (thesis 11.2.1)."""

    cell_mm: PositiveMm | None = None
    """Edge of a cell. Give this or ``node_count``; 30,000 nodes when both are left out."""
    node_count: Annotated[int, Field(ge=8, le=20_000_000)] | None = None
    """Number of nodes to aim at."""
    coverage_min: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.02
    """Fraction of a cell that must be tissue for the cell to exist."""
    repair: bool = True
    """Repair walls that broke and openings that closed."""

    @model_validator(mode="after")
    def _one_size(self) -> GridSettings:
        if self.cell_mm is not None and self.node_count is not None:
            raise ValueError("give cell_mm or node_count, not both")
        return self


LEAST_MAP_SIZE = 128
"""Edge of the smallest normal map, in texels."""


class SurfaceSettings(Model):
    """Extraction, decimation and normal map of the surface (thesis 11.2.2)."""

    triangle_count: Annotated[int, Field(ge=100, le=5_000_000)] = 80_000
    """Triangles after decimation; the full surface is kept where it has fewer. With error_mm the most there may be."""
    error_mm: Annotated[float, Field(gt=0.0, le=10.0)] | None = None
    """Take as few triangles as keep 99% of the surface within so many mm of its full resolution."""
    level_counts: Annotated[tuple[Annotated[int, Field(ge=100)], ...], Field(max_length=2)] = (20_000, 5_000)
    """Triangles of coarser levels of detail, from fine to coarse, each with a mapping and a normal map of its own, of
    half the size; a level that would not be coarser than the one before it is left out."""
    normal_map_size: Annotated[int, Field(ge=0, le=8192)] = 1024
    """Edge of the normal map in texels; 0 makes neither atlas nor normal map."""
    atlas: Literal["cone", "xatlas"] = "cone"
    """UV charts: cones grown greedily and projected, or xatlas (slower)."""
    baker: Literal["quick", "exact"] = "quick"
    """Normal map from the fields at points about 1.6 voxels apart, or for each texel from the full surface (slower)."""

    @model_validator(mode="after")
    def _map_has_room(self) -> SurfaceSettings:
        if 0 < self.normal_map_size < LEAST_MAP_SIZE:
            raise ValueError(f"normal_map_size must be 0 (no normal map) or at least {LEAST_MAP_SIZE}")
        return self

    @field_validator("level_counts")
    @classmethod
    def _levels_fall(cls, counts: tuple[int, ...]) -> tuple[int, ...]:
        if list(counts) != sorted(set(counts), reverse=True):
            raise ValueError("must fall from one level to the next, such as [20000, 5000]")
        return counts


class MapSettings(Model):
    """How the surface is tied to the grid (thesis 9.3.3)."""

    candidate_count: Annotated[int, Field(ge=1, le=256)] = 24
    """Nearest triangles that are tried for each vertex."""
    normal_penalty: Annotated[float, Field(ge=0.0, le=10.0)] = 0.5
    """Cells of distance that a triangle facing the other way is set back by."""


class MaterialSettings(Model):
    """Elastic constants of one label, or of a role."""

    material: MaterialName | None = None
    """A material by name, instead of numbers: it states those that are left out (docs/physics.md)."""
    youngs_modulus_kpa: Annotated[float, Field(gt=0.0, le=1e6)] = DEFAULT_MODULUS_KPA
    """Young's modulus, kPa."""
    density_kg_m3: Annotated[float, Field(gt=0.0, le=2e4)] = DEFAULT_DENSITY_KG_M3
    """Density, kg/m3."""

    @model_validator(mode="before")
    @classmethod
    def _of_material(cls, data: Any) -> Any:
        name = data.get("material") if isinstance(data, Mapping) else None
        known = MATERIALS.get(name) if isinstance(name, str) else None
        if known is None:
            return data
        # the numbers are there for all who read them, also after the table has changed
        return {"youngs_modulus_kpa": known.youngs_modulus_kpa, "density_kg_m3": known.density_kg_m3, **data}


class MaterialsSettings(MaterialSettings):
    """Elastic constants of the tissue, with exceptions by label name."""

    labels: dict[Name, MaterialSettings] = {}
    """Label name -> constants that differ."""


class Pin(Model):
    """A ball of tissue that is held fixed."""

    position_mm: PointMm
    """Centre, LPS mm."""
    radius_mm: PositiveMm
    """Radius."""


def resolved(settings: Model) -> dict[str, Any]:
    """All settings of a stage with their defaults, ready for JSON."""
    return settings.model_dump(mode="json")
