"""Segments, parts and marker files that overlap: told, counted, and put in the order that the recipe asks for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from heartcase.cli.main import main
from heartcase.pipeline.artifacts.serialise import load_artifact
from heartcase.pipeline.data import Scan, Segmentation
from heartcase.pipeline.formats.labels.segments import SegmentInfo, count_overlaps, segments_of, stacking_of
from heartcase.pipeline.formats.write_images import write_scan
from heartcase.pipeline.markers.load_markers import load_markers, load_segmentation
from heartcase.pipeline.warnings import WarningGrade
from heartcase.schemas.errors import RecipeError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import default_label_table
from heartcase.schemas.recipe.recipe import MarkerFile, parse_recipe
from tests.pipeline.formats.test_dicom_seg import highdicom_seg, source_images
from tests.pipeline.formats.test_stl_parts import write
from tests.pipeline.markers.test_markers import mrk, points, seg_nrrd

TABLE = default_label_table()
GEOMETRY = Geometry.of(shape=(16, 14, 12), spacing_mm=(1.0, 1.0, 2.0), origin_mm=(-5.5, -6.5, -15.0))
LA, RA, AORTA = (TABLE[name].value for name in ("LA", "RA", "aorta"))


def two_cubes(path: Path, *names: str) -> np.ndarray:
    """Two boxes in two layers that share a cube of 64 voxels; the shared voxels."""
    values = np.zeros((*GEOMETRY.shape, len(names)), np.uint8)
    values[2:8, 2:8, 2:8, 0] = 1
    values[4:10, 4:10, 4:10, 1] = 1
    seg_nrrd(path, values, GEOMETRY, [{"Name": n, "LabelValue": "1", "Layer": str(at)} for at, n in enumerate(names)])
    shared = (values != 0).all(axis=-1)
    assert shared.sum() == 64
    return shared


def test_a_cube_in_both_layers_is_told_with_its_size_and_both_names(tmp_path: Path) -> None:
    shared = two_cubes(tmp_path / "f.seg.nrrd", "left atrium", "aorta")
    found = load_segmentation(tmp_path / "f.seg.nrrd", {}, TABLE, GEOMETRY)
    assert (found.labels[shared] == AORTA).all()
    (warning,) = found.warnings
    assert warning.grade is WarningGrade.LOOK
    assert "64 voxels (0.13 ml)" in warning.text
    assert f"both the {TABLE[LA].name} (segment 1 of the file) and the aorta (segment 2 of the file)" in warning.text
    assert "the aorta lies on top" in warning.text


@pytest.mark.parametrize(
    ("order", "winner"),
    [((), AORTA), (("left atrium",), LA), (("aorta", "LA"), LA), (("LA", "aorta"), AORTA), (("RA",), AORTA)],
)
def test_the_recipe_chooses_which_lies_on_top(tmp_path: Path, order: tuple[str, ...], winner: int) -> None:
    shared = two_cubes(tmp_path / "f.seg.nrrd", "left atrium", "aorta")
    found = load_segmentation(tmp_path / "f.seg.nrrd", {}, TABLE, GEOMETRY, order=order)
    assert (found.labels[shared] == winner).all()
    assert f"the {TABLE[winner].name} lies on top" in found.warnings[0].text
    file = MarkerFile(path="f.seg.nrrd", order=order)
    markers = load_markers((file,), (), TABLE, GEOMETRY, tmp_path)
    assert (markers.labels[shared] == winner).all()
    assert markers.warnings[0].text.startswith("markers[1]: 64 voxels")


def test_what_is_one_label_or_left_out_overlaps_nothing(tmp_path: Path) -> None:
    two_cubes(tmp_path / "f.seg.nrrd", "upper aorta", "lower aorta")
    names = {"upper aorta": "aorta", "lower aorta": "aorta"}
    assert load_segmentation(tmp_path / "f.seg.nrrd", names, TABLE, GEOMETRY).warnings == ()
    two_cubes(tmp_path / "g.seg.nrrd", "aorta", "spleen")
    assert load_segmentation(tmp_path / "g.seg.nrrd", {}, TABLE, GEOMETRY, others="ignore").warnings == ()


def test_parts_that_overlap(tmp_path: Path) -> None:
    for name, first in (("Aorta", -3.0), ("LA", -1.0)):
        box = trimesh.creation.box(bounds=[(first, -3.0, -8.0), (first + 4.0, 1.0, 0.0)])
        write(tmp_path / f"{name}.stl", box, header="SPACE=LPS")
    found = load_segmentation(tmp_path, {}, TABLE, GEOMETRY)
    # 2 x 4 x 8 mm are in both, a voxel has 2 mm3
    (warning,) = found.warnings
    assert "32 voxels (0.064 ml)" in warning.text
    assert f"the {TABLE[LA].name} lies on top" in warning.text
    other = load_segmentation(tmp_path, {}, TABLE, GEOMETRY, order=("aorta",))
    changed = found.labels != other.labels
    assert changed.sum() == 32
    assert (other.labels[changed] == AORTA).all()


def test_segments_of_a_dicom_seg_that_overlap(tmp_path: Path) -> None:
    geometry = Geometry.of(shape=(6, 16, 18), spacing_mm=(1.0, 1.0, 2.0))
    layers = np.zeros((*geometry.shape, 2), np.uint8)
    layers[1:5, 2:10, 2:10, 0] = 1
    layers[2:6, 6:12, 6:12, 1] = 1
    seg = highdicom_seg(source_images(geometry, tmp_path), layers)
    seg.save_as(tmp_path / "s.dcm")
    from heartcase.pipeline.formats.read_scan import read_labels

    (overlap,) = read_labels(tmp_path / "s.dcm", geometry).overlaps
    assert (overlap.under, overlap.over) == (1, 2)
    assert overlap.voxel_count == 3 * 4 * 4
    first_on_top = read_labels(tmp_path / "s.dcm", geometry, rank=lambda segment: -segment.number)
    assert (first_on_top.overlaps[0].under, first_on_top.overlaps[0].over) == (2, 1)
    assert (first_on_top.values == 1).sum() == layers[..., 0].sum()


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 5))
def test_merging_and_counting_is_what_painting_one_after_the_other_gives(seed: int, count: int) -> None:
    """Against a plain loop over segments, in any order and with some left out."""
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 3, (3, 4, 5, count)).astype(np.uint16)
    header = {}
    masks = {}
    for number in range(1, 2 * count + 1):
        layer, value = (number - 1) // 2, 1 + (number - 1) % 2
        header |= {f"Segment{number}_Name": f"s{number}", f"Segment{number}_Layer": str(layer)}
        header |= {f"Segment{number}_LabelValue": str(value)}
        masks[number] = values[..., layer] == value
    ranks = {number: int(rng.integers(0, 3)) for number in masks}
    out = {number for number in masks if rng.random() < 0.2}
    merged, _, vanished, overlaps = segments_of(
        values, header, lambda one: one.number in out, lambda one: ranks[one.number]
    )
    order = sorted((number for number in masks if number not in out), key=lambda number: (ranks[number], number))
    expected = np.zeros(values.shape[:3], np.uint16)
    for number in order:
        expected[masks[number]] = number
    np.testing.assert_array_equal(merged, expected)
    pairs = {
        (low, high): int((masks[low] & masks[high]).sum())
        for at, low in enumerate(order)
        for high in order[at + 1 :]
        if (masks[low] & masks[high]).any()
    }
    assert {(one.under, one.over): one.voxel_count for one in overlaps} == pairs
    assert set(vanished) == {n for n, mask in masks.items() if mask.any() and not (expected == n).any()}


def test_counting_looks_at_pairs_of_a_voxel_in_three_segments() -> None:
    layers = [np.array([n, n, 0], np.uint16) for n in (1, 2, 3)]
    assert count_overlaps(layers) == {(1, 2): 2, (1, 3): 2, (2, 3): 2}
    assert count_overlaps([]) == {}
    infos = [SegmentInfo(1, ""), SegmentInfo(2, ""), SegmentInfo(3, "")]
    assert stacking_of(infos, lambda one: one.number == 2, lambda one: -one.number).numbers == (3, 1)


def test_a_later_marker_file_paints_over_an_earlier_one_and_says_so(tmp_path: Path) -> None:
    values = np.zeros(GEOMETRY.shape, np.uint8)
    values[2:8, 2:8, 2:8] = 1
    seg_nrrd(tmp_path / "a.seg.nrrd", values, GEOMETRY, [{"Name": "aorta", "LabelValue": "1", "Layer": "0"}])
    at = GEOMETRY.index_to_world((4, 4, 4)).tolist()
    mrk(tmp_path / "b.mrk.json", points("Fiducial", "LPS", [at], ["right atrium"]))
    files = [MarkerFile(path="a.seg.nrrd"), MarkerFile(path="b.mrk.json", radius_mm=0.0)]
    (warning,) = load_markers(files, (), TABLE, GEOMETRY, tmp_path).warnings
    assert warning.grade is WarningGrade.NOTE
    assert "markers[2] paints over" in warning.text
    assert f"1 voxel (0.002 ml) of the aorta become {TABLE[RA].name}" in warning.text
    assert load_markers(files[:1], (), TABLE, GEOMETRY, tmp_path).warnings == ()


RECIPE = """
heartcase_recipe = 1
name = "twice"
[scan]
path = "scan.nii.gz"
[segment]
method = "labels"
file = "f.seg.nrrd"
"""


def test_validate_and_segment_say_it_and_the_output_carries_it_on(tmp_path: Path, capsys) -> None:
    two_cubes(tmp_path / "f.seg.nrrd", "left atrium", "aorta")
    write_scan(Scan(np.zeros(GEOMETRY.shape, np.float32), GEOMETRY), tmp_path / "scan.nii.gz")
    recipe = tmp_path / "twice.toml"
    recipe.write_text(RECIPE)
    assert main(["validate", str(recipe)]) == 0
    said = capsys.readouterr().out
    assert "warning: segmentation: 64 voxels" in said
    assert said.endswith("sound\n")
    out = tmp_path / "labels.safetensors"
    assert main(["segment", str(tmp_path / "scan.nii.gz"), str(out), "--recipe", str(recipe)]) == 0
    assert "64 voxels" in capsys.readouterr().out
    assert "64 voxels" in load_artifact(out, Segmentation).warnings[0].text


def test_an_order_that_names_no_label_is_refused() -> None:
    with pytest.raises(RecipeError, match=r"segment\.order: there is no label 'spleen'"):
        parse_recipe(RECIPE + 'order = ["spleen"]\n')
