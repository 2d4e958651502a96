"""What a stage is, what it works with, and what the stages of one build have made so far."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from heartcase.pipeline.data import GridMap, Markers, Scan, Segmentation, SimulationGrid, Structures, Surface
from heartcase.pipeline.stages.resolve import SettingRules
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.base import Model
from heartcase.schemas.bundle.format import StageRecord
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.recipe.recipe import Recipe
from heartcase.schemas.recipe.resolved import ResolvedRecipe
from heartcase.schemas.recipe.settings import resolved

if TYPE_CHECKING:
    from heartcase.pipeline.artifacts.cache import Cache

__all__ = ["Node", "Stage", "StageOutputs", "Step", "Work", "have", "resolved_all"]

T = TypeVar("T")


@dataclass
class Node(Generic[T]):
    """A stage's output: its hash at once, itself when somebody needs it."""

    sha256: str
    fetch: Callable[[], T]
    value: T | None = None

    def get(self) -> T:
        """The output, computed or loaded when it was not yet."""
        if self.value is None:
            self.value = self.fetch()
        return self.value


@dataclass
class StageOutputs:
    """Outputs of the stages so far."""

    whole: Geometry | None = None
    """Lattice of the scan before its region of interest was cut out."""
    scan: Node[Scan] | None = None
    filtered: Node[Scan] | None = None
    markers: Node[Markers] | None = None
    segmentation: Node[Segmentation] | None = None
    grown: Node[Structures] | None = None
    structures: Node[Structures] | None = None
    grid: Node[SimulationGrid] | None = None
    surface: Node[Surface] | None = None
    grid_map: Node[GridMap] | None = None

    def of(self, name: str) -> Node[Any] | None:
        """The output of this name; None where no stage has made it."""
        node: Node[Any] | None = getattr(self, name, None)
        return node


@dataclass
class Work:
    """What the stages of one build work with."""

    recipe: Recipe
    """What is built; once it is resolved, with every setting stated."""
    directory: Path
    """Where the recipe's relative paths start."""
    outputs: StageOutputs = field(default_factory=StageOutputs)
    """What was made so far."""
    cache: Cache | None = None
    """For what a stage keeps beside its output; None where nothing is kept."""
    records: list[StageRecord] = field(default_factory=list)
    """How the outputs came about, in the order of the stages."""
    told: dict[str, tuple[CaseWarning, ...]] = field(default_factory=dict)
    """Warnings that are in no output, by what they are about (:data:`heartcase.pipeline.bundle.assembly.SOURCES`)."""
    begun: dict[str, Callable[[], Any]] = field(default_factory=dict)
    """Results of the last stage that are worked out ahead, by the name of the function that gives them."""

    @cached_property
    def rules(self) -> SettingRules:
        """What the settings are where the recipe leaves them to the scan, which is read."""
        return SettingRules(have(self.outputs.scan).get())

    def resolve(self) -> ResolvedRecipe:
        """State every setting of the recipe, once for all stages after the first; again it changes nothing."""
        if isinstance(self.recipe, ResolvedRecipe):
            return self.recipe
        stated = self.recipe = self.rules.resolve(self.recipe)
        return stated


def have(node: Node[T] | None) -> Node[T]:
    """An output that the order of the stages puts there.

    Raises
    ------
    LookupError
        It does not: a stage was run before one that it needs.
    """
    if node is None:
        raise LookupError("a stage needs the output of one that has not run: run the stages in their order")
    return node


def resolved_all(models: tuple[Model, ...]) -> list[Any]:
    """Settings as plain JSON, one for each model."""
    return [resolved(model) for model in models]


def _always(_: Recipe) -> bool:
    return True


@dataclass(frozen=True)
class Step:
    """A part of a build that has no output for other stages: what progress knows of it."""

    name: str
    title: str
    """What it does, while it does it."""
    expected_seconds: float
    """First estimate for a scan of a million voxels, until a build has measured."""


@dataclass(frozen=True)
class Stage(Generic[T]):
    """Everything that a build, its cache, its progress, its locks and its report know about a stage."""

    name: str
    version: int
    """Raised whenever the output changes for the same input, so that the cache forgets the old one."""
    title: str
    """What it does, while it does it: for progress."""
    deed: str
    """What it did: for the report."""
    subject: str
    """What its settings in the recipe are about, for the report; empty where it has none that have defaults."""
    output: str
    """Field of :class:`StageOutputs` that it fills."""
    kind: type[T]
    """Class of the output."""
    settings: Callable[[Work], dict[str, Any]]
    """What of the recipe its output depends on, as plain JSON: no path, and no name that changes nothing."""
    compute: Callable[[Work], T]
    """Its output."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """Name of an input in the cache's key -> field of :class:`StageOutputs`; one that was not made is left out."""
    expected_seconds: float = 1.0
    """First estimate for a scan of a million voxels, until a build has measured."""
    is_part: Callable[[Recipe], bool] = _always
    """Whether a build of the recipe takes this stage; its own command makes its output anyway."""
    has_work: Callable[[Recipe], bool] = _always
    """Whether the recipe has something for it to do."""
    is_kept: Callable[[Recipe], bool] = _always
    """Whether the cache keeps its output; not where it is cheap, or its input is outside the cache's sight."""
    passes_on: str = ""
    """Field of :class:`StageOutputs` that stands for its output where it has no work."""
    beside: str = ""
    """An earlier stage that takes less time, and that a build computes at the same time as this one."""
