"""The history of a recipe: every act on its text, in order, to be taken back and done again to any depth.

An act is what was cut out of the text at one place and what was put in there. Taking all back gives the first bytes, of
whatever kind the acts were, and none has to be understood for it. The history lies in a file of its own, to which each
act is added before the recipe is replaced; where one is in it is told by the recipe's own text. So whoever is killed in
between loses nothing, and another program's change of the recipe is never undone by mistake: the text then is none that
the history knows.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from heartcase.pipeline.building.recipe_text import split_session, with_stroke
from heartcase.schemas.errors import RecipeError, UsageError
from heartcase.schemas.files import atomic_write
from heartcase.schemas.recipe.recipe import Recipe, parse_recipe, read_recipe_text
from heartcase.schemas.recipe.settings import Stroke
from heartcase.schemas.toml_places import toml_places

__all__ = ["STROKE", "Act", "RecipeHistory", "history_file", "open_history"]

STROKE = "strokes"
"""Kind of an act that painted a stroke."""
_VERSION = 1


@dataclass(frozen=True)
class Act:
    """One change of a recipe's text."""

    kind: str
    """What was changed, in the recipe's words: ``strokes``, ``ends[2]``, ``materials.youngs_modulus_kpa``."""
    at: int
    """Where, in characters from the start."""
    removed: str
    """What stood there."""
    added: str
    """What stands there since."""

    @classmethod
    def between(cls, kind: str, before: str, after: str) -> Act:
        """The shortest act that makes one text of another."""
        start = _common_length(before, after)
        rest = min(len(before), len(after)) - start
        end = _common_length(before[::-1][:rest], after[::-1][:rest])
        return cls(kind, start, before[start : len(before) - end], after[start : len(after) - end])

    def done(self, text: str) -> str:
        """The text with it."""
        return text[: self.at] + self.added + text[self.at + len(self.removed) :]

    def undone(self, text: str) -> str:
        """The text without it."""
        return text[: self.at] + self.removed + text[self.at + len(self.added) :]


class RecipeHistory:
    """A recipe's text, and the acts that made it. Made by :func:`open_history`.

    Parameters
    ----------
    path
        The recipe's file.
    text
        What it holds.
    acts
        All that is known, also what was taken back.
    count
        How many of them the text has.
    log
        File that remembers them.
    """

    def __init__(self, path: Path, text: str, acts: tuple[Act, ...], count: int, log: Path) -> None:
        self.path = path
        self._text = text
        self._acts = list(acts)
        self._count = count
        self._log = log
        self._is_logged = False
        self._stroke_count = sum(act.kind == STROKE for act in acts[:count])
        self._head = split_session(text)[0] if self._stroke_count else text
        self._recipe: Recipe | None = None
        self._takes_strokes = self._stroke_count > 0

    @property
    def text(self) -> str:
        """The recipe as it was read or written last."""
        return self._text

    @property
    def log(self) -> Path:
        """File that remembers the acts."""
        return self._log

    @property
    def head(self) -> str:
        """The text without the strokes of sessions at its end."""
        return self._head

    @property
    def recipe(self) -> Recipe:
        """What :attr:`head` says."""
        if self._recipe is None:
            self._recipe = parse_recipe(self._head, needs_markers=False)
        return self._recipe

    @property
    def undo_count(self) -> int:
        """How many acts can be taken back."""
        return self._count

    @property
    def redo_count(self) -> int:
        """How many can be done again."""
        return len(self._acts) - self._count

    @property
    def stroke_count(self) -> int:
        """How many of the acts that hold are strokes."""
        return self._stroke_count

    @property
    def last(self) -> Act | None:
        """What :meth:`undo` takes back."""
        return self._acts[self._count - 1] if self._count else None

    @property
    def next(self) -> Act | None:
        """What :meth:`redo` does again."""
        return self._acts[self._count] if self.redo_count else None

    @property
    def undone_strokes(self) -> tuple[Stroke, ...]:
        """The strokes that were taken back, the next one to be painted again last."""
        acts = [act for act in self._acts[self._count :] if act.kind == STROKE]
        return tuple(_strokes_of(act.added)[-1] for act in reversed(acts))

    @property
    def is_stale(self) -> bool:
        """Whether another program changed the recipe since it was read or written here."""
        try:
            return self.path.read_bytes() != self._text.encode("utf-8")
        except OSError:
            return True

    def paint(self, stroke: Stroke) -> None:
        """Write a stroke at the recipe's end.

        Raises
        ------
        RecipeError
            Another program changed the recipe, its strokes are one array, or it cannot be written. Nothing is changed
            then.
        """
        text = with_stroke(self._text, stroke, has_some=self._stroke_count > 0)
        # Reading a recipe of many strokes takes long, and what holds some of them holds any.
        if not self._takes_strokes:
            try:
                parse_recipe(text, needs_markers=False)
            except RecipeError:
                raise RecipeError(
                    "strokes cannot be added at the end of this recipe: write its strokes as [[strokes]] tables "
                    "instead of strokes = [...]",
                    place="strokes",
                ) from None
        at = len(self._text)
        self._do(Act(STROKE, at, "", text[at:]))
        self._takes_strokes = True

    def change(self, kind: str, head: str) -> None:
        """Write what stands before the strokes of sessions anew.

        Parameters
        ----------
        kind
            What is changed, in the recipe's words.
        head
            The whole of it after the change.

        Raises
        ------
        RecipeError
            It is no recipe (every problem), another program changed the file, or it cannot be written. Nothing is
            changed then.
        """
        recipe = parse_recipe(head, needs_markers=False)
        self._do(Act.between(kind, self._head, head))
        self._recipe = recipe

    def undo(self) -> Act:
        """Take the last act back, and return it.

        Raises
        ------
        UsageError
            There is none.
        RecipeError
            As of :meth:`change`.
        """
        act = self.last
        if act is None:
            raise UsageError("there is nothing to take back", place="undo")
        self._check()
        self._write(act.undone(self._text))
        self._move(-1, act)
        return act

    def redo(self) -> Act:
        """Do again what was taken back last, and return it.

        Raises
        ------
        UsageError
            There is nothing.
        RecipeError
            As of :meth:`change`.
        """
        act = self.next
        if act is None:
            raise UsageError("there is nothing to do again", place="redo")
        self._check()
        self._write(act.done(self._text))
        self._move(1, act)
        return act

    def _do(self, act: Act) -> None:
        self._check()
        self._begin_log()
        self._log_line(_line(self._count, act))
        self._write(act.done(self._text))
        self._acts[self._count :] = [act]
        self._move(1, act)

    def _move(self, step: int, act: Act) -> None:
        self._count += step
        if act.kind == STROKE:
            self._stroke_count += step
        else:
            self._head = act.done(self._head) if step > 0 else act.undone(self._head)
            self._recipe = None
        if not self._stroke_count:
            self._head = self._text
        self._log_line({"count": self._count})

    def _check(self) -> None:
        if self.is_stale:
            raise RecipeError("another program changed the recipe meanwhile: open it again", place="recipe")

    def _write(self, text: str) -> None:
        self._begin_log()
        try:
            atomic_write(self.path, text.encode("utf-8"))
        except OSError as error:
            raise RecipeError(f"cannot be written: {error.strerror}", place="recipe") from None
        self._text = text

    def _begin_log(self) -> None:
        """Write down what is known; where that fails, less can be taken back after the next start."""
        if self._is_logged:
            return
        text = self._text
        for act in reversed(self._acts[: self._count]):
            text = act.undone(text)
        begins = {"heartcase_history": _VERSION, "sha256": _sha256(text), "length": len(text)}
        lines: list[dict[str, object]] = [begins]
        lines += [_line(number, act) for number, act in enumerate(self._acts)]
        lines.append({"count": self._count})
        with contextlib.suppress(OSError):
            self._log.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(self._log, "".join(json.dumps(line) + "\n" for line in lines).encode())
            self._is_logged = True

    def _log_line(self, line: dict[str, object]) -> None:
        if not self._is_logged:
            return
        try:
            with self._log.open("ab") as file:
                file.write(json.dumps(line).encode() + b"\n")
        except OSError:
            self._is_logged = False


def history_file(path: Path, *, out: Path) -> Path:
    """File that remembers what was done to a recipe that is built in this directory."""
    name = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:16]
    return out / ".heartcase-cache" / "studio" / f"{name}.jsonl"


def open_history(path: Path, *, out: Path) -> RecipeHistory:
    """Open a recipe with all that was done to it, as far as that is known.

    Where nothing is known, or another program changed the recipe since, the strokes that sessions wrote at its end can
    be taken back.

    Parameters
    ----------
    path
        The recipe's file.
    out
        Directory that the case is built in, with the build's cache.

    Raises
    ------
    RecipeError
        It cannot be read.
    """
    # for its refusals; line ends must stay as they are
    read_recipe_text(path)
    text = path.read_bytes().decode("utf-8")
    log = history_file(path, out=out)
    acts, count = of_strokes = _of_strokes(text)
    remembered = _remembered(log, text)
    # What is taken back must be what painting holds.
    if remembered and sum(act.kind == STROKE for act in remembered[0][: remembered[1]]) == len(of_strokes[0]):
        acts, count = remembered
    return RecipeHistory(path, text, acts, count, log)


def _remembered(log: Path, text: str) -> tuple[tuple[Act, ...], int] | None:
    """The acts of a file, and how many of them a text has; None where the text is none of theirs."""
    acts: list[Act] = []
    count = 0
    try:
        first, *lines = log.read_bytes().splitlines()
        begins = json.loads(first)
        if begins["heartcase_history"] != _VERSION:
            return None
        for line in lines:
            # a line that was being written when the machine stopped ends the file
            if (data := _data(line)) is None:
                break
            if "act" in data:
                acts[data["after"] :] = [Act(*data["act"])]
                count = min(count, len(acts))
            else:
                count = data["count"]
        at_start = _count_in(text, acts, count, begins["sha256"], begins.get("length"))
    except (OSError, ValueError, KeyError, TypeError, IndexError):
        return None
    return None if at_start is None else (tuple(acts), at_start)


def _data(line: bytes) -> dict[str, Any] | None:
    try:
        found = json.loads(line)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


def _count_in(text: str, acts: list[Act], count: int, sha256: str, length: int | None) -> int | None:
    """How many acts a text has, where the text before all of them had this digest: ``count``, or the nearest to it.

    Only where the length agrees are the acts taken back: of many strokes that takes long. A log without a length is
    asked for what a stop between two writes can leave alone.
    """
    grown = [0, *itertools.accumulate(len(act.added) - len(act.removed) for act in acts)]
    for number in sorted(range(len(acts) + 1), key=lambda one: abs(one - count)):
        if abs(number - count) > 1 if length is None else len(text) - grown[number] != length:
            continue
        first = text
        for act in reversed(acts[:number]):
            if first[act.at : act.at + len(act.added)] != act.added:
                break
            first = act.undone(first)
        else:
            if _sha256(first) == sha256:
                return number
    return None


def _of_strokes(text: str) -> tuple[tuple[Act, ...], int]:
    """The strokes of sessions at the end of a recipe, as acts."""
    parse_recipe(text, needs_markers=False)
    head, tail = split_session(text)
    acts: list[Act] = []
    start = 0
    tables = [table for table in toml_places(tail) if table.place] if tail else []
    for table in tables:
        end = len(tail) if table is tables[-1] else table.end
        acts.append(Act(STROKE, len(head) + start, "", tail[start:end]))
        start = end
    return tuple(acts), len(acts)


def _strokes_of(added: str) -> tuple[Stroke, ...]:
    return tuple(Stroke.model_validate(one) for one in tomllib.loads(added)["strokes"])


def _line(after: int, act: Act) -> dict[str, object]:
    return {"after": after, "act": [act.kind, act.at, act.removed, act.added]}


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _common_length(one: str, other: str) -> int:
    """How many characters two texts begin with alike."""
    low, high = 0, min(len(one), len(other))
    while low < high:
        middle = (low + high + 1) // 2
        if one[:middle] == other[:middle]:
            low = middle
        else:
            high = middle - 1
    return low
