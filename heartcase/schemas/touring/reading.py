"""A tour read from Markdown (CommonMark): headings are steps, a TOML block is a step's scene, ``[x]`` is right."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from markdown_it import MarkdownIt
from markdown_it.tree import SyntaxTreeNode
from pydantic import BaseModel, ValidationError

from heartcase.schemas.errors import HeartcaseError, Problem, ScriptError, problems_from_validation
from heartcase.schemas.migrate import TOUR
from heartcase.schemas.scripts.toml_text import text_of
from heartcase.schemas.toml_places import toml_places
from heartcase.schemas.toml_problems import toml_problem
from heartcase.schemas.touring.sound_scene import keys_of, sound_scene
from heartcase.schemas.touring.text import Block, Choice, Listing, Paragraph, Piece, Question
from heartcase.schemas.touring.tour import Scene, Tour, TourAct, TourHead, TourStep, Wait, act_problems, parse_act

__all__ = ["SIZE_MAX", "TOUR_ENDING", "ReadTour", "is_tour", "load_tour", "parse_tour", "read_tour"]

SIZE_MAX = 1 << 20
"""A tour that is longer, in bytes, is not read."""
TOUR_ENDING = ".tour.md"
"""How the names of tours' files end."""

_HEAD = re.compile(r"\A\ufeff?\+\+\+[ \t]*\n(.*?)^\+\+\+[ \t]*(?:\n|\Z)", re.S | re.M)
_CHOICE = re.compile(r"\[([ xX])\][ \t]+")
_ABOUT_LINE = re.compile(r" \(at line (\d+), column \d+\)")
_SAMPLE = "docs/tours.md has one"
M = TypeVar("M", bound=BaseModel)


def is_tour(path: Path | str) -> bool:
    """Whether a file is one by its name."""
    return str(path).lower().endswith(TOUR_ENDING)


@dataclass(frozen=True)
class ReadTour:
    """What was read of a tour's text, sound or not."""

    head: TourHead | None
    """What stands at its top; None where that is wrong."""
    steps: tuple[TourStep, ...]
    """Its steps, without what is wrong in them: what they name of a case can be looked at all the same."""
    problems: tuple[Problem, ...]
    """All that is wrong, each with its line."""


def load_tour(path: Path | str) -> Tour:
    """Read a tour.

    Raises
    ------
    ScriptError
        It cannot be read, or with every problem that was found in it, each with its line.
    """
    return parse_tour(_text(path))


def read_tour(path: Path | str) -> ReadTour:
    """What stands in the file of a tour that may be wrong.

    Raises
    ------
    ScriptError
        It cannot be read, or does not begin as a tour does.
    """
    reader, head = _read(_text(path))
    made = reader.tour(head)
    return ReadTour(head, made.steps if made else tuple(reader.sound_steps()), tuple(reader.problems))


def _text(path: Path | str) -> str:
    try:
        if Path(path).stat().st_size > SIZE_MAX:
            raise ScriptError(f"the file is larger than {SIZE_MAX >> 20} MiB: that is no tour", place="tour")
    except OSError:
        # told below
        pass
    return text_of(path, "tour")


def parse_tour(text: str) -> Tour:
    """Read a tour from the text of its file.

    Parameters
    ----------
    text
        A head of TOML between lines of ``+++``, and Markdown: ``#`` the title, ``##`` a step, ``###`` its question.

    Raises
    ------
    ScriptError
        With every problem that was found, each with its line.
    """
    reader, head = _read(text)
    tour = reader.tour(head)
    if tour is None:
        raise ScriptError(reader.problems)
    return tour


def _read(text: str) -> tuple[_Reader, TourHead | None]:
    """What has read all of it, and its head where that is sound."""
    text = text.replace("\r\n", "\n")
    reader = _Reader()
    found = _HEAD.match(text)
    if found is None:
        raise ScriptError(
            f'a tour begins with a line of +++, heartcase_tour = 1, case = "NAME", and a line of +++: {_SAMPLE}',
            place="line 1",
        )
    head = reader.head(found[1])
    before = text[: found.end()].count("\n")
    tree = SyntaxTreeNode(MarkdownIt("commonmark").parse(text[found.end() :]))
    for node in tree.children:
        reader.take(node, 1 + before + (node.map[0] if node.map else 0))
    return reader, head


class _Step:
    """A step that is being read."""

    def __init__(self, title: str, line: int) -> None:
        self.title, self.line = title, line
        self.blocks: list[Block] = []
        self.scene: Scene | None = None
        self.acts: tuple[TourAct, ...] = ()
        self.asked: str | None = None
        self.asked_line = 0
        self.choices: list[Choice] | None = None


class _Reader:
    def __init__(self) -> None:
        self.problems: list[Problem] = []
        self.title: str | None = None
        self.blocks: list[Block] = []
        self.steps: list[_Step] = []

    def head(self, text: str) -> TourHead | None:
        try:
            data = tomllib.loads(text)
            return TourHead.model_validate(TOUR.migrated(data)[0])
        except tomllib.TOMLDecodeError as error:
            self._toml_problem(text, error, 2)
        except ValidationError as error:
            for problem in problems_from_validation(error, model=TourHead):
                self._tell(_line_of(text, problem.place, 2), problem)
        except HeartcaseError as error:
            for problem in error.problems:
                self._tell(2, problem)
        return None

    def take(self, node: SyntaxTreeNode, line: int) -> None:
        """Take a block of the file."""
        step = self.steps[-1] if self.steps else None
        if node.type == "heading":
            self._heading(node, line)
        elif node.type == "fence":
            words = node.info.split()
            if step is None or words[:1] != ["toml"]:
                where = "stands before the first step (##)" if step is None else "is not of TOML"
                self._say(line, f"this block of code {where}: a step's scene is a block that begins with ```toml")
            elif step.scene is not None:
                self._say(line, "a step has one scene: put both blocks together")
            else:
                self._scene(step, node.content, line + 1)
        elif step is not None and step.asked is not None:
            if node.type == "bullet_list" and step.choices is None:
                step.choices = [self._choice(item, line - (node.map or (0, 0))[0]) for item in node.children]
            else:
                self._say(line, "below a question stands one list of answers, - [x] the right and - [ ] the wrong ones")
        elif (block := self._block(node, line)) is not None:
            (self.blocks if step is None else step.blocks).append(block)

    def tour(self, head: TourHead | None) -> Tour | None:
        """All that was read; None where anything is wrong with it."""
        steps: list[TourStep] = []
        if self.title is None:
            self._say(1, "the tour has no title: begin with a line such as  # A hole between the ventricles")
        if not self.steps:
            self._say(1, "the tour has no steps: each begins with a line such as  ## What it is")
        for step in self.steps:
            question = self._question(step)
            # What is wrong in a scene was told where it was read.
            scene = Scene() if step.scene is None or self.problems else step.scene
            if not step.blocks and question is None:
                self._say(step.line, "this step says nothing: write some words below its heading", step)
            steps += self._checked(
                TourStep,
                {
                    "title": step.title,
                    "line": step.line,
                    "blocks": tuple(step.blocks),
                    "scene": scene,
                    "acts": step.acts,
                    "question": question,
                },
                step.line,
            )
        made = []
        if head is not None and self.title is not None and self.steps and not self.problems:
            data = {"head": head, "title": self.title, "blocks": tuple(self.blocks), "steps": tuple(steps)}
            made = self._checked(Tour, data, 1)
        return made[0] if made else None

    def sound_steps(self) -> Iterator[TourStep]:
        """The steps as far as they are sound: their scenes, and what they do."""
        for step in self.steps:
            yield TourStep.model_construct(
                title=step.title, line=step.line, scene=step.scene or Scene(), acts=step.acts
            )

    def _heading(self, node: SyntaxTreeNode, line: int) -> None:
        title = _plain(node.children[0]) if node.children else ""
        level = int(node.tag[1:])
        if not title:
            self._say(line, "a heading needs words")
            title = "?"
        if level == 1:
            if self.title is not None or self.steps:
                self._say(line, "a tour has one title (#), at its beginning: steps begin with ##")
            self.title = title
        elif level == 2:
            self.steps.append(_Step(title, line))
        elif level == 3 and self.steps and self.steps[-1].asked is None:
            self.steps[-1].asked, self.steps[-1].asked_line = title, line
        elif level == 3:
            words = "a step has one question (###)" if self.steps else "a question (###) belongs to a step (##)"
            self._say(line, words)
        else:
            self._say(line, "headings are # the title, ## a step, ### its question")

    def _scene(self, step: _Step, text: str, first: int) -> None:
        step.scene = Scene()
        try:
            data = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            self._toml_problem(text, error, first, step)
            return
        done = data.pop("do", [])
        step.scene, problems = sound_scene(data)
        for problem in problems:
            self._tell(_line_of(text, problem.place, first), problem, step)
        if not isinstance(done, list):
            self._tell(_line_of(text, "do", first), Problem("do", "write each act as a table: [[do]]"), step)
            return
        acts: list[TourAct] = []
        for number, one in enumerate(done, start=1):
            for problem in (wrong := act_problems(one)):
                place = f"do[{number}]" + (f".{problem.place}" if problem.place else "")
                self._tell(_line_of(text, place, first), Problem(place, problem.message), step)
            # what stands for a wrong one names nothing, and leaves the others their numbers
            acts.append(Wait(kind="wait", seconds=1.0) if wrong else parse_act(one))
        step.acts = tuple(acts)

    def _question(self, step: _Step) -> Question | None:
        if step.asked is None:
            return None
        choices = step.choices
        if choices is None or len(choices) < 2:
            self._say(step.asked_line, "a question needs a list of two answers or more: - [x] right, - [ ] wrong", step)
            return None
        if not any(one.is_right for one in choices):
            self._say(step.asked_line, "none of the answers is right: mark it as  - [x]", step)
        if any(one.is_right and not one.reason for one in choices):
            say = "say why the right answer is right: a line further in, below it"
            self._say(step.asked_line, say, step)
        made = self._checked(Question, {"text": step.asked, "choices": tuple(choices)}, step.asked_line, step)
        return made[0] if made else None

    def _choice(self, item: SyntaxTreeNode, before: int) -> Choice:
        line = before + (item.map or (0, 0))[0]
        first, rest = item.children[:1], item.children[1:]
        pieces: tuple[Piece, ...] = ()
        if first and first[0].type == "paragraph":
            pieces = self._pieces(first[0].children[0], line)
        mark = _CHOICE.match(pieces[0].text) if pieces else None
        if mark is None:
            self._say(line, "an answer begins with [x] where it is right, and with [ ] where it is not")
            return Choice(pieces=(Piece(text="?"),), is_right=False)
        left = pieces[0].text[mark.end() :]
        pieces = (*((pieces[0].model_copy(update={"text": left}),) if left else ()), *pieces[1:])
        if not pieces:
            self._say(line, "this answer is empty")
            pieces = (Piece(text="?"),)
        reason: list[tuple[Piece, ...]] = []
        for node in rest:
            block = self._block(node, before + (node.map or (0, 0))[0])
            if isinstance(block, Paragraph):
                reason.append(block.pieces)
            elif block is not None:
                reason += block.items
        return Choice(pieces=pieces, is_right=mark[1] != " ", reason=tuple(reason))

    def _block(self, node: SyntaxTreeNode, line: int) -> Block | None:
        """A paragraph or a list; None, and told, where it is something else."""
        if node.type == "paragraph":
            pieces = self._pieces(node.children[0], line)
            return Paragraph(pieces=pieces) if pieces else None
        if node.type in ("bullet_list", "ordered_list"):
            items: list[tuple[Piece, ...]] = []
            for item in node.children:
                if [inner.type for inner in item.children] != ["paragraph"]:
                    self._say(line, "an item of a list is one paragraph: lists within lists are not shown")
                    continue
                pieces = self._pieces(item.children[0].children[0], line)
                if pieces:
                    items.append(pieces)
            return Listing(is_numbered=node.type == "ordered_list", items=tuple(items)) if items else None
        what = {"html_block": "HTML", "blockquote": "a quotation", "code_block": "text that begins with four spaces"}
        shown = what.get(node.type, "this")
        self._say(line, f"{shown} is not shown: a tour has paragraphs, lists, **strong** and *stressed* words")
        return None

    def _pieces(self, node: SyntaxTreeNode, line: int) -> tuple[Piece, ...]:
        """What stands in a paragraph."""
        found: list[Piece] = []

        def add(text: str, strong: bool, emphasis: bool) -> None:
            if not text:
                return
            if found and (found[-1].strong, found[-1].emphasis) == (strong, emphasis):
                text = found.pop().text + text
            if len(text) > 4000:
                self._say(line, "a paragraph has at most 4,000 letters")
                text = text[:4000]
            found.append(Piece(text=text, strong=strong, emphasis=emphasis))

        refused: set[str] = set()

        def walk(nodes: list[SyntaxTreeNode], strong: bool, emphasis: bool) -> None:
            for inner in nodes:
                if inner.type in ("text", "text_special", "code_inline"):
                    add(inner.content, strong, emphasis)
                elif inner.type in ("softbreak", "hardbreak"):
                    add(" ", strong, emphasis)
                elif inner.type == "strong":
                    walk(inner.children, True, emphasis)
                elif inner.type == "em":
                    walk(inner.children, strong, True)
                elif inner.type not in refused:
                    # a tag that is opened and closed is told once
                    refused.add(inner.type)
                    what = {"html_inline": "HTML", "link": "a link", "image": "a picture"}.get(inner.type, "this")
                    more = ": write its address as plain text" if inner.type == "link" else ""
                    self._say(line, f"{what} is not shown in a tour{more}")

        walk(node.children, False, False)
        return tuple(found)

    def _checked(self, model: type[M], data: dict[str, Any], line: int, step: _Step | None = None) -> list[M]:
        try:
            return [model.model_validate(data)]
        except ValidationError as error:
            for problem in problems_from_validation(error, model=model):
                self._tell(line, problem, step)
        return []

    def _toml_problem(self, text: str, error: tomllib.TOMLDecodeError, first: int, step: _Step | None = None) -> None:
        at = _ABOUT_LINE.search(str(error))
        words = _ABOUT_LINE.sub("", toml_problem(text, error))
        self._say(first + (int(at[1]) - 1 if at else 0), words, step)

    def _say(self, line: int, message: str, step: _Step | None = None) -> None:
        self._tell(line, Problem("", message), step)

    def _tell(self, line: int, problem: Problem, step: _Step | None = None) -> None:
        step = step or (self.steps[-1] if self.steps else None)
        where = f"line {line}"
        if step is not None and step in self.steps:
            where += f" (step {self.steps.index(step) + 1})"
        place = problem.place.replace("from_", "from")
        self.problems.append(Problem(f"{where}: {place}" if place else where, problem.message))


def _plain(node: SyntaxTreeNode) -> str:
    if node.type in ("softbreak", "hardbreak"):
        return " "
    if node.type in ("text", "text_special", "code_inline"):
        return node.content
    return "".join(_plain(inner) for inner in node.children).strip()


def _line_of(text: str, dotted: str, first: int) -> int:
    """Line of the file in which a setting stands; that of the nearest table above where it is not there."""
    keys = keys_of(dotted)
    best, at = -1, 0
    for table in toml_places(text):
        for place, start in ((table.place, table.start), *((entry.place, entry.start) for entry in table.entries)):
            shared = 0
            while shared < min(len(place), len(keys)) and place[shared] == keys[shared]:
                shared += 1
            if shared == len(place) and shared > best and not (shared == 0 and table.place):
                best, at = shared, start
    return first + text.count("\n", 0, at)
