"""Report pages in a browser: do they read on a phone and on a screen?

    python -m benchmarks.report_pages [PAGE.html ...] [--folder FOLDER]

Opens pages 390 and 1280 pixels wide, and prints what is wrong with them: a page that is wider than the window, a word
that is split over two lines, text that is less than 10 pixels high, a literal backtick, a picture without words to
point at. Screenshots go to the folder. Without pages, it makes two of the tests' cart: a diagnosis and a certificate.
Needs a browser and its driver: ``apt-get install chromium`` and ``pip install playwright``. Exit code 1 if anything is
wrong.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

import s2r_spec as s2r

WIDTHS = (390, 1280)
"""Definition: of a phone and of a screen [pixels]."""
SMALLEST = 10.0
"""Level: least height of text [pixels]."""
BROWSERS = ("chromium", "google-chrome", "chromium-browser")
CHECK = """(smallest) => {
  const wrong = [], seen = new Set();
  const say = (what, words) => { const line = what + ": " + words.trim().slice(0, 60);
    if (!seen.has(line)) { seen.add(line); wrong.push(line); } };
  const root = document.documentElement;
  for (const fold of document.querySelectorAll("details")) fold.open = true;
  if (root.scrollWidth > root.clientWidth) {
    say("wider than the window", root.scrollWidth + " of " + root.clientWidth + " pixels");
    for (const one of document.querySelectorAll("main *"))
      if (one.getBoundingClientRect().right > root.clientWidth + 1 && !one.closest("svg"))
        say("reaches out of the window", one.tagName + " " + (one.textContent || ""));
  }
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node; (node = walker.nextNode());) {
    const parent = node.parentElement, range = document.createRange();
    if (!node.data.trim() || parent.closest("title, style, script")) continue;
    range.selectNodeContents(node);
    if (!range.getClientRects().length) continue;
    const svg = parent.closest("text");
    const scale = svg && svg.getScreenCTM() ? Math.hypot(svg.getScreenCTM().a, svg.getScreenCTM().b) : 1;
    const size = parseFloat(getComputedStyle(parent).fontSize) * scale;
    if (size < smallest - 0.01) say("text of " + size.toFixed(1) + " pixels", node.data);
    if (!parent.closest("pre") && node.data.includes("`")) say("literal backtick", node.data);
    if (svg || parent.closest("pre")) continue;
    for (const word of node.data.matchAll(/[^\\s\\-–—\\/…]+/g)) {
      range.setStart(node, word.index); range.setEnd(node, word.index + word[0].length);
      const tops = new Set([...range.getClientRects()].map((one) => Math.round(one.top)));
      if (tops.size > 1) say("split word", word[0]);
    }
  }
  for (const picture of document.querySelectorAll("figure svg"))
    if (!picture.querySelector("g.hover > title")) say("nothing to point at", picture.getAttribute("aria-label"));
  return wrong;
}"""


def look(pages: list[Path], folder: Path) -> list[str]:
    """Open every page in both widths; save screenshots, and return what is wrong."""
    from playwright.sync_api import sync_playwright

    browser_path = next(filter(None, map(shutil.which, BROWSERS)), None)
    found = []
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=browser_path, args=["--no-sandbox"])
        for path in pages:
            for width in WIDTHS:
                page = browser.new_page(viewport={"width": width, "height": 900}, bypass_csp=True)
                page.goto(path.resolve().as_uri())
                found += [f"{path.name} at {width} pixels: {one}" for one in page.evaluate(CHECK, SMALLEST)]
                shot = folder / f"{path.stem}-{width}.png"
                page.screenshot(path=shot, full_page=True, animations="disabled")
                print(shot)
                page.close()
        browser.close()
    return found


def examples(folder: Path) -> list[Path]:
    """Return pages of the cart: of a diagnosis, and of a certificate."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "plugin"))
    from s2r_cart import SPEC, Cart, real

    spec, random = s2r.parse_spec(SPEC.replace("0.25 {m", "0.8 {m"), "cart.stl"), np.random.default_rng(0)
    drawn = spec.space.lower + random.uniform(size=(30, 2)) * (spec.space.upper - spec.space.lower)
    tests = [dict(zip(spec.space.names, one.tolist(), strict=True)) for one in drawn]
    runs = [(test, real(test, 7000 + number, {"coulomb": 0.9})) for number, test in enumerate(tests)]
    diagnosis = s2r.diagnose(spec, Cart(), runs, cache=folder / "cache")
    shutil.rmtree(folder / "run", ignore_errors=True)
    certificate = s2r.check(
        Path(__file__).parents[1] / "specs" / "turtlebot.stl", "turtlebot", folder / "run", budget=60
    )
    return [
        diagnosis.report(folder / "diagnosis.html"),
        certificate.report(folder / "certificate.html"),
    ]


def main() -> int:
    """Look at the pages, and print what is wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pages", nargs="*", type=Path)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "s2r-pages")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    wrong = look(given.pages or examples(given.folder), given.folder)
    print("\n".join(wrong) or "nothing is wrong")
    return min(len(wrong), 1)


if __name__ == "__main__":
    sys.exit(main())
