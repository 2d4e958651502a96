"""The pixels of DICOM images, decoded and as modality values.

What is stored becomes a value by the modality LUT or by rescale slope and intercept (PS3.3 C.11.1). MONOCHROME1 says
only that low values are shown bright (PS3.3 C.7.6.3.1.2), so it changes nothing here.
"""

from __future__ import annotations

import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import SimpleITK
from pydicom import uid as syntaxes
from pydicom.dataset import FileDataset, FileMetaDataset
from pydicom.encaps import encapsulate, get_frame
from pydicom.pixels import apply_modality_lut, get_decoder
from scipy import ndimage

from heartcase.pipeline.formats.dicom.archive import SourceFile
from heartcase.pipeline.formats.dicom.jpeg2000_check import is_contradictory
from heartcase.pipeline.formats.dicom.stack import Slice
from heartcase.pipeline.formats.dicom.tags import numbers_of, quiet_pydicom, read_data_set
from heartcase.pipeline.formats.volumes.quiet_itk import quiet_itk
from heartcase.schemas.arrays import Bool, Float32, Float64
from heartcase.schemas.errors import ScanError

__all__ = ["fill_padding", "read_pixels"]


DAMAGED = "the file is cut short or damaged: copy it from the scanner or archive again"
CONTRADICTORY = (
    "its compressed pixels are damaged and would give wrong values: copy it from the scanner or archive again, or "
    "export the series uncompressed"
)
UNREAD_COMPRESSION = "its compression is not read: export the series uncompressed"
PLUGINS = {
    syntaxes.RLELossless: "pydicom",
    syntaxes.JPEGLSLossless: "pyjpegls",
    syntaxes.JPEGLSNearLossless: "pyjpegls",
    syntaxes.JPEG2000Lossless: "pillow",
    syntaxes.JPEG2000: "pillow",
    syntaxes.JPEGBaseline8Bit: "pillow",
}
"""Transfer syntax -> decoder of pydicom. Named, so that another package that is installed changes no value."""
SPEAKING_BY_GDCM = (syntaxes.JPEGBaseline8Bit,)
"""Whose decoder above says nothing of damage that it meets, while the one inside SimpleITK does."""
GDCM_SYNTAXES = (*PLUGINS, syntaxes.JPEGExtended12Bit, syntaxes.JPEGLossless, syntaxes.JPEGLosslessSV1)
"""What the decoder inside SimpleITK takes, for want of the one above."""
SECONDARY_CAPTURE = "1.2.840.10008.5.1.4.1.1.7"


def read_pixels(slices: tuple[Slice, ...], progress: Callable[[], None] = lambda: None) -> Float32:
    """Values of the images of a stack.

    Parameters
    ----------
    slices
        Images of one size, in the order that is wanted.
    progress
        Called after each image.

    Returns
    -------
    ndarray
        Values, float32, shape (len(slices), rows, columns); NaN where an image is padded from its edge.

    Raises
    ------
    ScanError
        A file is damaged, or compressed in a way that is not read; it names the slice. Or some slices state a rescale
        and others do not.
    """
    _check_rescale(slices)
    rows, columns = slices[0].shape
    values = np.empty((len(slices), rows, columns), dtype=np.float32)
    by_file: dict[SourceFile, list[int]] = {}
    for number, image in enumerate(slices):
        by_file.setdefault(image.path, []).append(number)
    with quiet_pydicom():
        for path, numbers in by_file.items():
            dataset = None
            for number in numbers:
                try:
                    dataset = dataset if dataset is not None else _data_set(path)
                    stored = _stored(dataset, slices[number])
                    _compare_copies(path, stored, slices[number])
                    values[number] = _values(dataset, stored, slices[number])
                except ScanError as error:
                    raise ScanError(error.problems[0].message, place=f"slice {number + 1}") from None
                progress()
    return values


def _check_rescale(slices: tuple[Slice, ...]) -> None:
    for number, image in enumerate(slices):
        if image.rescale == "unreadable":
            raise ScanError(
                "its rescale slope and intercept, or modality LUT, cannot be read, so that its values are unknown: "
                "export the series again",
                place=f"slice {number + 1}",
            )
    bare = [number for number, image in enumerate(slices) if image.rescale == "unstated"]
    if 0 < len(bare) < len(slices):
        raise ScanError(
            "it states no rescale slope and intercept while other slices do, so that its values are unknown: export "
            "the series again",
            place=f"slice {bare[0] + 1}",
        )


def fill_padding(values: Float32) -> Float32:
    """Replace padding (NaN) by the lowest real value, in place.

    Raises
    ------
    ScanError
        There is nothing but padding.
    """
    padding = np.isnan(values)
    if padding.all():
        raise ScanError("all pixels hold the padding value of the header: export the series again")
    if padding.any():
        values[padding] = np.nanmin(values)
    return values


def _data_set(path: SourceFile) -> Any:
    try:
        return read_data_set(path)
    except Exception:  # pydicom raises errors of every kind on damaged files
        raise ScanError(DAMAGED) from None


def _stored(dataset: Any, image: Slice) -> npt.NDArray[Any]:
    """Stored values of an image, shape (rows, columns)."""
    index = image.frame or 0
    try:
        syntax = dataset.file_meta.TransferSyntaxUID
        if syntax.is_encapsulated:
            stored = _decompressed(dataset, syntax, index)
        else:
            decoder = get_decoder(syntax)
            stored = decoder.as_array(dataset, index=index, raw=True, correct_unused_bits=False)[0]
            stored = _used_bits(stored, dataset)
    except ScanError:
        raise
    except NotImplementedError:
        raise ScanError(UNREAD_COMPRESSION) from None
    except Exception:  # as above
        raise ScanError(DAMAGED) from None
    if stored.shape != image.shape:
        raise ScanError(DAMAGED)
    return stored


def _used_bits(stored: npt.NDArray[Any], dataset: Any) -> npt.NDArray[Any]:
    """Stored values without the bits above and below, which may hold an overlay, and with their sign."""
    if stored.dtype.kind == "f":
        return stored
    allocated, bits, high = int(dataset.BitsAllocated), int(dataset.BitsStored), int(dataset.HighBit)
    if not 0 < bits <= high + 1 <= allocated:
        raise ScanError(DAMAGED)
    stored = stored.astype(stored.dtype.newbyteorder("="))
    return (stored << (allocated - high - 1)) >> (allocated - bits) if bits < allocated else stored


def _decompressed(dataset: Any, syntax: Any, index: int) -> npt.NDArray[Any]:
    """One frame, of which no decoder complains."""
    plugin = PLUGINS.get(syntax)
    if plugin is None or plugin not in get_decoder(syntax).available_plugins:
        if syntax not in GDCM_SYNTAXES:
            raise ScanError(UNREAD_COMPRESSION)
        array = _decompressed_by_gdcm(dataset, syntax, index)
    else:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            array = get_decoder(syntax).as_array(dataset, index=index, raw=True, decoding_plugin=plugin)[0]
        if said:
            raise ScanError(CONTRADICTORY)
        if syntax in SPEAKING_BY_GDCM:
            _decompressed_by_gdcm(dataset, syntax, index)
    if syntax == syntaxes.JPEG2000Lossless and is_contradictory(_frame(dataset, index), array):
        raise ScanError(CONTRADICTORY)
    return np.asarray(array)


def _frame(dataset: Any, index: int) -> bytes:
    """A compressed frame as it is stored."""
    frame_count = int((numbers_of(dataset, "NumberOfFrames", 1) or (1.0,))[0])
    offsets = [dataset.get(keyword) for keyword in ("ExtendedOffsetTable", "ExtendedOffsetTableLengths")]
    extended = (offsets[0], offsets[1]) if None not in offsets else None
    frame: bytes = get_frame(dataset.PixelData, index, number_of_frames=frame_count, extended_offsets=extended)
    return frame


def _decompressed_by_gdcm(dataset: Any, syntax: Any, index: int) -> npt.NDArray[Any]:
    """One frame by the decoder inside SimpleITK, which reads files only and rescales what has a slope.

    So it gets a file of its own, with the frame and nothing else.
    """
    frame = _frame(dataset, index)
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = SECONDARY_CAPTURE, "2.25.1"
    meta.TransferSyntaxUID = syntax
    alone = FileDataset("", {}, file_meta=meta, preamble=b"\0" * 128)
    alone.SOPClassUID, alone.SOPInstanceUID = SECONDARY_CAPTURE, "2.25.1"
    alone.SamplesPerPixel, alone.PhotometricInterpretation = 1, "MONOCHROME2"
    for keyword in ("Rows", "Columns", "BitsAllocated", "BitsStored", "HighBit", "PixelRepresentation"):
        setattr(alone, keyword, getattr(dataset, keyword))
    alone.PixelData = encapsulate([frame])
    alone["PixelData"].VR = "OB"
    try:
        with tempfile.TemporaryDirectory(prefix="heartcase-") as folder, quiet_itk() as complaint:
            file = Path(folder) / "frame.dcm"
            alone.save_as(file, enforce_file_format=True)
            reader = SimpleITK.ImageFileReader()
            reader.SetImageIO("GDCMImageIO")
            reader.SetFileName(str(file))
            array: npt.NDArray[Any] = SimpleITK.GetArrayFromImage(reader.Execute())
    except OSError:
        raise ScanError("there is no room to decompress it: free space in the folder for temporary files") from None
    except (RuntimeError, MemoryError):
        raise ScanError(DAMAGED) from None
    if complaint.was_made:
        raise ScanError(CONTRADICTORY)
    return array[0] if array.ndim == 3 else array


def _compare_copies(path: SourceFile, stored: npt.NDArray[Any], image: Slice) -> None:
    for copy in image.copies:
        try:
            same_bytes = copy.read_bytes() == path.read_bytes()
        except OSError:
            raise ScanError(DAMAGED) from None
        if not same_bytes and not np.array_equal(_stored(_data_set(copy), image), stored):
            raise ScanError("two files with different pixels claim to be this image: remove the one that is wrong")


def _values(dataset: Any, stored: npt.NDArray[Any], image: Slice) -> Float64:
    padding = _padding(dataset, stored)
    if image.rescale == "table":
        try:
            values = np.asarray(apply_modality_lut(stored, dataset), dtype=np.float64)
        except Exception:  # as above
            raise ScanError(DAMAGED) from None
    else:
        values = stored.astype(np.float64) * image.slope + image.intercept
    if not (np.abs(values) <= np.finfo(np.float32).max).all():
        raise ScanError("its rescaled values are not finite numbers: export the series again")
    if padding is not None:
        values[padding] = np.nan
    return values


def _padding(dataset: Any, stored: npt.NDArray[Any]) -> Bool | None:
    """Pixels with the padding value that hang together with the edge of the image (PS3.3 C.7.5.1.1.2)."""
    first = numbers_of(dataset, "PixelPaddingValue", 1)
    if first is None or stored.dtype.kind == "f":
        return None
    last = numbers_of(dataset, "PixelPaddingRangeLimit", 1) or first
    # Written as US in many signed images: the bits count, not the sign.
    bits = 8 * stored.dtype.itemsize
    ends = [
        int(np.array(int(value) % 2**bits, dtype=f"u{stored.dtype.itemsize}").view(stored.dtype))
        for value in (*first, *last)
    ]
    mask = (stored >= min(ends)) & (stored <= max(ends))
    if not mask.any():
        return None
    parts, count = ndimage.label(mask, structure=np.ones((3, 3)))
    at_edge = np.zeros(count + 1, dtype=bool)
    for edge in (parts[0], parts[-1], parts[:, 0], parts[:, -1]):
        at_edge[edge] = True
    at_edge[0] = False
    return np.asarray(at_edge[parts])
