"""Hearts drawn at random: chambers, vessels, thin walls, muscle and defects, made into fields as a build does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from heartcase.pipeline.data import Segmentation, Structures
from heartcase.pipeline.edits.apply_edits import apply_edits
from heartcase.pipeline.fields.reader import ownership_on_lattice
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.schemas.arrays import Bool, Float64
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.edit_settings import SeptalDefect
from heartcase.schemas.recipe.settings import GridSettings, MapSettings, Pin, SurfaceSettings, WallsSettings

MUSCLE = 20
REACH_MM = 30.0
"""Half the edge of the scan, about."""


@dataclass(frozen=True)
class RandomHeart:
    """A heart and how it is simulated."""

    structures: Structures
    cell_mm: float
    triangle_count: int
    defects: int
    """Defects that join two chambers."""
    words: str
    """Geometry in words, for whoever looks into a failure."""

    @property
    def pins(self) -> list[Pin]:
        """Holds a bit of tissue where it is thickest, and no more, so that there is something left to move."""
        geometry = self.structures.geometry
        depth = ownership_on_lattice(self.structures, geometry).tissue_mm
        k, j, i = np.unravel_index(int(depth.argmin()), depth.shape)
        centre = geometry.index_to_world(np.array([i, j, k], float))
        return [Pin(position_mm=tuple(float(x) for x in centre), radius_mm=self.cell_mm)]

    @property
    def grid_settings(self) -> GridSettings:
        """Cells of the drawn size."""
        return GridSettings(cell_mm=self.cell_mm)

    @property
    def surface_settings(self) -> SurfaceSettings:
        """As many triangles as were drawn."""
        return SurfaceSettings(triangle_count=self.triangle_count)

    @property
    def map_settings(self) -> MapSettings:
        """The usual ones."""
        return MapSettings()


def random_heart(seed: int) -> RandomHeart:
    """Draw a heart; the same for the same seed.

    Two to four chambers of lumpy ellipsoids with one to four millimetres between them, one of them in thick muscle; one
    to three vessels that leave a chamber for the border of the scan or end on the way; walls of 0.6 to 2.5 mm; up to
    two round defects through the walls between chambers. Voxels of 0.8 to 1.7 mm along each axis on a turned lattice,
    right- or left-handed; cells of 1.5 to 4 mean voxels; 1,500 to 8,000 triangles.
    """
    random = np.random.default_rng(seed)
    geometry = _lattice(random)
    k, j, i = np.indices(geometry.shape)
    points = geometry.index_to_world(np.stack((i, j, k), axis=-1))
    chambers = _chambers(random, points)
    count = len(chambers)
    labels = np.zeros(geometry.shape, np.uint8)
    table = []
    muscle = (chambers[0][1] < random.uniform(2.5, 6.0)) & np.logical_and.reduce(
        [field > random.uniform(0.5, 2.0) for _, field in chambers[1:]]
    )
    labels[muscle] = MUSCLE
    for n, (_, field) in enumerate(chambers):
        labels[field < 0.0] = n + 1
        wall_mm = 0.0 if n == 0 else float(random.uniform(0.8, 2.5))
        table.append(Label(value=n + 1, name=f"chamber {n + 1}", role=Role.BLOOD, wall_thickness_mm=wall_mm))
    vessels = int(random.integers(1, 4))
    for n in range(vessels):
        value = 10 + n
        of = int(random.integers(count))
        tube = _vessel(random, points, chambers[of][0], chambers)
        if ((labels == 0) & tube).sum() < 30:
            continue
        labels[((labels == 0) | (labels == MUSCLE)) & tube] = value
        wall_mm = float(random.uniform(0.6, 1.5))
        table.append(Label(value=value, name=f"vessel {n}", role=Role.VESSEL_LUMEN, wall_thickness_mm=wall_mm))
    table.append(Label(value=MUSCLE, name="muscle", role=Role.MYOCARDIUM))
    segmentation = Segmentation(labels, geometry, LabelTable(labels=tuple(table)))
    structures = grow_walls(segmentation, WallsSettings(), ())
    mean_mm = float(np.prod(geometry.spacing_mm) ** (1 / 3))
    cell_mm = mean_mm * float(random.uniform(1.5, 4.0))
    defects = 0
    for _ in range(int(random.integers(0, 3))):
        one, other = random.choice(count, 2, replace=False)
        structures, is_made = _pierced(random, structures, chambers[one][0], chambers[other][0], cell_mm)
        defects += is_made
    triangle_count = int(random.integers(1500, 8001))
    words = (
        f"seed {seed}: {count} chambers, {vessels} vessels, {defects} defects, lattice {geometry.size} of "
        f"{np.round(geometry.spacing_mm, 2).tolist()} mm, cells of {cell_mm:.2f} mm, {triangle_count} triangles"
    )
    return RandomHeart(structures, cell_mm, triangle_count, defects, words)


def _lattice(random: np.random.Generator) -> Geometry:
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
    spacing = random.uniform(0.8, 1.7, 3)
    size = np.ceil(2.0 * REACH_MM / spacing).astype(int)
    size = np.minimum(size, 64)
    centre = random.uniform(-50.0, 50.0, 3)
    origin = centre - axes @ (spacing * (size - 1) / 2.0)
    return Geometry.of(shape=tuple(int(n) for n in size[::-1]), origin_mm=origin, spacing_mm=spacing, direction=axes)


def _lumpy(random: np.random.Generator, points: Float64, centre: Float64, radii: Float64) -> Float64:
    """An ellipsoid with waves on it: negative inside, about a distance in mm near its border."""
    axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
    at = (points - centre) @ axes
    scaled = np.linalg.norm(at / radii, axis=-1)
    waves = sum(
        random.uniform(0.0, 0.07) * np.sin(at @ random.normal(0.0, 0.28, 3) + random.uniform(0.0, 6.3))
        for _ in range(3)
    )
    return (scaled - 1.0 + waves) * float(radii.min())


def _chambers(random: np.random.Generator, points: Float64) -> list[tuple[Float64, Float64]]:
    """Centre and field of each; each keeps its gap from those before it."""
    middle = points.reshape(-1, 3).mean(axis=0)
    found: list[tuple[Float64, Float64]] = []
    first = random.normal(size=3)
    first /= np.linalg.norm(first)
    for n in range(int(random.integers(2, 5))):
        way = first if n == 0 else random.normal(size=3)
        way = way / np.linalg.norm(way)
        centre = middle + way * random.uniform(5.0, 12.0)
        field = _lumpy(random, points, centre, random.uniform(6.0, 12.0, 3))
        for _, other in found:
            field = np.maximum(field, random.uniform(1.0, 4.0) - other)
        if (field < 0.0).sum() > 200:
            inside = points[field < 0.0]
            found.append((inside[np.linalg.norm(inside - inside.mean(axis=0), axis=1).argmin()], field))
    if len(found) < 2:
        return _chambers(random, points)
    return found


def _vessel(
    random: np.random.Generator, points: Float64, start: Float64, chambers: list[tuple[Float64, Float64]]
) -> Bool:
    """A bent tube from a chamber outward, away from the others by a gap."""
    middle = points.reshape(-1, 3).mean(axis=0)
    way = start - middle + random.normal(0.0, 6.0, 3)
    way /= np.linalg.norm(way)
    bend = np.cross(way, random.normal(size=3))
    bend /= np.linalg.norm(bend)
    length, sag = random.uniform(15.0, 60.0), random.uniform(0.0, 8.0)
    along = np.linspace(0.0, 1.0, 60)
    line = start + along[:, None] * length * way + (np.sin(np.pi * along) * sag)[:, None] * bend
    radius = random.uniform(1.6, 4.0)
    nearest = np.full(points.shape[:-1], np.inf)
    for at in line:
        np.minimum(nearest, np.linalg.norm(points - at, axis=-1), out=nearest)
    own = min(range(len(chambers)), key=lambda n: float(np.linalg.norm(chambers[n][0] - start)))
    clear = np.logical_and.reduce([field > 1.0 for n, (_, field) in enumerate(chambers) if n != own])
    tube: Bool = (nearest < radius) & clear
    return tube


def _pierced(
    random: np.random.Generator, structures: Structures, one: Float64, other: Float64, cell_mm: float
) -> tuple[Structures, bool]:
    """A hole of one to two and a half cells between two chambers, where the edit says that it joins them."""
    middle = one + random.uniform(0.3, 0.7) * (other - one) + random.normal(0.0, 1.0, 3)
    edit = SeptalDefect(
        kind="septal_defect",
        position_mm=tuple(float(x) for x in middle),
        diameter_mm=float(random.uniform(1.0, 2.5) * cell_mm),
        axis=tuple(float(x) for x in other - one),
        length_mm=float(random.uniform(0.6, 1.2) * np.linalg.norm(other - one)),
    )
    try:
        return apply_edits(structures, (edit,)), True
    except StageError:
        return structures, False
