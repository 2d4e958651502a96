"""Templates to print: read back, outline and bar have their size in mm."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest

from heartcase.schemas.errors import UsageError
from heartcase.simulator.patching.flat_sheets import flat_sheet
from heartcase.simulator.patching.templates import template_pdf, template_svg, write_template
from tests.simulator.patching.test_flat_sheets import CIRCLE, turned

SVG = "{http://www.w3.org/2000/svg}"
SHEET = flat_sheet(turned(CIRCLE * (1, 1.4, 1), 3), scale=0.9)


def distances(points):
    """Distances of all points from each other, which no turn or flip changes."""
    return np.linalg.norm(points[:, None] - points[None], axis=2)


def test_the_svg_is_to_scale():
    root = ET.fromstring(template_svg(SHEET, "patch <A>"))
    width, height = (float(root.get(side).removesuffix("mm")) for side in ("width", "height"))
    assert root.get("viewBox") == f"0 0 {width:.3f} {height:.3f}"
    outline = root.find(f"{SVG}path[@id='outline']").get("d")
    points = np.array([[float(x) for x in pair.split(",")] for pair in re.findall(r"[\d.]+,[\d.]+", outline)])
    np.testing.assert_allclose(distances(points), distances(SHEET.outline_mm), atol=2e-3)
    assert (points > 5).all()
    assert (points < (width, height)).all()
    texts = [text.text for text in root.iter(f"{SVG}text")]
    assert texts[0].startswith(f"patch <A>: {SHEET.area_mm2:.0f} mm2")
    assert texts[2] == "Drawn at 90 % of the size that it fills: cut along it as it is"
    whole = ET.fromstring(template_svg(replace(SHEET, scale=1.0), "patch"))
    assert not any("Drawn at" in text.text for text in whole.iter(f"{SVG}text"))


def test_the_pdf_is_to_scale_and_its_table_points_at_its_objects():
    content = template_pdf(SHEET, "patch (A)")
    assert content.startswith(b"%PDF-1.4")
    start = int(re.search(rb"startxref\n(\d+)", content)[1])
    assert content[start:].startswith(b"xref")
    for number, place in enumerate(re.findall(rb"(\d{10}) 00000 n", content), start=1):
        assert content[int(place) :].startswith(b"%d 0 obj" % number)
    stream = re.search(rb"/Length (\d+) >>\nstream\n(.*)\nendstream", content, re.DOTALL)
    assert int(stream[1]) == len(stream[2])
    scale = float(re.search(rb"([\d.]+) 0 0 [\d.]+ 0 0 cm", stream[2])[1])
    drawn = re.search(rb"w\n(.*?)\ns\n", stream[2], re.DOTALL)[1].decode()
    points = np.array([[float(x) for x in line.split()[:2]] for line in drawn.splitlines()]) * scale
    np.testing.assert_allclose(distances(points) * 25.4 / 72, distances(SHEET.outline_mm), atol=2e-3)
    assert b"(patch \\(A\\): " in stream[2]


def test_a_template_is_written_by_its_suffix(tmp_path):
    for suffix in (".svg", ".pdf"):
        write_template(tmp_path / f"p{suffix}", SHEET, "p")
    assert (tmp_path / "p.svg").read_bytes() == template_svg(SHEET, "p")
    assert (tmp_path / "p.pdf").read_bytes() == template_pdf(SHEET, "p")
    with pytest.raises(UsageError, match="svg or"):
        write_template(tmp_path / "p.png", SHEET, "p")
    with pytest.raises(UsageError, match="cannot be written"):
        write_template(tmp_path / "none" / "p.svg", SHEET, "p")
