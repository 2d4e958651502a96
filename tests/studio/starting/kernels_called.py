"""Which kernels painting and operating in the studio call: run as a module, with FOLDER and OUTPUT as arguments.

A process of its own paints on a small scan and operates on a block, as pages would, and writes what Python called.
"""

from __future__ import annotations

import sys
from pathlib import Path
from unittest.mock import patch

from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.simulator.haptics.loop import LoopNumbers
from tests.pipeline.building.kernels_called import CalledKernels
from tests.simulator.live.scenes import write_case
from tests.studio.operating.performing import operator, theatre
from tests.studio.talking import page, studio, write_recipe

TOP = (22.0, -14.0, 40.5)
LIP = (22.3, -12.0, 40.5)


def paint(folder: Path) -> None:
    """On a scan with and without a noise floor: with one, most strokes lie in a flat minimum that others mark."""
    for name, settings in (
        ("plain", "\n[segment]\nnoise_floor = 0.0\n"),
        ("flat", "\n[segment]\nnoise_floor = 20.0\n"),
    ):
        (folder / name).mkdir()
        path, middle = write_recipe(folder / name)
        path.write_text(path.read_text() + settings)
        _paint(path, middle)


def _paint(path: Path, middle: list[float]) -> None:
    corner = load_recipe(path).strokes[0].points_mm[0]
    with studio(path) as browser, page(browser) as talker:
        # beside the background that is marked there: the second of the strokes finds a flat that two labels share
        for share in (0.2, 0.4):
            way = [(1.0 - share) * a + share * b for a, b in zip(corner, middle, strict=True)]
            talker.ask(do="paint", label="aorta", radius_mm=0.0, points_mm=[way])
            talker.ask(do="end")
        for label, way in (("aorta", 2.0), ("left ventricle", -2.0), ("background", 4.0)):
            talker.ask(do="paint", label=label, radius_mm=1.0, points_mm=[middle])
            talker.ask(do="extend", points_mm=[[middle[0] + way, *middle[1:]]])
            talker.ask(do="end")
        talker.ask(do="undo")
        talker.ask(do="redo")
        talker.ask(do="lock", label="aorta", locked=True)
        talker.ask(do="paint", label="left ventricle", radius_mm=2.0, points_mm=[middle])
        talker.ask(do="end")
        talker.ask(do="lock", label="aorta", locked=False)
        talker.ask(do="suggest")
        talker.ask(do="planes")
        talker.ask(do="picture", position_mm=middle)
        talker.ask(do="propose", about="vessel", position_mm=middle)
        talker.ask(do="propose", about="septum", position_mm=middle)
        talker.ask(do="preview")
        # of larger scans not all voxels are taken
        with patch("heartcase.pipeline.building.quick_surface.VOXELS", 50):
            talker.ask(do="preview")


def operate(folder: Path) -> None:
    with theatre(write_case(folder), folder) as (browser, opened), operator(browser, opened) as talker:
        talker.until(lambda frame: frame["step"] > 0)
        talker.done("strain", shown=True)

        def use(tool: str, *places: tuple[float, float, float]) -> None:
            talker.done("take", tool=tool)
            talker.at("press", places[0])
            for place in places[1:]:
                talker.at("drag", place)
            talker.at("release", places[-1])
            now = talker.frames[-1]["step"]
            talker.until(lambda frame: frame["step"] > now + 20)

        use("g", TOP, (26.0, -14.0, 40.5))
        use("p", TOP, (26.0, -14.0, 40.5))
        count = talker.topology_count
        use("c", *((22.3, y, 40.5) for y in (-17.0, -14.0, -11.0, -9.0)))
        talker.until(lambda frame: talker.topology_count > count)
        use("f", (19.0, -14.0, 40.5))
        use("r", (26.0, -16.0, 40.5), (26.0, -11.0, 40.5))
        talker.done("let_go", pointer=None)
        for place in ((20.0, -13.0, 40.5), (25.0, -13.0, 40.5)):
            use("s", place)
        talker.done("tie")
        talker.done("back")
        talker.done("undo")
    LoopNumbers.prepare()  # as a haptic device does


def main(folder: Path, output: Path) -> None:
    called = CalledKernels()
    for name, does in (("paint", paint), ("operate", operate)):
        (folder / name).mkdir()
        does(folder / name)
        called.note(name)
    called.write(output)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
