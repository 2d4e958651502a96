"""The pictures of the page's checklist: where each thing is painted in the sample heart.

    python -m tests.studio.page.guide_pictures [--recipe sample_cases/adult_phantom.toml] [--scan SCAN]

A slice of the sample's scan for each kind, with the sample's own strokes (and ends) of that kind that lie near it. The
pictures are written into ``heartcase/studio/page/painting/guide``; they show a synthetic heart, and nobody.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFilter

from heartcase.library.scans import ensure_scan
from heartcase.pipeline.data import UNMARKED
from heartcase.pipeline.formats.read_scan import read_scan
from heartcase.pipeline.markers.load_markers import rasterise_strokes
from heartcase.schemas.labels import BACKGROUND, Role
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.studio.serving.app import PAGE

GUIDE = PAGE / "painting" / "guide"
SIZE = (136, 136)
"""Pixels across and down: twice what is shown, for fine screens."""
WIDTH_MM = 138.0
NEAR_MM = 5.0
"""Strokes that lie so near to the slice are drawn."""
ATRIA = ("82471001", "73829009")
BACKGROUND_COLOUR = (255, 255, 255)
END_COLOUR = (255, 226, 122)


def kinds(table):
    """Kind of the checklist -> values of the labels that it asks for."""
    atria = [label.value for code in ATRIA if (label := table.find_code(code))]
    return {
        "background": [BACKGROUND],
        "chambers": [label.value for label in table if label.role is Role.BLOOD and label.value not in atria],
        "atria": atria,
        "vessels": [label.value for label in table if label.role is Role.VESSEL_LUMEN],
        "myocardium": [label.value for label in table if label.role is Role.MYOCARDIUM],
    }


def best_slice(marked, values, axis):
    """The slice in which most of these labels are marked, and then most of the one that is marked least."""
    counts = np.stack([(marked == value).sum(axis=tuple(a for a in range(3) if a != axis)) for value in values])
    # of a thin slab
    slab = np.stack([np.convolve(row, np.ones(3), "same") for row in counts])
    least = np.sort(slab, axis=0)
    return int(np.lexsort((*least[::-1], (slab > 0).sum(axis=0)))[-1])


def picture(scan, marked, values, colours, ends=()):
    """A slice with marks: axial for strokes, coronal for ends; the patient's left is at the right."""
    spacing, shape = np.array(scan.geometry.spacing_mm[::-1]), np.array(scan.values.shape)
    axis = 1 if ends else 0
    origin = scan.geometry.affine[:3, 3]
    if ends:
        # through the most ends
        away = [
            sum(abs((origin[1] + n * spacing[1]) - end.position_mm[1]) < end.radius_mm for end in ends)
            for n in range(shape[1])
        ]
        at = int(np.mean(np.flatnonzero(away == np.max(away))))
    else:
        at = best_slice(marked, values, axis)
    near = range(max(at - int(NEAR_MM / spacing[axis]), 0), min(at + int(NEAR_MM / spacing[axis]) + 1, shape[axis]))
    grey = np.take(scan.values, at, axis)
    low, high = np.percentile(scan.values[::2, ::2, ::2], (1.0, 99.5))
    grey = np.clip((grey - low) / (high - low), 0.0, 1.0)
    rgb = np.repeat((235 * grey)[..., None], 3, axis=2)
    slab = np.take(marked, near, axis)
    rows_mm, columns_mm = (spacing[a] for a in range(3) if a != axis)
    scale = SIZE[0] / WIDTH_MM
    size = (round(rgb.shape[1] * columns_mm * scale), round(rgb.shape[0] * rows_mm * scale))
    # the head is up in a coronal picture
    up = slice(None, None, -1) if ends else slice(None)
    full = Image.fromarray(rgb[up].round().astype(np.uint8)).resize(size, Image.Resampling.BICUBIC)
    for value in values if not ends else ():
        is_marked = Image.fromarray(255 * (slab == value).any(axis=axis).astype(np.uint8)).resize(size)
        # a dark rim, so that every colour is seen on bright blood
        for wide, colour in ((5, (0, 0, 0)), (3, colours[value])):
            full.paste(colour, mask=is_marked.filter(ImageFilter.MaxFilter(wide)))
    draw = ImageDraw.Draw(full)
    y_mm = origin[1] + at * spacing[1]
    for end in ends:
        x, y, z = end.position_mm
        if abs(y - y_mm) > end.radius_mm:
            continue
        across = np.array([end.axis[2], -end.axis[0]]) / max(np.hypot(end.axis[0], end.axis[2]), 1e-9)
        middle = np.array([x - origin[0] + columns_mm / 2, (shape[0] - 0.5) * spacing[0] - (z - origin[2])]) * scale
        # down the picture is to the feet
        step = np.array([across[0], -across[1]]) * end.radius_mm * scale
        for wide, colour in ((7, (0, 0, 0)), (4, END_COLOUR)):
            draw.line([tuple(middle - step), tuple(middle + step)], fill=colour, width=wide)
    heart = np.argwhere(np.take(marked, range(shape[axis]), axis) != UNMARKED)[:, [a for a in range(3) if a != axis]]
    centre = (heart.min(axis=0) + heart.max(axis=0)) / 2.0 * (rows_mm, columns_mm) * scale
    if ends:
        centre[0] = full.size[1] - centre[0]
    left = int(np.clip(centre[1] - SIZE[0] / 2, 0, max(full.size[0] - SIZE[0], 0)))
    top = int(np.clip(centre[0] - SIZE[1] / 2, 0, max(full.size[1] - SIZE[1], 0)))
    shown = Image.new("RGB", SIZE)
    shown.paste(full.crop((left, top, left + SIZE[0], top + SIZE[1])))
    return shown.quantize(128, dither=Image.Dither.NONE)


def pictures(recipe, scan):
    """Kind -> picture."""
    table = recipe.table
    marked = rasterise_strokes(recipe.strokes, table, scan.geometry)
    colours = {label.value: tuple(int(label.colour[n : n + 2], 16) for n in (1, 3, 5)) for label in table}
    colours[BACKGROUND] = BACKGROUND_COLOUR
    made = {kind: picture(scan, marked, values, colours) for kind, values in kinds(table).items()}
    vessels = kinds(table)["vessels"]
    return made | {"ends": picture(scan, marked, vessels, colours, ends=recipe.ends)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recipe", type=Path, default=Path("sample_cases/adult_phantom.toml"))
    parser.add_argument("--scan", type=Path, help="the sample's scan, where it was made already")
    parser.add_argument("--out", type=Path, default=GUIDE)
    given = parser.parse_args()
    recipe = load_recipe(given.recipe)
    if given.scan is None:
        ensure_scan(recipe.scan, given.recipe.parent)
    scan = read_scan(given.scan or given.recipe.parent / recipe.scan.path)
    given.out.mkdir(exist_ok=True)
    for kind, made in pictures(recipe, scan).items():
        made.save(given.out / f"{kind}.png", optimize=True)
        print(f"{kind}: {(given.out / f'{kind}.png').stat().st_size} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
