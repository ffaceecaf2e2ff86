"""Page of the documentation with every code, made of the table of findings.

Run ``python -m spl_batch.engine.report.troubleshooting [--check]``.
"""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from string import Formatter
from typing import Final

from spl_batch.engine.findings import PAGE, Code, table

BEGIN: Final = "<!-- codes: python -m spl_batch.engine.report.troubleshooting -->"
"""Line of the page from which on it is made of the table."""


def codes() -> str:
    """Text of all codes, in order."""
    return "\n".join(line for code in sorted(table()) for line in _section(code, table()[code]))


def page(text: str) -> str:
    """The page with its codes as the table has them; what stands before them is written by hand."""
    return f"{text.partition(BEGIN)[0]}{BEGIN}\n\n{codes()}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page, or only check it."""
    given = sys.argv[1:] if arguments is None else arguments
    path = Path(PAGE)
    before = path.read_text(encoding="utf-8")
    if before == page(before):
        return 0
    if "--check" in given:
        sys.stderr.write(f"{path}: stale; run python -m spl_batch.engine.report.troubleshooting\n")
        return 1
    path.write_text(page(before), encoding="utf-8")
    sys.stdout.write(f"{path}: written\n")
    return 0


def _section(name: str, code: Code) -> Iterator[str]:
    yield f"## {name}: {code.title}\n"
    sentences = code.sentences
    if isinstance(sentences, str):
        sentences = {"": sentences}
    for kind, sentence in sentences.items():
        shown = _shown(sentence)
        yield f"- `{kind}`: {shown}" if kind else shown
    yield ""
    if code.consequence:
        yield f"{_sentence(code.consequence)}\n"
    if code.remedy:
        yield f"To do: {_shown(code.remedy)}.\n"


def _sentence(text: str) -> str:
    shown = _shown(text)
    return f"{shown[0].upper()}{shown[1:]}."


def _shown(template: str) -> str:
    """A template with the names of its values in italics."""
    parts = Formatter().parse(template)
    return "".join(f"{text}*{name}*" if name else text for text, name, *_ in parts)


if __name__ == "__main__":
    sys.exit(main())
