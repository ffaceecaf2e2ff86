"""What the site has beside ``docs/``: pages and files of the repository, the reference."""

import re
from pathlib import Path
from typing import Any, Final

from mkdocs.structure.files import File, Files
from tutorial_notebook import with_outputs

from spl_batch import api

ROOT: Final = Path(__file__).parents[2]
PAGES: Final = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
"""Pages of the repository, and what they are called on the site."""

COPIED: Final = ("LICENSE", "Dockerfile", ".ci/run")
"""Files that pages link to; the workflows are, too."""

NOTEBOOK: Final = "tutorial.md"
"""Page that is a notebook."""

SEARCH: Final = "iframe-worker.js"
"""Script that lets pages search which are opened as files."""

_LINK: Final = re.compile(r"\]\(([^)#:\s]+)(#[^)\s]*)?\)")


def on_files(files: Files, config: Any) -> Files:
    """Add pages and files."""
    for source, name in PAGES.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, name, content=_relinked(text, Path())))
    workflows = [
        path.relative_to(ROOT).as_posix() for path in sorted(ROOT.glob("workflows/*.yaml"))
    ]
    for name in (*COPIED, *workflows):
        content = (ROOT / name).read_text(encoding="utf-8")
        files.append(File.generated(config, _copied(name), content=content))
    files.append(File.generated(config, "reference.md", content=_reference()))
    script = (Path(__file__).parent / SEARCH).read_text(encoding="utf-8")
    files.append(File.generated(config, f"assets/{SEARCH}", content=script))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Execute notebooks, and lead links out of ``docs/`` to what lies on the site."""
    if page.file.src_uri in {*PAGES.values(), "reference.md"}:
        return markdown
    if page.file.src_uri == NOTEBOOK:
        text = (ROOT / "docs" / NOTEBOOK).read_text(encoding="utf-8")
        markdown = with_outputs(text, ROOT)
    return _relinked(markdown, Path("docs", page.file.src_uri).parent)


def _copied(name: str) -> str:
    """What a file is called on the site; a name that starts with a dot would be left out."""
    return name.removeprefix(".")


def _relinked(text: str, folder: Path) -> str:
    """Links of a page that lies in a folder of the repository, as the site needs them."""
    up = "../" * (len(folder.parts) - 1)

    def target(link: re.Match[str]) -> str:
        name, anchor = link[1], link[2] or ""
        path = (ROOT / folder / name).resolve()
        if not path.exists() or not path.is_relative_to(ROOT):
            return link[0]
        place = path.relative_to(ROOT).as_posix()
        if place in PAGES:
            place = PAGES[place]
        elif place == "docs/evidence":
            place = "evidence/noise.md"
        elif place.startswith("docs/"):
            place = place.removeprefix("docs/")
        elif place in COPIED or place.startswith("workflows/"):
            place = _copied(place)
        else:
            return link[0]
        return f"]({up}{place}{anchor})"

    return _LINK.sub(target, text)


def _reference() -> str:
    """Everything that a notebook imports, from the docstrings."""
    lines = [
        "# Reference",
        "",
        "`spl_batch` has the functions on arrays, and `spl_batch.api` these and the verbs of the",
        "command line.",
    ]
    for name in sorted(api.__all__, key=lambda name: (name[0].isupper(), name)):
        found = getattr(api, name)
        lines += ["", f"::: {found.__module__}.{found.__qualname__}"]
        lines += ["    options:", f"      heading: {name}", f"      toc_label: {name}"]
    return "\n".join(lines) + "\n"
