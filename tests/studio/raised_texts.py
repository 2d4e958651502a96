"""What sources say and raise, as templates: what stands for a value is one mark."""

import ast
import re
from dataclasses import dataclass

from heartcase.schemas import errors

VALUE = "{}"
"""What stands for a value, or for several that follow each other."""
_ERRORS = {name for name in errors.__all__ if name.endswith("Error")}
_MESSAGE_OF = dict.fromkeys(_ERRORS, 0) | {"Problem": 1}
"""Who takes a message, and which of its arguments that is."""


@dataclass(frozen=True)
class Raised:
    """A text that is raised."""

    place: str
    """File and line."""
    text: str
    """With marks for values."""


def marked(template):
    """A text whose values, ``{name}``, are marks."""
    return re.sub(r"\{[^{}]*\}(?:\{[^{}]*\})*", VALUE, template)


def said(files):
    """Every text of some sources but their docstrings."""
    found = set()
    for _, tree, known in _read(files):
        docs = {
            id(one.body[0].value)
            for one in ast.walk(tree)
            if isinstance(one, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            and isinstance(one.body[0], ast.Expr)
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant | ast.JoinedStr | ast.BinOp) and id(node) not in docs:
                found.add(marked(_text(node, known)))
    return found


def raised(files):
    """Every text that is given to an error or a problem, also by a name that it was given in the same function."""
    found = []
    for file, tree, known in _read(files):
        for scope in (one for one in ast.walk(tree) if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef)):
            own = {}
            for node in ast.walk(scope):
                if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
                    own.setdefault(node.targets[0].id, []).extend(_choices(node.value))
            for node in ast.walk(scope):
                name = getattr(node.func, "id", "") if isinstance(node, ast.Call) else ""
                if name in _MESSAGE_OF and len(node.args) > _MESSAGE_OF[name]:
                    given = node.args[_MESSAGE_OF[name]]
                    meant = own.get(given.id, [given]) if isinstance(given, ast.Name) else _choices(given)
                    texts = {marked(_text(one, known)) for one in meant} - {VALUE}
                    found += [Raised(f"{file.name}:{node.lineno}", text) for text in texts]
    return found


def _read(files):
    for file in files:
        tree = ast.parse(file.read_text(encoding="utf-8"))
        known = {}
        for node in tree.body:
            match node:
                case (
                    ast.Assign(targets=[ast.Name(id=name)], value=value)
                    | ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value)
                ):
                    if (text := _text(value, known)) != VALUE:
                        known[name] = text
        yield file, tree, known


def _choices(node):
    """What an expression may be: either of two where it says so."""
    return [*_choices(node.body), *_choices(node.orelse)] if isinstance(node, ast.IfExp) else [node]


def _text(node, known):
    """The text of an expression; a value where it is none, or is not known before the program runs."""
    match node:
        case ast.Constant(value=str() as text):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(_text(part, known) for part in parts)
        case ast.FormattedValue(value=ast.Name(id=name)) | ast.Name(id=name) if name in known:
            return known[name]
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _text(left, known) + _text(right, known)
    return VALUE
