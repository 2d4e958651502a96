"""Opening a recipe for painting, and writing the strokes back into its file."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from heartcase.pipeline.artifacts.cache import Cache
from heartcase.pipeline.building.recipe_text import split_session, strokes_text
from heartcase.pipeline.building.runner import BuildListener, Runner, SilentListener
from heartcase.pipeline.data import Scan
from heartcase.pipeline.markers.session import SegmentationSession
from heartcase.pipeline.stages.filter import STAGE as FILTER
from heartcase.pipeline.stages.read import STAGE as READ
from heartcase.pipeline.stages.segment import filtered_tree
from heartcase.pipeline.stages.stage import Work, have
from heartcase.schemas.bundle.placing import refuse_inside_case
from heartcase.schemas.errors import MarkerError, Problem, RecipeError, UsageError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.geometry import Geometry
from heartcase.schemas.labels import LabelTable
from heartcase.schemas.recipe.recipe import Recipe, parse_recipe, read_recipe_text
from heartcase.schemas.recipe.settings import Stroke

__all__ = ["RecipeSession", "open_session", "write_with_tables"]


@dataclass
class RecipeSession:
    """A session, and the recipe's file that its strokes go into. Made by :func:`open_session`."""

    session: SegmentationSession
    """What is painted on."""
    scan: Scan
    """The scan's part that is painted on, as it was read."""
    recipe: Recipe
    """The recipe as it was opened, with everything resolved."""
    path: Path
    """Its file."""
    opened_text: str
    """Its text as it was opened, without the strokes that the session holds: kept to the letter, with its comments."""
    written_text: str
    """Its text as it was written last."""
    whole: Geometry | None = None
    """Lattice of the whole scan, of which the session may have a region of interest alone."""
    copies: set[Path] = field(default_factory=set)
    """Files that :meth:`save_as` has written."""
    _takes_strokes: bool = False

    def save(self) -> int:
        """Write the session's strokes at the end of the recipe; how many they are.

        Saving again, also after an undo, leaves what the session holds then. A crash leaves the old file or the new.

        Raises
        ------
        RecipeError
            Another program changed the file meanwhile, or its strokes are one array, which cannot be added to.
        """
        if read_recipe_text(self.path) != self.written_text:
            raise RecipeError(
                "the recipe was changed by another program since it was opened: save under another name, and copy the "
                "strokes from there",
                place="recipe",
            )
        return self.save_as(self.path)

    def save_as(self, path: Path) -> int:
        """Write the recipe with the session's strokes to another file; how many they are.

        What is there already is never replaced, unless this session wrote it.

        Raises
        ------
        RecipeError
            There is such a file, the recipe's strokes are one array, which cannot be added to, or the file cannot be
            written.
        UsageError
            It would lie in a case.
        """
        refuse_inside_case(path, place="save_as")
        if path.exists() and path.resolve() not in {self.path.resolve(), *self.copies}:
            raise RecipeError(f"{path.name} is there already and is not replaced: choose another name", place="save_as")
        advice = "write its strokes as [[strokes]] tables instead of strokes = [...]"
        strokes = strokes_text(self.session.strokes)
        text = write_with_tables(
            path, self.opened_text, strokes, place="strokes", advice=advice, is_checked=self._takes_strokes
        )
        # Reading a recipe of many strokes takes long, and what holds some of them holds any.
        self._takes_strokes |= bool(strokes)
        if path.resolve() == self.path.resolve():
            self.written_text = text
        self.copies.add(path.resolve())
        return len(self.session.strokes)

    def check_table(self, table: LabelTable) -> None:
        """Refuse a label table by which a marker file means something else than by the session's.

        Raises
        ------
        HeartcaseError
            One does: every such file.
        """
        from heartcase.pipeline.markers.load_markers import stated_markers

        session, problems = self.session, []
        where = (session.geometry, self.path.parent)
        for number, file in enumerate(self.recipe.markers, start=1):
            was = stated_markers((file,), (), session.table, *where, whole=self.whole).labels
            message = "marks other structures"
            try:
                if np.array_equal(was, stated_markers((file,), (), table, *where, whole=self.whole).labels):
                    continue
            except MarkerError as error:
                message = f"cannot be read any more ({'; '.join(one.message for one in error.problems)})"
            problems.append(Problem(f"markers[{number}]", f"with this label table {file.path} {message}"))
        if problems:
            raise UsageError(problems)


def open_session(
    path: Path,
    *,
    out: Path,
    cache: Path | None = None,
    listener: BuildListener | None = None,
    resumes: bool = False,
) -> RecipeSession:
    """Open a recipe for painting; scan, filter and tree are taken from the build's cache where they are there.

    The example strokes of a starter recipe are left out: they mark nothing. A build refuses them.

    Parameters
    ----------
    path
        The recipe's file.
    out
        Directory that the case is built in.
    cache
        Directory of the cache; ``out/.heartcase-cache`` when left out.
    listener
        Told of progress.
    resumes
        Whether the strokes that sessions wrote at the end of the recipe are strokes of this session: so that they can
        be taken back.

    Raises
    ------
    HeartcaseError
        A problem with the recipe, the scan or the markers; or the recipe's method is not the watershed.
    """
    text = read_recipe_text(path)
    kept, painted = _without_session(text) if resumes else (text, ())
    asked = parse_recipe(kept, needs_markers=False)
    if asked.segment.method != "watershed":
        raise UsageError(
            f"the recipe's segment.method is {asked.segment.method!r}: only the watershed is painted", place="segment"
        )
    store = Cache(cache or out / ".heartcase-cache")
    runner, work = Runner(store, listener or SilentListener(), force=False), Work(asked, path.parent, cache=store)
    runner.run(READ, work)
    recipe = work.resolve()
    runner.run(FILTER, work)
    filtered, nodes = have(work.outputs.filtered), work.outputs
    from heartcase.pipeline.markers.load_markers import load_markers, stated_markers
    from heartcase.pipeline.markers.marker_help import AutomaticMarkers
    from heartcase.pipeline.markers.placeholders import example_strokes

    scan, markers = have(nodes.scan).get(), None
    examples = example_strokes(recipe.strokes, nodes.whole)
    strokes = [stroke for number, stroke in enumerate(recipe.strokes, start=1) if number not in examples]
    stated = (recipe.markers, strokes, recipe.table, scan.geometry, path.parent)
    if recipe.segment.automatic:
        markers = AutomaticMarkers(scan, recipe.segment.automatic, stated_markers(*stated, whole=nodes.whole).labels)
    tree = filtered_tree(work)
    session = SegmentationSession(
        tree,
        filtered.get().geometry,
        recipe.table,
        markers=markers or load_markers(*stated, whole=nodes.whole),
        whole=nodes.whole,
    )
    for stroke in painted:
        # the region of interest may have been made smaller since
        session.paint(stroke, may_miss=True)
    return RecipeSession(session, scan, recipe, path, kept, text, nodes.whole)


def write_with_tables(
    path: Path, text: str, addition: str, *, place: str, advice: str, is_checked: bool = False
) -> str:
    """Write a recipe's text with tables added at its end, and return it.

    Where ``is_checked``, such tables are known to go with this text.

    Raises
    ------
    RecipeError
        At ``place``, with the ``advice``: what comes out is no recipe, as where it has the same as one array. Or the
        file cannot be written.
    """
    whole = (text if text.endswith("\n") or not addition else f"{text}\n") + addition
    try:
        if not is_checked:
            parse_recipe(whole, needs_markers=False)
    except RecipeError:
        raise RecipeError(f"{place} cannot be added at the end of this recipe: {advice}", place=place) from None
    try:
        atomic_write(path, whole.encode("utf-8"))
    except OSError as error:
        raise RecipeError(f"cannot be written: {error.strerror}", place="recipe") from None
    return whole


def _without_session(text: str) -> tuple[str, tuple[Stroke, ...]]:
    """A recipe's text without what sessions wrote at its end, and the strokes of that."""
    parse_recipe(text, needs_markers=False)
    kept, tail = split_session(text)
    painted = tomllib.loads(tail).get("strokes", ())
    return kept, tuple(Stroke.model_validate(stroke) for stroke in painted)
