"""The readers in C++ and JavaScript: they find what the golden case must give, and refuse what heartcase refuses."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors.numpy import load_file, save_file

from heartcase.pipeline.bundle.write_bundle import write_bundle
from heartcase.schemas.bundle.check import check_bundle
from heartcase.schemas.bundle.reader import open_bundle
from heartcase.schemas.geometry import Geometry
from heartcase.simulator.dynamics.integrate import Verlet, verlet_step
from heartcase.simulator.load import load_case
from tests.factories import block_case
from tests.readers.damage import DAMAGES, CaseCopy, Damage

ROOT = Path(__file__).parents[2]
READERS = ROOT / "readers"
GOLDEN = ROOT / "tests" / "golden"
CASE = GOLDEN / "lopsided.case"
EXPECTED = GOLDEN / "expected.json"
LANGUAGES = ("cpp", "javascript")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")


Result = tuple[int, str, str]
"""Exit code, output, error."""

_MANY = f"""
import {{ createInterface }} from "node:readline";
import {{ main }} from {json.dumps((READERS / "javascript" / "golden.mjs").as_uri())};
for await (const line of createInterface({{ input: process.stdin }})) {{
  const [said, complained] = [[], []];
  const keep = (lines) => (text) => lines.push(text + String.fromCharCode(10));
  const code = await main(JSON.parse(line), keep(said), keep(complained));
  console.log(JSON.stringify([code, said.join(""), complained.join("")]));
}}
"""


def _program(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        reason = f"{name} is not installed, and the readers were not tried"
        if os.environ.get("HEARTCASE_REQUIRE_READERS") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return found


def _compile(source: Path, program: Path) -> None:
    """With the sanitizers where the compiler has them: what is undefined ends the program with a message."""
    compiler = _program("g++")
    command = [
        compiler,
        "-std=c++17",
        "-O0",
        "-Wall",
        "-Wextra",
        "-Wshadow",
        "-pedantic",
        "-Werror",
        f"-I{READERS / 'cpp'}",
    ]
    probe = program.with_suffix(".probe")
    probed = subprocess.run(
        [compiler, *SANITIZERS, "-xc++", "-", "-o", probe], check=False, input=b"int main() {}", capture_output=True
    )
    flags = SANITIZERS if probed.returncode == 0 else ()
    built = subprocess.run([*command, *flags, source, "-o", program], check=False, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr


@dataclass(frozen=True)
class Steppers:
    """The step program of each language, and one JavaScript program that runs many commands one after the other."""

    commands: dict[str, list[str]]
    many: subprocess.Popen[str]

    def run_apart(self, *arguments: object) -> dict[str, Result]:
        """Exit code, output and error of a process of each language."""
        return {language: _run(command, *arguments) for language, command in self.commands.items()}

    def run(self, *arguments: object) -> dict[str, Result]:
        """The same, JavaScript without starting it anew."""
        assert self.many.stdin is not None
        assert self.many.stdout is not None
        print(json.dumps([str(one) for one in arguments]), file=self.many.stdin, flush=True)
        compiled = _run(self.commands["cpp"], *arguments)
        return {"cpp": compiled, "javascript": tuple(json.loads(self.many.stdout.readline()))}


def _run(command: Sequence[str], *arguments: object) -> Result:
    done = subprocess.run([*command, *map(str, arguments)], check=False, capture_output=True, text=True, timeout=60)
    return done.returncode, done.stdout, done.stderr


@pytest.fixture(scope="session")
def steppers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Steppers]:
    """Compiled and started once."""
    node = _program("node")
    program = tmp_path_factory.mktemp("readers") / "step"
    _compile(READERS / "cpp" / "step.cpp", program)
    script = READERS / "javascript" / "step.mjs"
    command = [node, "--input-type=module", "--eval", _MANY]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as many:
        yield Steppers({"cpp": [str(program)], "javascript": [node, str(script)]}, many)


def _assert_refused(results: dict[str, Result], says: str, secrets: Sequence[object]) -> None:
    for language, (code, _, error) in results.items():
        assert code == 1, f"{language}: {error}"
        assert error.count("\n") == 1, f"{language}: {error}"
        assert says in error, f"{language}: {error}"
        assert "memory" not in error, language
        for secret in secrets:
            assert str(secret) not in error, f"{language} tells {secret}"


def _copy(folder: Path) -> Path:
    shutil.copytree(CASE, folder / CASE.name)
    return folder / CASE.name


# ------------------------------------------------------------------------------------------------------------- truth


@pytest.mark.parametrize("language", LANGUAGES)
def test_golden_case(steppers, language):
    code, output, error = steppers.run_apart(CASE, EXPECTED)[language]
    assert code == 0, error
    golden = json.loads(EXPECTED.read_text())
    lines = [line for line in output.splitlines() if "from the golden file" in line]
    kinds = [f"nodes after {n} steps" for n in golden["steps"]]
    kinds += [f"{kind} after {n} steps" for n in golden["surface"] for kind in ("vertices", "normals")]
    assert sorted(line.split(":")[0] for line in lines) == sorted(kinds)
    worst = [float(line.split("at most ")[1].split(" ")[0]) for line in lines]
    assert max(worst) <= golden["tolerance_mm"]["float64"]


def _move_node(golden):
    golden["steps"]["100"]["nodes_mm"][40][2] += 1e-5


def _move_vertex(golden):
    golden["surface"]["100"]["vertices_mm"][7][0] -= 1e-5


def _mirror_expectation(golden):
    golden["checks"]["chirality_lps_mm3"] *= -1


def _leave_out_damping(golden):
    golden["damping_per_s"] = 0.0


def _scale_volume(golden):
    golden["checks"]["chirality_lps_mm3"] *= 1.01


def _lose_a_node(golden):
    golden["checks"]["counts"]["node_count"] -= 1


def _lose_mass(golden):
    golden["checks"]["mass_g"] *= 0.99999


def _turn_triangles(golden):
    golden["checks"]["enclosed_mm3"] *= -1


def _darken_voxel(golden):
    golden["checks"]["scan"][2]["intensity"] -= 1


def _move_voxel(golden):
    golden["checks"]["scan"][1]["lps_mm"][1] += 0.01


def _mirror_unity(golden):
    golden["checks"]["chirality_frames"]["unity"] *= -1


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (_lose_a_node, "counts"),
        (_lose_mass, "mass"),
        (_turn_triangles, "volume inside"),
        (_darken_voxel, "another intensity"),
        (_move_voxel, "elsewhere"),
        (_mirror_unity, "volume of the landmarks"),
        (_move_node, "nodes after 100 steps: further"),
        (_move_vertex, "vertices after 100 steps: further"),
        (_leave_out_damping, "further"),
        (_mirror_expectation, "mirrored"),
        (_scale_volume, "wrong volume"),
    ],
)
def test_a_wrong_golden_file_is_told(steppers, tmp_path, change, says):
    golden = json.loads(EXPECTED.read_text())
    change(golden)
    (tmp_path / "expected.json").write_text(json.dumps(golden))
    _assert_refused(steppers.run(CASE, tmp_path / "expected.json"), says, [tmp_path])


@given(
    seed=st.integers(0, 2**16),
    axis=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 0.1),
    count=st.integers(1, 30),
)
@settings(max_examples=5, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_steps_are_those_of_the_reference(steppers, tmp_path_factory, seed, axis, count):
    """An oblique block of uneven cells: the simulator's NumPy reference adds springs up in float32."""
    folder = tmp_path_factory.mktemp("block") / "block.case"
    x, y, z = np.array(axis) / np.linalg.norm(axis) * np.sin(0.4)
    w = np.cos(0.4)
    direction = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    geometry = Geometry.of(shape=(2, 3, 4), spacing_mm=(2.5,) * 3, origin_mm=(-80, 40, 900), direction=direction)
    write_bundle(folder, block_case(size=(4, 3, 2), geometry=geometry, cell_mm=2.5))
    case = CaseCopy(folder)
    random = np.random.default_rng(seed)
    for name, low, high in (("coverage", 0.02, 1.0), ("stiffness", 10.0, 60.0), ("density", 900.0, 1200.0)):
        case.set_values("grid", f"cell_{name}", random.uniform(low, high, 24).tolist())

    model = load_case(folder, needs=("grid",)).model
    step_s = case.manifest["simulation"]["step_default_s"]
    verlet = Verlet(
        step=step_s / model.units.time_s,
        damping=10.0 * model.units.time_s,
        gravity=tuple(np.array([0, 0, -9.81]) @ model.geometry.direction_matrix / model.units.acceleration_m_s2),
    )
    displacement = np.zeros((model.node_count, 3))
    velocity = np.zeros_like(displacement)
    inverse_mass = np.where(model.node_is_fixed, 0.0, 1.0 / model.node_mass)
    for _ in range(count):
        displacement, velocity = verlet_step(model, verlet, displacement, velocity, inverse_mass)
    expected = model.rest_positions_mm() + model.to_mm(displacement)
    moved = np.abs(model.to_mm(displacement)).max()

    for language, (code, output, error) in steppers.run(folder, count, "--nodes").items():
        assert code == 0, f"{language}: {error}"
        nodes = np.array([line.split() for line in output.splitlines()[2:]], float)
        np.testing.assert_allclose(nodes, expected, atol=1e-5 * moved + 1e-9, rtol=0, err_msg=language)


# ---------------------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.name)
def test_damaged_cases_are_refused(steppers, tmp_path, damage: Damage):
    folder = _copy(tmp_path)
    damage.apply(CaseCopy(folder))
    results = steppers.run(folder, EXPECTED)
    _assert_refused(results, damage.says, [tmp_path, "lopsided", "left tip", "outside.safetensors", "passwd"])
    assert bool(check_bundle(folder)) == damage.is_seen_by_heartcase


@pytest.mark.parametrize("arguments", [(), ("only-one",), ("no-such-folder", 1), (CASE, "no-such-file.json")])
def test_wrong_arguments(steppers, arguments):
    _assert_refused(steppers.run_apart(*arguments), "", ["no-such", "only-one"])


_STRANGE = (
    b"-1",
    b"0",
    b"0.5",
    b"1e999",
    b"4294967296",
    b"18446744073709551615",
    b"null",
    b'"x"',
    b"[]",
    b"{}",
    b"true",
)


@given(
    role=st.sampled_from(["grid", "surface", "mapping", "picking", "scan", "manifest"]),
    place=st.floats(0, 1, exclude_max=True),
    change=st.sampled_from(["byte", "cut", "value", "value"]),
    byte=st.integers(0, 255),
    strange=st.sampled_from(_STRANGE),
)
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_anything_may_be_wrong(steppers, tmp_path_factory, role, place, change, byte, strange):
    """Without hashes both readers say the same, in one line, and take no array that heartcase refuses to open."""
    folder = _copy(tmp_path_factory.mktemp("wrong"))
    case = CaseCopy(folder)
    file = folder / "case.json" if role == "manifest" else case.path(role)
    content = bytearray(file.read_bytes())
    header_size = 0 if role == "manifest" else int.from_bytes(content[:8], "little")
    at = int(place * len(content))
    if change == "byte":
        content[at] = byte
    elif change == "cut":
        del content[at]
    else:
        first, last = (0, len(content)) if role == "manifest" else (8, 8 + header_size)
        values = list(re.finditer(rb'-?[0-9][0-9.e-]*|"\w*"|\[[^\[\]]*\]', bytes(content[first:last])))
        start, end = values[int(place * len(values))].span()
        content[first + start : first + end] = strange
        if role != "manifest":
            content[:8] = (header_size + len(strange) - (end - start)).to_bytes(8, "little")
    if role == "manifest":
        file.write_bytes(content)
    else:
        case.write(role, bytes(content))
    results = steppers.run(folder, 1, "--no-hashes")
    codes = {code for code, _, _ in results.values()}
    assert codes in ({0}, {1}), results
    if codes == {1}:
        _assert_refused(results, "", [folder])
    elif role != "manifest":  # of the manifest the readers judge only what they use
        bundle = open_bundle(folder)
        for each in bundle.headers:
            bundle.arrays(each)


# ---------------------------------------------------------------------------------------------------- older and newer


@pytest.mark.parametrize("is_aligned", [True, False])
def test_version_1_0(steppers, tmp_path, is_aligned):
    """No tables of arrays, no coordinates, no scan; arrays need not be aligned."""
    folder = _copy(tmp_path)
    case = CaseCopy(folder)
    case.manifest.update(format_version="1.0")
    for key in ("coordinates", "scan_values"):
        case.manifest.pop(key)
    case.manifest["files"] = [entry for entry in case.manifest["files"] if entry["role"] not in ("scan", "render")]
    for entry in case.manifest["files"]:
        entry.pop("arrays")
    for role in ("grid", "surface", "mapping", "picking"):
        if not is_aligned:
            arrays = {name: a for name, a in load_file(case.path(role)).items() if not name.startswith("_")}
            save_file(arrays, case.path(role), metadata={"made": "by another writer"})
        case.write(role, case.path(role).read_bytes())
    golden = json.loads(EXPECTED.read_text())
    golden["checks"]["counts"] = {name: n for name, n in golden["checks"]["counts"].items() if "scan" not in name}
    (tmp_path / "expected.json").write_text(json.dumps(golden))
    results = steppers.run(folder, tmp_path / "expected.json")
    assert {code for code, _, _ in results.values()} == {0}, results


def test_newer_minor_version(steppers, tmp_path):
    """Unknown keys, an unknown role and an unknown array of a later 1.x are passed over."""
    folder = _copy(tmp_path)
    case = CaseCopy(folder)
    case.manifest.update(format_version="1.37", fibres={"of": [1, None, "\\u00e9\\ud83d\\ude00"]})
    (folder / "fibres.bin").write_bytes(b"fibres")
    case.manifest["files"].append(
        {"role": "fibres", "name": "fibres.bin", "size": 6, "sha256": hashlib.sha256(b"fibres").hexdigest()}
    )
    case.save()
    results = steppers.run(folder, EXPECTED)
    assert {code for code, _, _ in results.values()} == {0}, results


@pytest.mark.slow
def test_a_case_of_30_000_nodes(tmp_path):
    """Run with -s to see how long opening, building and 100 steps take."""
    write_bundle(tmp_path / "block.case", block_case(size=(30, 30, 30)))
    program = tmp_path / "step"
    source = READERS / "cpp" / "step.cpp"
    subprocess.run([_program("g++"), "-std=c++17", "-O2", source, "-o", program], check=True)
    commands = {"cpp": [str(program)], "javascript": [_program("node"), str(READERS / "javascript" / "step.mjs")]}
    for language, command in commands.items():
        code, output, error = _run(command, tmp_path / "block.case", 100)
        assert code == 0, error
        assert "nodes 29791" in output
        print(f"{language}: {output.replace(chr(10), '; ')}")
