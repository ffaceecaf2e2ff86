"""The tutorial as a notebook: executed while the site is built, with what its cells show."""

import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any, Final

import jupytext
import nbformat
from nbclient import NotebookClient

LONGEST: Final = 24
"""Lines of text that a cell shows; of more, the first and the last [count]."""

SECONDS: Final = 900
"""A cell that takes longer fails."""


@cache
def with_outputs(text: str, root: Path) -> str:
    """Page with what its cells show; it is executed once, however often a served site is built."""
    return as_markdown(executed(text, root))


def executed(text: str, root: Path) -> nbformat.NotebookNode:
    """Notebook of a page, with outputs.

    Parameters
    ----------
    text : str
        Page with its front matter; its blocks of ``python`` and ``sh`` are cells.
    root : Path
        Repository: what the cells call by its name is there.

    Raises
    ------
    nbclient.exceptions.CellExecutionError
        If a cell fails.
    """
    notebook = jupytext.reads(text, fmt="md")
    for cell in notebook.cells:
        if cell.cell_type == "code" and cell.source.startswith("%%sh\n"):
            # the command that belongs to this Python, and an error ends the build
            commands = cell.source.removeprefix("%%sh\n")
            cell.metadata["shown"] = ("sh", commands)
            path = Path(sys.executable).parent
            # the kernel asks programs for colours, as if its pipe were a terminal
            prepared = f"set -e\nunset FORCE_COLOR CLICOLOR\nexport PATH={path}:$PATH"
            cell.source = f"%%bash\n{prepared}\n{{\n{commands}\n}} 2>&1"
        elif cell.cell_type == "code":
            cell.metadata["shown"] = ("python", cell.source)
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder).resolve()
        (work / "workflows").symlink_to(root / "workflows")
        NotebookClient(
            notebook,
            timeout=SECONDS,
            coalesce_streams=True,
            resources={"metadata": {"path": str(work)}},
        ).execute()
        for cell in notebook.cells:
            for output in cell.get("outputs", ()):
                if "text" in output:
                    output.text = output.text.replace(f"{work}/", "")
    return notebook


def as_markdown(notebook: nbformat.NotebookNode) -> str:
    """Page of an executed notebook."""
    parts: list[str] = []
    for cell in notebook.cells:
        if cell.cell_type != "code":
            parts.append(cell.source)
            continue
        language, source = cell.metadata["shown"]
        parts.append(f"```{language}\n{source}\n```")
        parts += [shown for output in cell.outputs if (shown := _shown(output))]
    return "\n\n".join(parts) + "\n"


def _shown(output: Any) -> str:
    """What a cell has printed or drawn."""
    data = output.get("data", {})
    if "image/png" in data:
        picture = data["image/png"].replace("\n", "")
        return f"![What the cell above draws](data:image/png;base64,{picture})"
    text = output.get("text") or data.get("text/plain", "")
    lines = text.rstrip("\n").splitlines()
    if len(lines) > LONGEST:
        half = LONGEST // 2
        lines = [*lines[:half], f"... {len(lines) - 2 * half} lines more ...", *lines[-half:]]
    return "```text\n" + "\n".join(lines) + "\n```" if lines else ""
