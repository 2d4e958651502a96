"""What the models of commands share: one that is made in a program says what is wrong as the rest of heartcase does."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from heartcase.schemas.base import Model
from heartcase.schemas.errors import RecordingError, problems_from_validation

__all__ = ["CommandModel"]


class CommandModel(Model):
    """Base of the commands, and of what stands in them.

    Raises
    ------
    RecordingError
        With everything that is wrong with what it was made of.
    """

    def __init__(self, /, **data: Any) -> None:
        try:
            super().__init__(**data)
        except ValidationError as error:
            kind = type(self)
            raise RecordingError(problems_from_validation(error, place=kind.__name__, model=kind)) from None

    # pydantic calls an __init__ of one's own inside validation too, unless it is marked as its own is
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]
