"""The ``heartcase`` command: finds the subcommands, and turns errors into one clear line each."""

from __future__ import annotations

import atexit
import difflib
import gc
import importlib
import os
import re
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path

import click

from heartcase import __version__
from heartcase.cli.shared.clock import command_starts
from heartcase.schemas.errors import HeartcaseError, MissingExtraError

__all__ = ["COMMANDS", "cli", "main"]

COMMANDS: dict[str, str] = {
    "new": "Write a commented starter recipe for a scan.",
    "build": "Build a case from a recipe.",
    "library": "Build many cases from a folder of recipes.",
    "info": "Say what a scan, a recipe's scan, a case or a recording is.",
    "validate": "Check a case, a recipe, a script or a recording, and list every problem.",
    "studio": "Paint on a scan in the browser.",
    "paint": "Paint markers on a recipe's scan, for a viewer to drive.",
    "suggest": "Name the places where one more stroke is worth most.",
    "lock": "Write a recipe with every setting stated.",
    "upgrade": "Say what a newer heartcase would change in a file.",
    "approve": "Note that a case was reviewed and approved.",
    "preview": "Make a picture of a scan or a case.",
    "export": "Write a case's labels, models to print and meshes, or a recording in motion.",
    "simulate": "Run a scripted session on a case.",
    "view": "Operate on a case in a window, with the mouse.",
    "record": "Record a scripted session on a case.",
    "replay": "Repeat a recording, and go on from any moment of it.",
    "compare-incisions": "Run plans of incisions on cases, measure and rank them.",
    "bench": "Measure run time against error.",
    "phantom": "Make a synthetic scan of a heart, with its truth.",
    "filter": "Stage: smooth a scan, keeping edges.",
    "segment": "Stage: give each voxel a label.",
    "walls": "Stage: distance fields and grown walls.",
    "edit": "Stage: septal defects and sculpting.",
    "grid": "Stage: simulation cells.",
    "surface": "Stage: surface and normal map.",
    "map": "Stage: tie the surface to the grid.",
    "bundle": "Stage: write the case.",
    "schema": "Print or write the JSON Schemas.",
}
"""Name -> one-line help of each subcommand."""

_FOLDERS = (
    {"library": "library"}
    | dict.fromkeys(("simulate", "view", "record", "replay", "compare-incisions"), "sessions")
    | dict.fromkeys(("filter", "segment", "walls", "edit", "grid", "surface", "map", "bundle"), "stages")
)
"""Folder of the module of a command's name, where it is not ``commands``."""

_ANSWERING = {"studio", "paint"} | {name for name, folder in _FOLDERS.items() if folder == "sessions"}
"""Commands that move tissue or answer somebody while they run, where one long search for cycles would be noticed."""
_NEW_OBJECTS = 50_000
"""Objects after which the others look for cycles among the new ones. What imports and stages make stays: to
search it as often as Python does by itself is a thirtieth of a build."""
INTERNAL_ERROR = 70
"""Exit code of what should not happen (EX_SOFTWARE of sysexits)."""

_EXTRA_OF_MODULE = {
    "numba_cuda": "cuda",
    "dask": "library",
    "distributed": "library",
    "skimage": "bench",
} | dict.fromkeys(("starlette", "uvicorn", "websockets"), "studio")
_PREPARE_MODULES = [
    "SimpleITK",
    "cc3d",
    "edt",
    "jinja2",
    "matplotlib",
    "meshio",
    "PIL",
    "pydicom",
    "pyvista",
    "scipy",
    "vtk",
    "vtkmodules",
    "xatlas",
]


class _LazyGroup(click.Group):
    """Imports a subcommand only when it is used: ``heartcase simulate`` never loads the pipeline's libraries."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        folder, file = _FOLDERS.get(name, "commands"), name.replace("-", "_")
        module = importlib.import_module(f"heartcase.cli.{folder}.{file}")
        command: click.Command = module.command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            near = difflib.get_close_matches(args[0], COMMANDS, n=1)
            if near and near[0] not in error.message:
                error.message += f" Did you mean {near[0]!r}?"  # type: ignore[misc]
            raise

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=_LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="heartcase")
def cli() -> None:
    """From a cardiac MRI or CT to a case bundle and a simulation of it. Not a medical device."""


def main(arguments: Sequence[str] | None = None, *, command: click.Command = cli, name: str = "heartcase") -> int:
    """Run the command line; returns the exit code (0 well, 1 a problem, 2 wrong usage, 70 a bug, 130 interrupted).

    ``command`` is another command to run in the same way, and ``name`` what a user types for it.
    """
    command_starts()
    # What the process holds when it ends is not searched for cycles, which takes half a second after a build.
    atexit.register(gc.freeze)
    thresholds = gc.get_threshold()
    args = sys.argv[1:] if arguments is None else list(arguments)
    if args and args[0] in COMMANDS and args[0] not in _ANSWERING:
        gc.set_threshold(_NEW_OBJECTS, *thresholds[1:])
    try:
        code = command.main(args=args, prog_name=name, standalone_mode=False)
    except click.exceptions.Abort:
        click.echo("heartcase: interrupted; nothing half-written was left", err=True)
        return 130
    except click.ClickException as error:
        error.message = _without_arguments(error.message)  # type: ignore[misc]
        error.show()
        return error.exit_code
    except KeyboardInterrupt:
        click.echo("heartcase: interrupted; nothing half-written was left", err=True)
        return 130
    except ImportError as error:
        root = (error.name or "").partition(".")[0]
        extra = _EXTRA_OF_MODULE.get(root) or ("prepare" if root in _PREPARE_MODULES else None)
        if extra is None:
            raise
        return _show(MissingExtraError("This command", extra))
    except HeartcaseError as error:
        return _show(error)
    except OSError as error:
        # Its own text names the file, which may be named after a patient.
        reason = (error.strerror or "the system gives no reason").lower()
        return _show(HeartcaseError(f"a file or folder cannot be read or written: {reason}"))
    except Exception as error:
        if os.environ.get("HEARTCASE_DEBUG"):
            raise
        place = _place_of(error)
        message = f"something unforeseen happened ({type(error).__name__} in {place}): this is a fault of heartcase"
        _show(HeartcaseError(f"{message}; set HEARTCASE_DEBUG=1 to see where, and report it"))
        return INTERNAL_ERROR
    finally:
        gc.set_threshold(*thresholds)
    return code if isinstance(code, int) else 0


def _without_arguments(message: str) -> str:
    """A message of the command line without what the user typed: a path may be named after a patient."""
    if message.startswith("Got unexpected extra argument"):
        return (
            'there are more arguments than expected: see --help, and put a path that holds spaces in "quotation marks"'
        )
    return re.sub(r"(Path|File|Directory) '[^']*'", r"\1", message)


def _place_of(error: BaseException) -> str:
    """Module and line of heartcase's own code where an error came up."""
    place, package = "heartcase", Path(__file__).parents[1]
    for frame in traceback.extract_tb(error.__traceback__):
        # a checkout may be called like the package
        if Path(frame.filename).is_relative_to(package):
            place = f"{Path(frame.filename).relative_to(package).as_posix()}:{frame.lineno}"
    return place


def _show(error: HeartcaseError) -> int:
    for problem in error.problems:
        click.echo(f"heartcase: {problem}", err=True)
    return error.exit_code


if __name__ == "__main__":
    sys.exit(main())
