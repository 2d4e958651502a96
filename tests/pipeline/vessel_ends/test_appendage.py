"""An appendage is told from a vein by where it leads, also where a great artery's root bears another label."""

import numpy as np
import pytest

from heartcase.pipeline.vessel_ends.appendage import Surroundings
from tests.pipeline.lattices import LATTICES, lattice
from tests.pipeline.vessel_shapes import TABLE, ball, segmented

WIDEST_MM = 15.0
MIDDLE, VALVE = np.zeros(3), np.array([10.0, -18.0, -8.0])
"""Of a left atrium: its mitral valve lies before it, below and to the left."""


def surroundings(kind, artery_mm):
    """A ventricle behind the valve, and an artery above it, so far from the place before the atrium."""
    geometry = lattice(kind, 130.0)
    value = {label.name: label.value for label in TABLE}
    parts = (
        (value["left ventricle"], ball(geometry, np.array([18.0, -30.0, -14.0]), 15.0)),
        # below and behind the atrium too, where a lower vein runs close to it
        (value["left ventricle"], ball(geometry, np.array([16.0, 6.0, -38.0]), 18.0)),
        (value["aorta"], ball(geometry, np.array([14.0, -16.0, 8.0 + artery_mm + 8.0]), 8.0)),
    )
    return Surroundings.of(segmented(geometry, *parts), TABLE, TABLE["left atrium"])


@pytest.mark.parametrize("kind", sorted(LATTICES))
def test_what_leads_forwards_beside_a_ventricle_is_an_appendage(kind):
    appendage, lower_vein = np.array([14.0, -16.0, 2.0]), np.array([18.0, 3.0, -12.0])
    for artery_mm, is_near in ((6.0, True), (30.0, False)):
        around = surroundings(kind, artery_mm)
        near = around._distance(around.arteries, appendage) < 1.5 * WIDEST_MM
        assert near == is_near
        assert around.is_appendage(appendage, MIDDLE, VALVE, WIDEST_MM)
        assert not around.is_appendage(lower_vein, MIDDLE, VALVE, WIDEST_MM)
        # to the sides and behind no vein is taken for one
        for way in ([26.0, 8.0, 8.0], [-26.0, 8.0, 8.0], [0.0, 20.0, 20.0]):
            assert not around.is_appendage(np.array(way), MIDDLE, VALVE, WIDEST_MM)
