"""A disc across a vessel, against a tube whose axis and radius are known."""

import numpy as np
import pytest

from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.vessel_ends.discs import Stumps
from heartcase.pipeline.vessel_ends.end_place import end_place
from heartcase.schemas.errors import UsageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table

TABLE = default_label_table().with_walls()
CHAMBER, AORTA = TABLE["left ventricle"].value, TABLE["aorta"].value
STUMPS = Stumps(8.0, {})


def tube(axis, radius_mm):
    """A chamber at one side, and a straight vessel out of it along an axis; the point that the vessel passes."""
    geometry = Geometry(size=(60, 60, 60), spacing_mm=(1.0, 1.0, 1.0), origin_mm=(-30.0, -30.0, -30.0))
    k, j, i = np.meshgrid(*(np.arange(n) for n in geometry.shape), indexing="ij")
    at = geometry.index_to_world(np.stack([i, j, k], axis=-1))
    along = at @ axis
    across = np.linalg.norm(at - along[..., None] * axis, axis=-1)
    labels = np.where((across <= radius_mm) & (along > -20.0), AORTA, 0)
    labels[np.linalg.norm(at + 22.0 * axis, axis=-1) < 12.0] = CHAMBER
    return Segmentation(labels.astype(np.uint8), geometry, TABLE)


@pytest.mark.parametrize(
    ("axis", "radius_mm"), [((0.0, 0.0, 1.0), 8.0), ((0.6, -0.5, 0.62), 4.0), ((-0.7, 0.7, 0.1), 8.0)]
)
def test_a_disc_lies_across_a_tube_and_has_room_for_its_wall(axis, radius_mm):
    axis = np.array(axis) / np.linalg.norm(axis)
    off = np.cross(axis, [1.0, 0.0, 0.0])
    point = 8.0 * axis + 0.5 * radius_mm * off / np.linalg.norm(off)
    found = end_place(tube(axis, radius_mm), TABLE, STUMPS, tuple(point))
    assert found.label == "aorta"
    assert np.degrees(np.arccos(min(np.dot(found.axis, axis) / np.linalg.norm(found.axis), 1.0))) < 4.0
    away = np.array(found.position_mm)
    assert np.linalg.norm(away - (away @ axis) * axis) < 0.7
    wall = TABLE["aorta"].wall_thickness_mm
    assert radius_mm + wall < found.radius_mm < radius_mm + wall + 3.0


def test_where_no_vessel_is_it_says_what_to_do():
    segmentation = tube(np.array([0.0, 0.0, 1.0]), 4.0)
    for point, name, words in [
        ((25.0, 25.0, 25.0), None, "no cavity: click inside a vessel"),
        ((0.0, 0.0, 5.0), "pulmonary artery", "no voxels yet: paint it first"),
        ((0.0, 0.0, 5.0), "spleen", "no label 'spleen'"),
        ((900.0, 0.0, 5.0), None, "outside the scan"),
    ]:
        with pytest.raises(UsageError, match=words):
            end_place(segmentation, TABLE, STUMPS, point, name)
