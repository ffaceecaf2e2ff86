"""Numbers as people read them; every function shows ``None`` as a dash.

Every receiver's report and console takes its numbers from here. A report has typographic spaces and
signs, a console plain ones: :func:`as_ascii` converts.
"""

import re
from typing import Final

from spl_batch.errors import grouped

DASH: Final = "\N{EN DASH}"
THIN: Final = "\N{NARROW NO-BREAK SPACE}"
MINUS: Final = "\N{MINUS SIGN}"

_RAISED: Final = "\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079\u207b"
_SUPERSCRIPT: Final = str.maketrans("0123456789-", _RAISED)
_LOWERED: Final = str.maketrans(_RAISED, "0123456789-")
_POWER: Final = re.compile(f"(?<=10)[{_RAISED}]+")


def number(value: float | None, digits: int = 0) -> str:
    """Fixed point with groups of three digits, a true minus and no negative zero."""
    if value is None:
        return DASH
    text = grouped(value, digits).replace(" ", THIN)
    if text.startswith("-"):
        text = text[1:] if not text.strip(f"-0.{THIN}") else MINUS + text[1:]
    return text


def significant(value: float | None, figures: int = 3) -> str:
    """Three significant figures; an exponent where six digits do not do."""
    if value is None:
        return DASH
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.{figures - 1}e}".split("e")
        power = str(int(exponent)).translate(_SUPERSCRIPT)
        return f"{mantissa}\N{MULTIPLICATION SIGN}10{power}".replace("-", MINUS)
    rounded = float(f"{value:.{figures - 1}e}")
    digits = max(0, figures - 1 - int(f"{rounded:e}".split("e")[1]))
    return number(rounded, digits)


def expected_count(value: float | None, how: str) -> str:
    """A number of things that are expected, not counted; a part of one is none to speak of.

    ``how``: how sure it is, as ``about`` or ``at most``.
    """
    few = value is not None and 0 < value < 1
    return "fewer than 1" if few else f"{how} {significant(value, 2)}"


def plain(value: float | None) -> str:
    """As few digits as the number needs."""
    return DASH if value is None else f"{value:g}".replace("-", MINUS)


def percent(part: float | None, digits: int = 1) -> str:
    """Share as a percentage; only nothing is shown as 0 %."""
    if part is None:
        return DASH
    least = 10.0**-digits
    if 0 < part * 100 < least / 2:
        return f"<{THIN}{least:.{digits}f}{THIN}%"
    return f"{number(part * 100, digits)}{THIN}%"


def share(part: float | None) -> str:
    """Share of anything from all to hardly any, as a percentage of three significant figures."""
    return DASH if part is None else f"{significant(part * 100)}{THIN}%"


def large(value: float | None) -> str:
    """Count in words that fit a card: 11.3 M, 4.20 G; exact below a hundred thousand."""
    if value is None:
        return DASH
    for limit, unit in ((1e9, "G"), (1e6, "M")):
        if value >= limit * 0.9995:
            return f"{significant(value / limit)}{THIN}{unit}"
    if value >= 99_950:
        return f"{significant(value / 1e3)}{THIN}k"
    return number(value)


def duration(seconds: float | None) -> str:
    """Time in the two largest units that matter."""
    if seconds is None:
        return DASH
    if seconds < 59.95:
        return f"{number(seconds, 1)}{THIN}s"
    whole = round(seconds)
    minutes, hours = whole // 60, whole // 3600
    if hours >= 48:
        return f"{hours // 24}{THIN}d {hours % 24}{THIN}h"
    if hours:
        return f"{hours}{THIN}h {minutes % 60:02d}{THIN}min"
    return f"{minutes}{THIN}min {whole % 60:02d}{THIN}s"


def size(byte_count: float | None) -> str:
    """Size of a file in decimal units."""
    if byte_count is None:
        return DASH
    for limit, unit in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if byte_count >= limit * 0.9995:
            return f"{significant(byte_count / limit)}{THIN}{unit}"
    return f"{number(byte_count)}{THIN}B"


def centimetres(metres: float | None) -> str:
    """Metres as centimetres with one decimal, whatever their size: a quantity has one unit."""
    return DASH if metres is None else f"{number(metres * 100, 1)}{THIN}cm"


def height(metres: float | None, unit: tuple[str, float]) -> str:
    """A small height in the unit of delivery, with centimetres beside; of metres these alone.

    ``unit``: its name, and the metres in it.
    """
    name, unit_m = unit
    if metres is None or unit_m == 1.0:
        return centimetres(metres)
    return f"{number(metres / unit_m, 3)}{THIN}{name} ({centimetres(metres)})"


def metres(value: float | None, digits: int = 2) -> str:
    """Metres with a fixed number of decimals."""
    return DASH if value is None else f"{number(value, digits)}{THIN}m"


def millimetres(metres: float | None, digits: int = 1) -> str:
    """Metres as millimetres with a fixed number of decimals."""
    return DASH if metres is None else f"{number(metres * 1000, digits)}{THIN}mm"


def scaled(value: float | None, factor: float, digits: int = 0) -> str:
    """A number in another unit, for a column whose heading names it."""
    return DASH if value is None else number(value * factor, digits)


def of_all(part: int, whole: int, noun: str = "points") -> str:
    """Share that a count is of all there are, and of what: "41.1 % of all points"."""
    return f"{percent(part / whole if whole else None)} of all {noun}"


def surface_name(key: str) -> str:
    """Class of surface in words: "open ground", "slope 5-15 deg" and, for ``all``, "all"."""
    if key == "all":
        return "all surfaces"
    kind, _, span = key.partition("_")
    if kind == "slope":
        return f"slope {span.replace('_', DASH)}\N{DEGREE SIGN}"
    return key.replace("_", " ")


def as_ascii(text: str) -> str:
    """A console, and a log, need not know typographic spaces and signs."""
    plain: dict[str, str | int | None] = {
        THIN: " ",
        MINUS: "-",
        DASH: "-",
        "\N{MULTIPLICATION SIGN}": "x",
    }
    text = _POWER.sub(lambda found: "^" + found[0].translate(_LOWERED), text)
    return text.translate(str.maketrans(plain))
