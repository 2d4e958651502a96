"""Tables of stages that are not the package's own."""

from __future__ import annotations

from dataclasses import replace

import pytest

from heartcase.pipeline.stages import table


def with_versions(patch: pytest.MonkeyPatch, **versions: int) -> None:
    """Give stages other versions than they have."""
    stages = (replace(one, version=versions.get(one.name, one.version)) for one in table.STAGES)
    patch.setattr(table, "STAGES", tuple(stages))
