"""Confidence of each voxel: its formula the slow way, and what it is worth on a noisy heart whose truth is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.data import UNMARKED, Markers, Scan
from heartcase.pipeline.image.filter_scan import filter_scan
from heartcase.pipeline.markers.confidence import sureness_of, voxel_confidence
from heartcase.pipeline.markers.suggest import suggest_strokes
from heartcase.pipeline.watershed.certainty import foot_certainty, voxel_certainty
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree import build_basin_tree
from heartcase.pipeline.watershed.tree_cache import scan_tree
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.settings import FilterSettings, SegmentSettings
from tests.pipeline.report.analytic_heart import make_heart
from tests.pipeline.watershed.test_certainty import passes
from tests.pipeline.watershed.test_forest import landscape, painted, shapes

SPACING = (0.8, 1.1, 2.3)


@settings(max_examples=80, deadline=None)
@given(
    shape=shapes,
    levels=st.sampled_from([3, 40, None]),
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 12),
    labels=st.integers(1, 4),
)
def test_it_is_its_formula_with_passes_and_distances_by_brute_force(shape, levels, seed, count, labels):
    height, markers = landscape(shape, levels, seed), painted(shape, count, labels, seed)
    forest = solve_forest(build_basin_tree(height), markers)
    geometry = Geometry.of(shape=shape, spacing_mm=SPACING)
    got = voxel_confidence(forest, geometry)
    every = passes(height, markers)
    where = np.argwhere(np.ones(shape, bool)) * np.array(SPACING[::-1])
    away = {
        label: np.linalg.norm(where[:, None] - where[markers.ravel() == label], axis=-1).min(axis=1).reshape(shape)
        for label in every
    }
    for index in np.ndindex(*shape):
        own = int(forest.labels[index])
        others = {label: climb[index] for label, climb in every.items() if label != own}
        if markers[index] != UNMARKED or not others:
            assert got[index] == 1.0
            continue
        other = min(others.values())
        part = every[own][index] / other if other > 0.0 else 1.0
        # of several labels over one pass, any may be the rival
        wanted = [
            1.0 - part**4 * (away[own][index] / (away[own][index] + away[label][index])) ** 2
            for label, climb in others.items()
        ]
        rivals = [value for value, climb in zip(wanted, others.values(), strict=True) if climb == other]
        assert min(abs(got[index] - value) for value in rivals) < 2e-6


@pytest.fixture(scope="module")
def noisy_heart():
    heart = make_heart(spacing_mm=(2.5, 2.5, 3.0))
    values = heart.scan.values + np.random.default_rng(1).normal(
        0.0, 0.1 * np.ptp(heart.scan.values), heart.scan.values.shape
    )
    return heart, filter_scan(Scan(values.astype(np.float32), heart.scan.geometry, "MR"), FilterSettings())


def test_what_is_less_confident_is_more_often_wrong(noisy_heart):
    heart, filtered = noisy_heart
    truth = heart.segmentation.labels
    random = np.random.default_rng(2)
    markers = np.full(truth.shape, UNMARKED, np.uint8)
    for value in np.unique(truth):
        inside = np.flatnonzero(truth == value)
        markers.flat[random.choice(inside, 12)] = value
    tree = scan_tree(filtered, SegmentSettings())
    sureness = sureness_of(tree, Markers(markers, filtered.geometry))
    forest = solve_forest(tree, markers)
    wrong = (forest.labels != truth)[markers == UNMARKED]
    confidence = sureness.confidence[markers == UNMARKED]
    assert wrong[confidence < 0.75].mean() > 5.0 * wrong.mean()
    assert wrong.mean() > 2.0 * wrong[confidence >= 0.9].mean()
    assert sureness.strokes == suggest_strokes(forest, filtered.geometry)


def test_without_markers_there_is_no_confidence():
    forest = solve_forest(build_basin_tree(landscape((3, 4, 5), None, 1)), np.full((3, 4, 5), UNMARKED, np.uint8))
    assert (voxel_confidence(forest, Geometry.of(shape=(3, 4, 5), spacing_mm=SPACING)) == 0.0).all()
    assert (voxel_certainty(forest, foot_certainty(forest)) == 0.0).all()
