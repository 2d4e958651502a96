"""What a first build says of compiling: that it does, how far it is, and for how long still."""

import io

import pytest
from rich.console import Console
from rich.progress import Progress as Rows

from heartcase.cli.shared.compiling import Compiling
from heartcase.compiling.compile_ahead import Progress


def test_a_line_says_that_kernels_are_compiled_and_a_row_how_far_and_how_long():
    written = io.StringIO()
    rows = Rows(console=Console(file=written))
    compiling = Compiling(Console(file=written), rows)
    compiling(Progress(0, 0, 120, 60.0))
    compiling(Progress(30, 1, 120, 45.0))
    assert written.getvalue().count("compiling 120 kernels") == 1
    (row,) = rows.tasks
    assert "31 of 120" in row.description
    assert row.total - row.elapsed == pytest.approx(45.0, abs=5.0) if row.elapsed else row.total >= 45.0
    compiling(Progress(119, 1, 120, 0.0))
    assert rows.tasks == []
