"""Slices lie the way radiologists look at them, whatever the axes of the volume are."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heartcase.pipeline.report.slices import display_window, slice_pictures, slice_view
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table

SIGNED_AXES = [
    np.eye(3)[:, list(order)] * signs
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1.0, -1.0), repeat=3)
]
STRAIGHT = {
    "axial": {"left": "R", "right": "L", "top": "A", "bottom": "P"},
    "coronal": {"left": "R", "right": "L", "top": "S", "bottom": "I"},
    "sagittal": {"left": "A", "right": "P", "top": "S", "bottom": "I"},
}
LETTER_DIRECTIONS = {"L": (1, 0, 0), "R": (-1, 0, 0), "P": (0, 1, 0), "A": (0, -1, 0), "S": (0, 0, 1), "I": (0, 0, -1)}


@pytest.mark.parametrize("direction", SIGNED_AXES[::3])
@pytest.mark.parametrize("stack", ["axial", "coronal", "sagittal"])
def test_every_axis_order_and_handedness_is_shown_the_same_way(stack, direction):
    geometry = Geometry.of(shape=(7, 8, 9), spacing_mm=(1.0, 2.0, 3.0), direction=direction)
    view = slice_view(geometry, stack)
    assert view.letters == STRAIGHT[stack]
    index = np.stack(np.meshgrid(*(np.arange(n) for n in geometry.size), indexing="ij"), axis=-1)
    world = geometry.index_to_world(index).transpose(2, 1, 0, 3)
    for side, step in (("right", (0, 1)), ("bottom", (1, 0))):
        toward = np.array(LETTER_DIRECTIONS[STRAIGHT[stack][side]])
        along = view.take(world @ toward, 2)
        moved = along[step[0] :, step[1] :] - along[: along.shape[0] - step[0], : along.shape[1] - step[1]]
        assert (moved > 0.5).all()


def test_letters_of_an_oblique_scan_name_the_nearest_directions():
    turned = Rotation.from_euler("z", 30.0, degrees=True).as_matrix()
    letters = slice_view(Geometry.of(shape=(5, 5, 5), direction=turned), "axial").letters
    # i runs along (cos 30, sin 30, 0): mostly to the left, half to the back; j along (-sin 30, cos 30, 0).
    assert letters == {"left": "RA", "right": "LP", "top": "AL", "bottom": "PR"}
    slightly = Rotation.from_euler("z", 10.0, degrees=True).as_matrix()
    assert slice_view(Geometry.of(shape=(5, 5, 5), direction=slightly), "axial").letters == STRAIGHT["axial"]


def ball_scan(spacing: tuple[float, float, float]) -> tuple[np.ndarray, Geometry]:
    """A bright ball of 20 mm radius in the middle of a cube of 64 mm."""
    size = [round(64.0 / s) for s in spacing]
    geometry = Geometry.of(shape=tuple(reversed(size)), spacing_mm=spacing)
    index = np.stack(np.meshgrid(*(np.arange(n) for n in size), indexing="ij"), axis=-1).transpose(2, 1, 0, 3)
    centre = geometry.index_to_world((np.array(size) - 1) / 2.0)
    inside = np.linalg.norm(geometry.index_to_world(index) - centre, axis=-1) < 20.0
    return inside.astype(np.uint8), geometry


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (1.0, 1.0, 4.0), (2.0, 1.0, 0.5)])
def test_ball_is_round_in_every_stack_of_an_anisotropic_scan(spacing):
    inside, geometry = ball_scan(spacing)
    rows = slice_pictures(inside.astype(float), geometry, None, None, count=1, width=400, window=(0.0, 1.0))
    for stack, picture in rows.items():
        # Without the caption and the writing at the edges.
        cell = picture[-390:, 30:-30].astype(int)
        bright = (cell.min(axis=2) > 127)[40:-40]
        rows_used, columns_used = np.flatnonzero(bright.any(axis=1)), np.flatnonzero(bright.any(axis=0))
        height, width = np.ptp(rows_used) + 1, np.ptp(columns_used) + 1
        voxel_pixels = max(spacing) * 400 / 64
        assert abs(height - width) <= voxel_pixels + 2, stack
        assert width == pytest.approx(40.0 * 400 / 64, abs=voxel_pixels + 4), stack


def test_outlines_have_the_labels_colours_and_hug_the_label():
    inside, geometry = ball_scan((1.0, 1.0, 1.0))
    table = default_label_table()
    labels = (inside * 5).astype(np.uint8)
    picture = slice_pictures(np.zeros(geometry.shape), geometry, labels, table, count=1, width=400)["axial"].astype(int)
    aorta = [int(table[5].colour[n : n + 2], 16) for n in (1, 3, 5)]
    rows, columns = np.nonzero(np.abs(picture - aorta).sum(axis=2) < 60)
    assert len(rows) > 300
    # Cropped to the ball with a margin of 12 mm each side: 64 mm across 400 pixels.
    centre = np.array([rows.min() + rows.max(), columns.min() + columns.max()]) / 2.0
    radius = np.hypot(rows - centre[0], columns - centre[1]) * 64.0 / 400.0
    assert np.abs(radius - 20.0).max() < 1.5


def test_crop_follows_the_labels():
    geometry = Geometry.of(shape=(40, 80, 120))
    labels = np.zeros(geometry.shape, np.uint8)
    labels[10:20, 30:50, 100:120] = 1
    rows = slice_pictures(np.zeros(geometry.shape), geometry, labels, default_label_table(), count=2, width=400)
    whole = slice_pictures(np.zeros(geometry.shape), geometry, None, None, count=2, width=400)
    # 32 x 44 mm around the label against 120 x 80 mm of the whole slice.
    assert rows["axial"].shape[0] > whole["axial"].shape[0]


def test_window_of_ct_leaves_the_air_black():
    values = np.concatenate([np.full(500_000, -1000.0), np.full(490_000, 40.0), np.full(10_000, 400.0)])
    volume = values.reshape(100, 100, 100)
    assert display_window(volume, modality="CT") == (-250.0, 400.0)
    assert display_window(volume)[0] == -1000.0
    assert display_window(np.full((4, 4, 4), 7.0)) == (7.0, 8.0)
