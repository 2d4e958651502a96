"""An adult's walls around the heart of a child are told of; those that were chosen are not."""

from __future__ import annotations

import numpy as np
import pytest

from heartcase.pipeline.checks.adult_walls import adult_wall_warnings
from heartcase.pipeline.data import Segmentation
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable, default_label_table


def heart(ventricle_ml, table=None, *, labels=(1, 2, 5)):
    """A left ventricle of a volume, with a small cube of the other labels beside it; voxels of 2 mm."""
    edge = round((1000.0 * ventricle_ml) ** (1 / 3) / 2.0)
    values = np.zeros((edge + 14, edge + 14, edge + 14), np.uint8)
    for n, value in enumerate(labels[1:]):
        values[2:5, 2:5, 2 + 4 * n : 5 + 4 * n] = value
    values[7 : 7 + edge, 7 : 7 + edge, 7 : 7 + edge] = labels[0]
    geometry = Geometry(size=values.shape[::-1], spacing_mm=(2.0, 2.0, 2.0), origin_mm=(0.0, 0.0, 0.0))
    return Segmentation(values, geometry, table or default_label_table())


def with_wall(name, thickness_mm):
    table = default_label_table()
    changed = {"wall_thickness_mm": thickness_mm}
    return LabelTable(labels=tuple(one.model_copy(update=changed) if one.name == name else one for one in table))


def test_a_childs_ventricle_with_an_adults_walls():
    (warning,) = adult_wall_warnings(heart(12.0))
    assert warning.code == "adult-walls"
    # voxels of 10.6 ml: 62.02 A^1.3 ml gives 0.26 m2, and lengths of 0.38 of those of 1.75 m2
    assert "about 0.3 m²" in warning.text
    assert "morphologically right ventricle 4 mm (some 1.5), aorta 2 mm (some 0.8)" in warning.text
    assert "atrium" not in warning.text


@pytest.mark.parametrize("ventricle_ml", [60.0, 120.0])
def test_a_larger_heart_is_not_told_of(ventricle_ml):
    assert adult_wall_warnings(heart(ventricle_ml)) == ()


def test_walls_that_were_chosen_are_not_told_of():
    (warning,) = adult_wall_warnings(heart(12.0, with_wall("aorta", 1.0)))
    assert "aorta" not in warning.text
    (warning,) = adult_wall_warnings(heart(12.0), ["Aorta"])
    assert "aorta" not in warning.text
    only = heart(12.0, with_wall("morphologically right ventricle", 1.5), labels=(1, 2))
    assert adult_wall_warnings(only) == ()


def test_where_the_ventricles_are_not_known_nothing_is_said():
    assert adult_wall_warnings(heart(1.0)) == ()
