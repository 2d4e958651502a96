"""The figures of the table of segmentations, on spheres whose distances are known."""

from __future__ import annotations

import numpy as np
import pytest
import pyvista

from benchmarks import accuracy, scan_to_labels
from benchmarks.runner.cases import MethodSkipped
from heartcase.phantom.anatomy.heart import HeartPhantom
from heartcase.pipeline.data import UNMARKED, Markers, Scan, Segmentation
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import Label, LabelTable, Role

GEOMETRY = Geometry.of(shape=(30, 30, 30), spacing_mm=(1, 1, 1), origin_mm=(-14.5, -14.5, -14.5))
TABLE = LabelTable(
    labels=(
        Label(value=0, name="background", role=Role.BACKGROUND),
        Label(value=1, name="left ventricle", role=Role.BLOOD),
        Label(value=9, name="left ventricular myocardium", role=Role.MYOCARDIUM),
    )
)
INDEX = np.indices(GEOMETRY.shape)[::-1]
FROM_CENTRE = np.linalg.norm(GEOMETRY.index_to_world(np.moveaxis(INDEX, 0, -1)), axis=-1)


def ball(radius: float) -> tuple[np.ndarray, np.ndarray]:
    mesh = pyvista.Icosphere(radius=radius, nsub=4)
    return np.asarray(mesh.points, dtype=float), mesh.regular_faces.astype(np.int64)


def shells(inner: float, outer: float) -> np.ndarray:
    return np.where(inner > FROM_CENTRE, 1, np.where(outer > FROM_CENTRE, 9, 0)).astype(np.uint8)


def inputs_of(truth: np.ndarray, *, behind: np.ndarray | None = None):
    marked = np.full(GEOMETRY.shape, UNMARKED, np.uint8)
    marked[14:16, 14:16, 14:16] = 1
    marked[FROM_CENTRE > 13.5] = 0
    marked[(abs(FROM_CENTRE - 8.0) < 0.8) & (INDEX[2] > 14)] = 9
    values = np.where(truth == 1, 100.0, np.where(truth == 9, 50.0, 0.0)).astype(np.float32)
    nowhere = np.zeros(GEOMETRY.shape, bool)
    return accuracy.Inputs(
        filtered=Scan(values, GEOMETRY),
        markers=Markers(marked, GEOMETRY),
        table=TABLE,
        true_labels=truth,
        behind_ends=nowhere if behind is None else behind,
        size="spheres",
        walker_voxels_max=10**6,
    )


def surfaces(inner: float, outer: float):
    wall_v, wall_t = ball(outer)
    inner_v, inner_t = ball(inner)
    both = np.concatenate([wall_v, inner_v]), np.concatenate([wall_t, inner_t + len(wall_v)])
    return {
        "blood pool": (inner_v, inner_t),
        TABLE["left ventricle"].name: (inner_v, inner_t),
        TABLE["left ventricular myocardium"].name: both,
    }


@pytest.mark.parametrize("offset", [0.0, 1.0, 2.0])
def test_distance_of_two_concentric_balls(offset):
    mask = (8.0 + offset > FROM_CENTRE).astype(np.uint8)
    found = accuracy.surface_distance(mask, GEOMETRY, *ball(8.0))
    assert found.mean_mm == pytest.approx(offset, abs=0.35 if offset == 0.0 else 0.12)
    assert offset <= found.percentile_95_mm < offset + 0.7


def test_figures_of_a_result_that_is_a_millimetre_too_large(monkeypatch):
    monkeypatch.setattr(accuracy, "true_surfaces", lambda size: surfaces(6.0, 10.0))
    truth = shells(6.0, 10.0)
    found = accuracy.errors(inputs_of(truth), Segmentation(shells(7.0, 10.0), GEOMETRY, TABLE))
    expected = 2.0 * 6.0**3 / (6.0**3 + 7.0**3)
    assert found["blood pool Dice [1]"] == pytest.approx(expected, abs=0.02)
    assert found["blood pool mean distance [mm]"] == pytest.approx(1.0, abs=0.15)
    assert found["worst label Dice [1]"] == found["blood pool Dice [1]"]
    assert found["all labels Dice [1]"] == pytest.approx(
        0.5 * (found["blood pool Dice [1]"] + found["left myocardium Dice [1]"])
    )
    perfect = accuracy.errors(inputs_of(truth), Segmentation(truth, GEOMETRY, TABLE))
    assert perfect["worst label Dice [1]"] == 1.0
    assert perfect["worst label 95% distance [mm]"] < 0.6


def test_a_structure_that_was_lost_is_as_far_off_as_the_scan_is_long(monkeypatch):
    monkeypatch.setattr(accuracy, "true_surfaces", lambda size: surfaces(6.0, 10.0))
    truth = shells(6.0, 10.0)
    lost = np.where(truth == 1, 9, truth).astype(np.uint8)
    found = accuracy.errors(inputs_of(truth), Segmentation(lost, GEOMETRY, TABLE))
    assert found["worst label Dice [1]"] == 0.0
    assert found["worst label mean distance [mm]"] == pytest.approx(30.0 * np.sqrt(3.0))


def test_nothing_behind_an_end_disc_counts(monkeypatch):
    monkeypatch.setattr(accuracy, "true_surfaces", lambda size: surfaces(6.0, 10.0))
    truth = shells(6.0, 10.0)
    spill = truth.copy()
    spill[:2] = 1
    behind = np.zeros(GEOMETRY.shape, bool)
    behind[:2] = True
    inputs = inputs_of(truth, behind=behind)
    cleared = accuracy.errors(inputs, Segmentation(spill, GEOMETRY, TABLE))
    assert cleared["worst label Dice [1]"] == 1.0
    kept = accuracy.errors(inputs_of(truth), Segmentation(spill, GEOMETRY, TABLE))
    assert kept["blood pool Dice [1]"] < 0.8


# SWIG's types warn when ITK is imported; as an error that would end the process.
@pytest.mark.filterwarnings("ignore:builtin type .* has no __module__ attribute:DeprecationWarning")
@pytest.mark.parametrize("method", ["heartcase", "skimage", "randomwalker", "growcut"])
def test_every_method_finds_the_shells(method):
    inputs = inputs_of(shells(6.0, 10.0))
    try:
        found = accuracy.METHODS[method](inputs)
    except MethodSkipped as reason:
        if method != "growcut" or "'.[bench]'" not in str(reason):
            raise
        pytest.skip("itk-growcut is not installed")
    marked = inputs.markers.labels != UNMARKED
    np.testing.assert_array_equal(found.labels[marked], inputs.markers.labels[marked])
    assert (found.labels == inputs.true_labels).mean() > 0.93


OURS = ("heartcase", "heartcase_other", "heartcase_no_floor")
METHODS_OF_SCANS = (*OURS, "gradient", "gradient_blurred", "curvature", "curvature_blurred")


@pytest.mark.parametrize("method", METHODS_OF_SCANS)
def test_every_method_finds_the_shells_from_the_scan_for_each_set_of_markers(method):
    assert tuple(scan_to_labels.METHODS) == METHODS_OF_SCANS
    truth = shells(6.0, 10.0)
    source = inputs_of(truth)
    noisy = source.filtered.values + np.random.default_rng(2).normal(0.0, 4.0, truth.shape)
    marked = source.markers.labels
    fewer = marked.copy()
    fewer[INDEX[2] > 20] = UNMARKED
    inputs = scan_to_labels.Inputs(
        Scan(noisy.astype(np.float32), GEOMETRY), (marked, fewer), TABLE, truth, np.zeros(truth.shape, bool), (1, 9)
    )
    found = scan_to_labels.METHODS[method](inputs)
    assert len(found) == 2
    for labels, markers in zip(found, inputs.marker_sets, strict=True):
        np.testing.assert_array_equal(labels[markers != UNMARKED], markers[markers != UNMARKED])
    assert (found[0] == truth).mean() > 0.9
    errors = scan_to_labels.errors(inputs, (truth, np.zeros_like(truth)))
    assert errors["all labels Dice [1]"] == errors["left ventricle Dice [1]"] == 0.5
    assert errors["its standard error [1]"] == pytest.approx(0.5)  # of 1 and 0


def test_the_random_walker_says_why_it_is_left_out():
    inputs = inputs_of(shells(6.0, 10.0))
    limited = accuracy.Inputs(**{**vars(inputs), "walker_voxels_max": 1000})
    with pytest.raises(MethodSkipped, match="walker_voxels_max"):
        accuracy.randomwalker(limited)


@pytest.mark.slow
def test_contoured_surfaces_lie_on_the_true_ones():
    phantom = HeartPhantom.child()
    made = accuracy.contoured_truth(phantom)
    assert set(made) == {"blood pool", *(label.name for label in phantom.table if label.value)}
    for label in (1, 3, 9):
        vertices, _ = made[phantom.table[label].name]
        off = abs(phantom.truth.distance(vertices[::20], label, tolerance_mm=0.02))
        assert off.mean() < 0.05
        assert np.percentile(off, 95) < 0.15
    pool, _ = made["blood pool"]
    fields = np.stack([phantom.truth.value(pool[::20], value) for value in phantom.table.blood_values])
    assert np.percentile(abs(fields.min(axis=0)), 95) < 0.15
