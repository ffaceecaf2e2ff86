"""Kinds of warnings, as benchmarks tell them apart."""

import ast
from collections.abc import Iterator
from pathlib import Path

from benchmarks.airborne import sky, told
from benchmarks.airborne.ground import steep
from benchmarks.airborne.real_warnings import OF_FIT
from spl_batch import airborne


def sentences() -> Iterator[str]:
    """Texts of the receiver's modules, with a gap where a value stands."""
    for path in Path(airborne.__path__[0]).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.JoinedStr):
                parts = (p.value if isinstance(p, ast.Constant) else "{}" for p in node.values)
                yield "".join(map(str, parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value


def test_each_kind_is_of_words_that_a_sentence_holds() -> None:
    texts = list(sentences())
    assert [k for k, words in told.KINDS.items() if not any(words in t for t in texts)] == []


def test_an_effect_is_told_by_warnings_of_its_own_kinds_alone() -> None:
    gap = "2 gaps in the ground, 500 m2: heights are interpolated from ground up to 8 m away"
    cloud = "noise between 60 and 90 m: haze or cloud; its returns are class 18, and weak"
    assert told.kinds([gap, cloud, gap, "the trajectory ends early"]) == ["gaps", "cloud", "other"]
    assert told.telling([gap, cloud], sky.SAYS["haze 60-100 m, 5 x"]) == [cloud]
    assert told.new_warnings([gap, cloud], [gap.replace("500", "70")]) == [cloud]
    worse = {key: most * 2 for key, most in sky.HELD.items()}
    base = dict.fromkeys(sky.HELD, 0.0)
    assert sky.verdict(base, base, told=False) == "held"
    assert sky.verdict(worse, base, told=False).startswith("SILENT: noise removed -2.00, ")
    assert sky.verdict(worse, base, told=True).startswith("told: ")


def test_all_effects_name_kinds_that_there_are() -> None:
    assert set(sky.SAYS) == set(sky.EFFECTS)
    for of in (*sky.SAYS.values(), *steep.SAYS.values()):
        assert set(of) <= set(told.KINDS)
    assert set(steep.SAYS) == set(steep.SCENES)


def test_sentences_on_the_sky_are_counted_as_such_that_judge_the_fit() -> None:
    kinds = ("cloud", "thin layer", "fog", "mist", "noise by height", "floats", "flightlines")
    whole = {kind: next(t for t in sentences() if told.KINDS[kind] in t) for kind in kinds}
    assert [kind for kind, text in whole.items() if not OF_FIT.search(text)] == []
