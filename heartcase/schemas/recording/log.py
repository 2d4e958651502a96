"""The log of a recording, ``log.jsonl``: a JSON object a line, each sealed with a hash of all lines up to it.

A line says that something was done (``step``, ``command``), that the session went to where so many entries of its
history are done (``to``), or that a state was stored there (``step``, ``file``, ``size``, ``sha256``). It ends with its
link: the hash of the link before and of the line without its link. So a line that was changed, left out or cut is
found, and what stands before it is whole.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Annotated

from pydantic import Field, TypeAdapter, ValidationError

from heartcase.schemas.base import Model
from heartcase.schemas.recording.commands import Entry
from heartcase.schemas.recording.header import Hash
from heartcase.schemas.strict_json import parse_json

__all__ = ["LINE_SIZE_MAX", "GoToLine", "History", "StateLine", "opened", "sealed"]

LINE_SIZE_MAX = 16 << 20
"""A line that is longer, in bytes, is not read."""
_LINK = b',"link":"'
_SEAL_SIZE = len(_LINK) + 64 + len(b'"}')


class GoToLine(Model):
    """The session went back, or on."""

    to: Annotated[int, Field(ge=0)]
    """Entries that are done there."""


class StateLine(Model):
    """A state was stored."""

    step: Annotated[int, Field(ge=0)]
    """Its step."""
    file: Annotated[str, Field(pattern=r"^state-[0-9]{6,12}\.safetensors$")]
    """Its file, beside the log."""
    size: Annotated[int, Field(ge=0)]
    """Bytes of the file."""
    sha256: Hash
    """Hash of the file."""


Line = Entry | GoToLine | StateLine
_LINE: TypeAdapter[Line] = TypeAdapter(Line)


def sealed(line: Line, link: str) -> tuple[bytes, str]:
    """A line as it is written, after one with this link; and its own link."""
    body = json.dumps(line.model_dump(mode="json", exclude_none=True), separators=(",", ":")).encode()
    own = sha256(link.encode() + body).hexdigest()
    return body[:-1] + _LINK + own.encode() + b'"}\n', own


def opened(content: bytes, link: str) -> tuple[Line, str]:
    """A line that was read, without its line break, after one with this link; and its own link.

    Raises
    ------
    ValueError
        It is not what was written, or says nothing that a log says.
    """
    body, seal = content[:-_SEAL_SIZE] + b"}", content[-_SEAL_SIZE:]
    own = sha256(link.encode() + body).hexdigest()
    if seal != _LINK + own.encode() + b'"}':
        raise ValueError("the seal is broken")
    try:
        return _LINE.validate_python(parse_json(body)), own
    except ValidationError:
        raise ValueError("it says nothing that a log says") from None


@dataclass
class History:
    """What the lines of a log come to."""

    start_step: int
    """Step at which the session began."""
    entries: list[Entry] = field(default_factory=list)
    """What was done, without what was taken back and followed by something else."""
    position: int = 0
    """How many of them were done at the end."""
    states: dict[int, StateLine] = field(default_factory=dict)
    """Position -> state that was stored there."""

    @property
    def step(self) -> int:
        """Step at the end."""
        return self.step_at(self.position)

    def step_at(self, position: int) -> int:
        """Step where so many entries are done."""
        return self.entries[position - 1].end_step if position else self.start_step

    def take(self, line: Line) -> None:
        """Go on with a line.

        Raises
        ------
        ValueError
            It does not follow from the lines before.
        """
        if isinstance(line, GoToLine):
            if line.to > len(self.entries):
                raise ValueError("it goes on to what was never done")
            self.position = line.to
            return
        if line.step != self.step:
            raise ValueError("it is of another step")
        if isinstance(line, StateLine):
            self.states[self.position] = line
            return
        if self.position < len(self.entries):
            del self.entries[self.position :]
            self.states = {position: state for position, state in self.states.items() if position <= self.position}
        self.entries.append(line)
        self.position += 1
