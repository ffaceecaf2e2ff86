"""The site of the documentation works without a network, and as files without a server."""

import os
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.browser import browser, needs_chromium

ROOT = Path(__file__).parents[1]
OFFLINE = ("--host-resolver-rules=MAP * ~NOTFOUND",)
FIELD = "document.querySelector('[data-md-component=search-query]').focus()"
FOUND = """
new Promise((done, late) => {
  const end = Date.now() + 20000
  const look = () => {
    const found = [...document.querySelectorAll('.md-search-result__link')].map(a => a.href)
    if (found.length) done(found)
    else if (Date.now() > end) late(new Error('nothing found'))
    else setTimeout(look, 50)
  }
  look()
})
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site that CI has built; else a new one, whose tutorial is not executed."""
    if built := os.environ.get("SPL_BATCH_SITE"):
        return Path(built)
    config = pytest.importorskip("mkdocs.config", reason="mkdocs is not installed")
    build = pytest.importorskip("mkdocs.commands.build").build
    folder = tmp_path_factory.mktemp("site")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NO_MKDOCS_2_WARNING", "1")
        patch.syspath_prepend(str(ROOT / "docs" / "_site"))
        notebook: Any = pytest.importorskip("tutorial_notebook", reason="jupytext is not installed")
        patch.setattr(notebook, "with_outputs", lambda text, _: text)
        build(config.load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder)))
        sys.modules.pop("tutorial_notebook")
    return folder


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_no_page_of_the_site_loads_anything_from_elsewhere(site: Path) -> None:
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 25
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert 'src="http' not in text, page
        assert 'rel="stylesheet" href="http' not in text, page


@pytest.mark.slow
@needs_chromium
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", ["index.html", "evidence/noise.html"])
def test_the_site_searches_from_files_without_a_network(
    site: Path, name: str, tmp_path: Path
) -> None:
    with browser(tmp_path, *OFFLINE) as page:
        page.open(site / name)
        page.ask(FIELD)
        page.write("filter_points")
        page.press("ArrowDown")  # the theme looks at the field when a key is let go
        found = page.ask(FOUND)
        assert any("reference.html?h=filter_points" in link for link in found), found
        elsewhere = [url for url in page.reported if not url.startswith(("file://", "data:"))]
        assert elsewhere == []
