from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.phantom.drawing.recipe import recipe_text
from heartcase.phantom.drawing.strokes import marker_strokes
from heartcase.phantom.drawing.surface_lines import coronary_landmarks
from heartcase.schemas.recipe.recipe import load_recipe, parse_recipe
from tests.phantom.conftest import lattice_points

SAMPLES = Path(__file__).parents[2] / "sample_cases"


def segment_points(points, step_mm=0.3):
    if len(points) == 1:
        return points
    parts = []
    for a, b in pairwise(points):
        count = max(2, int(np.linalg.norm(b - a) / step_mm) + 1)
        parts.append(a + np.linspace(0.0, 1.0, count)[:, None] * (b - a))
    return np.concatenate(parts)


@pytest.fixture(scope="module", params=["adult", pytest.param("child", marks=pytest.mark.slow)])
def drawn(request):
    phantom = HeartPhantom.of_size(request.param)
    return phantom, marker_strokes(phantom)


def test_few_thin_strokes_for_every_label(drawn):
    phantom, strokes = drawn
    counts = Counter(stroke.label for stroke in strokes)
    assert {phantom.table[name].value for name in counts} == set(phantom.table.values)
    assert max(counts.values()) <= 10
    assert all(0.0 < stroke.radius_mm <= 2.0 for stroke in strokes)


def test_strokes_mark_less_than_a_hundredth_of_the_voxels(drawn):
    phantom, strokes = drawn
    geometry = phantom.scan_geometry(1.75 if phantom.size == "adult" else 1.0)
    centres = lattice_points(geometry).reshape(-1, 3)
    marked = np.zeros(len(centres), bool)
    for radius in {stroke.radius_mm for stroke in strokes}:
        points = [segment_points(np.array(s.points_mm), 0.5) for s in strokes if s.radius_mm == radius]
        distance, _ = cKDTree(np.concatenate(points)).query(centres, distance_upper_bound=radius)
        marked |= np.isfinite(distance)
    assert 0.002 < marked.mean() < 0.01


def test_strokes_stay_inside_their_structures(drawn):
    phantom, strokes = drawn
    truth = phantom.truth
    for stroke in strokes:
        value = phantom.table[stroke.label].value
        labels = truth.label(segment_points(np.array(stroke.points_mm)))
        # The wall of the right ventricle is grown, not segmented: on a scan it is marked as background.
        allowed = [0, truth.table.wall_value(2)] if value == 0 else [value]
        assert np.isin(labels, allowed).all(), stroke.label


def test_recipe_text_is_a_recipe_with_these_strokes_and_ends(drawn):
    phantom, strokes = drawn
    recipe = parse_recipe(recipe_text(phantom, name="a", scan_path="scan.nii.gz", command="make it", modality="MR"))
    assert recipe.strokes == strokes
    assert recipe.ends == phantom.ends
    assert recipe.landmarks == (*phantom.landmarks, *coronary_landmarks(phantom))
    assert recipe.table == phantom.table


def test_sample_case_holds_these_strokes(drawn):
    phantom, strokes = drawn
    recipe = load_recipe(SAMPLES / f"{phantom.size}_phantom.toml")
    assert recipe.scan.path == f"../out/{phantom.size}_phantom/scan.nii.gz"
    assert recipe.table == phantom.table
    same, more = recipe.strokes[: len(strokes)], recipe.strokes[len(strokes) :]
    assert [(s.label, s.radius_mm) for s in same] == [(s.label, s.radius_mm) for s in strokes]
    for saved, fresh in zip(same, strokes, strict=True):
        # Another processor may round a coordinate the other way.
        np.testing.assert_allclose(saved.points_mm, fresh.points_mm, atol=0.11)
    # Behind them come lines in the muscle, and as background in grown walls: the phantom command draws none.
    assert len(more) >= 60
    truth = phantom.truth
    walls = [value for value in truth.table.tissue_values if truth.table[value].wall_of is not None]
    for line in more:
        value = phantom.table[line.label].value
        assert line.radius_mm == 0.0
        labels = truth.label(segment_points(np.array(line.points_mm)))
        assert np.isin(labels, [value] if value else walls).all(), line
    for saved, fresh in zip(recipe.ends, phantom.ends, strict=True):
        assert saved.label == fresh.label
        np.testing.assert_allclose(saved.position_mm, fresh.position_mm, atol=0.0011)
