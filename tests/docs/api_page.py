"""Makes ``docs/api.md`` from the docstrings of the public names: ``python -m tests.docs.api_page --write``.

The modules are parsed, not imported: signatures and the docstrings below attributes are taken from the source.
"""

from __future__ import annotations

import ast
import re
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import heartcase

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "api.md"

_INTRO = """# Python names

What other programs are meant to use of heartcase. All of it is imported from `heartcase` itself, in one way only:

```py
from heartcase import Simulation, load_case
```

Everything else is private and may change without notice. What is here changes only as `CHANGELOG.md` says.

- Points and vectors are mm in patient LPS axes (`docs/conventions.md`), times s, forces N, unless a name or a text says
  otherwise. `[1]`, `[cells]` and `[k]` behind a text are units of the lattice (`docs/physics.md`).
- Arrays of a volume are indexed `[z, y, x]`. Shapes are given as `(rows, columns)`.
- Every error that a user can cause is a `HeartcaseError` with all `problems` that were found.
- `import heartcase` loads none of it: each name is loaded at its first use. What makes cases from scans needs
  `pip install '.[prepare]'` in a checkout, what builds libraries `'.[library]'`.

Made from the docstrings by `python -m tests.docs.api_page --write`.
"""

SECTIONS = {
    "Open a case": (
        "A case bundle: what it says of itself, its arrays, whether it is sound and approved.",
        "load_case Case ScanVolume open_bundle OpenBundle FileRole CaseManifest check_bundle approval_state "
        "approve_case Approval",
    ),
    "Simulate": (
        "A case in motion: grab, push, cut, join, feel the force, show the surface.",
        "Simulation Grab Forceps Retractor Scissors Probe Wrench State Snapshot Energy Watch DeformedSurface "
        "write_surface",
    ),
    "Operate and record": (
        "A simulation with a history: commands in, frames out, recorded and repeated (`docs/operating.md`).",
        "OperatingSession Frame InstrumentFrame TopologyChange Refusal Recorder open_recording Recording "
        "check_recording load_session Deviation StitchState PatchState FlatSheet write_template",
    ),
    "Commands of a session": (
        "What is asked of an operating session: plain data that JSON holds. Made of values that do not fit, each "
        "raises a `RecordingError` with all that is wrong, as `parse_command` does.",
        "CloseGrab LeadGrab OpenGrab BringProbe MoveProbe WithdrawProbe AddSprings RemoveSprings Cut Mark Halt Advance "
        "Undo Redo Rewind GoTo Entry parse_command CloseForceps SqueezeForceps CloseRetractor BringScissors "
        "PlaceScissors Snip WithdrawScissors PlaceStitch PlaceRow DrawStitch TieStitch TakeOutStitch PlacePatch Excise "
        "TakeOutPatch",
    ),
    "Feel it": (
        "Force and torque on a hand at 1 kHz (`docs/haptics.md`).",
        "HapticServo DeviceSpec device_names DeviceReading ServoSettings TissueSide FeltInstrument LedGrab LedProbe "
        "ToolPose Channel Felt MouseFeed PointerPlane",
    ),
    "Lattices and surfaces of one's own": (
        "What a simulation is made of, for whoever does not take it from a case.",
        "make_model LatticeModel GridUnits ForceLaw cell_nodes default_step step_limit make_surface SurfaceModel "
        "make_picking PickingModel",
    ),
    "Scripted sessions": (
        "What `heartcase simulate` runs; every setting is in `docs/schemas/simulation-script-reference.md`.",
        "load_script default_script with_positions run_script SimulationScript SessionSummary",
    ),
    "Scans and labels": (
        "Images in and out, and what their values stand for.",
        "read_scan Scan list_series SeriesInfo filter_scan FilterSettings write_scan read_labels LabelVolume "
        "Segmentation write_segmentation Markers Geometry Label LabelTable Role default_label_table Landmark",
    ),
    "Build a case": (
        "From a recipe to a case; every setting is in `docs/schemas/recipe-reference.md`.",
        "load_recipe parse_recipe Recipe ensure_scan check_inputs InputFindings build_case BuildResult BuildListener "
        "lock_recipe recipe_text",
    ),
    "Paint markers": (
        "Live segmentation for a viewer (`docs/segmentation.md`).",
        "open_session RecipeSession SegmentationSession SegmentSettings Stroke StrokePlaces StrokePlace",
    ),
    "Libraries of cases": (
        "Many cases at once (`docs/library.md`).",
        "plan_library LibraryCase stale_cases default_workers Workers connected build_cases CaseRecord "
        "check_case CaseCheck diff_libraries Tolerances CaseChange write_catalogue CatalogueResult",
    ),
    "Errors": (
        "All are a `HeartcaseError`.",
        "HeartcaseError Problem UsageError ScanError MarkerError RecipeError StageError BundleError ScriptError "
        "RecordingError SimulationError MissingExtraError UnsupportedVersionError",
    ),
}
"""Title of a part of the page -> what it is for, and its names in the order in which they are shown."""

_LINE = 96
_HEADED = re.compile(r"^(\w+)\n-{3,}\n", re.M)


def api_page() -> str:
    """The page: Markdown, the same text for the same sources."""
    parts = [_INTRO]
    for title, (purpose, names) in SECTIONS.items():
        parts.append(f"## {title}\n\n{purpose}\n")
        parts += [_entry(name) for name in names.split()]
    return "\n".join(parts)


def documented_calls() -> dict[str, tuple[tuple[str, ...], str]]:
    """Every public function, class that is called, and method: the names of its parameters, and its docstring."""
    found: dict[str, tuple[tuple[str, ...], str]] = {}
    for name in (name for _, names in SECTIONS.values() for name in names.split()):
        node = _source(heartcase._MODULE_OF[name]).defined[name]
        if isinstance(node, ast.FunctionDef):
            found[name] = (_parameters(node), ast.get_docstring(node) or "")
            continue
        for method in node.body:
            if isinstance(method, ast.FunctionDef) and not _is_private(method):
                found[f"{name}.{method.name}"] = (_parameters(method), ast.get_docstring(method) or "")
            elif isinstance(method, ast.FunctionDef) and method.name == "__init__":
                found[name] = (_parameters(method), ast.get_docstring(node) or "")
    return found


def _parameters(node: ast.FunctionDef) -> tuple[str, ...]:
    names = [argument.arg for argument in (*node.args.args, *node.args.kwonlyargs)]
    return tuple(name for name in names if name not in ("self", "cls"))


@dataclass(frozen=True)
class _Source:
    """A module's top level."""

    defined: dict[str, ast.ClassDef | ast.FunctionDef]
    aliases: dict[str, ast.expr]
    """What stands for a type: its name -> the type."""
    constants: dict[str, ast.expr]
    """Name -> the number, text or tuple that it stands for."""
    imported: dict[str, str]
    """Name -> the module of heartcase that it comes from."""

    def constant(self, name: str) -> ast.expr | None:
        """The value of a constant of this module, or of one that it imports."""
        if name in self.constants or name not in self.imported:
            return self.constants.get(name)
        return _source(self.imported[name]).constant(name)


@cache
def _source(module: str) -> _Source:
    file = ROOT.joinpath(*module.split(".")).with_suffix(".py")
    found = _Source({}, {}, {}, {})
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        nested = node.body if isinstance(node, ast.If) else [node]
        for inner in nested:
            if isinstance(inner, ast.ClassDef | ast.FunctionDef):
                found.defined[inner.name] = inner
            elif isinstance(inner, ast.Assign) and isinstance(inner.value, ast.Subscript):
                found.aliases.update({one.id: inner.value for one in inner.targets if isinstance(one, ast.Name)})
            elif isinstance(inner, ast.Assign | ast.AnnAssign) and isinstance(inner.value, ast.Constant | ast.Tuple):
                targets = inner.targets if isinstance(inner, ast.Assign) else [inner.target]
                found.constants.update({one.id: inner.value for one in targets if isinstance(one, ast.Name)})
            elif isinstance(inner, ast.ImportFrom) and (inner.module or "").startswith("heartcase."):
                found.imported.update({alias.name: inner.module or "" for alias in inner.names})
    return found


class _Plain(ast.NodeTransformer):
    """Writes an annotation out: aliases of types as what they stand for, constraints of settings left out."""

    def __init__(self, module: str) -> None:
        self.module = module

    def visit_Name(self, node: ast.Name) -> ast.AST:
        module = self.module
        while node.id not in _source(module).aliases and node.id in _source(module).imported:
            module = _source(module).imported[node.id]
        alias = _source(module).aliases.get(node.id)
        return node if alias is None else _Plain(module).visit(_copy(alias))

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        if isinstance(node.value, ast.Name) and node.value.id in ("np", "npt"):
            return ast.Name(node.attr)
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        if isinstance(node.value, ast.Name) and node.value.id == "Annotated" and isinstance(node.slice, ast.Tuple):
            return self.visit(node.slice.elts[0])
        return self.generic_visit(node)


def _copy(node: ast.expr) -> ast.expr:
    return ast.parse(ast.unparse(node), mode="eval").body


def _type(annotation: ast.expr | None, module: str) -> str:
    return "" if annotation is None else ast.unparse(_Plain(module).visit(_copy(annotation)))


def _entry(name: str) -> str:
    module = heartcase._MODULE_OF[name]
    node = _source(module).defined[name]
    heading = f"### `{name}`\n"
    if isinstance(node, ast.FunctionDef):
        return "\n".join([heading, _fenced(_signature(name, node, module)), _prose(ast.get_docstring(node))])
    return "\n".join([heading, *_class(name, node, module)])


def _class(name: str, node: ast.ClassDef, module: str) -> Iterator[str]:
    text = ast.get_docstring(node) or ""
    methods = [inner for inner in node.body if isinstance(inner, ast.FunctionDef) and not _is_private(inner)]
    start = next(
        (inner for inner in node.body if isinstance(inner, ast.FunctionDef) and inner.name == "__init__"), None
    )
    if start is not None:
        yield _fenced(_signature(name, start, module).removesuffix(" -> None"))
    yield _prose(text)
    facts = [] if "Attributes\n---" in text else list(_fields(node, module))
    facts += [
        f"- `{method.name}: {_type(method.returns, module)}`, read-only: {_flat(ast.get_docstring(method))}"
        for method in methods
        if _is_property(method)
    ]
    if facts:
        yield ("**Attributes**\n\n" if _HEADED.search(text) else "") + "\n".join(facts) + "\n"
    for method in methods:
        if not _is_property(method):
            yield f"#### `{name}.{method.name}`\n"
            yield _fenced(_signature(method.name, method, module))
            yield _prose(ast.get_docstring(method))


def _fields(node: ast.ClassDef, module: str) -> Iterator[str]:
    """What a class holds, each with the docstring below it."""
    for inner, after in zip(node.body, [*node.body[1:], None], strict=True):
        text = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else ""
        meaning = f": {_flat(text)}" if text else ""
        if isinstance(inner, ast.AnnAssign) and isinstance(inner.target, ast.Name) and inner.target.id[0] != "_":
            default = "" if inner.value is None else f" = {_default(inner.value, module)}"
            yield f"- `{inner.target.id}: {_type(inner.annotation, module)}{default}`{meaning}"
        elif isinstance(inner, ast.Assign) and isinstance(inner.targets[0], ast.Name) and inner.targets[0].id.isupper():
            yield f"- `{inner.targets[0].id} = {ast.unparse(inner.value)}`{meaning}"


def _default(value: ast.expr, module: str) -> str:
    """A default as a caller would write it: constants as their values; ``...`` where it is worked out."""
    if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id in ("field", "Field"):
        plain = [word.value for word in value.keywords if word.arg == "default"]
        made = {word.arg: ast.unparse(word.value) for word in value.keywords}.get("default_factory", "")
        return _default(plain[0], module) if plain else f"{made}()" if made.isidentifier() else "..."
    stands_for = _source(module).constant(value.id) if isinstance(value, ast.Name) else None
    return ast.unparse(stands_for or value)


def _signature(name: str, node: ast.FunctionDef, module: str) -> str:
    """A call with its annotations, on one line or with a parameter on each."""
    taken = node.args
    first = 1 if taken.args and taken.args[0].arg in ("self", "cls") else 0
    shown = []
    defaults: list[ast.expr | None] = [None] * (len(taken.args) - len(taken.defaults)) + list(taken.defaults)
    for argument, default in list(zip(taken.args, defaults, strict=True))[first:]:
        shown.append(_argument(argument, default, module))
    if taken.kwonlyargs:
        shown.append("*")
    for argument, default in zip(taken.kwonlyargs, taken.kw_defaults, strict=True):
        shown.append(_argument(argument, default, module))
    returned = f" -> {_type(node.returns, module)}" if node.returns is not None else ""
    line = f"{name}({', '.join(shown)}){returned}"
    if len(line) <= _LINE:
        return line
    return f"{name}(\n" + "".join(f"    {one},\n" for one in shown) + f"){returned}"


def _argument(argument: ast.arg, default: ast.expr | None, module: str) -> str:
    kind = _type(argument.annotation, module)
    end = "" if default is None else f" = {_default(default, module)}"
    return f"{argument.arg}: {kind}{end}"


def _is_private(method: ast.FunctionDef) -> bool:
    return method.name.startswith("_")


def _is_property(method: ast.FunctionDef) -> bool:
    return any(ast.unparse(decorator) in ("property", "cached_property") for decorator in method.decorator_list)


def _fenced(signature: str) -> str:
    return f"```py\n{signature}\n```\n"


def _prose(docstring: str | None) -> str:
    """A docstring of the numpy convention as Markdown: text as it is, sections as lists."""
    pieces = _HEADED.split(docstring or "")
    shown = [_marked(pieces[0].strip())]
    for title, body in zip(pieces[1::2], pieces[2::2], strict=True):
        shown.append(f"**{title}**\n\n" + "\n".join(_items(body)))
    return "\n\n".join(shown) + "\n"


def _items(body: str) -> Iterator[str]:
    """The entries of a section: names at the margin, their texts set in below."""
    for entry in re.split(r"\n(?=\S)", body.strip("\n")):
        name, _, text = entry.partition("\n")
        code = ", ".join(f"`{part.strip()}`" for part in name.split(","))
        meaning = _flat(textwrap.dedent(text))
        yield f"- {code}: {meaning}" if meaning else f"- {code}"


def _flat(text: str | None) -> str:
    return re.sub(r"\s+", " ", _marked((text or "").strip()))


def _marked(text: str) -> str:
    """Roles and literals of reStructuredText as Markdown's code."""
    text = re.sub(r":(\w+):`~?([^`]+)`", _role, text)
    return text.replace("``", "`")


def _role(match: re.Match[str]) -> str:
    kind, target = match.groups()
    name = target if kind == "mod" else target.rpartition(".")[2]
    return f"[`{name}`](#{name.lower()})" if name in heartcase.__all__ else f"`{name}`"


if __name__ == "__main__":
    if "--write" in sys.argv[1:]:
        PAGE.write_text(api_page(), encoding="utf-8")
    else:
        print(api_page(), end="")
