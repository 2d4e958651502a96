"""MetaImage files are read as ITK reads them."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from heartcase.pipeline.formats.volumes.read_metaimage import ELEMENT_TYPES, read_metaimage
from heartcase.schemas.errors import ScanError

TYPES = ["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"]


def same_as_itk(path: Path) -> None:
    image = SimpleITK.ReadImage(str(path))
    found = read_metaimage(path)
    expected = SimpleITK.GetArrayFromImage(image)
    np.testing.assert_array_equal(found.values, expected)
    assert found.values.dtype.newbyteorder("=") == expected.dtype
    np.testing.assert_allclose(found.geometry.origin_mm, image.GetOrigin(), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.geometry.spacing_mm, image.GetSpacing(), rtol=1e-6)
    np.testing.assert_allclose(np.ravel(found.geometry.direction), image.GetDirection(), atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(TYPES),
    st.tuples(*[st.integers(1, 5)] * 3),
    st.integers(0, 2**32 - 1),
    st.booleans(),
    st.booleans(),
    st.sampled_from([".mha", ".mhd"]),
    st.integers(1, 3),
)
def test_whatever_itk_writes(tmp_path_factory, dtype, shape, seed, mirrored, compressed, suffix, channels) -> None:
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 120, (*shape, channels) if channels > 1 else shape).astype(dtype)
    image = SimpleITK.GetImageFromArray(values, isVector=channels > 1)
    image.SetSpacing(rng.uniform(0.3, 4.0, 3).tolist())
    image.SetOrigin(rng.uniform(-500, 500, 3).tolist())
    turn = Rotation.random(random_state=seed % 1000).as_matrix() * (-1.0 if mirrored else 1.0)
    image.SetDirection(turn.ravel().tolist())
    path = tmp_path_factory.mktemp("meta") / f"volume{suffix}"
    SimpleITK.WriteImage(image, str(path), useCompression=compressed)
    same_as_itk(path)


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("element", sorted(set(ELEMENT_TYPES) - {"MET_LONG", "MET_ULONG"}))
def test_every_type_in_both_byte_orders(tmp_path: Path, element: str, big_endian: bool) -> None:
    dtype = np.dtype((">" if big_endian else "<") + ELEMENT_TYPES[element])
    values = np.arange(24).reshape(2, 3, 4).astype(dtype)
    path = tmp_path / "volume.mha"
    header = (
        f"ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = {big_endian}\nDimSize = 4 3 2\n"
    )
    header += f"ElementSize = 1 2 3\nPosition = 5 6 7\nRotation = 0 1 0 1 0 0 0 0 1\nElementType = {element}\n"
    path.write_bytes(f"{header}ElementDataFile = LOCAL\n".encode() + values.tobytes())
    same_as_itk(path)


def test_text_and_skipped_bytes(tmp_path: Path) -> None:
    head = "ObjectType = Image\nNDims = 3\nDimSize = 3 2 2\nElementSpacing = 1 2 3\nElementType = MET_SHORT\n"
    values = np.arange(-6, 6, dtype="<i2").reshape(2, 2, 3)
    text = tmp_path / "text.mha"
    text.write_text(f"{head}BinaryData = False\nElementDataFile = LOCAL\n" + " ".join(map(str, values.ravel())))
    np.testing.assert_array_equal(read_metaimage(text).values, values)
    (tmp_path / "values.raw").write_bytes(b"#" * 100 + values.tobytes())
    for size in (100, -1):
        path = tmp_path / "skipped.mhd"
        path.write_text(f"{head}HeaderSize = {size}\nElementDataFile = values.raw\n")
        same_as_itk(path)


def test_a_stream_that_holds_more_or_less_is_refused(tmp_path: Path) -> None:
    head = "ObjectType = Image\nNDims = 3\nDimSize = 3 2 2\nElementSpacing = 1 2 3\n"
    head += "ElementType = MET_SHORT\nCompressedData = True\n"
    path = tmp_path / "volume.mha"
    for count in (11, 13, 10**6):
        packed = zlib.compress(np.zeros(count, "<i2").tobytes())
        path.write_bytes(f"{head}ElementDataFile = LOCAL\n".encode() + packed)
        with pytest.raises(ScanError, match="damaged"):
            read_metaimage(path)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("", "voxel spacing of every axis"),
        ("ElementSpacing = 1 nan 3", "voxel spacing of every axis"),
        ("ElementSpacing = 1 -2 3", "voxel spacing of every axis"),
        ("ElementSpacing = 1 0 3", "voxel spacing of every axis"),
        ("ElementSpacing = 1 inf 3", "voxel spacing of every axis"),
        ("ElementSize = 1 2 3\nDistanceUnits = cm", "millimetres"),
        ("ElementSpacing = 1 2 3\nElementToIntensityFunctionSlope = 2", "intensity function"),
        ("ElementSpacing = 1 2 3\nElementToIntensityFunctionOffset = -1024", "intensity function"),
        ("ElementSpacing = 1 2 3\nElementToIntensityFunctionSlope = x", "intensity function"),
    ],
)
def test_what_itk_guesses_or_ignores_is_refused(tmp_path: Path, lines: str, words: str) -> None:
    path = tmp_path / "volume.mha"
    head = f"ObjectType = Image\nNDims = 3\nDimSize = 3 2 2\n{lines}\nElementType = MET_SHORT\n"
    path.write_bytes(f"{head}ElementDataFile = LOCAL\n".encode() + bytes(24))
    with pytest.raises(ScanError, match=words):
        read_metaimage(path)


@pytest.mark.parametrize("key", ["TransformMatrix", "Rotation", "Orientation", "AnatomicalOrientation", ""])
def test_whether_the_orientation_is_stated(tmp_path: Path, key: str) -> None:
    """AnatomicalOrientation only repeats in letters what a matrix says, and ITK does not read it."""
    line = f"{key} = 1 0 0 0 1 0 0 0 1\n" if key and not key.startswith("Ana") else "AnatomicalOrientation = RAI\n"
    path = tmp_path / "volume.mha"
    head = "ObjectType = Image\nNDims = 3\nDimSize = 3 2 2\nElementSpacing = 1 2 3\nDistanceUnits = mm\n"
    head += f"{line}ElementToIntensityFunctionSlope = 1.0\nElementType = MET_SHORT\nElementDataFile = LOCAL\n"
    path.write_bytes(head.encode() + bytes(24))
    assert read_metaimage(path).orientation_is_stated == (key in ("TransformMatrix", "Rotation", "Orientation"))
