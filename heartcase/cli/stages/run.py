"""How a stage command runs its stage: the very stage of a build, with its inputs from files.

What it writes carries how it came about and what was told on the way, so that the case at the end knows both.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from heartcase.cli.shared.stage_io import load_outputs, settings_of
from heartcase.pipeline.warnings import CaseWarning
from heartcase.schemas.errors import Problem, UsageError
from heartcase.schemas.recipe.recipe import Recipe, load_recipe, plain_recipe

if TYPE_CHECKING:
    from heartcase.pipeline.artifacts.serialise import History
    from heartcase.pipeline.data import Scan
    from heartcase.pipeline.stages.stage import Node, StageOutputs, Work
    from heartcase.schemas.bundle.format import StageRecord

__all__ = ["StageRun", "merged_history", "stage_run"]

T = TypeVar("T")


@dataclass
class StageRun:
    """A stage on its own: what it works with, and how its inputs came about."""

    work: Work
    """The recipe with the changes of the command line (one that says nothing where none was given); inputs, outputs."""
    has_recipe: bool
    """Whether a recipe was given."""
    history: History
    """Of the inputs."""
    is_known: bool = True
    """Whether every input said how it came about."""
    told: dict[str, tuple[CaseWarning, ...]] = field(default_factory=dict)
    """What this command has to tell, by its source."""

    @property
    def recipe(self) -> Recipe:
        """The recipe that the stage takes its settings from."""
        return self.work.recipe

    @recipe.setter
    def recipe(self, recipe: Recipe) -> None:
        self.work.recipe = recipe

    @property
    def outputs(self) -> StageOutputs:
        """Inputs, and outputs so far."""
        return self.work.outputs

    def run(self, stage: str) -> None:
        """Run a stage of the build."""
        from heartcase.pipeline.building.runner import UncachedRunner
        from heartcase.pipeline.stages.table import stage_named

        UncachedRunner().run(stage_named(stage), self.work)

    def take_scan(self, path: Path, choice: dict[str, Any]) -> Scan:
        """The scan's region of interest, read or from a stage's output; what is read is the build's first stage."""
        from heartcase.pipeline.data import Scan
        from heartcase.pipeline.image.region import crop_scan
        from heartcase.pipeline.stages.read import with_modality
        from heartcase.pipeline.stages.stage import have

        if path.suffix == ".safetensors":
            if choice:
                raise UsageError(
                    "these options choose among the images of a DICOM folder, and the output of a stage is one scan: "
                    "leave them out",
                    place="SCAN",
                )
            given = self.take({"SCAN": (path, Scan)})[0]
            scan = crop_scan(with_modality(given, self.recipe), self.recipe.region)
            self.outputs.scan, self.outputs.whole = node_of(scan), self.history.whole
            return scan
        source = self.recipe.scan.model_copy(update={"path": str(path.absolute()), "phantom": None} | choice)
        self.recipe = self.recipe.model_copy(update={"scan": source})
        self.run("read")
        self.history = replace(self.history, whole=self.outputs.whole)
        scan = have(self.outputs.scan).get()
        self.told["scan"] = scan.warnings
        return scan

    def take(self, wanted: Mapping[str, tuple[Path | None, type]]) -> list[Any]:
        """Outputs of stages (:func:`heartcase.cli.shared.stage_io.load_outputs`); their histories become this one's."""
        from heartcase.pipeline.artifacts.serialise import load_history

        found = load_outputs(wanted)
        paths = {name: path for name, (path, _) in wanted.items() if path is not None}
        histories = {name: load_history(path) for name, path in paths.items()}
        self.is_known = self.is_known and None not in histories.values()
        self.history = merged_history({"": self.history} | {n: one for n, one in histories.items() if one is not None})
        return found

    def finished_history(self) -> History:
        """How the output came about."""
        return self.history.after(self.work.records, self.told)


def stage_run(path: Path | None, sets: tuple[str, ...] = (), *, stage: str | None = None) -> StageRun:
    """Begin a stage command.

    Parameters
    ----------
    path
        The recipe's file, if one was given.
    sets
        What ``--set`` says of the settings of ``stage``.
    stage
        Name of the stage's settings in the recipe, where it has some.

    Raises
    ------
    UsageError, RecipeError
        The recipe or a change is wrong.
    """
    from heartcase.pipeline.artifacts.serialise import History
    from heartcase.pipeline.stages.stage import Work

    recipe = plain_recipe() if path is None else load_recipe(path)
    recipe = recipe.model_copy(update={"labels": recipe.table.labels})
    if stage is not None:
        given = getattr(recipe, stage)
        recipe = recipe.model_copy(update={stage: settings_of(type(given), given, sets)})
    directory = Path() if path is None else path.parent
    return StageRun(Work(recipe, directory), path is not None, History())


def node_of(value: T) -> Node[T]:
    """An input that is at hand, with the hash that a build would know it by."""
    from heartcase.pipeline.artifacts.serialise import artifact_to_bytes
    from heartcase.pipeline.stages.stage import Node

    return Node(hashlib.sha256(artifact_to_bytes(value)).hexdigest(), lambda: value, value)


def merged_history(histories: Mapping[str, History]) -> History:
    """One history of inputs that came about together.

    Parameters
    ----------
    histories
        By the name of the input.

    Raises
    ------
    UsageError
        Two of them were made from different outputs of one stage: they do not belong together.
    """
    from heartcase.pipeline.artifacts.serialise import History
    from heartcase.pipeline.stages.table import stage_names

    records: dict[str, tuple[str, StageRecord]] = {}
    told: dict[str, tuple[CaseWarning, ...]] = {}
    whole = None
    problems = []
    for name, history in histories.items():
        for record in history.stages:
            other, known = records.setdefault(record.stage, (name, record))
            if known != record:
                message = (
                    f"were made from different outputs of the stage '{record.stage}': run the stages after it again"
                )
                problems.append(Problem(f"{other} and {name}", message))
        told |= history.told
        whole = whole or history.whole
    if problems:
        raise UsageError(problems[:1])
    return History(_in_order((record for _, record in records.values()), stage_names()), told, whole)


def _in_order(records: Iterable[StageRecord], stages: Sequence[str]) -> tuple[StageRecord, ...]:
    known = {stage: place for place, stage in enumerate(stages)}
    return tuple(sorted(records, key=lambda record: known.get(record.stage, len(known))))
