"""Names of a page's tables, for who lists them or meets them by keyboard without seeing them."""

import re
from typing import Final

_SCROLL: Final = '<div class="scroll" tabindex="0"><table'
_HEADING: Final = re.compile(r"<(h[1-4])\b[^>]*>(.*?)</\1>", re.DOTALL)
_TAG: Final = re.compile(r"<[^>]*>")


def named_tables(page: str) -> str:
    """A page whose tables are called as the headings that they follow.

    Parameters
    ----------
    page : str
        HTML; each table is the first thing in a ``div`` of the class ``scroll``.
    """
    before, *tables = page.split(_SCROLL)
    parts, called, times = [before], "Table", 0
    for part in tables:
        headings = _HEADING.findall(before)
        if headings:
            called, times = " ".join(_TAG.sub("", headings[-1][1]).split()), 0
        times += 1
        name = (f"{called}, table {times}" if times > 1 else called).replace('"', "&quot;")
        region = f'<div class="scroll" tabindex="0" role="region" aria-label="{name}, scrolls">'
        parts += [f'{region}<table aria-label="{name}"', part]
        before = part
    return "".join(parts)
