"""Headers that say a thing twice or roundly: one tolerance, in mm at the volume's corners, for all formats."""

from __future__ import annotations

from pathlib import Path

import nibabel
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.pipeline.formats.volumes.agreement import AGREEMENT_MM, corner_distance_mm, even_line, right_angled
from heartcase.pipeline.formats.volumes.raw_volume import geometry_from_affine
from heartcase.schemas.errors import ScanError
from tests.pipeline.formats.dicom_series import write_series

SIZE = (60, 50, 40)


def sheared(amount: float, spacing: float = 1.2) -> np.ndarray:
    """A column that leans by ``amount`` in ``spacing``."""
    affine = np.diag([spacing, spacing, spacing, 1.0])
    affine[0, 1] = amount
    return affine


def test_a_shear_that_moves_no_corner_is_evened_out(tmp_path: Path) -> None:
    affine = sheared(0.001)
    assert corner_distance_mm(affine, right_angled(affine, SIZE), SIZE) < 0.03
    image = nibabel.Nifti1Image(np.zeros(SIZE, np.int16), affine)
    image.set_sform(affine, 1)
    image.set_qform(affine, 1)
    nibabel.save(image, tmp_path / "s.nii")
    geometry = read_scan(tmp_path / "s.nii").geometry
    direction = geometry.direction_matrix
    np.testing.assert_allclose(direction.T @ direction, np.eye(3), atol=1e-9)
    ras = np.diag([-1.0, -1.0, 1.0, 1.0]) @ affine
    assert corner_distance_mm(geometry.affine, ras, SIZE) < 0.03


def files_of(folder: Path, shear: float) -> list[Path]:
    """One volume of 4 x 500 x 3 voxels in every format, whose second axis leans by ``shear`` mm in 1 mm."""
    values = np.arange(6000, dtype="<i2")
    head = "NRRD0004\ntype: short\ndimension: 3\nsizes: 4 500 3\nencoding: raw\nendian: little\nspace: LPS\n"
    (folder / "a.nrrd").write_bytes(
        f"{head}space directions: (1,0,0) ({shear},1,0) (0,0,2)\nspace origin: (1,2,3)\n\n".encode() + values.tobytes()
    )
    unit = np.array([shear, 1.0]) / np.hypot(shear, 1.0)
    (folder / "a.mha").write_bytes(
        (
            "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nDimSize = 4 500 3\n"
            f"TransformMatrix = 1 0 0 {unit[0]} {unit[1]} 0 0 0 1\nElementSpacing = 1 1 2\nOffset = 1 2 3\n"
            "ElementType = MET_SHORT\nElementDataFile = LOCAL\n"
        ).encode()
        + values.tobytes()
    )
    affine = np.diag([-1.0, -1.0, 2.0, 1.0])
    affine[0, 1] = -shear
    image = nibabel.Nifti1Image(np.zeros((4, 500, 3), np.int16), affine)
    image.set_qform(None, 0)
    nibabel.save(image, folder / "a.nii")
    write_series(
        folder / "dicom",
        values.reshape(3, 500, 4),
        np.array([[1.0, 2.0, 3.0 + 2.0 * k] for k in range(3)]),
        orientation=(1.0, 0.0, 0.0, *unit, 0.0),
        pixel_spacing=(1.0, 1.0),
    )
    return [folder / "a.nrrd", folder / "a.mha", folder / "a.nii", folder / "dicom"]


@pytest.mark.parametrize(("shear", "is_read"), [(1.5e-4, True), (5e-3, False)])
def test_every_format_has_the_same_tolerance(tmp_path: Path, shear: float, is_read: bool) -> None:
    for path in files_of(tmp_path, shear):
        if is_read:
            geometry = read_scan(path).geometry
            true = np.diag([1.0, 1.0, 2.0, 1.0])
            true[0, 1] = shear
            true[:3, 3] = geometry.origin_mm
            assert corner_distance_mm(geometry.affine, true, geometry.size) < 2.0 * AGREEMENT_MM, path.suffix
        else:
            with pytest.raises(ScanError, match="not at right angles"):
                read_scan(path)


@settings(max_examples=60, deadline=None)
@given(
    shear=st.tuples(*[st.floats(-3e-3, 3e-3)] * 3),
    size=st.tuples(*[st.integers(2, 400)] * 3),
    spacing=st.tuples(*[st.floats(0.3, 8.0)] * 3),
    is_left_handed=st.booleans(),
)
def test_what_is_read_lies_within_the_tolerance_and_what_is_refused_does_not(
    shear, size, spacing, is_left_handed
) -> None:
    affine = np.eye(4)
    affine[:3, :3] += np.array([[0, shear[0], shear[1]], [0, 0, shear[2]], [0, 0, 0]])
    affine[:3, :3] *= np.array(spacing) * (1.0, 1.0, -1.0 if is_left_handed else 1.0)
    affine[:3, 3] = 40.0, -30.0, 700.0
    try:
        geometry = geometry_from_affine(affine, size[::-1])
    except ScanError:
        # no rotation of the columns by less than half of the largest angle between them sets them straight
        assert np.abs(shear).max() * np.dot(np.array(size) - 1, spacing) > AGREEMENT_MM
    else:
        assert corner_distance_mm(geometry.affine, affine, size) <= AGREEMENT_MM + 1e-9
        assert geometry.is_right_handed is not is_left_handed


@settings(max_examples=60, deadline=None)
@given(
    count=st.integers(3, 40),
    spacing=st.floats(0.5, 10.0),
    seed=st.integers(0, 10**6),
    digits=st.integers(0, 3),
)
def test_the_even_line_is_that_of_a_linear_programme(count: int, spacing: float, seed: int, digits: int) -> None:
    rng = np.random.default_rng(seed)
    places = np.concatenate(([0], np.cumsum(rng.integers(1, 3, count - 1))))
    along = np.round(rng.uniform(-50, 50) + spacing * places, digits)
    start, found, distance = even_line(along, places)
    assert np.abs(along - start - found * places).max() == pytest.approx(distance, abs=1e-9)
    ones = np.ones(count)
    rows = np.stack([ones, places, -ones], axis=1)
    result = linprog(
        [0, 0, 1],
        A_ub=np.concatenate([rows, np.stack([-ones, -places, -ones], axis=1)]),
        b_ub=np.concatenate([along, -along]),
        bounds=[(None, None), (None, None), (0, None)],
    )
    assert distance <= max(result.fun + 1e-6, 0.01)
    assert distance >= result.fun - 1e-6


@settings(max_examples=40, deadline=None)
@given(spacing=st.floats(0.3, 9.0), count=st.integers(5, 60), start=st.floats(-300.0, 300.0), digits=st.integers(1, 3))
def test_rounded_positions_are_read_with_a_spacing_that_fits_all(spacing, count, start, digits) -> None:
    from heartcase.pipeline.formats.dicom.stack import Slice, find_stack

    along = np.round(start + spacing * np.arange(count), digits)
    slices = [
        Slice(
            Path(),
            None,
            (8, 8),
            True,
            (0.0, 0.0, float(z)),
            (1, 0, 0, 0, 1, 0),
            (1.0, 1.0),
            1.0,
            0.0,
            position_decimals=(0, 0, digits),
        )
        for z in along
    ]
    stack = find_stack(slices)
    assert stack.places == tuple(range(count))
    fitted = stack.affine[2, 3] + stack.affine[2, 2] * np.arange(count)
    assert np.abs(fitted - along).max() <= max(0.5 * 10.0**-digits, 0.01) + 1e-9
    assert stack.affine[2, 2] == pytest.approx(spacing, abs=2.0 * 10.0**-digits / (count - 1) + 0.02 / (count - 1))


def test_slices_off_by_more_than_their_digits_explain_are_refused(tmp_path: Path) -> None:
    along = np.round(0.625 * np.arange(12), 1)
    along[6] += 0.2
    positions = np.array([[0.0, 0.0, z] for z in along])
    write_series(tmp_path, np.zeros((12, 5, 6), np.int16), positions)
    with pytest.raises(ScanError, match="uneven spacing"):
        read_scan(tmp_path)
