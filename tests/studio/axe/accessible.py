"""What axe-core finds on a page: nothing may be, at WCAG 2.2 AA."""

import hashlib
from functools import cache
from pathlib import Path

FILE = Path(__file__).parent / "axe.min.js"
SHA256 = "29348999450cdf2849a8e70b7912fc2da85a849da39c0d0d5394f51d4a9ed95c"

RUN = """async () => {
  const values = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"];
  // the size of targets is the one rule of WCAG 2.2 that axe leaves out unless it is asked for
  const rules = {"target-size": {enabled: true}};
  const options = {runOnly: {type: "tag", values}, rules, resultTypes: ["violations"]};
  const {violations, passes} = await axe.run(document, options);
  const found = violations.flatMap(({id, help, nodes}) =>
    nodes.map(({target, failureSummary}) => `${id} (${help}) at ${target.flat().join(" ")}: ${failureSummary}`));
  return [found, passes.length];
}"""


@cache
def _source():
    data = FILE.read_bytes()
    assert hashlib.sha256(data).hexdigest() == SHA256, "axe.min.js is not the file that its README names"
    return data.decode()


def axe_findings(page):
    """What breaks a rule of WCAG 2.2 A or AA as far as a program can tell, a line each, and how many rules held.

    ``page`` is a page of Playwright, or what has one as ``tab``. Only what is seen is looked at: open each tab and
    dialog.
    """
    tab = getattr(page, "tab", page)
    if not tab.evaluate("() => 'axe' in window"):
        # by the debugger: the page's content security policy lets no script in
        tab.evaluate(_source() + "\n0")
    return tab.evaluate(RUN)


def assert_accessible(page, name=""):
    """Axe finds nothing on what is seen of a page now; ``name`` says which state of it that is."""
    found, held = axe_findings(page)
    assert not found, "\n".join([f"{len(found)} found{f' ({name})' if name else ''}:", *found])
    # it did look at something
    assert held >= 5, held
