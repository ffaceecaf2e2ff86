"""What a run warns of is a value; one table has what each code means."""

import ast
import json
import pickle
import re
from collections.abc import Iterator
from pathlib import Path
from string import Formatter

import pytest

import spl_batch
from spl_batch.engine.findings import Finding, of_receipts, settled, table
from spl_batch.engine.report.reported import reported, texts
from spl_batch.engine.settings.base import ReportSettings
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.units import Units

ROOT = Path(spl_batch.__path__[0])

MOST_CODES = 40


def lost(count: int, subject: str) -> Finding:
    return Finding("N01", {"kind": "strays", "count": count}, subject, badness=count)


def test_findings_that_are_alike_are_one_the_worst_first() -> None:
    (one,) = reported(lost(n, name) for name, n in zip("abcde", (3, 9, 1, 4, 2), strict=True))
    assert one.subjects == ("b", "d", "a", "e", "c")
    assert one.values["count"] == 9
    assert (one.code, one.severity) == ("N01", "warning")


def test_other_kinds_and_wordings_stay_apart() -> None:
    found = [lost(3, "a"), Finding("N01", {"kind": "full"}, "a")]
    found += [Finding("I06", {"what": text}) for text in ("this", "that", "this")]
    assert len(reported(found)) == 4
    grid = {"kind": "grid", "what": "accurate to 6 m"}
    twice = [Finding("I05", {**grid, "key": key}, "county.gpkg") for key in ("aoi", "water")]
    assert [one.values["key"] for one in reported(twice)] == ["aoi", "water"]


def test_a_code_can_be_silenced_and_an_unknown_one_is_refused() -> None:
    found = [lost(3, "a"), Finding("I06", {"what": "this"})]
    assert [one.code for one in reported(found, ["N01"])] == ["I06"]
    assert ReportSettings(ignore=("N01",)).ignore == ("N01",)
    with pytest.raises(ValueError, match="no code N99"):
        ReportSettings(ignore=("N99",))


def test_a_cause_leaves_out_what_follows_from_it() -> None:
    cause = Finding("T02", {"kind": "leap", "leap_s": 18, "late": "early"}, "a")
    follows = [lost(3, "a"), lost(4, "b")]
    assert [one.subject for one in settled([cause, *follows])] == ["a", "b"]
    assert [one.subject for one in settled(follows, known=[cause])] == ["b"]
    assert settled([cause], known=[cause]) == []


def test_a_cause_may_explain_one_kind_alone() -> None:
    side = Finding("N01", {"kind": "side", "times": 3.0, "more": "above", "side": "below"}, "a")
    haze = Finding("N03", {"low_m": 60.0, "high_m": 90.0, "area_m2": 900.0, "ratio": 7.0})
    assert settled([side, lost(3, "a"), haze]) == [lost(3, "a"), haze]
    assert settled([side]) == [side]


def test_notes_are_in_no_report() -> None:
    note = Finding("E01", {"kind": "disk", "needed": "2 GiB", "free": "1 GiB"})
    assert reported([note]) == ()
    assert len(texts([note])) == 1


def test_a_place_is_in_the_sentence() -> None:
    (one,) = reported([Finding("I06", {"what": "odd"}, place=(10.2, 20.0, 30.0, 40.0))])
    assert one.place == (10.2, 20.0, 30.0, 40.0)
    assert "x 10 to 30 and y 20 to 40 m" in one.sentence
    foot = Units("foot", 0.3048, "foot", 0.3048)
    box = (304.8, 609.6, 304.8, 609.6)
    (one,) = reported([Finding("I06", {"what": "odd"}, place=box)], units=foot)
    assert one.place == box
    assert one.sentence.endswith("x 1 000 to 1 000 and y 2 000 to 2 000 ft")


def test_heights_are_in_the_unit_of_delivery_with_metres_beside() -> None:
    foot = Units("foot", 0.3048, "foot", 0.3048)
    layer = Finding("N02", {"ratio": 4.0, "low_m": 57, "high_m": 100.4})
    values = {"kind": "blunder", "count": 1, "of": 9, "limit_m": 0.3, "names": ["a"]}
    blunder = Finding("C01", {**values, "worst": "a", "error_m": -3.048})
    metric, _ = reported([layer, blunder])
    assert "between 57 m and 100 m in height" in metric.sentence
    layer_ft, blunder_ft = reported([layer, blunder], units=foot)
    assert "between 187 ft (57 m) and 329 ft (100 m) in height" in layer_ft.sentence
    assert "more than 0.984 ft (30.0 cm)" in blunder_ft.sentence
    assert "checkpoint -10.000 ft (-304.8 cm)" in blunder_ft.sentence
    assert layer_ft.values == metric.values


def test_findings_of_receipts_are_of_what_a_task_worked_on() -> None:
    facts = {"name": "line_1.laz", "findings": [list(lost(3, "")), list(lost(4, "own"))]}
    receipt = Receipt("index_file", "7", "", "", "", {}, facts, 0, 0.0, 0.0)
    assert [one.subject for one in of_receipts({"7": receipt})] == ["line_1.laz", "own"]


def test_findings_travel_as_json_and_as_pickles() -> None:
    for one in (Finding("W02"), lost(3, "a")):
        assert Finding(*json.loads(json.dumps(one))) == one
        assert pickle.loads(pickle.dumps(one)) == one  # noqa: S301 - our own


def test_the_table_is_small() -> None:
    assert len(table()) <= MOST_CODES


def modules() -> Iterator[tuple[Path, ast.Module]]:
    for path in ROOT.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if "Finding(" in text:
            yield path, ast.parse(text)


def fields(template: str) -> set[str]:
    return {name.partition("[")[0] for _, name, *_ in Formatter().parse(template) if name}


def dictionary(call: ast.Call, scope: ast.AST) -> ast.Dict | None:
    """Values of a finding: in its place, or named in the same function."""
    given = call.args[1] if len(call.args) > 1 else ast.Dict([], [])
    if isinstance(given, ast.Name):
        before = [
            (one.lineno, one.value)
            for one in ast.walk(scope)
            if isinstance(one, ast.Assign)
            and isinstance(one.targets[0], ast.Name)
            and one.targets[0].id == given.id
            and one.lineno < call.lineno
        ]
        given = max(before, key=lambda one: one[0])[1] if before else given
    return given if isinstance(given, ast.Dict) else None


def test_every_finding_has_the_values_of_its_sentence() -> None:
    seen = set()
    for path, tree in modules():
        scopes = [one for one in ast.walk(tree) if isinstance(one, ast.FunctionDef)] or [tree]
        for scope in scopes:
            for call in ast.walk(scope):
                if not (isinstance(call, ast.Call) and getattr(call.func, "id", "") == "Finding"):
                    continue
                if not (call.args and isinstance(call.args[0], ast.Constant)):
                    continue
                code = table()[call.args[0].value]
                seen.add(call.args[0].value)
                values = dictionary(call, scope)
                assert values is not None, f"{path}:{call.lineno}: its values cannot be seen"
                given = {
                    key.value: value for key, value in zip(values.keys, values.values, strict=True)
                }
                kind = given.get("kind")
                if isinstance(code.sentences, str):
                    possible = [code.sentences]
                elif isinstance(kind, ast.Constant):
                    possible = [code.sentences[kind.value]]
                else:
                    possible = [*code.sentences.values()]
                common = fields(code.consequence) | fields(code.remedy)
                assert any(fields(one) | common <= given.keys() for one in possible), (
                    f"{path}:{call.lineno}"
                )
    failures = {code for code in table() if code[0] == "F"}
    assert seen == table().keys() - failures, "a code without a finding, or the other way round"


def test_nothing_reads_a_message_to_decide() -> None:
    """No test of a reason's, a fault's, an error's or a warning's words."""
    words = r"(reason|message|fault|error|warning|finding|sentence|text)s?"
    reads = re.compile(
        rf"(\b{words}|str\({words}\))\.(startswith|endswith|removeprefix|find)\("
        rf"|re\.(match|search|fullmatch|sub)\([^)]*\b{words}\b"
        rf"|_\w+\.(match|search|fullmatch)\([^)]*\b(reason|str\(error\)|message)"
    )
    allowed = {"number_format.py", "planning.py", "track_csv.py", "checkpoints.py", "one_file.py"}
    for path in ROOT.rglob("*.py"):
        if path.name in allowed:
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            assert not reads.search(line), f"{path}:{number}: {line.strip()}"
