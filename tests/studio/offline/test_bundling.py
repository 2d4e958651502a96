"""Modules as one script: in order, each once, and run by node as the modules themselves are."""

import shutil
import subprocess

import pytest

from heartcase.schemas.errors import UsageError
from heartcase.studio.offline.bundling import bundled_script, for_script_element, modules_from
from heartcase.studio.serving.app import PAGE


def write(folder, **files):
    for name, text in files.items():
        path = folder / (name.replace("__", "/") + ".js")
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text(text)


def test_each_comes_after_what_it_imports(tmp_path):
    write(
        tmp_path,
        main='import { a } from "./part/a.js";\nimport "./b.js";\nimport * as c from \'./c.js\';\nlog(a);',
        part__a='export { b as a } from "../b.js";\n/** @typedef {import("../main.js").Main} Main */',
        b='export const b = "from \\"./c.js\\"";',
        c="export const c = 1; // ␛",
    )
    found = modules_from(tmp_path, "main.js")
    assert list(found) == ["b.js", "part/a.js", "c.js", "main.js"]
    assert found["main.js"].splitlines()[:3] == [
        'import { a } from "␛1␛";',
        'import "␛0␛";',
        "import * as c from '␛2␛';",
    ]
    assert found["part/a.js"].startswith('export { b as a } from "␛0␛";')
    assert "main.js" in found["part/a.js"]
    assert found["b.js"] == 'export const b = "from \\"./c.js\\"";'


def test_what_is_not_there_or_goes_round(tmp_path):
    write(
        tmp_path,
        a='import "./b.js";',
        b='import "./gone.js";',
        round='import "./back.js";',
        back='import "./round.js";',
    )
    with pytest.raises(UsageError, match=r"b\.js imports gone\.js, which is not there"):
        modules_from(tmp_path, "a.js")
    with pytest.raises(UsageError, match="may not go round"):
        modules_from(tmp_path, "round.js")
    (tmp_path / "in").mkdir()
    write(tmp_path, in__out='import "../b.js";')
    with pytest.raises(UsageError, match="is not there"):
        modules_from(tmp_path / "in", "out.js")


def test_nothing_ends_the_element():
    assert "</" not in for_script_element('["</script><!--"]')


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no node on this machine: the script was not run")
def test_the_script_runs(tmp_path):
    write(
        tmp_path,
        main='import { twice } from "./twice.js";\nconsole.log(twice("</script>$&"));',
        twice="export const twice = (text) => `${text} ${text}`;",
    )
    script = bundled_script(tmp_path, "main.js")
    assert "</" not in script
    # node imports no blob, but the same text as data
    instead = """globalThis.Blob = class { constructor(parts) { this.text = parts.join(""); } };
    URL.createObjectURL = (blob) => "data:text/javascript," + encodeURIComponent(blob.text);"""
    (tmp_path / "one.cjs").write_text(instead + script)
    found = subprocess.run(["node", "one.cjs"], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert found.stdout == "</script>$& </script>$&\n", found.stderr


def test_all_of_the_page_can_be_bundled():
    assert len(modules_from(PAGE, "main.js")) > 20
