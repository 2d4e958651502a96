"""DICOM segmentations written by highdicom are read, and ours are read by highdicom."""

import warnings
import zlib
from io import BytesIO

import highdicom
import numpy as np
import pydicom
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydicom.sequence import Sequence
from pydicom.sr.codedict import codes
from pydicom.uid import DeflatedExplicitVRLittleEndian, ExplicitVRLittleEndian, RLELossless, generate_uid
from scipy.spatial.transform import Rotation

from heartcase.pipeline.data import Segmentation
from heartcase.pipeline.formats.dicom.source import find_source
from heartcase.pipeline.formats.labels import dicom_seg
from heartcase.pipeline.formats.labels.dicom_seg import read_dicom_seg
from heartcase.pipeline.formats.labels.write_dicom_seg import dicom_seg_bytes
from heartcase.pipeline.formats.read_scan import read_labels, read_scan
from heartcase.pipeline.formats.volumes.raw_volume import at_most
from heartcase.pipeline.markers.load_markers import load_segmentation
from heartcase.schemas.errors import MarkerError, UsageError
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable, default_label_table
from tests.pipeline.formats.dicom_series import repr_ds, write_series
from tests.pipeline.formats.test_dicom_source import manifest_of

TABLE = default_label_table().with_walls()
TURN = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix()
OBLIQUE = Geometry.of(shape=(6, 9, 11), origin_mm=(-20.125, 35.5, -110.25), spacing_mm=(0.8, 1.3, 2.9), direction=TURN)


def source_images(geometry, tmp_path, **tags):
    """The scan's slices as DICOM files, with what highdicom asks of them."""
    positions = geometry.index_to_world([(0, 0, k) for k in range(geometry.size[2])])
    volume = np.arange(np.prod(geometry.shape), dtype=np.int16).reshape(geometry.shape)
    stated = {
        "PatientName": "Doe^Jane",
        "PatientID": "JANEDOE42",
        "PatientBirthDate": "19990913",
        "PatientSex": "F",
        "StudyID": "SECRET7",
        "StudyDate": "20230117",
        "StudyTime": "101112",
        "AccessionNumber": "ACC99",
        "ReferringPhysicianName": "Dr^House",
        "SliceThickness": repr_ds(geometry.spacing_mm[2]),
        "FrameOfReferenceUID": "1.2.826.0.1.3680043.8.498.4711",
    }
    paths = write_series(
        tmp_path / "scan",
        volume,
        positions,
        orientation=geometry.direction_matrix[:, :2].T.ravel(),
        pixel_spacing=(geometry.spacing_mm[1], geometry.spacing_mm[0]),
        order=np.random.default_rng(3).permutation(len(volume)),
        **(stated | tags),
    )
    images = [pydicom.dcmread(path) for path in paths]
    return sorted(images, key=lambda image: image.InstanceNumber)


def described(number, label, code):
    return highdicom.seg.SegmentDescription(
        segment_number=number,
        segment_label=label,
        segmented_property_category=codes.SCT.AnatomicalStructure,
        segmented_property_type=code,
        algorithm_type="MANUAL",
    )


SEGMENTS = [described(1, "Jane's LV", codes.SCT.LeftVentricle), described(2, "aorta", codes.SCT.Aorta)]


def highdicom_seg(images, pixels, kind="BINARY", segments=SEGMENTS, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return highdicom.seg.Segmentation(
            source_images=images,
            pixel_array=pixels,
            segmentation_type=kind,
            segment_descriptions=segments,
            series_instance_uid=generate_uid(),
            series_number=1,
            sop_instance_uid=generate_uid(),
            instance_number=1,
            manufacturer="x",
            manufacturer_model_name="x",
            software_versions="1",
            device_serial_number="1",
            **options,
        )


def two_layers(geometry, seed=0):
    """Two overlapping segments, with empty planes at one end and in the middle."""
    layers = np.random.default_rng(seed).random((*geometry.shape, 2)) < 0.4
    layers[[0, 3]] = False
    return layers.astype(np.uint8)


def merged(layers):
    return np.where(layers[..., 1] > 0, 5, np.where(layers[..., 0] > 0, 1, 0))


@pytest.mark.parametrize(
    ("kind", "syntax"),
    [("BINARY", ExplicitVRLittleEndian), ("FRACTIONAL", ExplicitVRLittleEndian), ("FRACTIONAL", RLELossless)],
)
def test_overlapping_segments_with_missing_frames(tmp_path, kind, syntax):
    layers = two_layers(OBLIQUE)
    pixels = layers.astype(float) * 0.5 + 0.3 * (layers == 0) if kind == "FRACTIONAL" else layers
    options = {"max_fractional_value": 200} if kind == "FRACTIONAL" else {}
    seg = highdicom_seg(source_images(OBLIQUE, tmp_path), pixels, kind, transfer_syntax_uid=syntax, **options)
    seg.save_as(tmp_path / "s.dcm")
    volume = read_dicom_seg(tmp_path / "s.dcm")
    assert [(one.number, one.snomed) for one in volume.segments.values()] == [(1, "87878005"), (2, "15825003")]
    found = load_segmentation(tmp_path / "s.dcm", {}, TABLE, OBLIQUE)
    np.testing.assert_array_equal(found.labels, merged(layers))


def test_label_maps_compressed_too(tmp_path):
    values = np.random.default_rng(1).integers(0, 3, OBLIQUE.shape).astype(np.uint8)
    images = source_images(OBLIQUE, tmp_path)
    for syntax in (ExplicitVRLittleEndian, RLELossless):
        highdicom_seg(images, values, "LABELMAP", transfer_syntax_uid=syntax).save_as(tmp_path / "s.dcm")
        found = load_segmentation(tmp_path / "s.dcm", {}, TABLE, None)
        np.testing.assert_array_equal(found.labels, np.array([0, 1, 5])[values])
        assert np.abs(found.geometry.affine - OBLIQUE.affine).max() < 1e-6


def shuffled(seg, order):
    """The same binary segmentation with its frames in another order."""
    frames = np.asarray(seg.pixel_array)[order]
    seg.PerFrameFunctionalGroupsSequence = Sequence([seg.PerFrameFunctionalGroupsSequence[n] for n in order])
    packed = np.packbits(frames.ravel(), bitorder="little").tobytes()
    seg.PixelData = packed + b"\0" * (len(packed) % 2)
    return seg


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_order_of_frames_on_any_lattice(tmp_path_factory, data):
    turn = Rotation.from_euler("xyz", [data.draw(st.floats(-180, 180)) for _ in range(3)], degrees=True).as_matrix()
    geometry = Geometry.of(
        shape=(5, 7, 9),
        origin_mm=[data.draw(st.floats(-300, 300)) for _ in range(3)],
        spacing_mm=[data.draw(st.floats(0.3, 4.0)) for _ in range(3)],
        direction=turn,
    )
    folder = tmp_path_factory.mktemp("seg")
    layers = two_layers(geometry, data.draw(st.integers(0, 99)))
    seg = highdicom_seg(source_images(geometry, folder), layers)
    shuffled(seg, data.draw(st.permutations(range(int(seg.NumberOfFrames))))).save_as(folder / "s.dcm")
    own = read_dicom_seg(folder / "s.dcm")
    # the first plane is empty and was not stored
    wanted = geometry.cropped((0, 0, 1), (9, 7, 4))
    assert own.geometry.size == wanted.size
    corners = [(i, j, k) for i in (0, 8) for j in (0, 6) for k in (0, 3)]
    assert np.abs(own.geometry.index_to_world(corners) - wanted.index_to_world(corners)).max() < 1e-4
    np.testing.assert_array_equal(load_segmentation(folder / "s.dcm", {}, TABLE, geometry).labels, merged(layers))


@pytest.mark.parametrize("thickness", [None, 0.9, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("planes", [(1, 3, 5), (1, 2, 5), (4,)])
def test_without_a_stated_distance_planes_are_the_scans_slices(tmp_path, planes, thickness):
    layers = np.zeros((*OBLIQUE.shape, 2), np.uint8)
    layers[list(planes), 2:7, 3:8, 0] = 1
    layers[list(planes), 1:4, 5:9, 1] = 1
    seg = highdicom_seg(source_images(OBLIQUE, tmp_path), layers)
    for shared in seg.SharedFunctionalGroupsSequence:
        del shared.PixelMeasuresSequence[0].SpacingBetweenSlices
        if thickness is None:
            del shared.PixelMeasuresSequence[0].SliceThickness
        else:
            shared.PixelMeasuresSequence[0].SliceThickness = thickness * OBLIQUE.spacing_mm[2]
    seg.save_as(tmp_path / "s.dcm")
    flipped, cropped = OBLIQUE.flipped(2), OBLIQUE.cropped((1, 1, -2), (8, 7, 6))
    found = load_segmentation(tmp_path / "s.dcm", {}, TABLE, OBLIQUE).labels
    np.testing.assert_array_equal(found, merged(layers))
    np.testing.assert_array_equal(load_segmentation(tmp_path / "s.dcm", {}, TABLE, flipped).labels[::-1], found)
    part = load_segmentation(tmp_path / "s.dcm", {}, TABLE, cropped).labels if min(planes) < 4 else None
    assert part is None or np.array_equal(part[2:], found[:4, 1:8, 1:9])
    # elsewhere only planes that are just so thick as their distance can be told
    other = OBLIQUE.model_copy(update={"spacing_mm": (0.8, 1.3, 2.2)})
    for scan in (None, other):
        if planes == (1, 3, 5) and thickness == 2.0:
            assert read_dicom_seg(tmp_path / "s.dcm", scan).geometry.spacing_mm[2] == pytest.approx(5.8, abs=1e-6)
        else:
            with pytest.raises(MarkerError, match="does not state the distance"):
                read_dicom_seg(tmp_path / "s.dcm", scan)


def test_what_cannot_be_placed_or_read_is_refused_in_one_line(tmp_path):
    images = source_images(OBLIQUE, tmp_path)
    buffer = BytesIO()
    highdicom_seg(images, two_layers(OBLIQUE)).save_as(buffer)

    def refused(change):
        seg = pydicom.dcmread(BytesIO(buffer.getvalue()))
        change(seg)
        seg.save_as(tmp_path / "jane.dcm")
        with pytest.raises(MarkerError) as caught:
            read_dicom_seg(tmp_path / "jane.dcm")
        assert "jane" not in str(caught.value).lower()
        assert len(caught.value.problems) == 1
        return str(caught.value)

    def no_place(seg):
        for frame in seg.PerFrameFunctionalGroupsSequence:
            del frame.PlanePositionSequence

    def uneven(seg):
        for frame in seg.PerFrameFunctionalGroupsSequence[-1:]:
            place = frame.PlanePositionSequence[0]
            moved = np.array(place.ImagePositionPatient, float) + 0.4 * OBLIQUE.index_to_world_matrix[:, 2]
            place.ImagePositionPatient = [f"{v:.6f}" for v in moved]

    def sheared(seg):
        for n, frame in enumerate(seg.PerFrameFunctionalGroupsSequence):
            place = frame.PlanePositionSequence[0]
            moved = np.array(place.ImagePositionPatient, float) + 0.1 * n * OBLIQUE.index_to_world_matrix[:, 0]
            place.ImagePositionPatient = [f"{v:.6f}" for v in moved]

    def apart(value):
        def change(seg):
            seg.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0].SpacingBetweenSlices = value

        return change

    def numbered_alike(seg):
        seg.SegmentSequence[1].SegmentNumber = 1
        for frame in seg.PerFrameFunctionalGroupsSequence:
            frame.SegmentIdentificationSequence[0].ReferencedSegmentNumber = 1

    def unlisted(seg):
        seg.SegmentSequence = seg.SegmentSequence[:1]

    assert "where it lies" in refused(no_place)
    assert "unevenly spaced" in refused(uneven)
    assert "shifted sideways" in refused(sheared)
    assert "does not list" in refused(unlisted)
    assert "same number" in refused(numbered_alike)
    assert "zero, negative" in refused(apart(-2.9))
    assert "zero, negative" in refused(apart(0.0))
    assert "distance that the file states" in refused(apart(2.0))
    assert "damaged" in refused(lambda seg: setattr(seg, "PixelData", seg.PixelData[:20]))
    assert "damaged" in refused(lambda seg: setattr(seg, "NumberOfFrames", 3))
    assert "damaged" in refused(lambda seg: delattr(seg, "Rows"))
    assert "no segmentation" in refused(lambda seg: setattr(seg, "SOPClassUID", images[0].SOPClassUID))
    with pytest.raises(MarkerError, match="6 DICOM files"):
        read_dicom_seg(tmp_path / "scan")


def test_a_folder_with_the_one_file_in_it_will_do(tmp_path):
    layers = two_layers(OBLIQUE)
    images = source_images(OBLIQUE, tmp_path)
    (tmp_path / "seg").mkdir()
    highdicom_seg(images, layers).save_as(tmp_path / "seg" / "s.dcm")
    np.testing.assert_array_equal(load_segmentation(tmp_path / "seg", {}, TABLE, OBLIQUE).labels, merged(layers))


def test_names_and_codes_that_contradict_each_other_are_refused_by_number(tmp_path):
    segments = [described(1, "Right_Ventricle", codes.SCT.LeftVentricle), described(2, "Jane", codes.SCT.Spleen)]
    seg = highdicom_seg(source_images(OBLIQUE, tmp_path), two_layers(OBLIQUE), segments=segments)
    seg.save_as(tmp_path / "s.dcm")
    with pytest.raises(MarkerError) as caught:
        load_segmentation(tmp_path / "s.dcm", {}, TABLE, OBLIQUE)
    first, second = (str(problem) for problem in caught.value.problems)
    assert "code of segment 1 of the file stand for different structures" in first
    assert "no label: segment 2 of the file" in second
    assert "Jane" not in str(caught.value)
    found = load_segmentation(tmp_path / "s.dcm", {"right_ventricle": "RV"}, TABLE, OBLIQUE, others="ignore")
    np.testing.assert_array_equal(found.labels == 2, two_layers(OBLIQUE)[..., 0] == 1)
    assert set(np.unique(found.labels)) == {0, 2}


def test_older_srt_codes_are_understood(tmp_path):
    seg = highdicom_seg(source_images(OBLIQUE, tmp_path), two_layers(OBLIQUE))
    kind = seg.SegmentSequence[0].SegmentedPropertyTypeCodeSequence[0]
    kind.CodeValue, kind.CodingSchemeDesignator = "T-32600", "SRT"
    seg.save_as(tmp_path / "s.dcm")
    assert read_dicom_seg(tmp_path / "s.dcm").segments[1].snomed == "87878005"


def segmentation(geometry, seed=0):
    labels = np.random.default_rng(seed).integers(0, len(TABLE), geometry.shape).astype(np.uint8)
    labels[[0, -1]] = 0
    labels[labels == 7] = 0
    return Segmentation(labels, geometry, TABLE)


@settings(max_examples=15, deadline=None)
@given(
    angles=st.tuples(*[st.floats(-180, 180)] * 3),
    spacing=st.tuples(*[st.floats(0.3, 4.0)] * 3),
    size=st.tuples(st.integers(2, 6), st.integers(1, 9), st.integers(1, 9)),
    hand=st.sampled_from((-1, 1)),
    seed=st.integers(0, 99),
)
def test_our_segmentation_comes_back_from_highdicom_and_from_us(tmp_path_factory, angles, spacing, size, hand, seed):
    turn = Rotation.from_euler("xyz", angles, degrees=True).as_matrix() @ np.diag([1, 1, hand])
    geometry = Geometry.of(shape=size, origin_mm=(12.3, -45.6, 78.9), spacing_mm=spacing, direction=turn)
    made = segmentation(geometry, seed)
    if not made.labels.any():
        return
    path = tmp_path_factory.mktemp("seg") / "s.dcm"
    path.write_bytes(dicom_seg_bytes(made, case_id="HC-0001"))
    np.testing.assert_array_equal(load_segmentation(path, {}, TABLE, geometry).labels, made.labels)
    own = load_segmentation(path, {}, TABLE, None)
    assert own.geometry.size == geometry.size
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        theirs = highdicom.seg.segread(path)
        volume = theirs.get_volume(combine_segments=True)
    names = [theirs.get_segment_description(n).segment_label for n in theirs.segment_numbers]
    values = np.array([0, *(TABLE[name].value for name in names)])[volume.array]
    # highdicom's index runs slice, row, column; take each of its voxels by its place
    index = np.stack(np.meshgrid(*[np.arange(n) for n in volume.spatial_shape], indexing="ij"), axis=-1).reshape(-1, 3)
    world = index @ volume.affine[:3, :3].T + volume.affine[:3, 3]
    i, j, k = np.rint(geometry.world_to_index(world)).astype(int).T
    assert np.abs(geometry.world_to_index(world) - np.stack([i, j, k], axis=1)).max() < 1e-4
    assert len(set(zip(i, j, k, strict=True))) == made.labels.size
    np.testing.assert_array_equal(values.ravel(), made.labels[k, j, i])


def test_a_segmentation_of_a_scan_refers_to_it_and_holds_nothing_else_of_it(tmp_path):
    images = source_images(OBLIQUE, tmp_path)
    cropped = OBLIQUE.cropped((3, 2, 1), (6, 5, 4))
    manifest = manifest_of(read_scan(tmp_path / "scan"), start=(3, 2, 1), size=(6, 5, 4))
    source = find_source(tmp_path / "scan", manifest)
    assert source.offset == (3, 2, 1)
    made = segmentation(cropped)
    content = dicom_seg_bytes(made, case_id="HC-0001", source=source)
    assert content == dicom_seg_bytes(made, case_id="HC-0001", source=source)
    seg = pydicom.dcmread(BytesIO(content))
    assert seg.StudyInstanceUID == images[0].StudyInstanceUID
    assert seg.FrameOfReferenceUID == images[0].FrameOfReferenceUID
    for frame in seg.PerFrameFunctionalGroupsSequence:
        referred = frame.DerivationImageSequence[0].SourceImageSequence[0].ReferencedSOPInstanceUID
        image = next(image for image in images if image.SOPInstanceUID == referred)
        apart = np.array(frame.PlanePositionSequence[0].ImagePositionPatient, float) - np.array(
            image.ImagePositionPatient, float
        )
        assert np.abs(apart @ OBLIQUE.direction_matrix[:, 2]) < 1e-6
    for secret in (b"Jane", b"JANEDOE42", b"19990913", b"SECRET7", b"20230117", b"101112", b"ACC99", b"House"):
        assert secret not in content
    assert (seg.PatientName, seg.PatientID) == ("HC-0001", "HC-0001")
    alone = dicom_seg_bytes(made, case_id="HC-0001")
    for uid in (images[0].StudyInstanceUID, images[0].SeriesInstanceUID, images[0].FrameOfReferenceUID):
        assert uid.encode() not in alone


def test_an_empty_case_has_nothing_to_export():
    empty = Segmentation(np.zeros(OBLIQUE.shape, np.uint8), OBLIQUE, LabelTable(labels=TABLE.labels))
    with pytest.raises(UsageError, match="nothing to export"):
        dicom_seg_bytes(empty, case_id="HC-0001")


def test_a_segment_that_nobody_wants_covers_none_that_is_wanted(tmp_path):
    layers = two_layers(OBLIQUE)
    tumour = described(2, "x", codes.SCT.Neoplasm)
    seg = highdicom_seg(source_images(OBLIQUE, tmp_path), layers, segments=[SEGMENTS[0], tumour])
    seg.save_as(tmp_path / "s.dcm")
    found = load_segmentation(tmp_path / "s.dcm", {}, TABLE, OBLIQUE, others="ignore")
    np.testing.assert_array_equal(found.labels, layers[..., 0])


def test_a_file_that_is_packed_as_a_whole_is_not_unpacked_beyond_what_may_be_read(tmp_path, monkeypatch):
    layers = two_layers(OBLIQUE)
    seg = highdicom_seg(source_images(OBLIQUE, tmp_path), layers)
    wanted, file = tmp_path / "plain.dcm", tmp_path / "s.dcm"
    seg.save_as(wanted)
    seg.file_meta.TransferSyntaxUID = DeflatedExplicitVRLittleEndian
    seg.save_as(file)
    np.testing.assert_array_equal(read_dicom_seg(file).values, read_dicom_seg(wanted).values)
    monkeypatch.setattr(dicom_seg, "_HEADERS_MOST", 1000)
    with at_most(1000, "too many"), pytest.raises(MarkerError, match="too many"):
        read_labels(file)
    # the stated length of the file meta information counts for nothing, as for a reader
    content = file.read_bytes()
    for length in (0, len(content) - 144):
        stated = length.to_bytes(4, "little")
        file.write_bytes(content[:140] + stated + content[144:] + zlib.compress(b"", wbits=-15))
        with at_most(1000, "too many"), pytest.raises(MarkerError, match="too many"):
            read_labels(file)
    # nor need it be there
    file.write_bytes(content[:132] + content[144:])
    np.testing.assert_array_equal(read_dicom_seg(file).values, read_dicom_seg(wanted).values)
    with at_most(1000, "too many"), pytest.raises(MarkerError, match="too many"):
        read_labels(file)
