"""Keys and mouse of the window: one table, for the window, its help and the documentation."""

from __future__ import annotations

from dataclasses import dataclass

from heartcase.simulator.live.tools import TOOLS

__all__ = ["KEYS", "MOUSE", "Key", "help_text"]


@dataclass(frozen=True)
class Key:
    """A key and what it does."""

    keys: tuple[str, ...]
    """Names of keys as VTK gives them (``keysym``): any of them."""
    action: str
    """What is done: a method of the window without its underscore, and after a colon what is given to it."""
    shown: str
    """The key as people call it."""
    words: str
    """What it does."""


KEYS: tuple[Key, ...] = (
    Key(("o", "O"), "take_tool:", "O", "orbit: no tool in hand"),
    *(Key((tool.key, tool.key.upper()), f"take_tool:{tool.key}", tool.key.upper(), tool.title) for tool in TOOLS),
    Key(("plus", "equal", "KP_Add"), "resize:1", "+", "larger: radius, depth, opening or tension of the tool"),
    Key(("minus", "KP_Subtract"), "resize:-1", "-", "smaller"),
    Key(("x", "X"), "let_go:", "X", "let go or take out what is pointed at; else what closed last"),
    Key(("t", "T"), "tie:", "T", "tie all stitches that are drawn"),
    Key(("u", "U"), "undo:", "U", "take back the last act, and pause"),
    Key(("y", "Y"), "redo:", "Y", "do it again"),
    Key(("b", "B"), "rewind:", "B", "go back by a second, and pause"),
    Key(("Return", "KP_Enter"), "play:", "Enter", "after going back: play what came then"),
    Key(("space",), "pause:", "Space", "pause; go on from here"),
    Key(("m", "M"), "mark:", "M", "give this moment a name"),
    Key(("w", "W"), "record:", "W", "record, from the start on; finish the recording"),
    Key(("v", "V"), "show_strain:", "V", "colours: structures, or how far the tissue is stretched"),
    Key(("i", "I"), "show_slice:", "I", "slice of the scan, the heart opened at it"),
    Key(("bracketleft", "comma"), "move_slice:-1", "[", "slice towards the scan's first"),
    Key(("bracketright", "period"), "move_slice:1", "]", "slice the other way"),
    Key(("a", "A"), "show_all:", "A", "show all structures"),
    Key(("Home",), "reset_view:", "Home", "the view of the start"),
    Key(("Escape",), "put_down:", "Esc", "put down what was begun"),
    Key(("h", "H", "question"), "show_help:", "H", "this list"),
    Key(("q", "Q"), "leave:", "Q", "close the window; a recording is finished"),
)
"""All keys."""

MOUSE: tuple[tuple[str, str], ...] = (
    ("left, no tool or beside the heart", "orbit"),
    ("left, on the heart", "use the tool"),
    ("right", "orbit"),
    ("middle, or Shift and left", "move the view"),
    ("wheel", "nearer or farther; while a tool holds: push it deeper, or draw it nearer"),
    ("left, on a name at the right edge", "show or hide the structure"),
)
"""What the mouse does: where, and what."""


def help_text() -> str:
    """All keys and what the mouse does, as lines."""
    lines = [f"{key.shown:>6}  {key.words}" for key in KEYS]
    return "\n".join([*lines, "", *(f"{where}: {what}" for where, what in MOUSE)])
