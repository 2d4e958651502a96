import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from heartcase.pipeline.data import Scan
from heartcase.pipeline.image.region import crop_scan
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.settings import RegionSettings

OBLIQUE = Rotation.from_euler("xyz", [20, -35, 50], degrees=True).as_matrix() * [1, 1, -1]


def make_scan(shape=(8, 9, 10), spacing=(1.0, 2.0, 3.0), direction=OBLIQUE):
    values = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    geometry = Geometry.of(shape=shape, origin_mm=(5.0, -70.0, 300.0), spacing_mm=spacing, direction=direction)
    return Scan(values=values, geometry=geometry, modality="CT")


def region_of(scan, low, high):
    """Region from continuous index ``low`` to ``high``, in units of voxels with centres at whole numbers."""
    low, high = np.array(low, float), np.array(high, float)
    center = scan.geometry.index_to_world(0.5 * (low + high))
    size = (high - low) * np.array(scan.geometry.spacing_mm)
    return RegionSettings(center_mm=tuple(center.tolist()), size_mm=tuple(size.tolist()))


def test_without_a_region_the_scan_stays():
    scan = make_scan()
    assert crop_scan(scan, None) is scan


def test_a_region_along_voxel_faces_takes_just_those_voxels():
    scan = make_scan()
    got = crop_scan(scan, region_of(scan, (1.5, 2.5, 3.5), (5.5, 7.5, 5.5)))
    np.testing.assert_array_equal(got.values, scan.values[4:6, 3:8, 2:6])
    assert got.modality == "CT"
    assert not np.shares_memory(got.values, scan.values)


@given(
    low=st.tuples(*[st.floats(-3.0, 6.0)] * 3),
    size=st.tuples(*[st.floats(0.05, 9.0)] * 3),
)
def test_it_is_the_smallest_box_that_covers_the_region_and_every_voxel_keeps_its_place(low, size):
    scan = make_scan()
    high = np.array(low) + size
    assume(np.all(high > -0.49))
    got = crop_scan(scan, region_of(scan, low, high))
    first = scan.geometry.world_to_index(got.geometry.origin_mm)
    last = first + np.array(got.geometry.size) - 1
    reach = np.array(scan.geometry.size) - 0.5
    wanted_low, wanted_high = np.maximum(low, -0.5), np.minimum(high, reach)
    assert np.all(first - 0.5 <= wanted_low + 1.1e-4)
    assert np.all(last + 0.5 >= wanted_high - 1.1e-4)
    assert np.all(first + 0.5 > wanted_low - 1e-9)
    assert np.all(last - 0.5 < wanted_high + 1e-9)
    i, j, k = np.rint(first).astype(int)
    ni, nj, nk = got.geometry.size
    np.testing.assert_array_equal(got.values, scan.values[k : k + nk, j : j + nj, i : i + ni])
    np.testing.assert_allclose(
        got.geometry.index_to_world((ni - 1, 0, nk - 1)),
        scan.geometry.index_to_world((i + ni - 1, j, k + nk - 1)),
        atol=1e-9,
    )


def test_a_region_outside_is_refused_with_the_extent():
    scan = make_scan(direction=np.eye(3))
    region = RegionSettings(center_mm=(500.0, 0.0, 0.0), size_mm=(10.0, 10.0, 10.0))
    with pytest.raises(StageError, match=r"outside the scan.* x 4\.5 to 14\.5, y -71\.0 to -53\.0, z 298\.5 to 322\.5"):
        crop_scan(scan, region)
