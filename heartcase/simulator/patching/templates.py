"""Templates of patches: the outline laid out flat, to scale, as SVG and as PDF, to print and to cut along.

Both are pages in mm with the outline, a tick at each stitch, a bar of 10 mm to check the print by, and what is known of
the patch: its area, and how much laying it out flat has stretched it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from heartcase.schemas.arrays import Float64
from heartcase.schemas.errors import UsageError
from heartcase.schemas.files import atomic_write
from heartcase.simulator.patching.flat_sheets import FlatSheet

__all__ = ["TEMPLATE_FORMATS", "template_pdf", "template_svg", "write_template"]

_MARGIN_MM = 10.0
_BAR_MM = 10.0
_TICK_MM = 1.0
_TEXT_MM = 3.0
_WIDTH_LEAST_MM = 110.0
_POINTS_PER_MM = 72.0 / 25.4


@dataclass(frozen=True)
class _Page:
    """What is drawn, in mm from the page's lower left corner, y up."""

    width: float
    height: float
    outline: Float64
    """Shape (count, 2)."""
    lines: Float64
    """Ticks at the stitches and the bar, shape (line_count, 2, 2)."""
    texts: tuple[tuple[float, float, str], ...]
    """Where each begins, and what it says."""


def _page(sheet: FlatSheet, name: str) -> _Page:
    outline = sheet.outline_mm
    low, high = outline.min(axis=0), outline.max(axis=0)
    width = max(high[0] - low[0] + 2 * _MARGIN_MM, _WIDTH_LEAST_MM)
    foot = 4 * _TEXT_MM + _MARGIN_MM
    height = high[1] - low[1] + 2 * _MARGIN_MM + foot
    shift = np.array([(width - low[0] - high[0]) / 2, _MARGIN_MM + foot - low[1]])
    points = outline + shift
    ahead, behind = np.roll(points, -1, axis=0), np.roll(points, 1, axis=0)
    along = ahead - behind
    inward = np.stack([-along[:, 1], along[:, 0]], axis=1)
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    ticks = np.stack([points, points + _TICK_MM * inward], axis=1)
    bar = np.array([[(_MARGIN_MM, foot - 1.0), (_MARGIN_MM + _BAR_MM, foot - 1.0)]])
    ends = [[(x, foot - 2.0), (x, foot)] for x in (_MARGIN_MM, _MARGIN_MM + _BAR_MM)]
    least, most = 100.0 * (sheet.stretch_least - 1.0), 100.0 * (sheet.stretch_most - 1.0)
    said = [
        f"{name}: {sheet.area_mm2:.0f} mm2, rim {sheet.perimeter_mm:.0f} mm, {sheet.rim_count} stitches (ticks)",
        f"Laid out flat; on the heart it is stretched by {least:+.1f} to {most:+.1f} %",
        "Print at 100 %: the bar is 10 mm. Not a medical device",
    ]
    if sheet.scale != 1.0:
        said.insert(2, f"Drawn at {100 * sheet.scale:.3g} % of the size that it fills: cut along it as it is")
    texts = tuple((_MARGIN_MM, foot - 3.0 - _TEXT_MM * (1.3 * number + 1.0), text) for number, text in enumerate(said))
    return _Page(width, height, points, np.concatenate([ticks, bar, np.array(ends)]), texts)


def template_svg(sheet: FlatSheet, name: str) -> bytes:
    """The template of a patch as SVG, to scale in mm."""
    page = _page(sheet, name)

    def at(point: Float64) -> str:
        return f"{point[0]:.3f},{page.height - point[1]:.3f}"

    path = "M " + " L ".join(at(point) for point in page.outline) + " Z"
    lines = " ".join(f"M {at(start)} L {at(end)}" for start, end in page.lines)
    texts = "".join(
        f'<text x="{x:.3f}" y="{page.height - y:.3f}" font-size="{_TEXT_MM}" font-family="sans-serif">'
        f"{escape(text)}</text>\n"
        for x, y, text in page.texts
    )
    size = f'width="{page.width:.3f}mm" height="{page.height:.3f}mm"'
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {page.width:.3f} {page.height:.3f}">\n'
        f"<title>{escape(name)}</title>\n"
        f'<path id="outline" d="{path}" fill="none" stroke="black" stroke-width="0.25"/>\n'
        f'<path id="marks" d="{lines}" fill="none" stroke="black" stroke-width="0.15"/>\n'
        f"{texts}</svg>\n"
    ).encode()


def template_pdf(sheet: FlatSheet, name: str) -> bytes:
    """The template of a patch as a PDF page, to scale in mm."""
    page = _page(sheet, name)

    def at(point: Float64) -> str:
        return f"{point[0]:.3f} {point[1]:.3f}"

    first, *rest = page.outline
    drawn = [f"{_POINTS_PER_MM:.9f} 0 0 {_POINTS_PER_MM:.9f} 0 0 cm", "0.25 w", f"{at(first)} m"]
    drawn += [f"{at(point)} l" for point in rest] + ["s", "0.15 w"]
    drawn += [f"{at(start)} m {at(end)} l S" for start, end in page.lines]
    for x, y, text in page.texts:
        plain = text.encode("latin-1", "replace").decode("latin-1")
        plain = plain.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")
        drawn.append(f"BT /F1 {_TEXT_MM} Tf {x:.3f} {y:.3f} Td ({plain}) Tj ET")
    content = "\n".join(drawn).encode("latin-1")
    box = f"[0 0 {page.width * _POINTS_PER_MM:.3f} {page.height * _POINTS_PER_MM:.3f}]"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
    ]
    file, starts = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, start=1):
        starts.append(len(file))
        file += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % start for start in starts)
    count = len(objects) + 1
    return file + (
        b"xref\n0 %d\n0000000000 65535 f \n%strailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n"
        % (count, table, count, len(file))
    )


TEMPLATE_FORMATS: dict[str, Callable[[FlatSheet, str], bytes]] = {".svg": template_svg, ".pdf": template_pdf}
"""File name suffix -> what writes it."""


def write_template(path: Path | str, sheet: FlatSheet, name: str) -> None:
    """Write the template of a patch, to scale in mm.

    Parameters
    ----------
    path
        Where to; the suffix says the format: ``.svg`` or ``.pdf``.
    sheet
        The patch laid out flat: what ``Simulation.template`` gives.
    name
        What is written beside it.

    Raises
    ------
    UsageError
        The suffix is neither, or the file cannot be written.
    """
    path = Path(path)
    write = TEMPLATE_FORMATS.get(path.suffix.lower())
    if write is None:
        raise UsageError(f"a template is written as {' or '.join(TEMPLATE_FORMATS)}; {path.name!r} is neither")
    try:
        atomic_write(path, write(sheet, name))
    except OSError as error:
        raise UsageError(f"{path.name} cannot be written: {error.strerror}") from None
