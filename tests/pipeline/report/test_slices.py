"""Slices lie the way radiologists look at them, whatever the axes of the volume are."""

import itertools
import re
from importlib.resources import files

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from heartcase.pipeline.report.slices import (
    STACKS,
    display_window,
    slice_number,
    slice_pictures,
    slice_position,
    slice_view,
)
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table

SIGNED_AXES = [
    np.eye(3)[:, list(order)] * signs
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1.0, -1.0), repeat=3)
]
STRAIGHT = {
    "axial": {"left": "R", "right": "L", "top": "A", "bottom": "P"},
    "coronal": {"left": "R", "right": "L", "top": "H", "bottom": "F"},
    "sagittal": {"left": "A", "right": "P", "top": "H", "bottom": "F"},
}
LETTER_DIRECTIONS = {"L": (1, 0, 0), "R": (-1, 0, 0), "P": (0, 1, 0), "A": (0, -1, 0), "H": (0, 0, 1), "F": (0, 0, -1)}


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


rotations = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)).filter(
    lambda q: np.linalg.norm(q) > 0.1
)


@settings(max_examples=60, deadline=None)
@given(
    rotations, st.booleans(), st.tuples(*[st.floats(0.4, 8.0)] * 3), st.sampled_from(["axial", "coronal", "sagittal"])
)
def test_painted_voxels_appear_where_the_letters_say_in_any_orientation(quaternion, mirror, spacing, stack):
    direction = Rotation.from_quat(quaternion).as_matrix() @ np.diag([-1.0 if mirror else 1.0, 1.0, 1.0])
    geometry = Geometry.of(shape=(11, 11, 11), spacing_mm=spacing, direction=direction)
    view = slice_view(geometry, stack)
    place = {}
    for sign in (1, -1):
        for axis in (view.across, view.down):
            values = np.zeros(geometry.shape)
            index = np.array([5, 5, 5])
            index[axis] += 4 * sign
            values[tuple(index[::-1])] = 1.0
            row, column = np.argwhere(view.take(values, 5))[0] - 5
            place["right" if column > 0 else "left" if column < 0 else "bottom" if row > 0 else "top"] = (
                geometry.index_to_world(index) - geometry.index_to_world((5, 5, 5))
            )
    assert set(place) == set(view.letters)
    for side, offset in place.items():
        along = [offset @ LETTER_DIRECTIONS[letter] / np.linalg.norm(offset) for letter in view.letters[side]]
        assert along[0] == pytest.approx(max(np.abs(offset)) / np.linalg.norm(offset))
        assert min(along) >= 0.35 - 1e-9
    # Not mirrored: the viewer stands at the feet, in front of the patient, or at the patient's left.
    ahead = np.cross(place["right"], place["bottom"])
    assert ahead @ {"axial": (0, 0, 1), "coronal": (0, 1, 0), "sagittal": (-1, 0, 0)}[stack] > 0.0
    # As much to the radiologist's right as any other way to lay these slices.
    right = np.array(LETTER_DIRECTIONS[STRAIGHT[stack]["right"]])
    down = np.array(LETTER_DIRECTIONS[STRAIGHT[stack]["bottom"]])
    toward = {side: offset / np.linalg.norm(offset) for side, offset in place.items()}
    assert toward["right"] @ right + toward["bottom"] @ down > 0.0


@pytest.mark.parametrize("direction", SIGNED_AXES[::9])
def test_what_is_marked_on_the_patients_left_is_on_the_right_of_axial_and_coronal_pictures(direction):
    geometry = Geometry.of(shape=(24, 24, 24), spacing_mm=(2.0, 2.0, 2.0), direction=direction)
    index = np.stack(np.meshgrid(*(np.arange(24),) * 3, indexing="ij"), axis=-1).transpose(2, 1, 0, 3)
    middle = geometry.index_to_world((11.5, 11.5, 11.5))
    marked = ((geometry.index_to_world(index) - middle)[..., 0] > 12.0).astype(float)
    rows = slice_pictures(marked, geometry, None, None, count=1, width=300, window=(0.0, 1.0))
    for stack in ("axial", "coronal"):
        bright = rows[stack][60:-60].astype(int).min(axis=2) > 200
        assert bright[:, 225:260].mean() > 0.9
        assert bright[:, 20:150].mean() < 0.05


def test_slice_positions_are_told_as_scanners_do():
    geometry = Geometry.of(shape=(10, 12, 14), spacing_mm=(1.5, 1.5, 4.0), origin_mm=(-9.0, 3.0, -20.0))
    assert slice_position(geometry, "axial", 0) == "F 20.0 mm"
    assert slice_position(geometry, "axial", 9) == "H 16.0 mm"
    assert slice_position(geometry, "coronal", 2) == "P 6.0 mm"
    assert slice_position(geometry, "sagittal", 0) == "R 9.0 mm"
    flipped = Geometry.of(shape=(10, 12, 14), spacing_mm=(1.5, 1.5, 4.0), direction=np.diag([1.0, 1.0, -1.0]))
    assert slice_position(flipped, "axial", 3) == "F 12.0 mm"
    turned = Rotation.from_euler("x", 40.0, degrees=True).as_matrix()
    oblique = Geometry.of(shape=(9, 9, 9), origin_mm=(5.0, 6.0, 7.0), direction=turned)
    along = np.array([5.0, 6.0, 7.0]) @ turned[:, 2] + 4.0
    assert slice_position(oblique, "axial", 4) == f"HA {along:.1f} mm"


@pytest.mark.parametrize(("spacing", "shape"), [((0.7, 0.7, 8.0), (8, 120, 90)), ((3.0, 0.5, 1.1), (60, 130, 20))])
def test_scale_bar_has_its_true_length(spacing, shape):
    geometry = Geometry.of(shape=shape, spacing_mm=spacing)
    rows = slice_pictures(np.zeros(shape), geometry, None, None, count=2, width=1400, window=(0.0, 1.0))
    for stack, picture in rows.items():
        view = slice_view(geometry, stack)
        # The first slice: black between white margins; rows of the bar are those of its colour.
        half = picture[:, :700].astype(int)
        inside = np.flatnonzero((half.max(axis=2) < 40).mean(axis=0) > 0.3)
        width_px = inside[-1] - inside[0] + 1
        wide_mm = geometry.size[view.across] * geometry.spacing_mm[view.across]
        gold = np.abs(half - [0xFF, 0xE9, 0xA8]).max(axis=2) < 12
        # The longest run of a row: the letter of the lower edge is gold as well.
        bar = max(len(run) for row in gold[-60:] for run in "".join("-#"[int(cell)] for cell in row).split("-"))
        length = max(mm for mm in (1, 2, 5, 10, 20, 50, 100, 200) if mm <= 0.25 * wide_mm)
        assert bar * wide_mm / width_px == pytest.approx(length, abs=2.0 * wide_mm / width_px), stack


def test_footnote_stands_below_every_row():
    geometry = Geometry.of(shape=(20, 20, 20))
    plain = slice_pictures(np.zeros(geometry.shape), geometry, None, None, count=2, width=400)
    noted = slice_pictures(np.zeros(geometry.shape), geometry, None, None, count=2, width=400, footnote="phase: 70 %")
    for stack, picture in noted.items():
        added = picture.shape[0] - plain[stack].shape[0]
        assert 20 <= added <= 45
        strip = picture[-added + 4 :, :200]
        assert (strip.min(axis=2) < 100).sum() > 60
        assert (strip[:, 180:] > 200).all()


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


def test_slices_are_counted_as_the_studio_counts_them():
    """From 1 to the head, the front and the left, whichever way the volume's axes run."""
    geometry = Geometry.of(shape=(10, 8, 6), spacing_mm=(3.0, 2.0, 4.0))
    assert [slice_number(geometry, stack, 0) for stack in STACKS] == [1, 8, 1]
    turned = Geometry.of(shape=(10, 8, 6), spacing_mm=(3.0, 2.0, 4.0), direction=np.diag([-1.0, -1.0, 1.0]))
    assert [slice_number(turned, stack, 2) for stack in STACKS] == [3, 3, 4]


def test_the_caption_names_the_letters_that_stand_in_the_pictures():
    template = files("heartcase.pipeline.report") / "templates" / "report.html.j2"
    named = re.search(r"Letters: ([^.]*)\.", template.read_text(encoding="utf-8"))
    assert {part.split()[0] for part in named[1].split(", ")} == set(LETTER_DIRECTIONS)
