"""Edits in a build: each kind reaches grid and surface, and only what depends on an edit is computed again."""

import numpy as np
import pytest

from heartcase.pipeline.building.run import build_case
from heartcase.pipeline.cells.build_grid import build_grid
from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.edits.apply_edits import apply_edits
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.pipeline.walls.grow_walls import grow_walls
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.recipe import load_recipe
from tests.ball import write_ball_recipe, write_ball_scan
from tests.pipeline.lattices import points_of

pytestmark = pytest.mark.usefixtures("plain_reports")

BRUSH = "radius_mm = 9\npoints_mm = [[17, 0, 0]]"
EDITS = {
    "add": 'label = "muscle"\nradius_mm = 5\npoints_mm = [[22, 0, 0]]',
    "smooth": f'label = "cavity"\nsigma_mm = 4\n{BRUSH}',
    "fill": f'label = "muscle"\ngap_mm = 14\n{BRUSH}',
    "keep_largest": 'label = "muscle"',
    "remove_islands": "smallest_ml = 1.0",
}
EARLIER, LATER = {"filter", "segment", "walls"}, {"grid", "surface", "map"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A built ball, with its cache."""
    folder = tmp_path_factory.mktemp("ball")
    write_ball_scan(folder / "ball.nii.gz")
    write_ball_recipe(folder / "ball.nii.gz", folder / "plain.toml", cell_mm=5.0)
    build(folder, "")
    return folder


def build(folder, more):
    path = folder / "edited.toml"
    path.write_text((folder / "plain.toml").read_text() + more)
    return build_case(load_recipe(path), directory=folder, out=folder / "out", replace=True)


def line(kind, more=""):
    return f'[[edits]]\nkind = "{kind}"\n{EDITS[kind]}\n{more}\n'


def test_only_what_depends_on_an_edit_is_done_again_and_taking_it_out_undoes_it(folder):
    plain = build(folder, "")
    assert set(plain.reused) >= EARLIER | LATER
    lump = build(folder, line("add"))
    assert set(lump.reused) >= EARLIER
    assert not {"edit", "grid", "surface", "map"} & set(lump.reused)
    # Cap of a ball of 5 mm whose middle is 2 mm outside a ball of 20 mm: what sticks out of it.
    gained = lump.manifest.simulation.tissue_volume_ml - plain.manifest.simulation.tissue_volume_ml
    z = np.linspace(-5.0, 5.0, 20001)
    own = np.pi * np.maximum(25.0 - z**2, 0.0)
    covered = np.minimum(own, np.pi * np.maximum(400.0 - (22.0 + z) ** 2, 0.0))
    assert gained == pytest.approx(float(np.trapezoid(own - covered, z)) / 1000.0, rel=0.08)
    # What an edit is called, and one that is switched off, redo nothing; the report tells both.
    off = line("smooth", 'name = "too much"\nenabled = false')
    named = build(folder, line("add", 'name = "a lump"') + off)
    assert set(named.reused) >= EARLIER | LATER | {"edit"}
    page = named.report.read_text()
    assert "a lump: added to muscle" in page
    assert "too much: smoothed cavity" in page
    assert "switched off: not carried out" in page
    undone = build(folder, off)
    assert set(undone.reused) >= EARLIER | LATER
    assert "edit" not in undone.seconds
    assert undone.manifest.files == plain.manifest.files


def test_every_kind_reaches_grid_and_surface(folder):
    recipe = load_recipe(folder / "plain.toml")
    structures = grow_walls(segmented(), recipe.walls, ())
    volumes = {}
    for kind in ("", *EDITS):
        (folder / "edited.toml").write_text((folder / "plain.toml").read_text() + (line(kind) if kind else ""))
        edited = apply_edits(structures, load_recipe(folder / "edited.toml").edits)
        grid = build_grid(edited, recipe.grid, pins=recipe.pins)
        surface = build_surface(edited, recipe.surface, render=False)
        corners = surface.vertices_mm[surface.triangles].astype(float)
        inside = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6000.0
        volumes[kind] = float(grid.cell_coverage.sum() * grid.geometry.voxel_volume_mm3 / 1000.0), inside
    for kind in EDITS:
        for now, before in zip(volumes[kind], volumes[""], strict=True):
            assert abs(now - before) > 0.02, kind


def segmented():
    """The ball with a dent and a speck of muscle beside it."""
    geometry = Geometry.of(shape=(32, 32, 32), spacing_mm=(2, 2, 2), origin_mm=(-31, -31, -31))
    points = points_of(geometry)
    radius = np.linalg.norm(points, axis=-1)
    labels = np.where(radius < 14.0, 1, np.where(radius < 20.0, 2, 0))
    labels[np.linalg.norm(points - [14.0, 0.0, 0.0], axis=-1) < 4.5] = 1
    labels[np.linalg.norm(points - [-26.0, 0.0, 0.0], axis=-1) < 4.0] = 2
    table = LabelTable(
        labels=(Label(value=1, name="cavity", role=Role.BLOOD), Label(value=2, name="muscle", role=Role.MYOCARDIUM))
    )
    return Segmentation(labels.astype(np.uint8), geometry, table)
