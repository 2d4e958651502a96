from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.pipeline.formats.dicom.stack import Slice, find_stack
from heartcase.pipeline.formats.dicom.straighten import straight_shape, straightened, with_missing
from heartcase.schemas.errors import ScanError

COUNT, ROWS, COLUMNS = 10, 7, 6
component = st.floats(-1.0, 1.0)


def rotation(q: tuple[float, ...]) -> np.ndarray:
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def slices_at(positions: np.ndarray, matrix: np.ndarray, spacing: tuple[float, float]) -> list[Slice]:
    """Slices in reverse order; spacing is that along rows, then along columns."""
    orientation = (*matrix[:, 0], *matrix[:, 1])
    return [
        Slice(Path(), None, (ROWS, COLUMNS), True, tuple(position), orientation, (spacing[1], spacing[0]), 1.0, 0.0)
        for position in positions[::-1]
    ]


def sampled(image: Slice, gradient: np.ndarray) -> np.ndarray:
    """A linear field at the pixels of a slice."""
    rows, columns = np.indices(image.shape)
    orientation = np.array(image.orientation)
    points = (
        np.array(image.position)
        + columns[..., np.newaxis] * orientation[:3] * image.spacing[1]
        + rows[..., np.newaxis] * orientation[3:] * image.spacing[0]
    )
    return points @ gradient


@settings(max_examples=60, deadline=None)
@given(
    quaternion=st.tuples(component, component, component, component).filter(lambda q: np.linalg.norm(q) > 0.1),
    spacing=st.tuples(*[st.floats(0.4, 3.0)] * 3),
    lean=st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0)).filter(lambda step: np.hypot(*step) > 0.35),
    gradient=st.tuples(component, component, component),
    gone=st.sampled_from([(), (3,), (2, 3), (1, 4, 5)]),
)
def test_a_linear_field_is_exact_wherever_the_slices_reach(quaternion, spacing, lean, gradient, gone) -> None:
    """Linear interpolation keeps a linear field, whichever way the stack leans and whatever is missing."""
    matrix, gradient = rotation(quaternion), np.array(gradient)
    step = matrix @ np.array([lean[0], lean[1], spacing[2]])
    positions = np.array([-20.0, 30.0, 5.0]) + np.arange(COUNT)[:, np.newaxis] * step
    kept = [k for k in range(COUNT) if k not in gone]
    slices = slices_at(positions[kept], matrix, spacing[:2])
    with pytest.raises(ScanError, match=r"leans by [\d.]+ degrees"):
        find_stack(slices, interpolate_missing=True)
    stack = find_stack(slices, interpolate_missing=True, straighten_tilt=True)
    assert stack.missing == gone
    assert stack.tilt_degrees == pytest.approx(np.degrees(np.arctan(np.hypot(*lean) / spacing[2])))
    values = np.stack([sampled(image, gradient) for image in stack.slices]).astype(np.float32)
    result, affine = straightened(values, stack)
    result = with_missing(result, stack)
    assert result.shape == straight_shape(stack)

    k, j, i = np.indices(result.shape)
    points = np.stack([i, j, k, np.ones_like(i)], axis=-1) @ affine.T
    truth = points[..., :3] @ gradient
    np.testing.assert_allclose(affine[:3, :3], matrix * spacing, atol=1e-9)
    reached, beyond = np.zeros(result.shape, dtype=bool), np.zeros(result.shape, dtype=bool)
    last = np.array([COLUMNS - 1, ROWS - 1])
    for place, position in enumerate(positions):
        local = ((points[place, ..., :3] - position) @ matrix / spacing)[..., :2]
        reached[place] = ((local >= -1e-9) & (local <= last + 1e-9)).all(axis=-1)
        beyond[place] = ((local < -1e-5) | (local > last + 1e-5)).any(axis=-1)
        assert (~beyond[place]).sum() >= (COLUMNS - 1) * (ROWS - 1)
    measured = reached.copy()
    for place in gone:  # between two slices, it takes both
        below, above = max(n for n in kept if n < place), min(n for n in kept if n > place)
        measured[place] = reached[below] & reached[above]
    np.testing.assert_allclose(result[measured], truth[measured], atol=1e-3)
    assert (result[kept][beyond[kept]] == values.min()).all()


def test_a_straight_stack_is_left_as_it_is() -> None:
    positions = np.arange(4)[:, np.newaxis] * np.array([0.0, 0.0, 2.0])
    stack = find_stack(slices_at(positions, np.eye(3), (1.0, 1.0)), straighten_tilt=True, interpolate_missing=True)
    values = np.random.default_rng(0).normal(size=(4, ROWS, COLUMNS)).astype(np.float32)
    result, affine = straightened(values, stack)
    assert result is values
    assert with_missing(values, stack) is values
    np.testing.assert_array_equal(affine, stack.affine)


@pytest.mark.parametrize(
    ("kept", "words"),
    [
        ([0, 4, 5, 6, 7, 8, 9, 10, 11], "3 slices are missing"),
        ([0, 1, 2, 3, 4, 5, 6, 7, 10, 11], ""),
        ([0, 3, 6, 7, 9, 10, 11], "5 of 12 slices are missing, more than a third"),
        ([0, 2, 3, 5, 6, 8, 9, 11], ""),
    ],
)
def test_how_much_may_be_missing(kept: list[int], words: str) -> None:
    positions = np.array(kept)[:, np.newaxis] * np.array([0.0, 0.0, 1.5])
    slices = slices_at(positions, np.eye(3), (1.0, 1.0))
    if words:
        with pytest.raises(ScanError, match=words):
            find_stack(slices, interpolate_missing=True)
        return
    stack = find_stack(slices, interpolate_missing=True)
    assert stack.places == tuple(kept)
    np.testing.assert_allclose(stack.affine[:3, 2], [0.0, 0.0, 1.5])
