"""The documentation builds without a warning and without a network, and leaves nothing out."""

import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import pytest

import s2r_spec as s2r
from s2r_spec.cli.commands import EXAMPLES

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
OUTSIDE = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "benchmarks").rglob("*.md"))]
"""Pages that the repository shows, and the site does not."""
PAGES = sorted(
    path.relative_to(DOCS).with_suffix("") for path in DOCS.rglob("*") if path.suffix in (".md", ".ipynb")
)


def built(docs: Path, site: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-d", str(site.with_name("cache"))]
    return subprocess.run([*command, str(docs), str(site)], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, whose links, anchors, pages outside every list and markup are errors if they are wrong."""
    place = tmp_path_factory.mktemp("built") / "site"
    done = built(DOCS, place)
    assert done.returncode == 0, done.stderr
    return place


def test_every_page_is_in_the_site_and_loads_nothing_from_a_network(site):
    for page in PAGES:
        text = (site / page).with_suffix(".html").read_text()
        loaded = re.findall(r"<(?:script|img|iframe)[^>]*\ssrc=\"([^\"]*)", text)
        loaded += re.findall(r"<link rel=\"(?:stylesheet|preload)\"[^>]*\shref=\"([^\"]*)", text)
        assert loaded
        assert not [address for address in loaded if "//" in address], page


def test_the_command_line_page_has_every_command_and_option(site):
    text = (site / "reference" / "command-line.html").read_text()
    commands = list(EXAMPLES)
    assert len(commands) > 10
    for command in commands:
        assert f'id="s2r-{command}"' in text
    for option in ("--scheduler", "--requirement", "--time-unit", "--apply"):
        assert option in text


def test_the_python_page_has_every_public_name_with_its_docstring(site):
    text = (site / "reference" / "python-api.html").read_text()
    documented = set(re.findall(r'<dt class="sig[^>]*" id="s2r_spec\.(\w+)"', text))
    assert documented == set(s2r.__all__)


def anchors(page: Path) -> set[str]:
    return set(re.findall(r' id="([^"]+)"', page.read_text()))


def test_every_link_within_the_site_leads_somewhere(site):
    known = {path: anchors(path) for path in site.rglob("*.html")}
    for page in PAGES:
        path = (site / page).with_suffix(".html")
        targets = re.findall(r' href="([^":?]*)(?:\?[^"]*)?"', path.read_text())
        assert len(targets) > 10
        for target, _, anchor in (target.partition("#") for target in targets):
            end = (path.parent / unquote(target)).resolve() if target else path
            assert end.is_file(), f"{page}: {target}"
            assert not anchor or end not in known or unquote(anchor) in known[end], (
                f"{page}: {target}#{anchor}"
            )


def test_every_link_from_the_repository_s_other_pages_leads_somewhere(site):
    for page in OUTSIDE:
        links = re.findall(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]*))?\)", page.read_text())
        for target, anchor in links:
            end = (page.parent / target).resolve()
            assert end.exists(), f"{page.name}: {target}"
            if anchor and end.is_relative_to(DOCS):
                shown = (site / end.relative_to(DOCS)).with_suffix(".html")
                assert anchor in anchors(shown), f"{page.name}: {target}#{anchor}"


def test_links_that_lead_nowhere_stop_the_build(tmp_path):
    docs = tmp_path / "docs"
    docs.mkdir()
    conf = (DOCS / "conf.py").read_text()
    (docs / "conf.py").write_text(conf.replace("__file__", repr(str(DOCS / "conf.py"))))
    links = ("[a page](other.md)", "[a place](#none)", "[a file](../../none.py)", "[another](../none.md)")
    (docs / "index.md").write_text("# A page\n\n" + "\n\n".join(links))
    done = built(docs, tmp_path / "site")
    assert done.returncode == 1
    assert len(re.findall(r"index\.md:\d+: WARNING", done.stderr)) == len(links)
