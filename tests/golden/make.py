"""Make the golden case: ``python -m tests.golden.make`` compares it with what is committed; ``--write`` writes it."""

from __future__ import annotations

import json
import re
import sys
import tempfile
from pathlib import Path

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.files import atomic_write
from tests.golden.motion import expected
from tests.golden.shape import CASE_NAME, golden_content

__all__ = ["CASE", "EXPECTED", "differences", "make"]

HERE = Path(__file__).parent
CASE = HERE / f"{CASE_NAME}.case"
EXPECTED = HERE / "expected.json"


def make(directory: Path) -> None:
    """Write the case and expected.json into a directory."""
    case = directory / CASE.name
    write_bundle(case, golden_content())
    atomic_write(directory / EXPECTED.name, _text(expected(case)).encode())


def _text(values: dict[str, object]) -> str:
    """JSON with one point to a line, so that a change can be read."""
    text = json.dumps(values, indent=1)
    innermost = re.compile(r"\[([^\[\]{}]*)\]")
    return innermost.sub(lambda found: "[" + " ".join(found[1].split()) + "]", text) + "\n"


def differences(made: Path) -> list[str]:
    """Files that are not byte for byte those that are committed."""
    names = {path.relative_to(made) for path in made.rglob("*") if path.is_file()}
    names |= {path.relative_to(HERE) for path in [EXPECTED, *CASE.iterdir()] if path.is_file()}
    return sorted(str(name) for name in names if _bytes(made / name) != _bytes(HERE / name))


def _bytes(path: Path) -> bytes | None:
    return path.read_bytes() if path.is_file() else None


def main() -> int:
    if sys.argv[1:] == ["--write"]:
        make(HERE)
        return 0
    with tempfile.TemporaryDirectory() as directory:
        make(Path(directory))
        changed = differences(Path(directory))
    print("\n".join(changed) or "the golden case is as it is committed")
    return bool(changed)


if __name__ == "__main__":
    sys.exit(main())
