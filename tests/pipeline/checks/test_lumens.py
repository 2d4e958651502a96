"""Narrow places against shapes of known width, and what the smoothing does to them."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.pipeline.checks.lumens import narrowest_lumens
from heartcase.pipeline.fields.distance import default_smoothing_mm, label_distances
from heartcase.schemas.labels import Label, LabelTable, Role
from tests.pipeline.lattices import LATTICES, directions, lattice, points_of

TABLE = LabelTable(
    labels=(
        Label(value=1, name="left atrium", role=Role.BLOOD),
        Label(value=2, name="right atrium", role=Role.BLOOD),
        Label(value=3, name="myocardium", role=Role.MYOCARDIUM),
    )
)

VOXEL_MM = 1.75
"""Of the lattice "even"."""


def found(labels, geometry, **more):
    distances = label_distances(
        labels,
        geometry.spacing_mm,
        smoothing_mm=default_smoothing_mm(geometry.spacing_mm),
        band_mm=6.0,
        blood_values=TABLE.blood_values,
        tissue_values=TABLE.tissue_values,
    )
    return narrowest_lumens(labels, distances, geometry, TABLE, **more)


def hourglass(geometry, axis, least_mm, most_mm=9.0):
    """A vessel that narrows from ``most_mm`` to ``least_mm`` of radius in the middle, in muscle."""
    points = points_of(geometry)
    along = points @ axis
    radius = most_mm - (most_mm - least_mm) * np.exp(-0.5 * (along / 5.0) ** 2)
    across = np.linalg.norm(points - along[..., None] * axis, axis=-1)
    labels = np.where(across < radius, 1, 3).astype(np.uint8)
    labels[np.linalg.norm(points, axis=-1) > 21.0] = 3
    return labels


@pytest.mark.parametrize("kind", LATTICES)
@pytest.mark.parametrize("axis", directions(3, seed=9), ids=["a", "b", "c"])
@pytest.mark.parametrize("least_mm", [2.5, 4.0])
def test_a_stenosis_is_found_where_it_is_and_as_wide_as_it_is(kind, axis, least_mm):
    geometry = lattice(kind, 48.0)
    (one,) = found(hourglass(geometry, axis, least_mm), geometry)
    voxel = float(np.mean(geometry.spacing_mm))
    assert np.linalg.norm(one.position_mm) < 3.0
    assert one.label == 1
    assert one.segmented_mm == pytest.approx(2.0 * least_mm, abs=0.5 * voxel)
    # smoothing tightens it by less than half a voxel
    assert one.smoothed_mm > 2.0 * least_mm - 0.5 * voxel
    assert one.smoothed_mm == pytest.approx(one.segmented_mm, abs=0.5 * voxel)


@pytest.mark.parametrize("axis", directions(3, seed=2), ids=["a", "b", "c"])
def test_a_septal_defect_is_a_narrow_place_between_two_chambers(axis):
    geometry = lattice("even", 48.0)
    points = points_of(geometry)
    along = points @ axis
    across = np.linalg.norm(points - along[..., None] * axis, axis=-1)
    labels = np.where(along < 0.0, 1, 2).astype(np.uint8)
    labels[(np.abs(along) < 3.0) & (across > 4.0)] = 3
    labels[np.linalg.norm(points, axis=-1) > 20.0] = 3
    (one,) = found(labels, geometry)
    assert one.segmented_mm == pytest.approx(8.0, abs=0.5 * VOXEL_MM)
    assert one.smoothed_mm == pytest.approx(one.segmented_mm, abs=0.5 * VOXEL_MM)
    assert np.linalg.norm(one.position_mm) < 4.0
    # two labels that meet in the canal leave it as wide as one label does
    (alone,) = found(np.where(labels == 2, 1, labels).astype(np.uint8), geometry)
    assert one.smoothed_mm == pytest.approx(alone.smoothed_mm, abs=0.1 * VOXEL_MM)


def test_of_several_the_narrowest_come_first():
    geometry = lattice("even", 64.0)
    points = points_of(geometry)
    z = points[..., 2]
    radius = 8.0 - 5.0 * np.exp(-0.5 * ((z + 12.0) / 3.0) ** 2) - 3.0 * np.exp(-0.5 * ((z - 12.0) / 3.0) ** 2)
    labels = np.where((np.hypot(points[..., 0], points[..., 1]) < radius) & (np.abs(z) < 28.0), 1, 3).astype(np.uint8)
    one, other = found(labels, geometry)
    assert one.position_mm[2] == pytest.approx(-12.0, abs=2.0)
    assert other.position_mm[2] == pytest.approx(12.0, abs=2.0)
    assert one.segmented_mm == pytest.approx(6.0, abs=0.5 * VOXEL_MM)
    assert other.segmented_mm == pytest.approx(10.0, abs=0.5 * VOXEL_MM)
    assert found(labels, geometry, most=1) == (one,)


def test_an_even_vessel_and_a_scan_without_blood_have_none():
    geometry = lattice("even", 40.0)
    points = points_of(geometry)
    inside = (np.hypot(points[..., 0], points[..., 1]) < 6.0) & (np.abs(points[..., 2]) < 16.0)
    assert found(np.where(inside, 1, 3).astype(np.uint8), geometry) == ()
    assert found(np.where(inside, 3, 0).astype(np.uint8), geometry) == ()
