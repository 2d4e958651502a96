"""The build report: one HTML page with pictures and figures by which a clinician can trust or reject a case.

The page stands alone: pictures are inside it, it links to nothing and runs no script. It shows only what it is given
here, never a path or a file name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from heartcase import __version__
from heartcase.pipeline.checks.openings import Opening, Verdict
from heartcase.pipeline.data import GridMap, Scan, Segmentation, SimulationGrid, Structures, Surface
from heartcase.pipeline.kernels.parallel import side_by_side
from heartcase.pipeline.markers.confidence import Sureness
from heartcase.pipeline.report.confidence_part import ConfidencePart, confidence_part
from heartcase.pipeline.report.ends_part import EndsPart, ends_part
from heartcase.pipeline.report.hand_work import hand_work_facts, region_words
from heartcase.pipeline.report.plain_words import (
    Fact,
    cardiac_phase_words,
    figure_facts,
    placed,
    setting_lines,
    smoothing_facts,
)
from heartcase.pipeline.report.report_pictures import (
    Picture,
    ThicknessRow,
    slice_parts,
    surface_parts,
    thickness_spread,
)
from heartcase.pipeline.stages.resolve import SettingRules
from heartcase.pipeline.stages.table import STAGES
from heartcase.pipeline.walls.grown_places import LEAST_REST_MM2
from heartcase.pipeline.warnings import CaseWarning, WarningGroup, grouped
from heartcase.schemas.arrays import Float32
from heartcase.schemas.bundle.format import CaseManifest, StageRecord
from heartcase.schemas.labels import BACKGROUND, LabelTable, Role
from heartcase.schemas.recipe.recipe import Recipe

__all__ = [
    "STATE_WORDS",
    "VERDICT_WORDS",
    "OpeningRow",
    "ReportData",
    "ReportInputs",
    "SeptumRow",
    "StageRow",
    "StructureRow",
    "build_report",
    "render_report",
]

_NOTICE: str = CaseManifest.model_fields["notice"].default
_ROLE_WORDS = {
    Role.BLOOD: "blood in a chamber",
    Role.VESSEL_LUMEN: "blood in a vessel",
    Role.MYOCARDIUM: "heart muscle",
    Role.WALL: "vessel wall",
    Role.DEVICE: "patch or device",
    Role.BACKGROUND: "background",
}
VERDICT_WORDS = {
    Verdict.UNEXPECTED: "not in a normal heart, and the recipe does not say that it is meant",
    Verdict.OTHER_VENTRICLE: "the great artery arises from the other ventricle: is that the malformation?",
    Verdict.UNKNOWN: "a name that heartcase does not know: look at it",
    Verdict.STATED: "not in a normal heart; meant, says",
    Verdict.EXPECTED: "in every normal heart",
}
STATE_WORDS = {
    "grown": "grown, not seen: look at it",
    "opened": "open, as the recipe states",
    "confirmed": "wall, as the recipe says (walls.contact)",
}
"""What is to be thought of a place of a grown septum, by its state."""
_TOTALS = {
    "Blood in the chambers": (Role.BLOOD,),
    "Blood in the vessels": (Role.VESSEL_LUMEN,),
    "All blood": (Role.BLOOD, Role.VESSEL_LUMEN),
    "Heart muscle": (Role.MYOCARDIUM,),
    "Vessel walls": (Role.WALL,),
    "Patches and devices": (Role.DEVICE,),
    "All tissue": (Role.MYOCARDIUM, Role.WALL, Role.DEVICE),
}
_PHASE = ("trigger_time_ms", "cardiac_phase_percent")


@dataclass(frozen=True)
class StructureRow:
    """One structure: its colour and volume."""

    name: str
    """Name of the label."""
    colour: str
    """``#rrggbb``."""
    kind: str
    """Its role in words."""
    volume_ml: float
    """Volume, ml."""


@dataclass(frozen=True)
class OpeningRow:
    """Where two cavities are open to each other."""

    between: str
    """Names of the two."""
    area_mm2: float
    """Area, mm2."""
    diameter_mm: float
    """Diameter of a circle of this area, mm."""
    patches: int
    """Pieces of it."""
    place: str
    """A point of the largest piece."""
    verdict: str
    """What is to be thought of it."""
    is_doubtful: bool
    """Whether there is a warning about it."""


@dataclass(frozen=True)
class SeptumRow:
    """A wall between two cavities that was grown and not seen."""

    between: str
    """Names of the two."""
    area_mm2: float
    """Area of the contact on both sides of which it was grown, without stated openings, mm2."""
    thickness_mm: float
    """Thickness, mm."""
    patches: int
    """Pieces of the contact."""
    place: str
    """A point of the largest piece."""
    state: str = ""
    """What is to be thought of it, in words."""
    is_doubtful: bool = False
    """Whether a person must look at it."""


@dataclass(frozen=True)
class StageRow:
    """One stage: how long it took and how it was set."""

    name: str
    """Name of the stage."""
    words: str
    """What it does."""
    seconds: float | None
    """Time, s; None where it was not measured."""
    share: float
    """Part of the longest stage's time, 0 to 1."""
    version: int | None
    """Version of its algorithm."""
    settings: list[str]
    """``name = value``."""
    fingerprint: str
    """First digits of the hash of its output."""


@dataclass(frozen=True)
class ReportData:
    """Everything that the page shows."""

    case_name: str
    """Name of the case."""
    version: str = __version__
    """Version of heartcase."""
    case_id: str | None = None
    """Made-up identifier of the case."""
    bundle_sha256: str = ""
    """The bundle hash of the case that the page is about; empty where it is not known."""
    notice: str = _NOTICE
    """Shown first."""
    warnings: Sequence[WarningGroup] = ()
    """Worst first."""
    key_facts: Sequence[Fact] = ()
    """The handful of figures to look at first."""
    scan_facts: Sequence[Fact] = ()
    """The scan: size, spacing, modality, acquisition."""
    slices: Sequence[Picture] = ()
    """Slices with outlines."""
    confidence: ConfidencePart | None = None
    """How sure the outlines are; None where they do not come from a watershed."""
    sides: Sequence[Picture] = ()
    """The surface from all six sides."""
    views: Sequence[Picture] = ()
    """The surgeon's view, and the heart cut open."""
    without_short_axis: bool = False
    """Whether nothing tells where the short axis is."""
    thickness: Sequence[Picture] = ()
    """Thickness maps and histogram."""
    thickness_rows: Sequence[ThicknessRow] = ()
    """Thickness per tissue."""
    structures: Sequence[StructureRow] = ()
    """Structures with volumes, in the label table's order."""
    totals: Sequence[tuple[str, float]] = ()
    """What -> volume, ml: sums over the structures."""
    openings: Sequence[OpeningRow] = ()
    """Openings between chambers and vessels, the worst first."""
    ends: EndsPart | None = None
    """Where vessels end; None where none does."""
    septa: Sequence[SeptumRow] = ()
    """Walls between cavities that were grown where their outlines touch, the largest first."""
    quality: Mapping[str, Sequence[Fact]] = field(default_factory=dict)
    """Title -> figures."""
    hand_work: Sequence[Fact] = ()
    """What a person did."""
    stages: Sequence[StageRow] = ()
    """Time and provenance."""
    total_s: float = 0.0
    """Time of all stages, s."""


@dataclass(frozen=True)
class ReportInputs:
    """What a report is made from."""

    recipe: Recipe
    """What was asked for."""
    scan: Scan
    """The scan as it was read, cropped to the region of interest."""
    segmentation: Segmentation
    """The labels before walls were grown; drawn where the fields lie on another lattice than the scan."""
    structures: Structures
    """The fields after edits: what is drawn over the scan's slices."""
    grid: SimulationGrid
    """The simulation grid."""
    surface: Surface | None
    """The visible surface; None where the recipe does not want it."""
    grid_map: GridMap | None
    """What ties it to the grid; likewise."""
    volumes_ml: Mapping[int, float]
    """Label value -> volume, ml."""
    timings_s: Mapping[str, float]
    """Stage -> seconds."""
    stages: Sequence[StageRecord]
    """Provenance of the stages, in order."""
    warnings: Sequence[CaseWarning]
    """In any order."""
    case_id: str | None = None
    """Made-up identifier of the case."""
    bundle_sha256: str = ""
    """The bundle hash of the case."""
    openings: Sequence[Opening] = ()
    """Where cavities are open to each other, the worst first."""
    septa: Sequence[Mapping[str, Any]] = ()
    """The septa that were grown, judged: :func:`heartcase.pipeline.walls.grown_places.judged_places`."""
    sureness: Callable[[], Sureness | None] = lambda: None
    """Works out how sure the segmentation is, beside the views; None where it was not made by watershed."""
    thickness_mm: Callable[[], Float32] | None = None
    """Gives :func:`heartcase.pipeline.report.report_pictures.surface_thickness_mm` where it is worked out ahead."""
    rules: SettingRules | None = None
    """What the settings are where a recipe leaves them to this scan; found anew when left out."""


def render_report(data: ReportData) -> str:
    """Write the page: a whole HTML document that needs nothing beside it."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("heartcase.pipeline.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html.j2").render(data=data)


def build_report(inputs: ReportInputs) -> str:
    """Draw the pictures of a case and write its report.

    Returns
    -------
    str
        A whole HTML document.
    """
    recipe, scan, segmentation, structures = inputs.recipe, inputs.scan, inputs.segmentation, inputs.structures
    grid, surface, grid_map, volumes_ml = inputs.grid, inputs.surface, inputs.grid_map, inputs.volumes_ml
    table = structures.table
    rows = [
        StructureRow(label.name, label.colour, _ROLE_WORDS[label.role], volumes_ml[label.value])
        for label in table
        if label.value != BACKGROUND and label.value in volumes_ml
    ]
    totals = _totals(table, volumes_ml)
    septa_mm = {one.value: one.thickness_mm for one in structures.grown_septa}

    def slices() -> tuple[list[Picture], ConfidencePart | None, EndsPart | None]:
        shown, ends = slice_parts(scan, segmentation, structures), ends_part(scan, structures)
        sureness = inputs.sureness()  # last, as it may still be worked out
        return shown, confidence_part(scan, segmentation, sureness) if sureness is not None else None, ends

    (slice_rows, confidence, ends), shown = side_by_side(
        slices, lambda: surface_parts(surface, recipe.landmarks, recipe.walls, septa_mm, inputs.thickness_mm)
    )
    quality = {
        "Smoothing of the outlines": smoothing_facts(structures.quality),
        "Simulation grid": figure_facts(grid.quality),
        "Visible surface": figure_facts(surface.quality) if surface is not None else [],
        "Tie between surface and grid": figure_facts(grid_map.quality) if grid_map is not None else [],
    }
    return render_report(
        ReportData(
            case_name=recipe.name,
            case_id=inputs.case_id,
            bundle_sha256=inputs.bundle_sha256,
            warnings=grouped(inputs.warnings),
            key_facts=_key_facts(grid, surface, scan, totals),
            scan_facts=_scan_facts(recipe, scan),
            slices=slice_rows,
            confidence=confidence,
            sides=shown.sides,
            views=shown.views,
            without_short_axis=shown.without_short_axis,
            thickness=[*shown.thickness, *thickness_spread(surface, shown)],
            thickness_rows=shown.thickness_rows,
            structures=rows,
            totals=list(totals.items()),
            openings=[_opening_row(one) for one in inputs.openings],
            ends=ends,
            septa=[row for one in inputs.septa for row in _septum_rows(one)],
            quality={title: facts for title, facts in quality.items() if facts},
            hand_work=hand_work_facts(recipe, scan, rules=inputs.rules),
            stages=_stage_rows(inputs.stages, inputs.timings_s),
            total_s=sum(inputs.timings_s.values()),
        )
    )


def _totals(table: LabelTable, volumes_ml: Mapping[int, float]) -> dict[str, float]:
    """Sums over the structures, with parts of a sum where it has more than one."""
    kinds = {label.value: label.role for label in table}
    sums = {
        words: sum(volume for value, volume in volumes_ml.items() if kinds.get(value) in roles)
        for words, roles in _TOTALS.items()
    }
    return {words: volume for words, volume in sums.items() if words.startswith("All") or volume > 0.0}


def _key_facts(grid: SimulationGrid, surface: Surface | None, scan: Scan, totals: Mapping[str, float]) -> list[Fact]:
    facts = [
        Fact("Cardiac phase", cardiac_phase_words(scan.acquisition)),
        Fact("Tissue in the scan", f"{totals['All tissue']:.1f} ml"),
        Fact("Blood in the scan", f"{totals['All blood']:.1f} ml"),
        Fact("Cells of the simulation", f"{len(grid.cells):,}"),
        Fact("Edge of a cell", f"{grid.geometry.spacing_mm[0]:.2f} mm"),
        Fact("Points of the simulation", f"{len(grid.nodes):,}"),
    ]
    if surface is not None:
        facts.append(Fact("Surface", f"{len(surface.triangles):,} triangles"))
    return facts


def _scan_facts(recipe: Recipe, scan: Scan) -> list[Fact]:
    geometry = scan.geometry
    size, spacing = geometry.size, geometry.spacing_mm
    modality = {"CT": "CT", "MR": "MRI"}.get(scan.modality, "not stated in the file")
    facts = [
        Fact("Kind of scan", modality),
        Fact("Cardiac phase", cardiac_phase_words(scan.acquisition), "The model is the heart at this moment."),
        Fact("Part of the scan used", region_words(recipe)),
        Fact("Points in the part used", " x ".join(f"{n}" for n in size)),
        Fact("Distance between points", " x ".join(f"{s:.3g}" for s in spacing) + " mm"),
        Fact("Extent", " x ".join(f"{n * s:.0f}" for n, s in zip(size, spacing, strict=True)) + " mm"),
    ]
    others = {name: value for name, value in scan.acquisition.items() if name not in _PHASE}
    facts += [Fact(fact.name, fact.value) for fact in figure_facts(others)]
    return facts


def _septum_rows(figure: Mapping[str, Any]) -> list[SeptumRow]:
    """A row of each place of a septum, and one of all its smaller patches together."""
    between, thickness = " and ".join(figure["between"]), float(figure["thickness_mm"])
    rows = []
    for place in figure.get("places", ()):
        state = place["state"]
        words, where = STATE_WORDS[state], placed(place["center_mm"])
        rows.append(SeptumRow(between, float(place["area_mm2"]), thickness, 1, where, words, state == "grown"))
    if "others" in figure:
        area, count = float(figure["others"]["area_mm2"]), int(figure["patches"]) - len(rows)
        is_left = area >= LEAST_REST_MM2
        words = STATE_WORDS["grown"] if is_left else "smaller patches"
        rows.append(SeptumRow(between, area, thickness, count, placed(figure["others"]["center_mm"]), words, is_left))
    if not rows:
        place = placed(figure["center_mm"])
        words, count = STATE_WORDS["grown"], int(figure["patches"])
        rows.append(SeptumRow(between, float(figure["area_mm2"]), thickness, count, place, words, True))
    return rows


def _opening_row(one: Opening) -> OpeningRow:
    words = VERDICT_WORDS[one.verdict]
    if one.stated_by:
        words = f"{words} {one.stated_by}"
    if one.asked_mm2 is not None:
        words = f"{words}, which asks for {one.asked_mm2:,.0f} mm²"
    if one.is_odd_size and one.usual_mm is not None:
        words = f"{words}, but with about {one.usual_mm:.0f} mm across in a heart of this size: look at it"
    return OpeningRow(
        f"{one.names[0]} and {one.names[1]}",
        one.area_mm2,
        one.diameter_mm,
        one.patches,
        placed(one.center_mm),
        words,
        one.is_doubtful,
    )


def _stage_rows(stages: Sequence[StageRecord], timings_s: Mapping[str, float]) -> list[StageRow]:
    longest = max(timings_s.values(), default=0.0)
    records = {record.stage: record for record in stages}
    deeds = {stage.name: stage.deed for stage in STAGES}
    rows = []
    for name in sorted({*records, *timings_s}, key=lambda name: _place_in(list(deeds), name)):
        record, seconds = records.get(name), timings_s.get(name)
        rows.append(
            StageRow(
                name=name,
                words=deeds.get(name, ""),
                seconds=seconds,
                share=seconds / longest if seconds is not None and longest > 0.0 else 0.0,
                version=record.version if record else None,
                settings=setting_lines(record.settings) if record else [],
                fingerprint=record.output_sha256[:12] if record else "",
            )
        )
    return rows


def _place_in(known: list[str], name: str) -> tuple[int, str]:
    return (known.index(name) if name in known else len(known), name)
