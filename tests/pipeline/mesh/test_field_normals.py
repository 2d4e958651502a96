from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from heartcase.pipeline.fields.reader import FieldReader, ownership_at_points
from heartcase.pipeline.mesh.extraction.field_normals import (
    RING_MISFIT,
    RING_WAYS,
    SMOOTH_SPANS_VOXELS,
    STEPPED_SPANS_VOXELS,
    fitted_normals,
)
from tests.pipeline.solids import LEFT_HANDED, OBLIQUE, bumps, lattice, solid, sphere, walled


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1)[..., None]


def degrees(one, two):
    return np.degrees(np.arccos(np.clip((one * two).sum(axis=1), -1.0, 1.0)))


def rough(normals, rng, tilt=0.1):
    return unit(normals + tilt * rng.standard_normal(normals.shape))


def slow(structures, point, normal, reach_mm):
    """Drawn point, fitted normal and whether a ring fits, in plain NumPy."""

    def value(p):
        return float(ownership_at_points(structures, p[None]).tissue_mm[0])

    away, drawn = 0.0, point
    for _ in range(2):
        away = np.clip(away - value(drawn), -reach_mm, reach_mm)
        drawn = point + away * normal
    helper = np.eye(3)[np.abs(normal).argmin()]
    first = unit(helper - (helper @ normal) * normal)
    second = np.cross(normal, first)
    angle = np.pi * np.arange(RING_WAYS) / RING_WAYS
    ways = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    basis = np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def ring(voxels):
        span = voxels * float(np.mean(structures.geometry.spacing_mm))
        rise = np.array([(value(drawn + span * way) - value(drawn - span * way)) / (2.0 * span) for way in ways])
        slope = np.linalg.lstsq(basis, rise, rcond=None)[0]
        return slope, np.abs(rise - basis @ slope).max() < RING_MISFIT / voxels

    for voxels in STEPPED_SPANS_VOXELS if structures.has_voxel_steps else SMOOTH_SPANS_VOXELS:
        slope, fits = ring(voxels)
        if fits:
            break
    rest = np.sqrt(max(1.0 - slope @ slope, 0.1))
    return drawn, unit(rest * normal + slope[0] * first + slope[1] * second), fits


@pytest.mark.parametrize("direction", [np.eye(3), OBLIQUE @ LEFT_HANDED])
@pytest.mark.parametrize(("shape", "stepped"), [("shell", True), ("bumps", True), ("bumps", False)])
def test_the_kernel_does_what_plain_numpy_does(shape, stepped, direction):
    rng = np.random.default_rng(4)
    geometry = lattice(1.2, 22.0, direction=direction)
    structures = walled(sphere(12.0), 2.0, geometry) if shape == "shell" else solid(bumps, geometry)
    structures = replace(structures, has_voxel_steps=stepped)
    normal = unit(rng.standard_normal((60, 3)))
    start = normal * (14.0 if shape == "shell" else 16.0) + rng.uniform(-0.3, 0.3, (60, 3))
    guess = rough(normal, rng)
    drawn, normals, found = fitted_normals(FieldReader.of(structures), start, guess, reach_mm=1.0)
    assert found.mean() > 0.2
    for n in range(len(start)):
        point, fitted, fits = slow(structures, start[n], guess[n], 1.0)
        assert np.abs(point - drawn[n]).max() < 1e-5
        assert found[n] == fits
        assert np.abs(normals[n] - fitted).max() < 1e-4


def test_points_are_drawn_to_the_root_with_its_normal():
    structures = walled(sphere(12.0), 1.5, lattice(1.5, 17.0))
    rng = np.random.default_rng(2)
    direction = unit(rng.standard_normal((400, 3)))
    radius = np.where(rng.random(400) < 0.5, 12.0, 13.5)
    start = direction * (radius + rng.uniform(-0.3, 0.3, 400))[:, None]
    outward = direction * np.where(radius > 12.5, 1.0, -1.0)[:, None]
    guess = rough(outward, rng, 0.03)
    found, normals, fits = fitted_normals(FieldReader.of(structures), start, guess, reach_mm=0.5)
    # Interpolation errs by at most h^2 / 8 (2 / r).
    assert np.abs(np.linalg.norm(found, axis=1) - radius).max() < 1.5**2 / 8.0 * 2.0 / 12.0 + 0.01
    assert fits.mean() > 0.9
    # Between voxels the interpolated field is flat: its slope errs by up to half a voxel over the radius.
    assert degrees(normals, outward)[fits].max() < np.degrees(0.5 * 1.5 * np.sqrt(3.0) / 12.0)
    assert degrees(normals, outward)[fits].mean() < 0.4 * degrees(guess, outward)[fits].mean()
    far, _, _ = fitted_normals(FieldReader.of(structures), direction * 8.0, direction, reach_mm=0.5)
    assert np.linalg.norm(far - direction * 8.0, axis=1).max() < 0.5 + 1e-9


def test_across_an_edge_the_narrowest_ring_counts():
    def wedge(p):
        return np.maximum(p[..., 0], p[..., 1])

    structures = replace(solid(wedge, lattice(0.5, 14.0)), has_voxel_steps=True)
    at = np.array([[0.0, -1.2, 0.0], [0.0, -6.0, 0.0]])
    guess = np.array([[1.0, 0.0, 0.0], unit(np.array([1.0, 0.1, 0.0]))])
    _, normals, found = fitted_normals(FieldReader.of(structures), at, guess, reach_mm=0.5)
    assert found.all()
    # the narrowest ring does not reach the edge, the wider ones do
    assert degrees(normals, np.array([[1.0, 0.0, 0.0]])).max() < 2.0
