"""Every GLB passes the Khronos glTF validator: no error, warning, information or hint."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from heartcase.pipeline.building.run import build_case
from heartcase.pipeline.bundle.glb import glb_bytes
from heartcase.pipeline.exports.animation import MovingSurface, animation_glb_bytes
from heartcase.pipeline.mesh.build_surface import build_surface
from heartcase.schemas.recipe.recipe import load_recipe
from heartcase.schemas.recipe.settings import SurfaceSettings
from tests.ball import write_ball_recipe, write_ball_scan
from tests.pipeline.solids import lattice, tube, walled
from tests.readers.test_readers import ROOT, _program

pytestmark = pytest.mark.usefixtures("plain_reports")

HERE = Path(__file__).parent / "gltf_validator"
INSTALL = ("ci", "--ignore-scripts", "--no-audit", "--no-fund", "--prefer-offline", "--fetch-retries=1")

Judge = Callable[[Sequence[bytes]], list[dict[str, Any]]]


@pytest.fixture(scope="module")
def judge(tmp_path_factory: pytest.TempPathFactory) -> Judge:
    """The validator, installed by the lock file beside it: version and content are pinned."""
    node, npm = _program("node"), _program("npm")
    folder = tmp_path_factory.mktemp("validator")
    for name in ("package.json", "package-lock.json"):
        shutil.copy(HERE / name, folder)
    done = subprocess.run([npm, *INSTALL], cwd=folder, check=False, capture_output=True, text=True)
    if done.returncode != 0:
        code = [line for line in done.stderr.splitlines() if "error code" in line]
        pytest.skip(f"npm cannot install the glTF validator, and no GLB was tried: {' '.join(code)}")

    def judged(files: Sequence[bytes]) -> list[dict[str, Any]]:
        paths = []
        for number, content in enumerate(files):
            paths.append(folder / f"{number}.glb")
            paths[-1].write_bytes(content)
        command = [node, HERE / "judge.mjs", folder, *paths]
        said = subprocess.run(command, check=True, capture_output=True, text=True, timeout=60)
        return [json.loads(line) for line in said.stdout.splitlines()]

    return judged


@pytest.fixture(scope="module")
def surfaces():
    moved = walled(lambda p: tube(6.0)(p - [40.0, -90.0, 0.0]), 2.0, lattice(1.5, 11.0, centre=(40.0, -90.0, 7.0)))
    return {
        render: build_surface(moved, SurfaceSettings(triangle_count=2000, normal_map_size=128), render=render)
        for render in (True, False)
    }


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The GLB of a case that was built from a scan."""
    directory = tmp_path_factory.mktemp("ball")
    write_ball_scan(directory / "scan.nii.gz")
    recipe = write_ball_recipe(directory / "scan.nii.gz", directory / "ball.toml", cell_mm=5.0)
    result = build_case(load_recipe(recipe), directory=directory, out=directory / "out")
    (glb,) = result.case.glob("render-*.glb")
    return glb.read_bytes()


def test_with_and_without_a_map_and_of_cases(judge, surfaces, built):
    (golden,) = (ROOT / "tests" / "golden" / "lopsided.case").glob("render-*.glb")
    files = [glb_bytes(surfaces[True], case_id="HC-0001"), glb_bytes(surfaces[False]), golden.read_bytes(), built]
    reports = judge(files)
    for report, attributes, primitives in zip(reports, (4, 2, 2, 4), (3, 3, 4, 2), strict=True):
        assert report["issues"]["messages"] == []
        assert report["issues"]["numErrors"] == report["issues"]["numWarnings"] == 0
        assert report["mimeType"] == "model/gltf-binary"
        assert report["info"]["maxAttributes"] == attributes
        assert report["info"]["hasTextures"] == (attributes == 4)
        assert report["info"]["drawCallCount"] == primitives
    assert reports[0]["info"]["totalTriangleCount"] == len(surfaces[True].triangles)


def moving(frame_count=6, *, start_s=0.0, scale=2.0):
    """A tetrahedron that is stretched and turned."""
    rest = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]], np.float32)
    triangles = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32)
    rng = np.random.default_rng(1)
    vertices = np.stack(
        [rest + number * scale * rng.random((4, 3)).astype(np.float32) for number in range(frame_count)]
    )
    normals = vertices - vertices.mean(axis=1, keepdims=True)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    colours = np.array([[200, 10, 10], [200, 10, 10], [10, 10, 200], [10, 10, 200]], np.uint8)
    return MovingSurface(start_s + 0.1 * np.arange(frame_count), vertices, normals, triangles, colours)


def test_surfaces_in_motion(judge):
    """One that moves, one that rests, one of a single frame, and one that gives way to two others, as after cuts."""
    after_cuts = [replace(moving(3), until_s=0.3), replace(moving(4, start_s=0.3), until_s=0.7), moving(1, start_s=0.7)]
    files = [[moving()], [moving(scale=0.0)], [moving(1)], after_cuts]
    reports = judge([animation_glb_bytes(file, tolerance_mm=1e-3, case_id="HC-0001")[0] for file in files])
    for report, animations, calls in zip(reports, (1, 0, 0, 1), (2, 2, 2, 6), strict=True):
        assert report["issues"]["messages"] == []
        assert report["issues"]["numErrors"] == report["issues"]["numWarnings"] == 0
        assert report["info"]["animationCount"] == animations
        assert report["info"]["hasMorphTargets"] == (animations == 1)
        assert report["info"]["drawCallCount"] == calls


def test_the_validator_sees_what_is_wrong(judge, surfaces):
    """Otherwise silence would say nothing."""
    surface = surfaces[True]
    long = replace(surface, normals=(2.0 * surface.normals).astype(np.float32))
    flat = replace(surface, render_tangents=np.zeros_like(surface.render_tangents))
    content = glb_bytes(surface)
    cut = content[:8] + (len(content) - 4).to_bytes(4, "little") + content[12:-4]
    codes = [
        {message["code"] for message in report["issues"]["messages"]}
        for report in judge([glb_bytes(long), glb_bytes(flat), cut])
    ]
    assert "ACCESSOR_VECTOR3_NON_UNIT" in codes[0]
    assert "ACCESSOR_INVALID_SIGN" in codes[1]
    assert codes[2]
