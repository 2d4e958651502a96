"""Where a septum lies, against planes whose place and normal are known."""

import numpy as np
import pytest

from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.edits.septum_place import septum_place
from heartcase.schemas.errors import UsageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table

TABLE = default_label_table()
LEFT, RIGHT, MUSCLE = TABLE["left ventricle"].value, TABLE["right ventricle"].value, TABLE["myocardium"].value
SIZE, SPACING = (50, 40, 32), (1.0, 1.25, 1.5)
TURN = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])


def two_halves(normal, thickness_mm, *, direction=TURN):
    """Two cavities and a flat septum through the middle of the volume."""
    geometry = Geometry(
        size=SIZE, spacing_mm=SPACING, origin_mm=(10.0, -20.0, 5.0), direction=tuple(map(tuple, direction.tolist()))
    )
    k, j, i = np.meshgrid(*(np.arange(n) for n in geometry.shape), indexing="ij")
    middle = geometry.index_to_world((np.array(SIZE) - 1) / 2)
    side = (geometry.index_to_world(np.stack([i, j, k], axis=-1)) - middle) @ normal
    labels = np.where(side < -thickness_mm / 2, LEFT, np.where(side > thickness_mm / 2, RIGHT, MUSCLE))
    return Segmentation(labels.astype(np.uint8), geometry, TABLE), middle


@pytest.mark.parametrize("normal", [(1.0, 0.0, 0.0), (0.5, 0.7, -0.5), (0.0, 0.3, 0.95)])
@pytest.mark.parametrize("thickness_mm", [4.0, 9.0])
def test_a_flat_septum_is_found_with_middle_normal_and_thickness(normal, thickness_mm):
    normal = np.array(normal) / np.linalg.norm(normal)
    segmentation, middle = two_halves(normal, thickness_mm)
    for off_mm in (-3.0, 0.0, 3.0):
        found = septum_place(segmentation, TABLE, tuple(middle + off_mm * normal))
        towards = 1.0 if found.between[0] == TABLE[LEFT].name else -1.0
        assert set(found.between) == {TABLE[LEFT].name, TABLE[RIGHT].name}
        assert np.degrees(np.arccos(towards * np.dot(found.axis, normal))) < 4.0
        assert abs(np.dot(np.array(found.position_mm) - middle, normal)) < 0.75
        assert found.thickness_mm == pytest.approx(thickness_mm, abs=1.5)


def test_without_two_cavities_it_says_what_to_do():
    segmentation, middle = two_halves(np.array([1.0, 0.0, 0.0]), 4.0)
    labels = np.where(segmentation.labels == RIGHT, MUSCLE, segmentation.labels)
    with pytest.raises(UsageError, match="no two cavities within 25 mm: paint both"):
        septum_place(Segmentation(labels, segmentation.geometry, TABLE), TABLE, tuple(middle))
    with pytest.raises(UsageError, match="outside the scan"):
        septum_place(segmentation, TABLE, (900.0, 0.0, 0.0))
