"""Walls whose thickness varies: tables against plain formulas, walls against cones and bent tubes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from heartcase.pipeline.artifacts.serialise import artifact_from_bytes, artifact_to_bytes
from heartcase.pipeline.data import Segmentation, Structures, ThicknessTable
from heartcase.pipeline.fields.reader import ownership_at_points, ownership_on_lattice
from heartcase.pipeline.fields.wall_thickness import thickness_at_points
from heartcase.pipeline.walls.grow_walls import grow_walls, resolve_walls
from heartcase.schemas.errors import StageError
from heartcase.schemas.labels import Label, LabelTable, Role
from heartcase.schemas.recipe.settings import WallsSettings, WallThickness
from tests.pipeline.analytic_structures import cylinder
from tests.pipeline.analytic_structures import lattice as centred
from tests.pipeline.lattices import lattice, points_of
from tests.pipeline.walls.test_walls import KINDS, grown, owners, ray_thickness, table_of

AXIS = np.array([0.48, 0.6, 0.64])
COORDINATE = st.integers(-4000, 4000).map(lambda n: n / 100.0)
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE)


def tapered(kind="centreline", *, half_mm=20.0, thickness=(1.0, 3.0), label="aorta"):
    points = [tuple(float(v) for v in s * AXIS) for s in np.linspace(-half_mm, half_mm, len(thickness))]
    return WallThickness(label=label, kind=kind, points_mm=points, thickness_mm=thickness)


@st.composite
def tables(draw, kind):
    points = draw(st.lists(POINT, min_size=2, max_size=6, unique=True))
    if kind == "centreline":
        gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        points = [points[0], *(p for p, gap in zip(points[1:], gaps, strict=True) if gap > 0.1)]
        points = points if len(points) > 1 else [*points, (41.0, 0.0, 0.0)]
    values = draw(st.lists(st.floats(0.0, 50.0), min_size=len(points), max_size=len(points)))
    return ThicknessTable(1, kind, tuple(points), tuple(values))


@settings(deadline=None, max_examples=60)
@given(table=tables("centreline"), queries=st.lists(POINT, min_size=1, max_size=5))
def test_a_centreline_gives_the_thickness_at_its_nearest_point(table, queries):
    """Against the polyline in 4,000 samples per piece; where two parts of it are as near either will do."""
    points, values = np.array(table.points_mm), np.array(table.thickness_mm)
    part = np.linspace(0.0, 1.0, 4001)[:, None]
    samples = np.concatenate([a + part * (b - a) for a, b in pairwise(points)])
    numbers = np.concatenate([a + part[:, 0] * (b - a) for a, b in pairwise(values)])
    found, _ = thickness_at_points(table, queries)
    for query, value in zip(np.array(queries), found, strict=True):
        distance = np.linalg.norm(samples - query, axis=1)
        candidates = numbers[distance <= distance.min() + 0.02]
        assert candidates.min() - 0.2 <= value <= candidates.max() + 0.2
        assert values.min() <= value + 1e-9
        assert value <= values.max() + 1e-9


@settings(deadline=None, max_examples=60)
@given(table=tables("positions"), queries=st.lists(POINT, min_size=1, max_size=5))
def test_positions_give_shepards_mean(table, queries):
    points, values = np.array(table.points_mm), np.array(table.thickness_mm)
    distance = np.linalg.norm(np.array(queries)[:, None] - points, axis=2)
    there = np.isclose(distance, 0.0, atol=1e-6)
    weights = np.where(there.any(axis=1)[:, None], there, 1.0 / np.maximum(distance, 1e-6) ** 4)
    expected = (weights * values).sum(axis=1) / weights.sum(axis=1)
    found, _ = thickness_at_points(table, queries)
    assert found == pytest.approx(expected, abs=1e-6)
    assert thickness_at_points(table, points)[0].tolist() == values.tolist()


@pytest.mark.parametrize("kind", ["centreline", "positions"])
def test_the_slope_is_the_length_of_the_gradient(kind):
    table = ThicknessTable(1, kind, ((0.0, 0.0, 0.0), (10.0, 4.0, -3.0), (20.0, 0.0, 5.0)), (1.0, 4.0, 0.5))
    points = np.random.default_rng(3).uniform([1, -4, -4], [19, 6, 6], (300, 3))
    step = 1e-5
    ahead = [thickness_at_points(table, points + step * unit)[0] for unit in np.eye(3)]
    behind = [thickness_at_points(table, points - step * unit)[0] for unit in np.eye(3)]
    expected = np.linalg.norm((np.array(ahead) - np.array(behind)) / (2.0 * step), axis=0)
    slope = thickness_at_points(table, points)[1]
    # a point may lie within a step of the sheet on which the nearest point of the line jumps
    assert np.mean(np.isclose(slope, expected, atol=1e-5)) > 0.99


@settings(deadline=None, max_examples=12)
@given(
    thickness=st.floats(0.3, 4.0),
    kind=st.sampled_from(["centreline", "positions"]),
    on=st.sampled_from(KINDS),
    points=st.lists(POINT, min_size=2, max_size=4, unique=True),
)
def test_a_table_of_equal_numbers_is_the_constant_wall_byte_for_byte(thickness, kind, on, points):
    geometry = lattice(on, 18.0)
    labels = np.where(np.linalg.norm(points_of(geometry), axis=-1) < 5.0, 1, 0)
    table = WallThickness(label="aorta", kind=kind, points_mm=points, thickness_mm=[thickness] * len(points))
    plain = grown(labels, geometry, first_mm=thickness)
    # the label's own number must not matter
    varying = grown(labels, geometry, first_mm=9.0, settings=WallsSettings(thickness=(table,)))
    assert varying.band_mm == plain.band_mm
    fine = geometry.refined(2)
    for one, other in zip(
        vars(ownership_on_lattice(plain, fine)).values(),
        vars(ownership_on_lattice(varying, fine)).values(),
        strict=True,
    ):
        assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize("kind", ["centreline", "positions"])
@pytest.mark.parametrize("away", [1e-170, 1e200])
def test_points_whose_distance_has_no_square_give_a_thickness_of_the_table(kind, away):
    table = ThicknessTable(1, kind, ((away, 0.0, 0.0), (0.0, 0.0, 0.0) if away < 1.0 else (0.0, away, 0.0)), (1.0, 3.0))
    thickness, slope = thickness_at_points(table, [(0.0, 0.0, 0.0), (2.0, -1.0, 5.0)])
    assert ((thickness >= 1.0) & (thickness <= 3.0)).all()
    assert np.isfinite(slope).all()


def test_the_field_of_a_tapered_wall_is_the_distance_to_a_cone():
    geometry = centred(26.0, (1.0, 1.0, 1.0))
    table = LabelTable(labels=(Label(value=1, name="aorta", role=Role.VESSEL_LUMEN, wall_thickness_mm=1.0),))
    radius, slope = 6.0, 0.3
    tube = cylinder(radius, (0.0, 0.0, 1.0))
    k, j, i = np.indices(geometry.shape)
    bare = tube(geometry.index_to_world(np.stack((i, j, k), axis=-1))).astype(np.float32)
    line = ThicknessTable(1, "centreline", ((0.0, 0.0, -10.0), (0.0, 0.0, 10.0)), (1.0, 1.0 + 20.0 * slope))
    walled = Structures({0: -bare, 1: bare}, geometry, table.with_walls(), band_mm=1e3, thickness_tables=(line,))
    rng = np.random.default_rng(5)
    z, angle = rng.uniform(-7.0, 7.0, 4000), rng.uniform(0.0, 2.0 * np.pi, 4000)
    outer = radius + 1.0 + (z + 10.0) * slope
    height = rng.uniform(-0.6, 1.5, 4000)
    r = outer + height
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    cone = height / np.hypot(1.0, slope)
    assert np.abs(ownership_at_points(walled, points).tissue_mm - cone).max() < 0.03


@pytest.mark.parametrize("on", KINDS)
@pytest.mark.parametrize("kind", ["centreline", "positions"])
def test_a_tube_with_a_tapered_wall_has_the_thickness_of_its_table(on, kind):
    geometry = lattice(on, 46.0)
    points = points_of(geometry)
    across = np.linalg.norm(points - (points @ AXIS)[..., None] * AXIS, axis=-1)
    one = tapered(kind, half_mm=14.0, thickness=(1.0, 2.0, 3.0))
    structures = grown((across < 6.0).astype(int), geometry, settings=WallsSettings(thickness=(one,)))
    rng = np.random.default_rng(2)
    side = np.cross(AXIS, [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    angle, s = rng.uniform(0.0, 2.0 * np.pi, 200), rng.uniform(-12.0, 12.0, 200)
    rays = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(AXIS, side)
    inner, outer = ray_thickness(structures, s[:, None] * AXIS + 3.0 * rays, rays, 8.0)
    expected = 2.0 + s / 14.0
    if kind == "positions":
        feet = np.linspace(-14.0, 14.0, 3)
        reach = (3.0 + outer)[:, None]
        weights = 1.0 / (reach**2 + (s[:, None] - feet) ** 2) ** 2
        expected = (weights * [1.0, 2.0, 3.0]).sum(axis=1) / weights.sum(axis=1)
    error = np.abs(outer - inner - expected)
    assert error.mean() < 0.1
    assert np.percentile(error, 95) < 0.3


def test_a_bent_tube_is_as_thick_as_its_centreline_says():
    """A quarter of a ring: thickness linear in the angle; the polyline's corners cost little."""
    geometry = lattice("even", 60.0)
    bend, radius = 20.0, 5.0
    points = points_of(geometry) + np.array([10.0, 10.0, 0.0])
    flat = np.hypot(points[..., 0], points[..., 1])
    labels = (np.hypot(flat - bend, points[..., 2]) < radius) & (points[..., 0] > -8.0) & (points[..., 1] > -8.0)
    turn = np.linspace(0.0, np.pi / 2.0, 10)
    line = [(bend * np.cos(a) - 10.0, bend * np.sin(a) - 10.0, 0.0) for a in turn]
    values = np.linspace(1.0, 2.5, 10)
    one = WallThickness(label="aorta", kind="centreline", points_mm=line, thickness_mm=values.tolist())
    structures = grown(labels.astype(int), geometry, settings=WallsSettings(thickness=(one,)))
    rng = np.random.default_rng(4)
    angle, around = rng.uniform(0.15, 1.4, 250), rng.uniform(0.0, 2.0 * np.pi, 250)
    out = np.stack([np.cos(angle), np.sin(angle), np.zeros(250)], axis=1)
    rays = np.cos(around)[:, None] * out + np.sin(around)[:, None] * [0.0, 0.0, 1.0]
    starts = bend * out - [10.0, 10.0, 0.0] + 2.5 * rays
    inner, outer = ray_thickness(structures, starts, rays, 7.0)
    error = np.abs(outer - inner - (1.0 + 1.5 * angle / (np.pi / 2.0)))
    assert error.mean() < 0.1
    assert np.percentile(error, 95) < 0.3


def test_there_is_no_wall_where_the_thickness_is_zero():
    geometry = lattice("oblique", 46.0)
    points = points_of(geometry)
    along = points @ AXIS
    labels = np.linalg.norm(points - along[..., None] * AXIS, axis=-1) < 6.0
    one = tapered(half_mm=15.0, thickness=(2.0, 2.0, 0.0, 0.0))
    structures = grown(labels.astype(int), geometry, settings=WallsSettings(thickness=(one,)))
    owner = ownership_on_lattice(structures, geometry)
    tissue = owner.tissue_mm < 0.0
    assert tissue[(along < -6.0) & (along > -16.0)].any()
    assert not tissue[along > 5.1].any()
    assert structures.thinnest_layer_mm == 2.0
    line = AXIS * 10.0 + np.linspace(0.0, 12.0, 241)[:, None] * np.cross(AXIS, [1.0, 0.0, 0.0]) / np.hypot(0.6, 0.64)
    assert set(owners(structures, line)) == {0, 1}


def test_the_thickest_part_counts_for_the_band():
    geometry = lattice("even", 20.0)
    table = table_of(first_mm=1.0, second_mm=0.5).with_walls()
    thick = WallsSettings(thickness=(tapered(thickness=(1.0, 7.0)),))
    assert resolve_walls(thick, geometry, table).band_mm == pytest.approx(7.0 + 3.0 * 1.75)
    thin = WallsSettings(thickness=(tapered(thickness=(0.2, 0.4)),))
    assert resolve_walls(thin, geometry, table).band_mm == pytest.approx(0.5 + 3.0 * 1.75)


def test_every_bad_table_is_reported():
    with pytest.raises(ValidationError) as error:
        WallThickness(label="aorta", kind="centreline", points_mm=[(0, 0, 0), (0, 0, 0)], thickness_mm=[0.0])
    message = str(error.value)
    for part in ("2 points and thickness_mm 1", "in a row are the same", "all thicknesses are 0"):
        assert part in message
    for bad in (-0.1, 50.1, float("nan")):
        with pytest.raises(ValidationError):
            WallThickness(label="aorta", kind="positions", points_mm=[(0, 0, 0)], thickness_mm=[bad])
    with pytest.raises(ValidationError, match="at least two points"):
        WallThickness(label="aorta", kind="centreline", points_mm=[(0, 0, 0)], thickness_mm=[1.0])
    with pytest.raises(ValidationError, match="two positions are the same"):
        WallThickness(label="aorta", kind="positions", points_mm=[(0, 0, 0), (0, 0, 0)], thickness_mm=[1.0, 2.0])
    geometry = lattice("even", 16.0)
    labels = (np.linalg.norm(points_of(geometry), axis=-1) < 5.0).astype(int)
    names = ("aorta", "Aorta", "septum", "vena cava")
    with pytest.raises(StageError) as found:
        grown(labels, geometry, settings=WallsSettings(thickness=tuple(tapered(label=name) for name in names)))
    by_place = {problem.place: problem.message for problem in found.value.problems}
    assert "no label 'vena cava'" in by_place["walls.thickness[4]"]
    assert "grows no wall" in by_place["walls.thickness[3]"]
    assert "has a table already" in by_place["walls.thickness[2]"]
    assert len(found.value.problems) == 3


def test_a_table_that_cannot_matter_is_reported():
    geometry = lattice("even", 16.0)
    labels = (np.linalg.norm(points_of(geometry), axis=-1) < 5.0).astype(int)
    away = WallThickness(label="aorta", kind="positions", points_mm=[(300.0, 0, 0)], thickness_mm=[2.0])
    (warning,) = grown(labels, geometry, settings=WallsSettings(thickness=(away,))).warnings
    assert "aorta: no point of its table of thicknesses lies in the scan" in warning.text
    painted = LabelTable(
        labels=(*table_of().labels[1:], Label(value=7, name="sleeve", role=Role.WALL, wall_of=1)),
    )
    geometry = lattice("even", 24.0)
    ring = np.linalg.norm(points_of(geometry), axis=-1)
    labels = np.where(ring < 6.0, 1, np.where(ring < 10.0, 7, 0)).astype(np.uint8)
    segmentation = Segmentation(labels, geometry, painted)
    (warning,) = grow_walls(segmentation, WallsSettings(thickness=(tapered(half_mm=5.0),)), ()).warnings
    assert warning.text.startswith("aorta: its wall is segmented")


def test_tables_travel_with_the_structures_and_cost_nothing_where_there_are_none():
    geometry = lattice("even", 16.0)
    labels = (np.linalg.norm(points_of(geometry), axis=-1) < 5.0).astype(int)
    varying = grown(labels, geometry, settings=WallsSettings(thickness=(tapered(),)))
    back = artifact_from_bytes(artifact_to_bytes(varying), Structures)
    assert back.thickness_tables == varying.thickness_tables
    assert isinstance(back.thickness_tables[0], ThicknessTable)
    assert back.grown_walls == varying.grown_walls == {4: (1, 3.0)}
    plain = replace(varying, thickness_tables=())
    assert b"thickness_tables" not in artifact_to_bytes(plain)
