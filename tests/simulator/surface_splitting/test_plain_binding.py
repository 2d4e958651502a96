"""What is asked of vertices near sheets alone is what plain NumPy says of all, to the bit."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.simulator.cutting.parted_lattice import part
from heartcase.simulator.mesh_arrangement.arrange import NOTHING_CROSSES, crossings
from heartcase.simulator.surface_splitting import surface_binding
from heartcase.simulator.surface_splitting.lips_and_walls import split_mesh
from heartcase.simulator.surface_splitting.split_surface import _directions as directions
from tests.simulator.surface_splitting.plain_binding import (
    plain_directions,
    plain_near_sheets,
    plain_towards_own_triangles,
)
from tests.simulator.surface_splitting.surfaces import plane, sheets
from tests.simulator.surface_splitting.test_split_surface import BENT, MODEL, TISSUE

together = st.lists(st.sampled_from([plane(0, 1.3), plane(1, 1.0), plane(2, 0.8, high=1.2)]), min_size=1, max_size=3)


@settings(max_examples=40, deadline=None)
@given(st.one_of(sheets(), together))
def test_vertices_near_sheets_are_asked_as_all_are(blades):
    split = split_mesh(BENT.mesh, crossings(BENT.mesh, blades, NOTHING_CROSSES, 0))
    for found, wanted in zip(directions(BENT, split), plain_directions(BENT, split), strict=True):
        np.testing.assert_array_equal(found, wanted, strict=True)
    parted = part(MODEL, blades, TISSUE)
    old = split.places[: len(BENT.normals)]
    near = surface_binding._near_sheets(MODEL, parted, BENT.tied)
    np.testing.assert_array_equal(near, plain_near_sheets(MODEL, parted, old), strict=True)
    towards = surface_binding._towards_own_triangles(split, BENT.tied, near)
    np.testing.assert_array_equal(towards, plain_towards_own_triangles(split, near), strict=True)


def test_only_vertices_near_a_small_sheet_are_asked():
    """In a box that is larger than what a sheet comes to."""
    blades = [plane(2, 0.8, low=-0.2, high=0.3)]
    parted = part(MODEL, blades, TISSUE)
    near = surface_binding._near_sheets(MODEL, parted, BENT.tied)
    assert 0 < len(near) < len(BENT.mesh.places)
