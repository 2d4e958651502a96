"""All tools of the mouse, in the order in which they are listed."""

from __future__ import annotations

from heartcase.window.drawing_tools import CutTool, PatchTool, RowTool, ScissorsTool, StitchTool
from heartcase.window.holding_tools import ForcepsTool, GrabTool, ProbeTool, RetractorTool
from heartcase.window.tool import Tool

__all__ = ["TOOLS"]

TOOLS: tuple[type[Tool], ...] = (
    GrabTool,
    ProbeTool,
    CutTool,
    ScissorsTool,
    ForcepsTool,
    RetractorTool,
    StitchTool,
    RowTool,
    PatchTool,
)
"""Classes of tools."""
