"""What one more sheet leaves is what all sheets at once leave, to the byte."""

from __future__ import annotations

from dataclasses import fields, is_dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.schemas.bundle.lattice import lattice_keys
from heartcase.simulator.cutting.bit_masks.touched import begun_among, places_of_links
from heartcase.simulator.cutting.blade_sheet import (
    Sheet,
    checked_poses,
    crossed_links,
    key_indices,
    touched_places,
)
from heartcase.simulator.cutting.blade_sheet import _swept_in_parts as swept_in_parts
from heartcase.simulator.cutting.crossings import SAMPLES
from heartcase.simulator.cutting.cuts import Cuts
from heartcase.simulator.cutting.descent import descent_of, nodes_now
from heartcase.simulator.cutting.parted_lattice import PartedLattice, part
from heartcase.simulator.cutting.tissue_samples import TissueSamples
from heartcase.simulator.lattice.moduli import ForceLaw
from tests.simulator.cutting.test_parted_lattice import blades, block
from tests.simulator.cutting.test_plain_parting import BALL

# Along faces of cells and through samples, a sheet lies on what it may cross.
even = st.integers(-4, 36).map(lambda n: n / 8)
along_faces = st.lists(
    st.tuples(st.integers(0, 2), st.integers(0, 4).map(float), st.lists(even, min_size=4, max_size=4)).map(
        lambda drawn: [
            [tuple(np.roll((drawn[1], drawn[2][a], drawn[2][2 + b]), drawn[0])) for b in (0, 1)] for a in (0, 1)
        ]
    ),
    min_size=1,
    max_size=2,
)


def assert_same(one, other, name):
    """Arrays have the same type, shape and bytes, in all fields but what a further sheet goes on from."""
    if isinstance(one, np.ndarray):
        assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes()), name
    elif is_dataclass(one):
        for each in fields(one):
            if each.name != "found":
                assert_same(getattr(one, each.name), getattr(other, each.name), f"{name}.{each.name}")


def assert_parted_alike(cuts: Cuts, sheets: list[Sheet]) -> None:
    """Sheet by sheet, and all at once."""
    before: PartedLattice | None = None
    for number, sheet in enumerate(sheets):
        cuts, step = cuts.with_sheet(sheet)
        assert cuts.parted is not None
        assert cuts.parted.found is not None
        whole = part(cuts.uncut, sheets[: number + 1], cuts.tissue)
        assert_same(cuts.parted, whole, f"sheet {number}")
        descent = descent_of(cuts.uncut, before, whole)
        assert_same(step.descent, descent, f"descent {number}")
        assert_same(step.node_now, nodes_now(cuts.uncut, before, whole, descent.node_before), "heaviest")
        before = whole


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.one_of(blades, along_faces), min_size=1, max_size=2),
    st.integers(0, 9),
    st.sampled_from(["springs", "element"]),
)
def test_one_more_sheet_parts_as_all_at_once(found, seed, law):
    """Crossing, ending inside, along faces, or none: with tissue of a ball, or that fills its cells."""
    model = block((4, 4, 4), ForceLaw(law), kept=0.7, seed=seed)
    tissue = BALL if seed % 2 else TissueSamples.everywhere()
    assert_parted_alike(Cuts(model, tissue), [Sheet.swept(np.array(poses)) for blade in found for poses in blade])


@pytest.mark.thorough
@settings(max_examples=600, deadline=None)
@given(st.lists(st.one_of(blades, along_faces), min_size=1, max_size=3), st.integers(0, 99), st.booleans())
def test_more_sheets_part_as_all_at_once(found, seed, is_element):
    model = block((5, 4, 3), ForceLaw("element" if is_element else "springs"), kept=0.8, seed=seed)
    tissue = BALL if seed % 2 else TissueSamples.everywhere()
    assert_parted_alike(Cuts(model, tissue), [Sheet.swept(np.array(poses)) for blade in found for poses in blade])


def test_a_stroke_that_closes_on_itself_and_enters_again_parts_as_all_at_once():
    """A ring cut out in short samples, the last over the first, and then across."""
    model = block((9, 8, 3), kept=0.95, seed=3)
    turns = np.linspace(0.0, 2.2 * np.pi, 10)
    rim = np.stack([4.4 + 2.3 * np.cos(turns), 4.1 + 2.3 * np.sin(turns)], axis=1)
    blade = [[(x, y, -1.0), (x + 0.3, y, 2.7)] for x, y in rim]
    strokes = [blade[n : n + 2] for n in range(len(blade) - 1)]
    strokes += [[[(-1, 4.2, -1), (-1, 4.2, 1.6)], [(5, 4.6, -1), (5, 4.2, 1.6)]], strokes[2]]
    assert_parted_alike(Cuts(model, TissueSamples.everywhere()), [Sheet.swept(poses) for poses in strokes])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 6), st.integers(2, 12), st.sampled_from([0.3, 2.0, 9.0, 90.0]))
def test_a_sheet_is_swept_as_plain_numpy_sweeps_it(seed, poses, count, size):
    draw = np.random.default_rng(seed)
    blade = draw.uniform(-size, size, (poses, count, 3)) / max(poses, count)
    if seed % 3 == 0:
        blade = np.round(4 * blade) / 4
    if seed % 5 == 0:
        blade[draw.random((poses, count)) < 0.2] = np.nan
    found, wanted = Sheet.swept(blade), swept_in_parts(checked_poses(blade, "blade", may_be_open=True))
    assert_same(found.triangles, wanted.triangles, "triangles")
    assert_same(found.beyond, wanted.beyond, "beyond")
    np.testing.assert_array_equal(found.laid_out(), wanted.laid_out())
    if size < 3:
        touched = touched_places(found.links)
        assert_same(places_of_links(*found.links), touched, "touched")
        for axis in range(3):
            keys = crossed_links(found.beyond, axis)
            kept = keys[np.isin(lattice_keys(key_indices(keys) // SAMPLES), touched)]
            assert_same(begun_among(touched, keys), kept, "beyond")


def test_tissue_as_bits_is_what_it_is_as_samples():
    cells = np.stack(np.meshgrid(*[np.arange(-1, 6)] * 3), axis=-1).reshape(-1, 3).astype(np.int32)
    moments = np.random.default_rng(2).uniform(-0.4, 0.4, (len(cells), 9))
    for tissue in (BALL, TissueSamples.everywhere()):
        bits = tissue.bits_of(cells, moments)
        samples = (bits[:, :, None] >> np.arange(SAMPLES**2)) & 1
        np.testing.assert_array_equal(samples.reshape(len(cells), -1) == 1, tissue.of_cells(cells, moments))
