import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage, sparse
from scipy.sparse.csgraph import minimum_spanning_tree

from heartcase.pipeline.artifacts.cache import Cache
from heartcase.pipeline.data import UNMARKED, Scan
from heartcase.pipeline.image.landscape import landscape
from heartcase.pipeline.watershed import tree_cache as kept
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree import build_basin_tree
from heartcase.pipeline.watershed.tree_cache import scan_tree
from heartcase.schemas.errors import StageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.settings import SegmentSettings


def noise(seed, shape=(15, 21, 18), sigma=0.8):
    values = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), sigma)
    return (values - values.min()).astype(np.float32)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 1000), shape=st.tuples(st.integers(1, 9), st.integers(1, 9), st.integers(1, 9)))
def test_its_passes_are_those_of_a_spanning_tree_by_scipy(seed, shape):
    """The heights of the faces that join the basins, and the steps inside them, against all faces of all voxels."""
    height = noise(seed, shape)
    tree = build_basin_tree(height)
    number = np.arange(height.size).reshape(shape)
    pairs = np.concatenate(
        [np.stack([np.delete(number, -1, a).ravel(), np.delete(number, 0, a).ravel()], 1) for a in range(3)]
    )
    if not len(pairs):
        assert tree.basin_count == 1
        return
    weight = height.ravel()[pairs].max(axis=1).astype(float) + 1.0
    want = minimum_spanning_tree(sparse.coo_matrix((weight, pairs.T), shape=(height.size,) * 2)).data - 1.0
    steps = height.ravel()[np.setdiff1d(number.ravel(), tree.root)]
    joins = height.ravel()[tree.ends[0]]
    np.testing.assert_allclose(np.sort(np.concatenate([steps, joins])), np.sort(want), atol=1e-6)


def test_basins_are_numbered_by_their_lowest_voxel_and_hold_what_drains_there():
    height = noise(1)
    tree = build_basin_tree(height)
    start, voxels = tree.voxels
    assert np.all(np.diff(tree.root) > 0)
    for b in range(tree.basin_count):
        mine = voxels[start[b] : start[b + 1]]
        assert np.all(np.diff(mine) > 0)
        assert (tree.basin.ravel()[mine] == b).all()
        assert mine[np.argmin(height.ravel()[mine])] == tree.root[b]
        whole = tree.basin == b
        assert ndimage.label(whole)[1] == 1
    start, faces = tree.neighbours
    assert sorted(faces.tolist()) == sorted(2 * list(range(tree.basin_count - 1)))
    for b in range(tree.basin_count):
        assert all(b in (tree.basins[0][e], tree.basins[1][e]) for e in faces[start[b] : start[b + 1]])


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 9), (1, 7, 1), (6, 1, 1), (2, 2, 2)])
@pytest.mark.parametrize("value", [0.0, -0.0, 3.5])
def test_a_flat_landscape_is_one_basin(shape, value):
    tree = build_basin_tree(np.full(shape, value, np.float32))
    assert tree.basin_count == 1
    assert tree.flat.tolist() == [0 if np.prod(shape) > 1 else -1]
    marks = np.full(shape, UNMARKED, np.uint8)
    assert (solve_forest(tree, marks).labels == UNMARKED).all()
    marks.flat[0] = 4
    assert (solve_forest(tree, marks).labels == 4).all()


def test_on_a_plateau_two_floods_meet_half_way():
    marks = np.full((1, 1, 10), UNMARKED, np.uint8)
    marks[0, 0, [0, 9]] = 3, 0
    for height in (0.0, 2.0):
        tree = build_basin_tree(np.full((1, 1, 10), height, np.float32))
        assert solve_forest(tree, marks).labels.ravel().tolist() == [3] * 5 + [0] * 5


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0])
def test_what_is_no_landscape_is_refused(bad):
    height = noise(2)
    height[3, 4, 5] = bad
    with pytest.raises(StageError, match="negative or not a number"):
        build_basin_tree(height)


def test_views_that_are_not_contiguous_work():
    height = noise(3)
    turned = build_basin_tree(height.transpose(2, 0, 1))
    np.testing.assert_array_equal(turned.basin, build_basin_tree(height.transpose(2, 0, 1).copy()).basin)


THREADS = """
import hashlib, sys
import numpy as np
from tests.pipeline.watershed.test_tree import noise
from heartcase.pipeline.watershed.forest import solve_forest
from heartcase.pipeline.watershed.tree import build_basin_tree
height = noise(4, (40, 37, 45))
height[:, :9] = np.floor(height[:, :9] * 9.0)
tree = build_basin_tree(height)
random = np.random.default_rng(5)
markers = np.full(height.shape, 255, np.uint8)
markers.flat[random.choice(markers.size, 300, replace=False)] = random.integers(0, 9, 300)
forest = solve_forest(tree, markers)
for n in range(30):
    start = random.integers(0, height.size - 50)
    forest.paint(np.arange(start, start + 40, 3), int(random.choice([0, 1, 5, 255])))
digest = hashlib.sha256()
for array in (tree.direction, tree.basin, tree.root, tree.key, forest.labels, forest.foot_level):
    digest.update(array.tobytes())
sys.stdout.write(digest.hexdigest())
"""


def test_the_bytes_are_the_same_with_any_number_of_threads(monkeypatch):
    found = set()
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
        done = subprocess.run([sys.executable, "-c", THREADS], capture_output=True, text=True, check=True)
        found.add(done.stdout)
    assert len(found) == 1
    assert len(found.pop()) == 64


def test_a_kept_tree_is_the_tree(tmp_path, monkeypatch):
    values = np.random.default_rng(6).normal(0.0, 50.0, (9, 10, 11)).astype(np.float32)
    scan = Scan(values, Geometry.of(shape=values.shape, spacing_mm=(1.0, 1.0, 2.0)))
    cache = Cache(tmp_path)
    stated = SegmentSettings(shape_sigma_mm=2.0, noise_floor=1.0)
    kept_in = {"cache": cache, "scan_sha256": "a"}
    first = scan_tree(scan, stated, **kept_in)

    def no_work(height, *costs):
        raise AssertionError("worked out again")

    with monkeypatch.context() as patched:
        patched.setattr(kept, "build_basin_tree", no_work)
        again = scan_tree(scan, stated, **kept_in)
        for name in ("height", "direction", "basin", "root", "key", "cost"):
            np.testing.assert_array_equal(getattr(again, name), getattr(first, name))
        assert again.axis_cost == first.axis_cost == (2, 1, 1)
        with pytest.raises(AssertionError, match="worked out"):
            scan_tree(scan, stated, **(kept_in | {"scan_sha256": "b"}))
        for changed in ({"gradient_sigma_mm": 1.0}, {"shape_sigma_mm": 0.0}, {"noise_floor": 0.0}):
            with pytest.raises(AssertionError, match="worked out"):
                scan_tree(scan, stated.model_copy(update=changed), **kept_in)
    for file in tmp_path.glob("basins-*.safetensors"):
        file.write_bytes(file.read_bytes()[:-3] + b"xyz")
    np.testing.assert_array_equal(scan_tree(scan, stated, **kept_in).key, first.key)


def test_a_tree_is_made_as_its_kind_of_scan_asks():
    values = np.random.default_rng(6).normal(0.0, 50.0, (9, 10, 11)).astype(np.float32)
    geometry = Geometry.of(shape=values.shape, spacing_mm=(1.0, 1.0, 2.0))
    for modality, stated in (
        ("CT", {"shape_sigma_mm": 3.0, "noise_floor": 4.0}),
        ("MR", {"shape_sigma_mm": 3.0, "noise_floor": 6.0}),
        ("unknown", {"shape_sigma_mm": 3.0, "noise_floor": 6.0}),
    ):
        scan = Scan(values, geometry, modality)
        want = landscape(values, geometry.spacing_mm, gradient_sigma_mm=0.0, **stated)
        for found in (
            scan_tree(scan, SegmentSettings()),
            scan_tree(dataclasses.replace(scan, modality="MR"), SegmentSettings(**stated)),
        ):
            np.testing.assert_array_equal(found.height, want.height)
            np.testing.assert_array_equal(found.cost, want.cost)
