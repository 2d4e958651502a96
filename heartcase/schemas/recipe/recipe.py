"""The case recipe: a TOML file that says everything that makes a case."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Collection, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from heartcase.schemas.about import About
from heartcase.schemas.base import CaseId, Model, Name
from heartcase.schemas.errors import ModelProblems, Problem, RecipeError, problems_from_validation
from heartcase.schemas.files import is_there
from heartcase.schemas.labels import Label, LabelTable, Role, default_label_table, repeated_names
from heartcase.schemas.landmarks import Landmark
from heartcase.schemas.migrate import RECIPE
from heartcase.schemas.recipe.edit_settings import CloseDefect, Edit, Sculpt, SeptalDefect
from heartcase.schemas.recipe.lock import RecipeLock, fill_unset
from heartcase.schemas.recipe.phantom_scan import PhantomScan
from heartcase.schemas.recipe.plausible import density_problem, modulus_problem, wall_problem
from heartcase.schemas.recipe.settings import (
    Convention,
    EndMarker,
    FilterSettings,
    GridSettings,
    MapSettings,
    MaterialSettings,
    MaterialsSettings,
    Pin,
    RegionSettings,
    SegmentSettings,
    Stroke,
    SurfaceSettings,
    WallsSettings,
)
from heartcase.schemas.toml_problems import toml_problem

__all__ = [
    "RECIPE_VERSION",
    "MarkerFile",
    "Part",
    "Recipe",
    "ScanSource",
    "load_recipe",
    "parse_recipe",
    "plain_recipe",
    "read_recipe_text",
]

RECIPE_VERSION = RECIPE.newest
"""Version of the recipe's format that this heartcase writes."""


class Part(StrEnum):
    """Optional parts of a case: what is not wanted is not made."""

    SURFACE = "surface"
    RENDER = "render"
    PICKING = "picking"
    LABELS = "labels"
    SCAN = "scan"


class ScanSource(Model):
    """Where the scan is. The path stays in the recipe: it is written to no output."""

    path: Annotated[str, Field(min_length=1)]
    """File (.nii, .nii.gz, .nrrd, .nhdr, .mha, .mhd), or folder of a DICOM series, which may be zipped, relative to the
    recipe."""
    series: str | None = None
    """DICOM: which series of the folder, by its number or code in the list, or its UID, when there are several."""
    trigger_time_ms: Annotated[float, Field(ge=0.0, le=100_000.0)] | None = None
    """DICOM: which cardiac phase, by its time after the R wave, ms; the nearest one is taken. In a file of several
    volumes that says when each is: which one, by its time."""
    echo_time_ms: Annotated[float, Field(ge=0.0, le=10_000.0)] | None = None
    """DICOM: which echo, by its echo time, ms; the nearest one is taken."""
    frame: Annotated[int, Field(ge=0)] | None = None
    """NIfTI, NRRD and MetaImage files of several volumes: which one, from 0."""
    interpolate_missing: bool = False
    """DICOM: fill missing slices from their neighbours instead of refusing the series."""
    straighten_tilt: bool = False
    """DICOM: resample a stack that leans (tilted gantry) onto a straight one instead of refusing the series."""
    overlap: Literal["earlier", "later"] | None = None
    """DICOM: where two acquisitions meet in one slice position, take the image acquired earlier or later."""
    modality: Literal["CT", "MR"] | None = None
    """Kind of scan, for files that do not say it (NIfTI, NRRD, MetaImage)."""
    origin: Annotated[str, Field(max_length=500)] | None = None
    """Where to get the scan, shown when it is not there."""
    phantom: PhantomScan | None = None
    """A synthetic scan: where ``path`` does not hold it, building makes it."""

    @property
    def choice(self) -> dict[str, Any]:
        """What chooses among DICOM images and says what may be done to them, where it says anything."""
        fields = (
            "series",
            "trigger_time_ms",
            "echo_time_ms",
            "frame",
            "interpolate_missing",
            "straighten_tilt",
            "overlap",
        )
        stated = {name: getattr(self, name) for name in fields}
        # not what is left at its default: a later default must change no record of a locked recipe
        return {name: value for name, value in stated.items() if value is not None and value is not False}


class MarkerFile(Model):
    """A file of markers: a label volume, or a list of points."""

    path: Annotated[str, Field(min_length=1)]
    """.nii.gz, .nrrd, .seg.nrrd, DICOM SEG (.dcm), a folder of parts (.stl) or .mrk.json, relative to the recipe."""
    names: dict[str, Name] = {}
    """Segment name, value or list name in the file -> label name; the same name when left out."""
    convention: Convention | None = None
    """Label volumes without names: what their values stand for (see docs/labels.md)."""
    others: Literal["refuse", "ignore"] = "refuse"
    """Segments, values and points that are no label: refuse the file, or leave them out."""
    order: tuple[Name, ...] = ()
    """Where segments of the file overlap, label names from the lowest to the topmost. Those that are not named lie
    below, in the file's order, the later one over the earlier. Between files the later one of the recipe counts."""
    radius_mm: Annotated[float, Field(ge=0.0, le=50.0)] = 1.5
    """Point lists: radius of the dab around each point."""
    core_mm: Annotated[float, Field(gt=0.0, le=50.0)] | None = None
    """Label volumes: take the file as a draft, and of each label only what lies at least this deep inside it; of a
    label that is nowhere so deep, its deepest parts. All of the file is taken as markers when left out."""
    background: bool = False
    """Label volumes with ``core_mm``: where the file holds 0 is background, as far from every label."""

    @model_validator(mode="after")
    def _background_needs_a_core(self) -> MarkerFile:
        if self.background and self.core_mm is None:
            raise ValueError("background = true needs core_mm: how far in a draft is to be trusted, such as 3.0")
        return self


AUTOMATIC = "automatic"


def _or_automatic(schema: dict[str, Any]) -> None:
    """Let the JSON Schema of the ends take the one text that they may be."""
    array = {key: schema.pop(key) for key in ("type", "items") if key in schema}
    schema["anyOf"] = [array, {"const": AUTOMATIC, "type": "string"}]


class Recipe(Model):
    """Everything that makes a case, but the scan itself."""

    heartcase_recipe: Annotated[int, Field(ge=1, json_schema_extra={"maximum": RECIPE_VERSION})]
    """Version of the recipe's format: 1."""
    name: Name
    """Name of the case: not the patient's."""
    case_id: CaseId | None = None
    """Made-up identifier that is on every output; made from the name and the scan's values when left out."""
    scan: ScanSource
    """The scan."""
    labels: tuple[Label, ...] = Field(default_factory=lambda: default_label_table().labels)
    """Label table; a heart with four chambers when left out."""
    region: RegionSettings | None = None
    """Region of interest; the whole scan when left out."""
    filter: FilterSettings = FilterSettings()
    """Smoothing."""
    segment: SegmentSettings = SegmentSettings()
    """Segmentation."""
    markers: tuple[MarkerFile, ...] = ()
    """Marker files; later ones paint over earlier ones."""
    strokes: tuple[Stroke, ...] = ()
    """Painted strokes, over the marker files; later ones paint over earlier ones."""
    walls: WallsSettings = WallsSettings()
    """Distance fields and walls."""
    ends: Annotated[tuple[EndMarker, ...], Field(json_schema_extra=_or_automatic)] = ()
    """Where vessels are cut off. ``ends = "automatic"`` instead lets the program find where: it stands for no entry and
    ``find_ends = true`` in ``[walls]``, which goes with entries as well."""
    edits: tuple[Edit, ...] = ()
    """Septal defects, sculpting and cleaning of structures, in order."""
    grid: GridSettings = GridSettings()
    """Simulation grid."""
    surface: SurfaceSettings = SurfaceSettings()
    """Visible surface."""
    map: MapSettings = MapSettings()
    """Tie between them."""
    materials: MaterialsSettings = MaterialsSettings()
    """Elastic constants."""
    pins: tuple[Pin, ...] = ()
    """Tissue that is held fixed beside what the region of interest or an end marker cuts."""
    landmarks: tuple[Landmark, ...] = ()
    """Named points, rings and lines that go into the case."""
    about: About | None = None
    """What the case teaches, its diagnoses, origin and licence: goes into the case and its library's catalogue."""
    parts: tuple[Part, ...] = (Part.SURFACE, Part.RENDER, Part.PICKING, Part.LABELS)
    """Optional parts that the scene wants; the simulation grid is always there. ``scan``, the filtered scan for viewers
    that show slices, is in a case only where it is asked for."""
    lock: RecipeLock | None = None
    """What the recipe was locked with; written by ``heartcase lock``."""

    @property
    def table(self) -> LabelTable:
        """The label table, background included, without grown walls."""
        return LabelTable(labels=self.labels)

    @property
    def input_files(self) -> tuple[tuple[str, str], ...]:
        """Place in the recipe and path of each file or folder that it reads; not of a scan that is made."""
        named = [("scan.path", self.scan.path)] if self.scan.phantom is None else []
        named += [(f"markers[{n}].path", marker.path) for n, marker in enumerate(self.markers, start=1)]
        if self.segment.finished_file is not None:
            named.append(("segment.file", self.segment.finished_file))
        return tuple(named)

    def missing_files(self, directory: Path) -> tuple[Problem, ...]:
        """Files that the recipe names and that are not there; relative paths start at ``directory``."""
        hint = {"scan.path": f". Where it comes from: {self.scan.origin}"} if self.scan.origin else {}
        return tuple(
            Problem(
                place, f"there is no such file: check the spelling; it is relative to the recipe{hint.get(place, '')}"
            )
            for place, path in self.input_files
            if not (directory / path).exists()
        )

    @property
    def walls_to_grow(self) -> WallsSettings:
        """The walls' settings for a build: a locked recipe's ends were found when it was locked."""
        if self.lock is None or self.lock.found_end_count is None:
            return self.walls
        return self.walls.model_copy(update={"find_ends": False})

    @model_validator(mode="before")
    @classmethod
    def _automatic_ends(cls, data: Any) -> Any:
        if not isinstance(data, Mapping) or not isinstance(data.get("ends"), str):
            return data
        walls = data.get("walls", {})
        if data["ends"] != AUTOMATIC:
            raise ModelProblems([Problem("ends", f"write [[ends]] tables, or ends = {AUTOMATIC!r}")])
        if not isinstance(walls, Mapping):
            return {**data, "ends": []}
        if walls.get("find_ends", True) is not True:
            message = f"says false, but ends = {AUTOMATIC!r} asks for it: remove one of them"
            raise ModelProblems([Problem("walls.find_ends", message)])
        return {**data, "ends": [], "walls": {**walls, "find_ends": True}}

    @field_validator("heartcase_recipe")
    @classmethod
    def _version_is_known(cls, version: int) -> int:
        if version > RECIPE.newest:
            raise ValueError(f"must be at most {RECIPE.newest}: a newer recipe needs a newer heartcase")
        return version

    @model_validator(mode="after")
    def _names_are_known(self, info: ValidationInfo) -> Recipe:
        table = self.table
        with_walls = table.with_walls()
        devices = {edit.label.lower() for edit in self.edits if edit.kind == "close_defect"}
        problems: list[Problem] = []

        def check(place: str, name: str, known: LabelTable, others: Collection[str] = ()) -> None:
            if known.find(name) is None and name.lower() not in others:
                listed = ", ".join(label.name for label in table)
                # People write the short name; both lead to the label.
                spelt = {one: label.name for label in known for one in _spellings(label.name)}
                spelt |= {other: other for other in others}
                near = difflib.get_close_matches(name.lower(), spelt, n=1)
                hint = f"did you mean {spelt[near[0]]!r}?" if near else f"the labels are: {listed}"
                problems.append(Problem(place, f"there is no label {name!r}; {hint}"))

        # One wrong name is one mistake, in however many strokes.
        strokes_of: dict[str, list[int]] = {}
        for n, stroke in enumerate(self.strokes, start=1):
            if stroke.label is not None:
                strokes_of.setdefault(stroke.label, []).append(n)
        for name, numbers in strokes_of.items():
            check(_stroke_places(numbers), name, table)
        for n, marker in enumerate(self.markers, start=1):
            for name in marker.names.values():
                check(f"markers[{n}].names", name, table)
            for name in marker.order:
                check(f"markers[{n}].order", name, table)
        for name in self.segment.names.values():
            check("segment.names", name, table)
        for name in self.segment.order:
            check("segment.order", name, table)
        for n, wanted in enumerate(self.segment.ranges, start=1):
            check(f"segment.ranges[{n}]", wanted.label, table)
        for n, end in enumerate(self.ends, start=1):
            check(f"ends[{n}]", end.label, table)
        for n, varying in enumerate(self.walls.thickness, start=1):
            check(f"walls.thickness[{n}]", varying.label, table)
        problems += self.walls.thickness_problems(table)
        for place, pair in self.walls.septum_pairs:
            for named_cavity in pair:
                check(place, named_cavity, table)
        problems += self.walls.septum_problems(table)
        for n, edit in enumerate(self.edits, start=1):
            if isinstance(edit, SeptalDefect | CloseDefect):
                if not any(edit.axis):
                    problems.append(Problem(f"edits[{n}].axis", "must not be zero"))
                continue
            others = [(f"edits[{n}].only_from", name) for name in getattr(edit, "only_from", None) or ()]
            others += [(f"edits[{n}].into", name) for name in [getattr(edit, "into", None)] if name]
            problems += [
                Problem(place, f"{name!r} is the label of the edit itself: name another one")
                for place, name in others
                if _are_one(with_walls, edit.label, name)
            ]
            for place, named in [(f"edits[{n}]", edit.label), *others]:
                if named is None:
                    continue
                check(place, named, with_walls, devices)
                # Only what has a field of its own can be smoothed, filled or cleaned.
                wall = with_walls.find(named)
                if not isinstance(edit, Sculpt) and wall is not None and wall.value not in table:
                    problems.append(Problem(place, f"{wall.name!r} is a grown wall and follows its cavity: name that"))
        for name in self.materials.labels:
            check("materials.labels", name, with_walls, devices)
        problems += self._implausible_numbers(with_walls, devices)
        needs_markers = info.context is None or info.context["needs_markers"]
        if needs_markers and self.segment.method == "watershed" and not self.markers and not self.strokes:
            problems.append(Problem("segment", "the watershed needs markers: add [[markers]] or [[strokes]]"))
        names = [landmark.name for landmark in self.landmarks]
        problems += [Problem("landmarks", message) for message in repeated_names(names)]
        if Part.RENDER in self.parts and Part.SURFACE not in self.parts:
            problems.append(Problem("parts", "'render' needs 'surface': add it, or leave 'render' out"))
        if problems:
            raise ModelProblems(problems)
        return self

    def _implausible_numbers(self, table: LabelTable, devices: Collection[str]) -> list[Problem]:
        """Moduli, densities and walls that were meant in another unit."""
        found = [
            (f"labels[{n}].wall_thickness_mm", wall_problem(label.wall_thickness_mm))
            for n, label in enumerate(self.labels, start=1)
        ]
        for n, varying in enumerate(self.walls.thickness, start=1):
            found += [(f"walls.thickness[{n}].thickness_mm", wall_problem(value)) for value in varying.thickness_mm]
        every: list[tuple[str, MaterialSettings, bool]] = [("materials", self.materials, False)]
        for name, one in self.materials.labels.items():
            label = table.find(name)
            is_device = name.lower() in devices if label is None else label.role is Role.DEVICE
            every.append((f"materials.labels.{name}", one, is_device))
        for place, one, is_device in every:
            found += [
                (f"{place}.youngs_modulus_kpa", modulus_problem(one.youngs_modulus_kpa, is_device=is_device)),
                (f"{place}.density_kg_m3", density_problem(one.density_kg_m3, is_device=is_device)),
            ]
        return [Problem(place, message) for place, message in found if message]


def _are_one(table: LabelTable, name: str | None, other: str) -> bool:
    found = None if name is None else table.find(name)
    return found is not None and found == table.find(other)


def _spellings(name: str) -> tuple[str, ...]:
    """A label's name in small letters, with and without the word for morphology."""
    lowered = name.lower()
    return lowered, lowered.removeprefix("morphologically ")


def parse_recipe(text: str, *, needs_markers: bool = True) -> Recipe:
    """Read a recipe from TOML text.

    Parameters
    ----------
    text
        The recipe.
    needs_markers
        Whether a watershed without any marker is a problem. It is none for who is going to paint them.

    Raises
    ------
    RecipeError
        With every problem that was found.
    """
    try:
        data: dict[str, Any] = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise RecipeError(toml_problem(text, error), place="recipe") from None
    data, _ = RECIPE.migrated(data)
    fill_unset(data)
    try:
        return Recipe.model_validate(data, context={"needs_markers": needs_markers})
    except ValidationError as error:
        raise RecipeError(
            (*problems_from_validation(error, model=Recipe), *_hidden_problems(data, error, needs_markers))
        ) from None


def plain_recipe() -> Recipe:
    """A recipe that asks for nothing but the usual: what a stage command works by when it is given none."""
    return Recipe.model_validate(_NEUTRAL, context={"needs_markers": False})


_NEUTRAL: dict[str, Any] = {"heartcase_recipe": RECIPE_VERSION, "name": "x", "scan": {"path": "x"}}
_JUDGED_TOGETHER = {"labels", "segment", "markers", "strokes", "walls", "ends", "edits", "landmarks", "parts"}
"""Settings whose names are checked against each other: where one is wrong in itself the others cannot be judged."""


def _hidden_problems(data: dict[str, Any], error: ValidationError, needs_markers: bool) -> tuple[Problem, ...]:
    """What is wrong between settings, which the model looks at only where each setting is right in itself."""
    wrong = {detail["loc"][0] for detail in error.errors(include_url=False) if detail["loc"]}
    if not wrong or wrong & _JUDGED_TOGETHER:
        return ()
    rest = {key: value for key, value in data.items() if key not in wrong}
    try:
        neutral = {key: value for key, value in _NEUTRAL.items() if key in wrong}
        Recipe.model_validate(rest | neutral, context={"needs_markers": needs_markers})
    except ValidationError as hidden:
        return problems_from_validation(hidden, model=Recipe)
    return ()


def load_recipe(path: Path | str) -> Recipe:
    """Read a recipe file.

    Raises
    ------
    RecipeError
        It cannot be read, or with every problem that was found in it.
    """
    return parse_recipe(read_recipe_text(path))


_SCAN_SUFFIXES = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd", ".dcm", ".ima", ".zip")
_DICOM_MARK, _DICOM_MARK_AT = b"DICM", 128


def _stroke_places(numbers: list[int]) -> str:
    """Where some strokes are: ``strokes[1]``, ``strokes[1, 2, 5 and 8 more]``."""
    more = f" and {len(numbers) - 3} more" if len(numbers) > 3 else ""
    return f"strokes[{', '.join(map(str, numbers[:3]))}{more}]"


def read_recipe_text(path: Path | str) -> str:
    """The text of a recipe's file.

    Raises
    ------
    RecipeError
        It is not there, cannot be read, is a folder, or looks like a scan.
    """
    path = Path(path)
    if not is_there(path):
        raise RecipeError("there is no such file; check the path", place="recipe")
    if path.is_dir():
        raise RecipeError(
            "this is a folder, not a recipe: give the recipe, a .toml file; for a folder of DICOM files  heartcase new "
            "FOLDER  writes one",
            place="recipe",
        )
    try:
        if _looks_like_a_scan(path):
            raise RecipeError(
                "this looks like a scan, not a recipe: write a recipe for it with  heartcase new SCAN  and give that",
                place="recipe",
            )
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise RecipeError("there is no such file; check the path", place="recipe") from None
    except UnicodeDecodeError:
        raise RecipeError(
            "the file cannot be read as UTF-8 text: give the recipe, a .toml file, which  heartcase new SCAN  writes",
            place="recipe",
        ) from None
    except OSError as error:
        reason = (error.strerror or "the system gives no reason").lower()
        raise RecipeError(f"the file cannot be read: {reason}", place="recipe") from None


def _looks_like_a_scan(path: Path) -> bool:
    """Whether a file is named like a scan, or begins like a DICOM file."""
    with path.open("rb") as file:
        start = file.read(_DICOM_MARK_AT + len(_DICOM_MARK))
    return path.name.lower().endswith(_SCAN_SUFFIXES) or start[_DICOM_MARK_AT:] == _DICOM_MARK
