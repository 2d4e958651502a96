"""Parting near the sheets is what plain NumPy makes of the whole lattice, to the bit."""

from __future__ import annotations

from dataclasses import fields
from unittest.mock import patch

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.plain_parting import plain_nodes_now, plain_parted, plain_stems, plain_tissue
from heartcase.simulator.cutting import pieces as pieces_module
from heartcase.simulator.cutting.blade_sheet import Sheet
from heartcase.simulator.cutting.descent import descent_of, nodes_now
from heartcase.simulator.cutting.parted_lattice import part
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.lattice.moduli import ForceLaw
from tests.simulator.cutting.test_parted_lattice import blades, block

# A ball of tissue as an octahedron: some of its samples lie on its faces.
CORNERS = np.array([(2, 2, -0.5), (2, 2, 4.5), (2, -0.5, 2), (2, 4.5, 2), (-0.5, 2, 2), (4.5, 2, 2)])
FACES = np.array([(a, b, c) for a in (0, 1) for b in (2, 3) for c in (4, 5)])
FACES[[0, 3, 5, 6]] = FACES[[0, 3, 5, 6]][:, ::-1]
BALL = TissueSamples.inside(CORNERS, FACES)


def assert_same_bytes(one, other):
    """Fields that are arrays have the same type, shape and bytes."""
    for each in fields(one):
        a, b = getattr(one, each.name), getattr(other, each.name)
        if isinstance(a, np.ndarray):
            assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes()), each.name


@settings(max_examples=60, deadline=None)
@given(st.lists(blades, min_size=1, max_size=2), st.integers(0, 9), st.sampled_from(["springs", "element"]))
def test_a_lattice_is_parted_as_plain_numpy_parts_it(found, seed, law):
    model = block((4, 4, 4), ForceLaw(law), kept=0.7, seed=seed)
    sheets = [Sheet.swept(np.array(poses)) for blade in found for poses in blade]
    tissue = BALL if seed % 2 else TissueSamples.everywhere()
    with patch.object(pieces_module, "_with_stems", plain_stems):
        wanted = part(model, sheets, tissue)
    parted = part(model, sheets, tissue)
    assert_same_bytes(parted.pieces, wanted.pieces)
    plain = plain_parted(model, parted.pieces)
    assert_same_bytes(parted, plain)
    assert_same_bytes(parted.model, plain.model)
    before = part(model, sheets[:-1], tissue) if len(sheets) > 1 else None
    descent = descent_of(model, before, parted).node_before
    heaviest = plain_nodes_now(model, before, parted, descent)
    np.testing.assert_array_equal(nodes_now(model, before, parted, descent), heaviest)


def test_samples_lie_in_the_tissue_where_plain_numpy_says_so():
    cells = np.stack(np.meshgrid(*[np.arange(-1, 6)] * 3), axis=-1).reshape(-1, 3).astype(np.int32)
    wanted = plain_tissue(BALL.entries, cells)
    found = BALL.of_cells(cells, np.zeros((len(cells), 9)))
    some = wanted.any(axis=1)
    assert 0 < some.sum() < len(cells)
    np.testing.assert_array_equal(found[some], wanted[some])
    assert (found[~some].sum(axis=1) == 1).all()
