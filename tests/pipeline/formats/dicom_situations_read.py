"""Situations of how an image is stored: kinds of pixel, compression, coding of the file."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pydicom
from pydicom import uid
from pydicom.dataset import Dataset, FileDataset
from pydicom.encaps import encapsulate
from pydicom.sequence import Sequence

from tests.pipeline.formats.dicom_series import ENHANCED_MR, items, put_pixels, write_enhanced
from tests.pipeline.formats.dicom_situations import (
    GEOMETRY,
    STORED,
    Situation,
    Truth,
    direction_cosines,
    frames_of_itk,
    write,
)

__all__ = ["SITUATIONS", "compressed", "enhanced", "lossless_jpeg"]

Change = Callable[[FileDataset, int], None]

POSITIONS = GEOMETRY.index_to_world([(0, 0, k) for k in range(len(STORED))])
ENHANCED_CT = "1.2.840.10008.5.1.4.1.1.2.1"
LEGACY_CT = "1.2.840.10008.5.1.4.1.1.2.2"


def stored_as(change: Change, *, values: np.ndarray = STORED, loss: float = 0.0, **options: Any) -> Any:
    """A plain series with each data set changed before it is saved."""

    def make(folder: Path) -> Truth:
        write(folder, each=change, **options)
        return Truth(values, loss=loss)

    return make


def compressed(syntax: str, **options: Any) -> Change:
    """Compress by one of pydicom's encoders."""

    def change(dataset: FileDataset, index: int) -> None:
        dataset.compress(syntax, generate_instance_uid=False, **options)

    return change


def lossless_jpeg(dataset: FileDataset, index: int = 0) -> None:
    """Compress as JPEG process 14, selection value 1."""
    count = int(dataset.get("NumberOfFrames", 1))
    frames = frames_of_itk(dataset.PixelData, (count, dataset.Rows, dataset.Columns))
    dataset.PixelData = encapsulate(list(frames))
    dataset["PixelData"].VR = "OB"
    dataset.file_meta.TransferSyntaxUID = uid.JPEGLosslessSV1


def _eight_bit(dataset: FileDataset, index: int) -> None:
    put_pixels(dataset, (STORED[index] // 8).astype(np.uint8))


def _jpeg_baseline(dataset: FileDataset, index: int) -> None:
    _eight_bit(dataset, index)
    buffer = io.BytesIO()
    PIL.Image.fromarray((STORED[index] // 8).astype(np.uint8)).save(buffer, "JPEG", quality=100)
    dataset.PixelData = encapsulate([buffer.getvalue()])
    dataset["PixelData"].VR = "OB"
    dataset.file_meta.TransferSyntaxUID = uid.JPEGBaseline8Bit


def _monochrome1(dataset: FileDataset, index: int) -> None:
    dataset.PhotometricInterpretation = "MONOCHROME1"


def _monochrome1_jpeg(dataset: FileDataset, index: int) -> None:
    lossless_jpeg(dataset)
    _monochrome1(dataset, index)


def _overlay(dataset: FileDataset, index: int) -> None:
    dataset.BitsStored, dataset.HighBit = 12, 11
    dataset.PixelData = (STORED[index] | ((index % 16) << 12)).astype(np.uint16).tobytes()


def _signed_twelve(dataset: FileDataset, index: int) -> None:
    put_pixels(dataset, ((STORED[index].astype(np.int16) - 800) & 0x0FFF).astype(np.int16))
    dataset.BitsStored, dataset.HighBit = 12, 11


def _left_aligned(dataset: FileDataset, index: int) -> None:
    put_pixels(dataset, (STORED[index] << 4).astype(np.uint16))
    dataset.BitsStored, dataset.HighBit = 12, 15


def _thirty_two(dataset: FileDataset, index: int) -> None:
    put_pixels(dataset, STORED[index].astype(np.uint32) * 1000)


def _float(dataset: FileDataset, index: int) -> None:
    del dataset.PixelData, dataset.PixelRepresentation, dataset.BitsStored, dataset.HighBit
    dataset.BitsAllocated = 32
    dataset.FloatPixelData = (STORED[index] * np.float32(0.25)).astype("<f4").tobytes()


def _modality_lut(dataset: FileDataset, index: int) -> None:
    del dataset.RescaleSlope, dataset.RescaleIntercept
    curve = (np.arange(1500) ** 2 // 50).astype(np.uint16)
    lut = items(LUTDescriptor=[1500, 0, 16], ModalityLUTType="US", LUTData=curve.tobytes())
    dataset.ModalityLUTSequence = lut


def _padded(value: int, signed: bool) -> tuple[np.ndarray, Change]:
    """The corners of every slice are padding, and one voxel inside happens to hold the same value."""
    j, i = np.indices(STORED.shape[1:])
    outside = (j - 17.5) ** 2 + (i - 16.5) ** 2 > 16.0**2
    dtype = np.int16 if signed else np.uint16
    stored = STORED.astype(dtype)
    stored[:, outside] = value
    stored[4, 19, 17] = value
    truth = stored.astype(float)
    truth[:, outside] = stored[:, ~outside].min()

    def change(dataset: FileDataset, index: int) -> None:
        put_pixels(dataset, stored[index])
        dataset.add_new("PixelPaddingValue", "US", value % 2**16)  # as many scanners do, whatever the sign

    return truth, change


def _per_slice(dataset: FileDataset, index: int) -> None:
    dataset.RescaleSlope, dataset.RescaleIntercept = 0.5 + index, -index


def _big_endian(folder: Path) -> Truth:
    for index, path in enumerate(write(folder, order=range(len(STORED)))):
        dataset = pydicom.dcmread(path)
        dataset.file_meta.TransferSyntaxUID = uid.ExplicitVRBigEndian
        dataset.PixelData = STORED[index].astype(">u2").tobytes()
        pydicom.dcmwrite(path, dataset, implicit_vr=False, little_endian=False, force_encoding=True)
    return Truth(STORED)


def _syntax(syntax: str) -> Change:
    def change(dataset: FileDataset, index: int) -> None:
        dataset.file_meta.TransferSyntaxUID = syntax

    return change


def _nested(dataset: FileDataset, index: int) -> None:
    inner = Dataset()
    inner.CodeValue, inner.CodeMeaning = "T-32000", "Sensitivus"
    inner.ReferencedImageSequence = items(ReferencedSOPInstanceUID="1.2.3")
    inner["ReferencedImageSequence"].is_undefined_length = True
    inner.is_undefined_length_sequence_item = True
    dataset.ProcedureCodeSequence = Sequence([inner])
    dataset["ProcedureCodeSequence"].is_undefined_length = True
    block = dataset.private_block(0x0029, "SENSITIVUS HEADER", create=True)
    block.add_new(0x10, "OB", bytes(range(256)) * 4)
    block.add_new(0x20, "SQ", items(PatientName="Sensitivus^Anna"))
    dataset[0x00291020].is_undefined_length = True


def _bare(folder: Path) -> Truth:
    for path in write(folder):
        dataset = pydicom.dcmread(path)
        bare = Dataset()
        bare.update(dataset)
        bare.save_as(path, implicit_vr=True, little_endian=True, enforce_file_format=False)
    return Truth(STORED)


def _no_modality(dataset: FileDataset, index: int) -> None:
    del dataset.Modality


def enhanced(folder: Path, stored: np.ndarray = STORED, positions: np.ndarray = POSITIONS, **options: Any) -> None:
    """An enhanced multi-frame file at the geometry."""
    options = {"name": "one.dcm"} | options
    write_enhanced(
        folder / options.pop("name"),
        stored,
        positions,
        orientation=direction_cosines(GEOMETRY),
        spacing=(GEOMETRY.spacing_mm[1], GEOMETRY.spacing_mm[0]),
        **options,
    )


def _multi_frame(**options: Any) -> Callable[[Path], Truth]:
    def make(folder: Path) -> Truth:
        order = np.random.default_rng(5).permutation(len(STORED))
        slopes = np.ones(len(STORED)) * 2.0
        intercepts = np.ones(len(STORED)) * 3.0
        given = dict(options)
        if given.pop("per_frame_rescale", False):
            slopes, intercepts = 1.0 + 0.5 * order, -100.0 * order

            def frames(frame: Dataset, number: int) -> None:
                frame.PixelValueTransformationSequence = items(
                    RescaleSlope=slopes[number], RescaleIntercept=intercepts[number]
                )

            given["frames"] = frames
        enhanced(folder, STORED[order], POSITIONS[order], **given)
        values = np.empty(STORED.shape)
        values[order] = STORED[order] * slopes[:, None, None] + intercepts[:, None, None]
        return Truth(values)

    return make


def _frame_per_file(folder: Path) -> Truth:
    for k in range(len(STORED)):
        enhanced(folder, STORED[k : k + 1], POSITIONS[k : k + 1], name=f"f{7 * k % 9}", instance=k + 1)
    return Truth(STORED * 2.0 + 3.0)


_PAD_LOW, _CHANGE_LOW = _padded(-2000, True)
_PAD_HIGH, _CHANGE_HIGH = _padded(65535, False)
_SMALL = (STORED // 8).astype(float)
_SQUARED = (np.arange(1500) ** 2 // 50).astype(float)[STORED]

SITUATIONS = (
    Situation("slices out of order, oblique, pixels not square", stored_as(lambda d, i: None)),
    Situation(
        "rescale slope and intercept of each slice",
        stored_as(_per_slice, values=STORED * (0.5 + np.arange(9))[:, None, None] - np.arange(9)[:, None, None]),
    ),
    Situation(
        "CT, signed 16 bit, intercept -1024",
        stored_as(
            lambda d, i: put_pixels(d, STORED[i].astype(np.int16) - 500),
            modality="CT",
            intercept=-1024.0,
            values=STORED - 1524.0,
        ),
    ),
    Situation("MONOCHROME1: shown inverted, values as they are", stored_as(_monochrome1)),
    Situation("MONOCHROME1, lossless JPEG", stored_as(_monochrome1_jpeg)),
    Situation("modality LUT instead of a slope", stored_as(_modality_lut, values=_SQUARED)),
    Situation("8 bit", stored_as(_eight_bit, values=_SMALL)),
    Situation("12 of 16 bits, an overlay in the high bits", stored_as(_overlay)),
    Situation(
        "signed 12 of 16 bits, high bits not filled with the sign", stored_as(_signed_twelve, values=STORED - 800.0)
    ),
    Situation("12 bits at the upper end of 16", stored_as(_left_aligned)),
    Situation("32 bit", stored_as(_thirty_two, values=STORED * 1000.0)),
    Situation("float pixel data", stored_as(_float, values=STORED * 0.25)),
    Situation("padding -2000 outside the field of view, written as unsigned", stored_as(_CHANGE_LOW, values=_PAD_LOW)),
    Situation("padding 65535 outside the field of view", stored_as(_CHANGE_HIGH, values=_PAD_HIGH)),
    Situation("no modality in the header", stored_as(_no_modality)),
    Situation("implicit VR", stored_as(_syntax(uid.ImplicitVRLittleEndian))),
    Situation("explicit VR big endian", _big_endian),
    Situation("deflated", stored_as(_syntax(uid.DeflatedExplicitVRLittleEndian))),
    Situation("no preamble, no file meta information", _bare),
    Situation("nested and private sequences of undefined length", stored_as(_nested)),
    Situation("RLE", stored_as(compressed(uid.RLELossless, encoding_plugin="pydicom"))),
    Situation("JPEG baseline, 8 bit, lossy", stored_as(_jpeg_baseline, values=_SMALL, loss=2.0)),
    Situation("JPEG lossless (process 14)", stored_as(lossless_jpeg)),
    Situation("JPEG-LS lossless", stored_as(compressed(uid.JPEGLSLossless))),
    Situation("JPEG-LS near-lossless", stored_as(compressed(uid.JPEGLSNearLossless, jls_error=3), loss=3.0)),
    Situation("JPEG 2000 lossless", stored_as(compressed(uid.JPEG2000Lossless))),
    Situation(
        "JPEG 2000 lossless, signed",
        stored_as(
            lambda d, i: (put_pixels(d, STORED[i].astype(np.int16) - 800), compressed(uid.JPEG2000Lossless)(d, i))[0],
            values=STORED - 800.0,
        ),
    ),
    Situation("JPEG 2000 lossy", stored_as(compressed(uid.JPEG2000, j2k_psnr=[90.0]), loss=12.0)),
    Situation("enhanced MR, multi-frame, frames out of order", _multi_frame()),
    Situation("enhanced MR, the file itself given", _multi_frame(), file="one.dcm"),
    Situation(
        "enhanced CT, rescale of each frame", _multi_frame(sop_class=ENHANCED_CT, modality="CT", per_frame_rescale=True)
    ),
    Situation("legacy converted enhanced CT", _multi_frame(sop_class=LEGACY_CT, modality="CT")),
    Situation("enhanced MR, one frame in each file", _frame_per_file),
    Situation(
        "enhanced MR, RLE", _multi_frame(whole=lambda d: compressed(uid.RLELossless, encoding_plugin="pydicom")(d, 0))
    ),
    Situation("enhanced MR, JPEG 2000", _multi_frame(whole=lambda d: compressed(uid.JPEG2000Lossless)(d, 0))),
    Situation("enhanced MR, JPEG-LS", _multi_frame(whole=lambda d: compressed(uid.JPEGLSLossless)(d, 0))),
    Situation("enhanced MR, lossless JPEG", _multi_frame(sop_class=ENHANCED_MR, whole=lossless_jpeg)),
)
"""How an image is stored: all of it is read."""
