"""Text of a tour as plain structure: paragraphs and lists of pieces. Nothing in it is markup, and nothing can run."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from heartcase.schemas.base import Model

__all__ = ["Block", "Choice", "Listing", "Paragraph", "Piece", "Question", "plain"]

_Text = Annotated[str, Field(min_length=1, max_length=4000)]


class Piece(Model):
    """Letters of one kind."""

    text: _Text
    """The letters."""
    strong: bool = False
    """Whether they stand out."""
    emphasis: bool = False
    """Whether they are stressed."""


Pieces = Annotated[tuple[Piece, ...], Field(min_length=1, max_length=400)]


class Paragraph(Model):
    """A paragraph."""

    kind: Literal["paragraph"] = "paragraph"
    """Which block."""
    pieces: Pieces
    """Its text."""


class Listing(Model):
    """A list."""

    kind: Literal["list"] = "list"
    """Which block."""
    is_numbered: bool
    """Whether its items have numbers."""
    items: Annotated[tuple[Pieces, ...], Field(min_length=1, max_length=100)]
    """Text of each."""


Block = Annotated[Paragraph | Listing, Field(discriminator="kind")]


class Choice(Model):
    """An answer that can be chosen."""

    pieces: Pieces
    """The answer."""
    is_right: bool
    """Whether it is right."""
    reason: Annotated[tuple[Pieces, ...], Field(max_length=20)] = ()
    """Why it is right or wrong: paragraphs."""


class Question(Model):
    """A question, with answers to choose from."""

    text: _Text
    """What is asked."""
    choices: Annotated[tuple[Choice, ...], Field(min_length=2, max_length=10)]
    """Answers; one or more of them are right."""


def plain(pieces: tuple[Piece, ...]) -> str:
    """The letters of some pieces."""
    return "".join(piece.text for piece in pieces)
