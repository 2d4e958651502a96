"""The page of public names is that of the docstrings, and says of each parameter what it is."""

from __future__ import annotations

import ast
import re

import heartcase
from tests.docs.api_page import PAGE, SECTIONS, api_page, documented_calls
from tests.docs.pages import PAGES, ROOT

_CODE = re.compile(r"^```(?:python|py)\n(.*?)^```$", re.M | re.S)


def test_the_page_is_up_to_date():
    assert PAGE.read_text(encoding="utf-8") == api_page(), "run  python -m tests.docs.api_page --write"


def test_the_page_shows_the_public_names_and_no_others():
    """This list is what the package promises: a name that comes, goes or changes its name shows here."""
    shown = [name for _, names in SECTIONS.values() for name in names.split()]
    assert sorted(shown) == sorted({*heartcase.__all__} - {"__version__"})


def test_shapes_units_types_and_errors_are_on_the_page():
    page = api_page()
    for line in (
        "- `turn`: Rotation about its centre since it closed, LPS axes, shape (3, 3); none when left out.",
        "    curvature: Literal['flagged', 'all', 'none'] = 'flagged',",
        "- `vertices_mm: NDArray[float32]`: Positions, LPS mm, shape (vertex_count, 3).",
        "- `time_s: float`, read-only: Simulated time, s.",
        "    sleep_mm: float = 0.05,",
        "- `UsageError`: The needs are a text instead of a list of them, a need or the curvature "
        "is unknown, or the case does not have the level.",
    ):
        assert f"{line}\n" in page, line
    assert ":func:" not in page
    assert "Annotated[" not in page


def test_every_parameter_of_a_public_call_is_described():
    """Where a call takes more than one thing, its docstring says what each is."""
    bare = {
        call: missing
        for call, (parameters, text) in documented_calls().items()
        if len(parameters) > 1 and (missing := [name for name in parameters if not re.search(rf"\b{name}\b", text)])
    }
    assert bare == {}


def test_examples_import_from_the_package_alone():
    for page in (*PAGES, ROOT / "readers" / "README.md"):
        for code in _CODE.findall(page.read_text(encoding="utf-8")):
            for node in ast.walk(ast.parse(code)) if "import" in code else ():
                if isinstance(node, ast.ImportFrom):
                    assert not (node.module or "").startswith("heartcase."), f"{page.name}: {node.module}"
                    if node.module == "heartcase":
                        assert {alias.name for alias in node.names} <= {*heartcase.__all__}, page.name
                elif isinstance(node, ast.Import):
                    assert not any(alias.name.startswith("heartcase.") for alias in node.names), page.name
