"""All tools of the mouse, in the order in which they are listed."""

from __future__ import annotations

from heartcase.simulator.live.drawing_tools import CutTool, ExciseTool, PatchTool, RowTool, ScissorsTool, StitchTool
from heartcase.simulator.live.holding_tools import ForcepsTool, GrabTool, ProbeTool, RetractorTool
from heartcase.simulator.live.tool import Tool

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
    ExciseTool,
)
"""Classes of tools."""
