"""A small picture of a place: the scan and the labels around it, axial and coronal, as PNG in a data URL."""

from __future__ import annotations

import base64
import io

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates

from heartcase.pipeline.data import Scan
from heartcase.schemas.arrays import Float64, UInt8
from heartcase.schemas.labels import BACKGROUND, LabelTable

__all__ = ["PICTURE_SIZE", "place_picture"]

PICTURE_SIZE = 84
"""Height of a picture, and half of its width, in pixels."""
WIDTH_MM = 44.0
"""What is shown from left to right of each plane."""
_SHARE = 0.4
"""How much of a label's colour is laid over the scan."""
_PLANES = (((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
"""Directions to the right and down, LPS: axial and coronal, as radiologists see them."""
_RING = (255, 226, 122)


def place_picture(
    scan: Scan, labels: UInt8, table: LabelTable, position_mm: tuple[float, float, float], window: tuple[float, float]
) -> str:
    """The axial and the coronal plane through a place, side by side, with a ring around it.

    Parameters
    ----------
    scan
        The scan.
    labels
        Label of each of its voxels, shape [z, y, x].
    table
        Colours.
    position_mm
        The place, LPS mm; what lies outside of the scan is black.
    window
        Intensities that are black and white.

    Returns
    -------
    str
        A data URL.
    """
    colours = np.zeros((256, 3))
    for label in table:
        colours[label.value] = [int(label.colour[at : at + 2], 16) for at in (1, 3, 5)]
    pictures = [_plane(scan, labels, colours, np.array(position_mm), np.array(plane), window) for plane in _PLANES]
    stream = io.BytesIO()
    Image.fromarray(np.concatenate(pictures, axis=1)).save(stream, "png")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


def _plane(
    scan: Scan, labels: UInt8, colours: Float64, middle: Float64, plane: Float64, window: tuple[float, float]
) -> UInt8:
    off = (np.arange(PICTURE_SIZE) + 0.5) / PICTURE_SIZE - 0.5
    points = middle + WIDTH_MM * (off[:, None, None] * plane[1] + off[None, :, None] * plane[0])
    index = np.moveaxis(scan.geometry.world_to_index(points)[..., ::-1], -1, 0)
    low, high = window
    values = map_coordinates(scan.values, index, order=1, mode="constant", cval=low)
    grey = np.clip((values - low) / max(high - low, 1e-6), 0.0, 1.0)[..., None] * 255.0
    found = map_coordinates(labels, index, order=0, mode="constant", cval=BACKGROUND)
    is_shown = (found != BACKGROUND) & (found != 255)
    picture = np.where(is_shown[..., None], (1.0 - _SHARE) * grey + _SHARE * colours[found], grey)
    away = np.hypot(off[:, None], off[None, :]) * PICTURE_SIZE
    picture[np.abs(away - 9.0) < 0.8] = _RING
    shown: UInt8 = picture.astype(np.uint8)
    return shown
