"""Labels for a first look are those that the session has there, and hold what is painted."""

from unittest.mock import patch

import numpy as np
import pytest

from heartcase.pipeline.building import first_look as module
from heartcase.pipeline.building.first_look import first_look
from heartcase.pipeline.building.quick_surface import quick_surface
from heartcase.pipeline.data import Scan
from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.pipeline.watershed import voxel_labels
from heartcase.schemas.errors import MarkerError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import parse_recipe
from heartcase.schemas.recipe.settings import Stroke
from tests.pipeline.building.test_quick_surface import TABLE, TEXT

SHAPE = (30, 44, 52)
GEOMETRY = Geometry.of(shape=SHAPE, spacing_mm=(1.0, 1.25, 2.0), origin_mm=(5.0, -3.0, 2.0))
MIDDLE = (30, 20, 14)


def session_on_a_ball(*, puts_off):
    """A session in which a bright ball is painted, its surroundings too."""
    at = [np.arange(n) for n in SHAPE[::-1]]
    i, j, k = np.meshgrid(*at, indexing="ij")
    away = np.linalg.norm((np.stack([i, j, k], axis=-1) - MIDDLE) * GEOMETRY.spacing_mm, axis=-1).T
    noise = np.random.default_rng(0).normal(0.0, 3.0, SHAPE)
    values = (100.0 + 300.0 / (1.0 + np.exp(away - 9.0)) + noise).astype(np.float32)
    session = SegmentationSession.of_scan(Scan(values, GEOMETRY, "MR"), TABLE)
    if puts_off:
        session.put_off()
    for label, index in (("background", (2, 2, 2)), ("left atrium", MIDDLE)):
        place = GEOMETRY.index_to_world(np.array(index)).tolist()
        session.paint(Stroke(label=label, radius_mm=1.0, points_mm=[place]))
    return session


@pytest.fixture
def everything_is_put_off():
    with patch.multiple(voxel_labels, MOST_AT_ONCE=0, MOST_LISTED=0):
        yield


@pytest.mark.parametrize(("searched", "voxels"), [(10**9, 10**9), (2_000, 10_000), (500, 3_000)])
def test_it_has_the_labels_of_the_session_and_all_that_is_painted(everything_is_put_off, searched, voxels):
    session, plain = session_on_a_ball(puts_off=True), session_on_a_ball(puts_off=False)
    assert session.put_off_tiles.any()
    with patch.multiple(module, SEARCHED=searched, VOXELS=voxels):
        found, is_thin = first_look(session, parse_recipe(TEXT, needs_markers=False))
    # of which lumens are thin nothing is known
    assert is_thin is None
    # nothing else was worked out
    assert session.put_off_tiles.any()
    k, j, i = np.indices(found.labels.shape).reshape(3, -1)
    index = GEOMETRY.world_to_index(found.geometry.index_to_world(np.stack([i, j, k], axis=1)))
    at = np.rint(index).astype(int)
    np.testing.assert_allclose(index, at, atol=1e-6)
    np.testing.assert_array_equal(found.labels.ravel(), plain.labels[at[:, 2], at[:, 1], at[:, 0]])
    there = np.argwhere(plain.labels == TABLE["left atrium"].value)[:, ::-1]
    assert len(there) > 500
    assert (there.min(axis=0) >= at.min(axis=0)).all()
    assert (there.max(axis=0) <= at.max(axis=0)).all()
    np.testing.assert_array_equal(session.labels, plain.labels)


def test_its_surface_lies_where_that_of_all_labels_does(everything_is_put_off):
    recipe = parse_recipe(TEXT, needs_markers=False)
    session = session_on_a_ball(puts_off=True)
    quick = quick_surface(first_look(session, recipe), recipe, is_coarse=True)
    whole = quick_surface(session.segmentation(), recipe, is_coarse=True)
    middle = GEOMETRY.index_to_world(np.array(MIDDLE))
    inner, outer = (np.linalg.norm(one.vertices_mm - middle, axis=1) for one in (quick, whole))
    for share in (5, 50, 95):
        assert abs(np.percentile(inner, share) - np.percentile(outer, share)) < max(whole.spacing_mm)


def test_a_small_structure_between_the_voxels_that_are_looked_at_is_found(everything_is_put_off):
    session = session_on_a_ball(puts_off=True)
    with patch.object(module, "SEARCHED", 1):
        found, _ = first_look(session, parse_recipe(TEXT, needs_markers=False))
    assert (found.labels == TABLE["left atrium"].value).any()


def test_a_thin_vessel_is_in_it_where_nothing_is_put_off():
    size = 96
    geometry = Geometry.of(shape=(size,) * 3, spacing_mm=(1.0,) * 3)
    values = np.zeros(geometry.shape, np.float32)
    values[20:76, 47:49, 47:49] = 300.0
    values += np.random.default_rng(0).normal(0.0, 1.0, values.shape).astype(np.float32)
    session = SegmentationSession.of_scan(Scan(values, geometry, "MR"), TABLE)
    for label, points in (("background", [[2.0, 2.0, 2.0]]), ("aorta", [[47.5, 47.5, 22.0], [47.5, 47.5, 74.0]])):
        session.paint(Stroke(label=label, radius_mm=0.8, points_mm=points))
    recipe = parse_recipe(TEXT, needs_markers=False)
    there = session.segmentation().labels == TABLE["aorta"].value
    assert 4 * 50 < there.sum() < 4 * 60
    tiles = np.zeros((3, 3, 3), np.bool_)
    tiles[0] = True
    settings = {"VOXELS": 2_000, "SEARCHED": 10**9}
    with patch.multiple(module, **settings), patch.object(SegmentationSession, "put_off_tiles", tiles):
        found, is_thin = first_look(session, recipe)
    assert is_thin is not None
    assert min(found.geometry.spacing_mm) > 2.0
    # of the last two thirds every coarse voxel that the vessel passes through, of the first those that were hit
    index = found.geometry.world_to_index(geometry.index_to_world(np.argwhere(there)[:, ::-1]))
    at = np.floor(index + 0.5001).astype(int)[:, ::-1]
    is_later = np.argwhere(there)[:, 0] >= 32 + 4
    assert (found.labels[tuple(at[is_later].T)] == TABLE["aorta"].value).all()
    assert is_thin[tuple(at[is_later].T)].all()


def test_nothing_marked_is_told():
    session = session_on_a_ball(puts_off=False)
    for _ in range(2):
        session.undo()
    with pytest.raises(MarkerError, match="no voxel"):
        first_look(session, parse_recipe(TEXT, needs_markers=False))
