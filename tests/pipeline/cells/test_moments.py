"""Where in its cell the tissue lies, against shapes whose moments are known."""

import numpy as np
import pytest

from heartcase.pipeline.cells.moments import cell_moments
from heartcase.pipeline.cells.sampling import cell_lattice, sample_cells, sample_factor, tissue_part
from heartcase.schemas.bundle.lattice import FULL_MOMENTS
from tests.pipeline.analytic_structures import WALL, ball, lattice, rotation, slab, structures, without

OBLIQUE = rotation((1.0, 2.0, 3.0), 33.0)
FINE = 16


def sampled(shape, volume, cell_mm):
    return sample_cells(
        structures({WALL: shape}, volume), cell_lattice(volume, cell_mm), sample_factor(volume, cell_mm)
    )


def inner_cells(samples, least=0.1):
    """Cells with tissue that do not touch the border of the volume, (i, j, k)."""
    cells = np.argwhere(samples.coverage >= least)[:, ::-1].astype(np.int32)
    return cells[((cells > 0) & (cells < np.array(samples.geometry.size) - 2)).all(axis=1)]


def counted_out(shape, geometry, cells):
    """Moments and coverage by many points in each cell."""
    line = (np.arange(FINE) + 0.5) / FINE - 0.5
    points = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    x, y, z = points.T
    own = 1.0 / (12.0 * FINE**2)
    of_point = np.stack([x, y, z, x * x + own, y * y + own, z * z + own, y * z, x * z, x * y], axis=1)
    inside = shape(geometry.index_to_world(cells[:, None] + points)) < 0.0
    coverage = inside.mean(axis=1)
    return inside @ of_point / np.maximum(inside.sum(axis=1), 1)[:, None], coverage


@pytest.mark.parametrize("cell_mm", [2.0, 3.0])
@pytest.mark.parametrize(
    "shape",
    {
        "half of space, tilted": slab(-50.0, 0.3, (3.0, 1.0, 2.0)),
        "wall of 1.2 mm, tilted": slab(-0.6, 0.6, (1.0, 2.0, -1.0)),
        "wall of 0.7 mm": slab(-0.35, 0.35, (0.1, 0.2, 1.0)),
        "ball": ball(7.0),
        "shell of 1.5 mm": without(ball(8.0), ball(6.5)),
    }.items(),
    ids=lambda item: item[0],
)
@pytest.mark.parametrize("direction", [np.eye(3), OBLIQUE @ np.diag([1.0, 1.0, -1.0])], ids=["straight", "mirrored"])
def test_moments_are_those_of_the_shape(shape, cell_mm, direction):
    # Errors of the samples' centres alone, without the plane that cuts each: 3 to 10 times as large.
    samples = sampled(shape[1], lattice(10.0, shift=(0.3, 0.2, -0.4), direction=direction), cell_mm)
    cells = inner_cells(samples)
    cells = cells[:: max(len(cells) // 40, 1)]
    found = cell_moments(samples, cells).astype(np.float64)
    expected, coverage = counted_out(shape[1], samples.geometry, cells)
    assert (coverage > 0.05).sum() > 10
    found, expected = found[coverage > 0.05], expected[coverage > 0.05]

    def error(a, b):
        return np.sqrt(((a - b) ** 2).mean()), np.abs(a - b).max()

    def variance(moments):
        return moments[:, 3:6] - moments[:, :3] ** 2

    for (typical, largest), limits in (
        (error(found[:, :3], expected[:, :3]), (0.025, 0.06)),
        (error(variance(found), variance(expected)), (0.004, 0.016)),
        (error(found[:, 6:], expected[:, 6:]), (0.006, 0.03)),
    ):
        assert (typical, largest) < limits
        assert largest < limits[1]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_walls_along_the_axes_are_exact(axis):
    low, high = -4.3, -0.9
    samples = sampled(slab(low, high, np.eye(3)[axis]), lattice(9.0), 2.0)
    cells = inner_cells(samples, 0.01)
    found = cell_moments(samples, cells)
    centre = samples.geometry.index_to_world(cells)[:, axis]
    a, b = np.clip([(low - centre) / 2.0, (high - centre) / 2.0], -0.5, 0.5)
    expected = np.tile(FULL_MOMENTS.astype(np.float64), (len(cells), 1))
    expected[:, axis], expected[:, 3 + axis] = (a + b) / 2.0, (a * a + a * b + b * b) / 3.0
    assert len(np.unique(b - a)) > 1
    np.testing.assert_allclose(found, expected, atol=2e-6)


def test_a_full_cell_has_the_moments_of_a_cube_to_the_last_digit_and_the_volume_cuts_cells():
    # 21 mm in cells of 2 mm: half of the last cell of each axis lies in the volume.
    samples = sampled(ball(100.0), lattice(10.0), 2.0)
    cells = np.argwhere(samples.coverage > 0.0)[:, ::-1].astype(np.int32)
    found = cell_moments(samples, cells)
    last = cells == 10
    np.testing.assert_array_equal(found[~last.any(axis=1)], np.tile(FULL_MOMENTS, (10**3, 1)))
    np.testing.assert_allclose(found[:, :3], np.where(last, -0.25, 0.0), atol=1e-7)
    # Half a cell, seen from the middle of the whole, has the second moment of the whole.
    np.testing.assert_allclose(found[:, 3:6], 1.0 / 12.0, atol=1e-7)
    np.testing.assert_allclose(found[:, 6], found[:, 1].astype(float) * found[:, 2], atol=1e-7)


def test_the_samples_count_by_their_parts_in_the_coverage():
    samples = sampled(without(ball(7.0), ball(5.2)), lattice(9.0), 3.0)
    s, width = samples.factor, samples.cell_mm / samples.factor
    cells = inner_cells(samples)
    found = cell_moments(samples, cells)
    place = (np.arange(s) + 0.5) / s - 0.5
    assert ((cells[:, 0] % 2 == 0) & (samples.coverage[tuple(cells[:, ::-1].T)] < 1.0)).any()
    for (i, j, k), moments in zip(cells[::7].tolist(), found[::7], strict=True):
        places = np.ndindex(s, s, s)
        part = np.array([tissue_part(samples.tissue_mm, k * s + c, j * s + b, i * s + a, width) for c, b, a in places])
        part = part.reshape(s, s, s)
        assert part.mean() == pytest.approx(float(samples.coverage[k, j, i]), rel=1e-6)
        mean = [(part.sum(axis=others) @ place) / part.sum() for others in ((0, 1), (0, 2), (1, 2))]
        # A cut sample's tissue lies at most half a sample from its middle.
        cut = (part * (1.0 - part)).sum() / part.sum() / (2.0 * s)
        assert np.abs(moments[:3] - mean).max() <= cut + 1e-6


def test_a_cell_without_tissue_counts_as_full_and_any_field_gives_moments_that_a_cell_can_have():
    samples = sampled(ball(4.0), lattice(9.0), 2.0)
    corner = np.zeros((1, 3), np.int32)
    np.testing.assert_array_equal(cell_moments(samples, corner), FULL_MOMENTS[None])
    random = np.random.Generator(np.random.PCG64(3))
    samples.tissue_mm[:] = random.normal(0.0, 0.6, samples.tissue_mm.shape)
    cells = np.argwhere(np.ones_like(samples.coverage, bool))[:, ::-1].astype(np.int32)
    moments = cell_moments(samples, cells).astype(np.float64)
    assert np.abs(moments[:, :3]).max() <= 0.5
    mean, (xx, yy, zz, yz, xz, xy) = moments[:, :3], moments[:, 3:].T
    second = np.moveaxis(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), -1, 0)
    spread = np.linalg.eigvalsh(second - mean[:, :, None] * mean[:, None, :])
    assert -1e-6 < spread.min() < spread.max() < 0.25
