from __future__ import annotations

import itertools
import json
from pathlib import Path

import nibabel
import numpy as np
import pytest
import SimpleITK
from hypothesis import example, given, settings
from hypothesis import strategies as st

from heartcase.pipeline.artifacts.serialise import artifact_from_bytes, artifact_to_bytes
from heartcase.pipeline.data import UNMARKED, Scan, Segmentation
from heartcase.pipeline.formats.read_scan import LabelVolume, read_labels
from heartcase.pipeline.formats.write_images import write_scan
from heartcase.pipeline.markers.load_markers import load_markers, load_segmentation, rasterise_strokes, resample_labels
from heartcase.pipeline.markers.paint import paint_passed_voxels
from heartcase.pipeline.warnings import WarningGrade
from heartcase.schemas.errors import MarkerError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable, default_label_table
from heartcase.schemas.recipe.recipe import MarkerFile
from heartcase.schemas.recipe.settings import Stroke

TABLE = default_label_table()
ANGLE = 0.4
TURN = np.array([[np.cos(ANGLE), 0, np.sin(ANGLE)], [0, 1, 0], [-np.sin(ANGLE), 0, np.cos(ANGLE)]])
OBLIQUE = Geometry.of(
    shape=(9, 14, 16), origin_mm=(-20.0, 35.0, -110.0), spacing_mm=(0.8, 1.3, 2.9), direction=TURN @ np.diag([1, 1, -1])
)
PLAIN = Geometry.of(shape=(12, 13, 14), origin_mm=(-50.0, 20.0, 5.0), spacing_mm=(1.0, 1.5, 2.0))


def stroke(label: str, radius: float, *points: tuple[float, float, float] | np.ndarray) -> Stroke:
    return Stroke(label=label, radius_mm=radius, points_mm=tuple(tuple(float(v) for v in point) for point in points))


def centres(geometry: Geometry) -> np.ndarray:
    k, j, i = np.meshgrid(*[np.arange(n) for n in geometry.shape], indexing="ij")
    return geometry.index_to_world(np.stack([i, j, k], axis=-1))


def distance_to_polyline(points: np.ndarray, polyline: np.ndarray) -> np.ndarray:
    """Distance of each point in world mm to a polyline, by the foot points on its segments."""
    best = np.full(points.shape[:-1], np.inf)
    for a, b in zip(
        polyline[: max(1, len(polyline) - 1)], polyline[1:] if len(polyline) > 1 else polyline, strict=True
    ):
        length = float((b - a) @ (b - a))
        t = np.clip((points - a) @ (b - a) / length, 0, 1) if length > 0 else np.zeros(points.shape[:-1])
        best = np.minimum(best, np.linalg.norm(points - a - t[..., np.newaxis] * (b - a), axis=-1))
    return best


def sampled_voxels(geometry: Geometry, polyline: np.ndarray, count: int = 20001) -> np.ndarray:
    """Voxels that hold a point of the polyline, by dense sampling."""
    t = np.linspace(0.0, 1.0, count)[:, np.newaxis]
    result = np.zeros(geometry.shape, bool)
    for a, b in itertools.pairwise(polyline):
        index = np.floor(geometry.world_to_index(a + t * (b - a)) + 0.5).astype(int)
        index = index[((index >= 0) & (index < geometry.size)).all(axis=1)]
        result[index[:, 2], index[:, 1], index[:, 0]] = True
    return result


def passed_voxels_painted(painted: np.ndarray, geometry: Geometry, polyline: np.ndarray) -> np.ndarray:
    """Whether each sampled point of the line lies in a painted voxel; on a face, by rounding, in either of the two."""
    t = np.linspace(0.0, 1.0, 5001)[:, np.newaxis]
    index = np.concatenate([geometry.world_to_index(a + t * (b - a)) for a, b in itertools.pairwise(polyline)])
    shifts = 1e-6 * np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    voxels = np.floor(index[:, np.newaxis] + shifts + 0.5).astype(int)
    voxels = voxels[((voxels >= 0) & (voxels < geometry.size)).all(axis=(1, 2))]
    found: np.ndarray = painted[voxels[..., 2], voxels[..., 1], voxels[..., 0]].any(axis=1)
    return found


index_coordinate = st.floats(-0.2, 1.2)


@settings(max_examples=25, deadline=None)
@given(
    fractions=st.lists(st.tuples(*[index_coordinate] * 3), min_size=1, max_size=4),
    radius=st.floats(0.5, 9.0),
    geometry=st.sampled_from([OBLIQUE, PLAIN]),
)
@example(fractions=[(0.0, 0.0, 0.5)], radius=1.0, geometry=OBLIQUE)  # along a face between two layers of voxels
def test_a_stroke_is_a_capsule_in_true_mm(fractions, radius: float, geometry: Geometry) -> None:
    polyline = geometry.index_to_world(np.array([(0.5, 0.5, 0.5), *fractions]) * geometry.size)
    painted = rasterise_strokes([stroke("aorta", radius, *polyline)], TABLE, geometry) == 5
    distance = distance_to_polyline(centres(geometry), polyline)
    # a voxel on the brush's rim may go either way by rounding
    rim = np.abs(distance - radius) < 1e-6
    np.testing.assert_array_equal(painted[(distance < radius) & ~rim], True)
    half_diagonal = 0.5 * np.linalg.norm(geometry.spacing_mm)
    beyond = painted & (distance > radius) & ~rim
    assert (distance[beyond] <= half_diagonal).all()
    assert passed_voxels_painted(painted, geometry, polyline).all()


def test_a_sphere_has_the_volume_of_a_sphere_on_an_oblique_lattice() -> None:
    geometry = Geometry.of(shape=(60, 80, 100), spacing_mm=(0.5, 0.7, 1.1), direction=TURN)
    centre = geometry.index_to_world((50.2, 40.3, 30.4))
    painted = rasterise_strokes([stroke("aorta", 12.0, centre)], TABLE, geometry) == 5
    volume = painted.sum() * geometry.voxel_volume_mm3
    assert volume == pytest.approx(4 / 3 * np.pi * 12.0**3, rel=0.005)


def test_a_thin_stroke_leaves_no_gap_and_radius_zero_is_the_line() -> None:
    polyline = OBLIQUE.index_to_world(np.array([(1.2, 2.1, 0.8), (13.7, 9.4, 6.9), (3.3, 12.2, 7.6)]))
    line = rasterise_strokes([stroke("aorta", 0.0, *polyline)], TABLE, OBLIQUE) == 5
    np.testing.assert_array_equal(line, sampled_voxels(OBLIQUE, polyline))
    # radius below any distance from a voxel centre to the line
    thin = rasterise_strokes([stroke("aorta", 1e-6, *polyline)], TABLE, OBLIQUE) == 5
    np.testing.assert_array_equal(thin, line)


@settings(max_examples=50, deadline=None)
@given(
    start=st.tuples(*[st.integers(-8, 24).map(lambda n: n / 2)] * 3),
    end=st.tuples(*[st.integers(-8, 24).map(lambda n: n / 2)] * 3),
)
def test_passed_voxels_are_joined_by_corners_at_least(start, end) -> None:
    """Also where the line runs through corners and along faces of voxels."""
    labels = np.zeros((8, 9, 10), np.uint8)
    paint_passed_voxels(labels, np.array(start), np.array(end), 1)
    count = SimpleITK.ConnectedComponentImageFilter()
    count.FullyConnectedOn()
    count.Execute(SimpleITK.GetImageFromArray(labels))
    assert count.GetObjectCount() <= 1
    for point in (start, end):
        i, j, k = (int(np.floor(v + 0.5)) for v in point)
        if 0 <= i < 10 and 0 <= j < 9 and 0 <= k < 8:
            assert labels[k, j, i] == 1


def test_later_strokes_paint_over_and_background_is_a_label() -> None:
    at = PLAIN.index_to_world((6, 6, 6))
    markers = load_markers((), [stroke("aorta", 5.0, at), stroke("Background", 2.0, at)], TABLE, PLAIN, Path())
    assert markers.geometry == PLAIN
    assert markers.labels[6, 6, 6] == 0
    assert (markers.labels == 5).any()
    assert set(np.unique(markers.labels)) == {0, 5, UNMARKED}


def test_strokes_outside_are_listed_with_a_remedy() -> None:
    inside = PLAIN.index_to_world((6, 6, 6))
    strokes = [
        stroke("aorta", 2.0, inside),
        stroke("aorta", 2.0, inside * (-1, -1, 1)),
        stroke("left atrium", 2.0, (900.0, 0.0, 0.0), (900.0, 50.0, 0.0)),
        stroke("no such thing", 2.0, inside),
    ]
    with pytest.raises(MarkerError) as caught:
        load_markers((), strokes, TABLE, PLAIN, Path())
    assert [problem.place for problem in caught.value.problems] == ["strokes[2]", "strokes[3]", "strokes[4]"]
    second, third, fourth = (problem.message for problem in caught.value.problems)
    assert "RAS: change the sign" in second
    assert "x -50.5 to -36.5, y 19.2 to 38.8, z 4.0 to 28.0 mm" in third
    assert "LPS" in third
    assert "no label 'no such thing'" in fourth


def test_a_stroke_that_reaches_out_is_cut_off() -> None:
    ends = PLAIN.index_to_world(np.array([(-500.0, 6.0, 6.0), (500.0, 6.0, 6.0)]))
    painted = rasterise_strokes([stroke("aorta", 0.0, *ends)], TABLE, PLAIN)
    np.testing.assert_array_equal(painted[6, 6], 5)
    assert (painted == 5).sum() == 14
    near = PLAIN.index_to_world((-2.0, 6.0, 6.0))
    assert (rasterise_strokes([stroke("aorta", 2.5, near)], TABLE, PLAIN) == 5).any()


def write_labels(path: Path, values: np.ndarray, geometry: Geometry) -> None:
    image = SimpleITK.GetImageFromArray(values)
    image.SetOrigin(geometry.origin_mm)
    image.SetSpacing(geometry.spacing_mm)
    image.SetDirection(geometry.direction_matrix.ravel())
    SimpleITK.WriteImage(image, str(path))


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha"])
def test_label_volume_on_the_scans_grid(tmp_path: Path, suffix: str) -> None:
    values = np.zeros(OBLIQUE.shape, np.uint8)
    values[3, 4, 5], values[5, 6, 7], values[0, 0, 0] = 1, 2, 77
    write_labels(tmp_path / f"m{suffix}", values, OBLIQUE)
    files = [MarkerFile(path=f"m{suffix}", names={"77": "background", "2": "Aorta", "1": "LV"})]
    markers = load_markers(files, (), TABLE, OBLIQUE, tmp_path)
    expected = np.full(OBLIQUE.shape, UNMARKED, np.uint8)
    expected[3, 4, 5], expected[5, 6, 7], expected[0, 0, 0] = 1, 5, 0
    np.testing.assert_array_equal(markers.labels, expected)


@pytest.mark.parametrize("codes", ["RAS", "LPI", "PIR", "SAL"])
def test_label_volume_with_axes_in_another_order(tmp_path: Path, codes: str) -> None:
    """The same voxels written with other axes, as ITK-SNAP may: nothing is lost or moved."""
    values = np.random.default_rng(0).integers(0, 10, OBLIQUE.shape).astype(np.uint8)
    image = nibabel.Nifti1Image(values.T, np.diag([-1.0, -1.0, 1.0, 1.0]) @ OBLIQUE.affine)
    turned = image.as_reoriented(
        nibabel.orientations.ornt_transform(
            nibabel.io_orientation(image.affine), nibabel.orientations.axcodes2ornt(codes)
        )
    )
    nibabel.save(turned, tmp_path / "m.nii.gz")
    markers = load_markers([MarkerFile(path="m.nii.gz")], (), TABLE, OBLIQUE, tmp_path)
    np.testing.assert_array_equal(markers.labels, np.where(values == 0, UNMARKED, values))


def test_label_volume_on_another_grid_as_simpleitk_resamples_it() -> None:
    values = np.random.default_rng(0).integers(0, 10, (11, 12, 13)).astype(np.uint8)
    other = Geometry.of(
        shape=values.shape, origin_mm=OBLIQUE.index_to_world((2.0, 1.0, 1.0)), spacing_mm=(1.1, 1.7, 1.9)
    )
    volume = LabelVolume(values=values, geometry=other)
    ours = resample_labels(volume, OBLIQUE)
    image = SimpleITK.GetImageFromArray(values)
    image.SetOrigin(other.origin_mm)
    image.SetSpacing(other.spacing_mm)
    reference = SimpleITK.Image(OBLIQUE.size, SimpleITK.sitkUInt8)
    reference.SetOrigin(OBLIQUE.origin_mm)
    reference.SetSpacing(OBLIQUE.spacing_mm)
    reference.SetDirection(OBLIQUE.direction_matrix.ravel())
    theirs = SimpleITK.Resample(image, reference, SimpleITK.Transform(), SimpleITK.sitkNearestNeighbor, 0)
    assert ours.any()
    np.testing.assert_array_equal(ours, SimpleITK.GetArrayFromImage(theirs))


def seg_nrrd(path: Path, values: np.ndarray, geometry: Geometry, segments: list[dict[str, str]]) -> None:
    """A segmentation as 3D Slicer writes it; values (z, y, x) or (z, y, x, layer)."""
    image = SimpleITK.GetImageFromArray(values, isVector=values.ndim == 4)
    image.SetOrigin(geometry.origin_mm)
    image.SetSpacing(geometry.spacing_mm)
    image.SetDirection(geometry.direction_matrix.ravel())
    for index, segment in enumerate(segments):
        for key, text in segment.items():
            image.SetMetaData(f"Segment{index}_{key}", text)
    SimpleITK.WriteImage(image, str(path), useCompression=True)


def test_cropped_seg_nrrd_with_names(tmp_path: Path) -> None:
    start, size = (4, 3, 2), (5, 6, 1)
    cropped = OBLIQUE.cropped(start, size)
    values = np.zeros(cropped.shape, np.uint8)
    values[0, 1, 2], values[0, 5, 4] = 1, 2
    seg_nrrd(
        tmp_path / "m.seg.nrrd",
        values,
        cropped,
        [
            {"Name": "LEFT Ventricle", "LabelValue": "1", "Layer": "0"},
            {"Name": "not heart", "LabelValue": "2", "Layer": "0"},
            {"Name": "Segment_3", "LabelValue": "3", "Layer": "0"},
        ],
    )
    files = [MarkerFile(path="m.seg.nrrd", names={"Not Heart": "background"})]
    markers = load_markers(files, (), TABLE, OBLIQUE, tmp_path)
    expected = np.full(OBLIQUE.shape, UNMARKED, np.uint8)
    expected[2, 4, 6], expected[2, 8, 8] = 1, 0
    np.testing.assert_array_equal(markers.labels, expected)


@pytest.mark.parametrize("has_layer_keys", [True, False])
def test_overlapping_layers_go_to_the_later_segment(tmp_path: Path, has_layer_keys: bool) -> None:
    values = np.zeros((*PLAIN.shape, 2), np.uint8)
    values[2:6, 4, 4, 0] = 1
    values[4:8, 4, 4, 1] = 1
    keys = [{"LabelValue": "1", "Layer": str(n)} if has_layer_keys else {} for n in range(2)]
    seg_nrrd(tmp_path / "m.seg.nrrd", values, PLAIN, [{"Name": "aorta"} | keys[0], {"Name": "left atrium"} | keys[1]])
    volume = read_labels(tmp_path / "m.seg.nrrd")
    assert {value: one.name for value, one in volume.segments.items()} == {1: "aorta", 2: "left atrium"}
    np.testing.assert_array_equal(volume.values[:, 4, 4], [0, 0, 1, 1, 2, 2, 2, 2, 0, 0, 0, 0])
    segmentation = load_segmentation(tmp_path / "m.seg.nrrd", {}, TABLE, None)
    np.testing.assert_array_equal(segmentation.labels[:, 4, 4], [0, 0, 5, 5, 3, 3, 3, 3, 0, 0, 0, 0])
    assert segmentation.geometry.matches(PLAIN)


@pytest.mark.parametrize(
    ("segments", "words"),
    [
        ([], "no table"),
        ([{"Name": "a", "LabelValue": "x", "Layer": "0"}], "damaged"),
        ([{"Name": "a", "LabelValue": "1", "Layer": "7"}], "does not fit"),
        ([{"Name": "a", "LabelValue": "1", "Layer": "0"}], "does not name"),
    ],
)
def test_bad_segment_tables(tmp_path: Path, segments: list[dict[str, str]], words: str) -> None:
    values = np.ones((*PLAIN.shape, 2), np.uint8)
    seg_nrrd(tmp_path / "m.seg.nrrd", values, PLAIN, segments)
    with pytest.raises(MarkerError, match=words):
        read_labels(tmp_path / "m.seg.nrrd")


def mrk(path: Path, *markups: dict) -> None:
    path.write_text(json.dumps({"markups": list(markups)}))


def points(kind: str, system: str, positions: list, labels: list[str] | None = None, **more) -> dict:
    labels = labels or [f"F-{n}" for n in range(1, len(positions) + 1)]
    control = [
        {"label": label, "position": list(map(float, position)), "positionStatus": "defined"}
        for label, position in zip(labels, positions, strict=True)
    ]
    return {"type": kind, "coordinateSystem": system, "coordinateUnits": "mm", "controlPoints": control} | more


def test_point_lists_in_lps_and_ras_and_by_every_name(tmp_path: Path) -> None:
    at = [PLAIN.index_to_world(index) for index in ((2, 2, 2), (11, 2, 2), (2, 10, 2), (11, 10, 2), (6, 6, 9))]
    mrk(
        tmp_path / "left ventricle.mrk.json",
        points("Fiducial", "LPS", [at[0], at[1]], ["F-1", "Aorta-2"]),
        points("Fiducial", "RAS", [at[2] * (-1, -1, 1)], name="Left Atrium"),
        points("Fiducial", "LPS", [at[3], at[4]], ["nope", "LA point 12"]),
    )
    content = json.loads((tmp_path / "left ventricle.mrk.json").read_text())
    content["markups"][2]["controlPoints"][0]["positionStatus"] = "undefined"
    (tmp_path / "left ventricle.mrk.json").write_text(json.dumps(content))
    files = [MarkerFile(path="left ventricle.mrk.json", names={"la point": "pulmonary artery"}, radius_mm=2.1)]
    markers = load_markers(files, (), TABLE, PLAIN, tmp_path)
    expected = np.full(PLAIN.shape, UNMARKED, np.uint8)
    for position, value in ((at[0], 1), (at[1], 5), (at[2], 3), (at[4], 6)):
        expected[np.linalg.norm(centres(PLAIN) - position, axis=-1) <= 2.1] = value
    np.testing.assert_array_equal(markers.labels, expected)


def test_lines_and_curves_are_polylines(tmp_path: Path) -> None:
    corners = PLAIN.index_to_world(np.array([(2, 2, 5), (10, 2, 5), (10, 9, 5)]))
    for kind, expected in (("Curve", corners), ("ClosedCurve", np.concatenate((corners, corners[:1])))):
        mrk(tmp_path / "m.mrk.json", points(kind, "LPS", list(corners), name="aorta"))
        files = [MarkerFile(path="m.mrk.json", radius_mm=0.0)]
        markers = load_markers(files, (), TABLE, PLAIN, tmp_path)
        np.testing.assert_array_equal(markers.labels == 5, sampled_voxels(PLAIN, expected))


def test_every_problem_of_every_file_at_once_and_no_file_name(tmp_path: Path) -> None:
    values = np.zeros(PLAIN.shape, np.uint8)
    values[1, 1, 1], values[2, 2, 2] = 1, 2
    segments = [
        {"Name": "mystery", "LabelValue": "1", "Layer": "0"},
        {"Name": "riddle", "LabelValue": "2", "Layer": "0"},
    ]
    seg_nrrd(tmp_path / "Secret1.seg.nrrd", values, PLAIN, segments)
    write_labels(tmp_path / "Secret2.nii.gz", values * 100, PLAIN)
    far = PLAIN.model_copy(update={"origin_mm": (900.0, 900.0, 900.0)})
    write_labels(tmp_path / "Secret3.nrrd", values, far)
    write_labels(tmp_path / "Secret4.nrrd", values * 0, PLAIN)
    mrk(tmp_path / "Secret5.mrk.json", points("Fiducial", "LPS", [(0, 0, 0), (900, 0, 0)], ["x-1", "aorta-1"]))
    mrk(tmp_path / "Secret6.mrk.json", points("Plane", "LPS", [(0, 0, 0)]))
    mrk(tmp_path / "Secret7.mrk.json", points("Fiducial", "IJK", [(0, 0, 0)]))
    mrk(tmp_path / "Secret8.mrk.json", points("Fiducial", "LPS", [(0, 0, float("nan"))]))
    mrk(tmp_path / "Secret9.mrk.json", points("Fiducial", "LPS", []))
    (tmp_path / "Secret10.mrk.json").write_text("[1, 2")
    mrk(tmp_path / "Secret11.mrk.json", {"type": "Fiducial"})
    write_scan(Scan(np.full(PLAIN.shape, 0.5, np.float32), PLAIN), tmp_path / "Secret12.nrrd")
    names = [
        *("Secret1.seg.nrrd", "Secret2.nii.gz", "Secret3.nrrd", "Secret4.nrrd"),
        *(f"Secret{n}.mrk.json" for n in range(5, 12)),
        *("Secret12.nrrd", "Secret13.nii.gz"),
    ]
    with pytest.raises(MarkerError) as caught:
        load_markers([MarkerFile(path=name) for name in names], (), TABLE, PLAIN, tmp_path)
    words = {
        1: "segment 1, segment 2 of the file",
        2: "value 100, value 200 of the file",
        3: "value 1, value 2 of the file lie outside",
        4: "marks nothing",
        5: "the name of point 1 of list 1 is no label",
        6: "something else than points",
        7: "neither LPS nor RAS",
        8: "not a number",
        9: "marks nothing",
        10: "not a point list",
        11: "not a point list",
        12: "whole numbers",
        13: "no such file",
    }
    by_place: dict[str, str] = {}
    for problem in caught.value.problems:
        by_place[problem.place] = by_place.get(problem.place, "") + problem.message
    assert {f"markers[{n}]": text in by_place.get(f"markers[{n}]", "") for n, text in words.items()} == {
        f"markers[{n}]": True for n in words
    }
    assert "point 2 of list 1 lies outside the scan" in by_place["markers[5]"]
    assert "labels: background, morphologically left ventricle" in by_place["markers[1]"]
    assert not any(name in str(caught.value) for name in ("mystery", "riddle", "x-1"))
    assert "secret" not in str(caught.value).lower()
    assert str(tmp_path) not in str(caught.value)
    assert len(str(caught.value).splitlines()) == len(caught.value.problems) == 14


def test_finished_segmentation_on_another_grid(tmp_path: Path) -> None:
    values = np.random.default_rng(4).integers(0, 10, PLAIN.shape).astype(np.uint8)
    write_labels(tmp_path / "s.nii.gz", values, PLAIN)
    wanted = PLAIN.cropped((2, -3, 4), (9, 9, 6))
    segmentation = load_segmentation(tmp_path / "s.nii.gz", {}, TABLE, wanted)
    np.testing.assert_array_equal(segmentation.labels[:, 3:], values[4:10, 0:6, 2:11])
    np.testing.assert_array_equal(segmentation.labels[:, :3], 0)
    assert segmentation.table == TABLE
    far = PLAIN.cropped((200, 0, 0), (5, 5, 5))
    with pytest.raises(MarkerError, match=r"segmentation: the segmentation lies outside the scan"):
        load_segmentation(tmp_path / "s.nii.gz", {}, TABLE, far)
    with pytest.raises(MarkerError, match=r"segmentation: there is no such file"):
        load_segmentation(tmp_path / "missing.nii.gz", {}, TABLE, far)
    write_labels(tmp_path / "s.nii.gz", values * 0, PLAIN)
    with pytest.raises(MarkerError, match="holds no label"):
        load_segmentation(tmp_path / "s.nii.gz", {}, TABLE, PLAIN)
    write_labels(tmp_path / "s.nii.gz", values + 30, PLAIN)
    with pytest.raises(MarkerError, match="value 30, value 31"):
        load_segmentation(tmp_path / "s.nii.gz", {}, TABLE, PLAIN)


def terminology(code: str, meaning: str) -> str:
    """The tag of a segment as 3D Slicer writes it."""
    return (
        "Segmentation.Status:inprogress|TerminologyEntry:Segmentation category and type - 3D Slicer General Anatomy "
        f"list~SCT^123037004^Anatomical Structure~SCT^{code}^{meaning}~^^~Anatomic codes - DICOM master list~^^~^^|"
    )


def test_a_code_names_a_segment_that_its_name_does_not(tmp_path: Path) -> None:
    values = np.zeros(PLAIN.shape, np.uint8)
    values[1, 1, 1], values[2, 2, 2], values[3, 3, 3] = 1, 2, 3
    segments = [
        {"Name": "Segment_1", "LabelValue": "1", "Layer": "0", "Tags": terminology("73829009", "Right atrium")},
        {"Name": "RV", "LabelValue": "2", "Layer": "0", "Tags": terminology("85756007", "Tissue")},
        {"Name": "Jane", "LabelValue": "3", "Layer": "0", "Tags": "|"},
    ]
    seg_nrrd(tmp_path / "s.seg.nrrd", values, PLAIN, segments)
    with pytest.raises(MarkerError, match="no label: segment 3 of the file") as caught:
        load_segmentation(tmp_path / "s.seg.nrrd", {}, TABLE, PLAIN)
    assert "Jane" not in str(caught.value)
    found = load_segmentation(tmp_path / "s.seg.nrrd", {}, TABLE, PLAIN, others="ignore").labels
    assert (found[1, 1, 1], found[2, 2, 2], found[3, 3, 3]) == (4, 2, 0)
    found = load_segmentation(tmp_path / "s.seg.nrrd", {"jane": "svc", "RV": "background"}, TABLE, PLAIN).labels
    assert (found[1, 1, 1], found[2, 2, 2], found[3, 3, 3]) == (4, 0, 7)
    markers = load_markers([MarkerFile(path="s.seg.nrrd", others="ignore")], (), TABLE, PLAIN, tmp_path).labels
    assert (markers[1, 1, 1], markers[2, 2, 2], markers[3, 3, 3]) == (4, 2, UNMARKED)


@pytest.mark.parametrize(
    ("convention", "given", "expected"),
    [
        ("hvsmr-2.0", range(9), range(9)),
        ("totalsegmentator-heartchambers", range(8), (0, 9, 3, 1, 4, 2, 5, 6)),
        ("totalsegmentator-total-v2", (0, 52, 62, 63), (0, 5, 7, 8)),
    ],
)
def test_values_by_convention(tmp_path: Path, convention, given, expected) -> None:
    values = np.resize(np.array(list(given), np.uint8), PLAIN.shape)
    write_labels(tmp_path / "l.nii.gz", values, PLAIN)
    found = load_segmentation(tmp_path / "l.nii.gz", {}, TABLE, PLAIN, convention=convention)
    np.testing.assert_array_equal(found.labels, np.resize(np.array(list(expected), np.uint8), PLAIN.shape))


def test_a_value_that_a_convention_lacks_is_refused_or_left_out(tmp_path: Path) -> None:
    values = np.resize(np.array([0, 5, 52, 61], np.uint8), PLAIN.shape)
    write_labels(tmp_path / "l.nii.gz", values, PLAIN)
    with pytest.raises(MarkerError, match="no label: value 5, value 61 of the file"):
        load_segmentation(tmp_path / "l.nii.gz", {}, TABLE, PLAIN, convention="totalsegmentator-total-v2")
    found = load_segmentation(
        tmp_path / "l.nii.gz", {"61": "LA"}, TABLE, PLAIN, convention="totalsegmentator-total-v2", others="ignore"
    )
    np.testing.assert_array_equal(np.unique(found.labels), [0, 3, 5])


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd"])
def test_a_value_forgotten_under_names_becomes_no_other_organ(tmp_path: Path, suffix: str) -> None:
    """Value 4 of the table is the right atrium; of the file, whatever its painter meant."""
    values = np.resize(np.array([0, 1, 4, 6], np.uint8), PLAIN.shape)
    write_labels(tmp_path / f"l{suffix}", values, PLAIN)
    names = {"1": "aorta"}
    with pytest.raises(MarkerError, match="value 4, value 6 of the file have no name under names"):
        load_segmentation(tmp_path / f"l{suffix}", names, TABLE, PLAIN)
    with pytest.raises(MarkerError, match="value 4 of the file has no name under names"):
        load_markers([MarkerFile(path=f"l{suffix}", names=names | {"6": "LA"})], (), TABLE, PLAIN, tmp_path)
    found = load_segmentation(tmp_path / f"l{suffix}", names, TABLE, PLAIN, others="ignore").labels
    np.testing.assert_array_equal(found, np.where(values == 1, 5, 0))
    found = load_segmentation(tmp_path / f"l{suffix}", names | {"4": "LV", "6": "background"}, TABLE, PLAIN).labels
    np.testing.assert_array_equal(found, np.select([values == 1, values == 4], [5, 1], 0))
    found = load_segmentation(tmp_path / f"l{suffix}", {}, TABLE, PLAIN).labels
    np.testing.assert_array_equal(found, values)


def test_a_convention_does_not_fall_back_to_the_table(tmp_path: Path) -> None:
    values = np.resize(np.array([0, 1, 8], np.uint8), PLAIN.shape)
    write_labels(tmp_path / "l.nii.gz", values, PLAIN)
    with pytest.raises(MarkerError, match="no label: value 8 of the file"):
        load_segmentation(tmp_path / "l.nii.gz", {"1": "LV"}, TABLE, PLAIN, convention="totalsegmentator-heartchambers")


def test_walls_that_are_grown_again_are_left_out_and_said(tmp_path: Path) -> None:
    values = np.zeros(PLAIN.shape, np.uint8)
    values[1, 1, 1], values[2, 2, 2], values[3, 3, 3], values[4, 4, 4] = 1, 2, 3, 4
    segments = [
        {"Name": name, "LabelValue": str(number), "Layer": "0"}
        for number, name in enumerate(("aorta", "Aorta_Wall", "RV wall", "Jane wall"), start=1)
    ]
    seg_nrrd(tmp_path / "s.seg.nrrd", values, PLAIN, segments)
    with pytest.raises(MarkerError, match="no label: segment 4 of the file") as caught:
        load_segmentation(tmp_path / "s.seg.nrrd", {}, TABLE, PLAIN)
    assert "segment 2" not in str(caught.value)
    found = load_segmentation(tmp_path / "s.seg.nrrd", {"Jane wall": "SVC wall"}, TABLE, PLAIN)
    np.testing.assert_array_equal(found.labels, np.where(values == 1, 5, 0))
    (warning,) = found.warnings
    assert warning.grade is WarningGrade.NOTE
    for name in ("morphologically right ventricle wall", "aorta wall", "superior vena cava wall"):
        assert name in warning.text
    assert "Jane" not in warning.text
    again = artifact_from_bytes(artifact_to_bytes(found), Segmentation)
    assert again.warnings == found.warnings
    # a wall of the table is a label like any other, and a cavity without a thickness grows none
    own = load_segmentation(tmp_path / "s.seg.nrrd", {}, TABLE.with_walls(), PLAIN, others="ignore")
    assert own.labels[2, 2, 2] == TABLE.with_walls()["aorta wall"].value
    assert own.warnings == ()
    segments[1]["Name"] = "LV wall"
    seg_nrrd(tmp_path / "s.seg.nrrd", values, PLAIN, segments)
    with pytest.raises(MarkerError, match="no label: segment 2, segment 4 of the file"):
        load_segmentation(tmp_path / "s.seg.nrrd", {}, TABLE, PLAIN)
    # markers are painted by hand: a wall among them is a mistake
    with pytest.raises(MarkerError, match="no label: segment 2, segment 3, segment 4"):
        load_markers([MarkerFile(path="s.seg.nrrd")], (), TABLE, PLAIN, tmp_path)


def test_what_leaves_nothing_out_keeps_its_bytes() -> None:
    bare = Segmentation(np.zeros(PLAIN.shape, np.uint8), PLAIN, TABLE)
    assert b"warnings" not in artifact_to_bytes(bare)
    assert artifact_from_bytes(artifact_to_bytes(bare), Segmentation).warnings == ()


SMALL = LabelTable(labels=tuple(TABLE[name] for name in ("background", "LV", "myocardium")))


@pytest.mark.parametrize(
    ("name", "code", "contrary"),
    [
        ("RV", "87878005", True),
        ("aorta", "87878005", True),
        ("LV", "53085002", True),
        ("LV", "74281007", True),
        ("aorta", "74281007", True),
        ("LV", "87878005", False),
        ("Segment 1", "87878005", False),
        ("myocardium", "49848007", False),
        ("lv myocardium", "74281007", False),
        ("LV", "85756007", False),
    ],
)
def test_a_name_and_a_code_that_contradict_each_other_in_a_small_table(tmp_path, name, code, contrary) -> None:
    values = np.zeros(PLAIN.shape, np.uint8)
    values[1, 1, 1] = 1
    entry = {"Name": name, "LabelValue": "1", "Layer": "0", "Tags": terminology(code, "x")}
    seg_nrrd(tmp_path / "s.seg.nrrd", values, PLAIN, [entry])
    for others in ("refuse", "ignore"):
        if contrary:
            with pytest.raises(MarkerError, match="code of segment 1 of the file stand for different"):
                load_segmentation(tmp_path / "s.seg.nrrd", {}, SMALL, PLAIN, others=others)
        else:
            assert load_segmentation(tmp_path / "s.seg.nrrd", {}, SMALL, PLAIN, others=others).labels.any()
    for key in (name, "1"):
        mapped = load_segmentation(tmp_path / "s.seg.nrrd", {key: "myocardium"}, SMALL, PLAIN)
        assert mapped.labels[1, 1, 1] == 9


def test_a_structure_that_would_vanish_is_refused(tmp_path: Path) -> None:
    values = np.zeros(PLAIN.shape, np.uint8)
    values[2:5, 2:5, 2:5], values[2:5, 2:5, 11:13] = 1, 2
    write_labels(tmp_path / "s.nii.gz", values, PLAIN)
    part = PLAIN.cropped((0, 0, 0), (9, 13, 12))
    with pytest.raises(MarkerError, match="value 2 of the file would vanish"):
        load_segmentation(tmp_path / "s.nii.gz", {}, TABLE, part)
    kept = load_segmentation(tmp_path / "s.nii.gz", {"1": "LV", "2": "background"}, TABLE, part)
    assert set(np.unique(kept.labels)) == {0, 1}
    layers = np.zeros((*PLAIN.shape, 2), np.uint8)
    layers[2:5, 2:5, 2:5, 0] = layers[2:6, 2:5, 2:5, 1] = 1
    keys = [{"LabelValue": "1", "Layer": str(n)} for n in (0, 1)]
    seg_nrrd(tmp_path / "s.seg.nrrd", layers, PLAIN, [{"Name": "aorta"} | keys[0], {"Name": "LA"} | keys[1]])
    with pytest.raises(MarkerError, match="segment 1 of the file would vanish"):
        load_segmentation(tmp_path / "s.seg.nrrd", {}, TABLE, PLAIN)


def test_values_of_totalsegmentator_1_are_not_taken_for_those_of_2(tmp_path: Path) -> None:
    """Version 1: 44-48 myocardium and chambers, 49 pulmonary artery, 51 and 52 iliac arteries."""

    def load(counts: dict[int, int], names: dict[str, str] | None = None) -> set[int]:
        values = np.zeros(PLAIN.shape, np.uint8)
        values.ravel()[: sum(counts.values())] = np.repeat(list(counts), list(counts.values()))
        write_labels(tmp_path / "l.nii.gz", values, PLAIN)
        options = {"convention": "totalsegmentator-total-v2"}
        found = load_segmentation(tmp_path / "l.nii.gz", names or {}, TABLE, PLAIN, others="ignore", **options)
        return set(np.unique(found.labels).tolist())

    for old in (
        {46: 90, 52: 5},
        {44: 80, 45: 50, 46: 60, 47: 40, 48: 60, 49: 30, 52: 4},
        {46: 90, 51: 6, 52: 5, 50: 99},
    ):
        with pytest.raises(MarkerError, match="another version's numbering"):
            load(old)
    assert load({44: 9, 45: 8, 51: 200, 52: 40}) == {0, 5}
    assert load({52: 40, 62: 9}) == {0, 5, 7}


@pytest.mark.parametrize("number", ["1" + "0" * 400, "-1" + "0" * 400, "1e999", "1" + "0" * 5000])
def test_point_lists_with_numbers_beyond_any_size(tmp_path: Path, number: str) -> None:
    mrk(tmp_path / "m.mrk.json", points("Fiducial", "LPS", [(0, 0, 4711)], ["aorta"]))
    text = (tmp_path / "m.mrk.json").read_text()
    (tmp_path / "m.mrk.json").write_text(text.replace("4711.0", number))
    with pytest.raises(MarkerError, match=r"not a point list|not a number"):
        load_markers([MarkerFile(path="m.mrk.json")], (), TABLE, PLAIN, tmp_path)


@pytest.mark.parametrize(
    ("name", "others"),
    [("a tumour", "ignore"), ("aorta wall", "refuse"), ("right ventricle-aorta septum (grown)", "refuse")],
)
def test_a_segment_that_is_not_taken_covers_none_that_is(tmp_path: Path, name: str, others: str) -> None:
    """Whatever nobody wants, or will be grown again, comes later in the list and overlaps."""
    values = np.zeros((*PLAIN.shape, 2), np.uint8)
    values[2:6, 4, 4, 0] = 1
    values[4:8, 4, 4, 1] = 1
    seg_nrrd(tmp_path / "m.seg.nrrd", values, PLAIN, [{"Name": "aorta"}, {"Name": name}])
    segmentation = load_segmentation(tmp_path / "m.seg.nrrd", {}, TABLE, None, others=others)
    np.testing.assert_array_equal(segmentation.labels[:, 4, 4], [0, 0, 5, 5, 5, 5, 0, 0, 0, 0, 0, 0])
    assert len(segmentation.warnings) == (1 if others == "refuse" else 0)
    file = MarkerFile(path="m.seg.nrrd", others="ignore")
    markers = load_markers([file], (), TABLE, PLAIN, tmp_path).labels[:, 4, 4]
    np.testing.assert_array_equal(markers, np.where(segmentation.labels[:, 4, 4] == 5, 5, UNMARKED))
