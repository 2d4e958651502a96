"""A draft dropped on the studio's page; in a real browser."""

import base64

import numpy as np

from heartcase.pipeline.building.session_file import open_session
from heartcase.schemas.recipe.recipe import load_recipe
from tests.studio.axe.accessible import assert_accessible
from tests.studio.page.browsing import browsing, until
from tests.studio.test_drafts import volume

DROP = """([name, data]) => {
  const bytes = Uint8Array.from(atob(data), (one) => one.charCodeAt(0));
  const held = new DataTransfer();
  held.items.add(new File([bytes], name));
  for (const kind of ["dragenter", "dragover", "drop"]) {
    const options = { dataTransfer: held, bubbles: true, cancelable: true };
    document.querySelector("#axial .surface").dispatchEvent(new DragEvent(kind, options));
  }
}"""


def test_a_draft_is_dropped_refused_and_taken(chromium, painted):
    server, path, _ = painted
    text = path.read_text()
    blocks = np.zeros((24, 30, 40), np.uint8)
    blocks[3:9, 3:9, 3:9] = 1
    blocks[12:20, 14:22, 20:30] = 77
    data, _ = volume(path, values=blocks)
    with browsing(chromium, server, viewport={"width": 1366, "height": 768}) as page:
        page.tab.evaluate(DROP, ["Surname^Forename.nii.gz", base64.b64encode(data).decode()])
        page.tab.locator("#draft[open]").wait_for()
        assert page.text("#draft-what").startswith("Surname^Forename.nii.gz (")
        for theme in ("dark", "light"):
            page.tab.locator("html").evaluate("(one, theme) => { one.dataset.theme = theme; }", theme)
            assert_accessible(page, f"draft, {theme}")
        # an unknown value is refused, and the dialog stays
        page.tab.locator("#draft-whole").check()
        assert page.tab.locator("#draft-background").is_disabled()
        page.tab.locator("#draft-add").click()
        page.tab.locator("#draft-said li").first.wait_for()
        assert "77" in page.text("#draft-said")
        assert_accessible(page, "draft refused")
        assert path.read_text() == text
        page.tab.locator("#draft-ignores").check()
        page.tab.locator("#draft-add").click()
        page.tab.locator("#draft[open]").wait_for(state="detached")
        page.ready()
        page.saved(1)
        assert [file.path for file in load_recipe(path).markers] == ["draft_1.nii.gz"]
        assert "Surname" not in path.read_text()
        session = open_session(path, out=path.parent / "out").session
        np.testing.assert_array_equal(session.marked == 1, blocks == 1)
        row = page.tab.locator("#structures .structure").filter(has_text="left ventricle").first
        # without background its volume would be that of the whole scan
        until(lambda: row.locator(".mark").get_attribute("data-state") != "nothing")
        assert "ml" not in row.inner_text()
        page.tab.locator("#undo").click()
        page.tab.locator("#redo .count").get_by_text("1", exact=True).wait_for()
        page.ready()
        page.saved(0)
        assert path.read_text() == text
        # the same by the button
        with page.tab.expect_file_chooser() as chosen:
            page.tab.locator("#draft-open").click()
        chosen.value.set_files([{"name": "a.txt", "mimeType": "text/plain", "buffer": b"hello"}])
        # what nobody reads is refused at once
        page.tab.locator("#draft-said").get_by_text("Not taken: a.txt").wait_for()
        assert ".mrk.json" in page.text("#draft-said")
        assert page.tab.locator("#draft-add").is_disabled()
        page.tab.keyboard.press("Escape")
        assert not page.tab.locator("#draft").is_visible()
