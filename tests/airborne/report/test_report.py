"""What the report says: its model, its numbers in words, its verdicts, its JSON."""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.accuracy.checkpoint_errors import CheckpointStatistics
from spl_batch.airborne.report.model import (
    Accuracy,
    Checkpoints,
    Counts,
    Report,
)
from spl_batch.airborne.report.verdicts import (
    noise_removed,
    screen_summary,
    terrain_statistics,
    verdicts,
)
from spl_batch.engine.report import number_format as text
from spl_batch.engine.report.page import report_json
from spl_batch.engine.report.parts import (
    Statistics,
    finite_or_none,
)
from tests.report_data import make_failures, make_report, smallest_report

NARROW = text.THIN


def with_rmse(rmse: float, name: str = "open_ground") -> Report:
    return make_report(accuracy=Accuracy(dtm={name: Statistics(n=10, rmse=rmse, mean=0.0)}))


class TestModel:
    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, np.float32("nan"), None])
    def test_a_number_that_is_not_finite_becomes_null(self, value: Any) -> None:
        assert Statistics(n=0, mean=value).mean is None

    @settings(max_examples=30)
    @given(
        st.recursive(
            st.none() | st.booleans() | st.text() | st.integers() | st.floats(),
            lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
            max_leaves=12,
        )
    )
    def test_cleaning_leaves_only_json(self, value: Any) -> None:
        clean = finite_or_none(value)
        assert json.loads(json.dumps(clean, allow_nan=False)) == clean


class TestJson:
    def test_it_can_be_read_again(self) -> None:
        report = make_report(failures=make_failures())
        assert Report.model_validate_json(report_json(report)) == report


class TestVerdicts:
    @pytest.mark.parametrize(
        ("rmse", "level", "tone"),
        [
            (0.041, "QL0", "good"),
            (0.05, "QL0", "good"),
            (0.0501, "QL1 and QL2", "good"),
            (0.2, "QL3", "good"),
            (0.201, "above", "attention"),
        ],
    )
    def test_accuracy_is_measured_against_the_levels(
        self, rmse: float, level: str, tone: str
    ) -> None:
        verdict = verdicts(with_rmse(rmse))[0]
        assert level in verdict.text
        assert verdict.tone == tone
        assert "open ground" in verdict.text

    @pytest.mark.parametrize("rmse", [0.0312, None])
    def test_checkpoints_tell_how_the_terrain_fits_where_no_reference_does(
        self, rmse: float | None
    ) -> None:
        at = CheckpointStatistics(n=7, rmse_v1_m=rmse), CheckpointStatistics(n=0)
        tested = Checkpoints(statement="", nva=at[0], vva=at[1], points=())
        said = verdicts(make_report(accuracy=None, checkpoints=tested))[0]
        assert ("7 open checkpoints" in said.text) == (rmse is not None)

    def test_open_ground_goes_before_everything(self) -> None:
        made = Accuracy(
            dtm={"all": Statistics(n=9, rmse=0.3), "open_ground": Statistics(n=5, rmse=0.04)}
        )
        terrain = terrain_statistics(make_report(accuracy=made))
        assert terrain is not None
        assert terrain[0] == "open_ground"

    def test_lost_points_come_first(self) -> None:
        first = verdicts(make_report(counts=Counts(points_in=100, points_out=97)))[0]
        assert first.tone == "bad"
        assert first.text.startswith("3 points fewer out than in")
        first = verdicts(make_report(counts=Counts(points_in=100, points_out=101)))[0]
        assert first.text.startswith("1 points more")

    def test_a_survey_that_is_mostly_unfiltered_is_told_loudly(self) -> None:
        report = make_report(
            counts=Counts(points_in=100, points_out=100, signal=49, not_assessed=51, no_beam=51)
        )
        (said,) = [v for v in verdicts(report) if "delivered" in v.text]
        assert said.tone == "bad"
        told = dict(screen_summary(report))["attention"]
        assert told.startswith("51.0 % of the points have no usable time or no trajectory")
        assert told.isascii()
        half = Counts(points_in=100, points_out=100, signal=50, not_assessed=50, no_beam=50)
        assert "attention" not in dict(screen_summary(make_report(counts=half)))
        aside = Counts(points_in=100, points_out=100, signal=40, not_assessed=60, outside_aoi=60)
        assert "attention" not in dict(screen_summary(make_report(counts=aside))), "as asked for"

    def test_no_survey_of_which_nothing_was_assessed_looks_well(self) -> None:
        counts = Counts(points_in=100, points_out=100, not_assessed=100)
        (said,) = [v for v in verdicts(make_report(counts=counts)) if "delivered" in v.text]
        assert (said.tone, "none was assessed" in said.text) == ("bad", True)
        none = make_report(
            counts=counts, noise=make_report().noise.model_copy(update={"method": "none"})
        )
        (said,) = [v for v in verdicts(none) if "delivered" in v.text]
        assert said.tone == "good", "linear-mode clouds are not filtered"


class TestSummary:
    def test_it_holds_the_few_numbers(self) -> None:
        rows = dict(screen_summary(make_report()))
        assert rows["points"] == "11 284 033 in, 11 284 033 out"
        assert rows["signal"] == "7 012 655 (62.1 % of all points)"
        assert rows["background noise"] == "3 894 201 (34.5 % of all points)"
        assert rows["ground"] == "2 977 310 (26.4 % of all points)"
        assert rows["DTM accuracy"].startswith("RMSE 4.")
        assert rows["run time"] == "1 min 44 s (108 k points/s)"
        assert rows["failures"] == "none"

    @pytest.mark.parametrize(
        "make", [make_report, smallest_report, lambda: make_report(failures=make_failures())]
    )
    def test_any_console_can_show_it(self, make: Callable[[], Report]) -> None:
        for label, value in screen_summary(make()):
            assert (label + value).isascii()

    def test_noise_is_a_share_of_all_points_as_every_share_is(self) -> None:
        counts = Counts(
            points_in=20, points_out=20, signal=6, background=1, afterpulse=1, not_assessed=12
        )
        assert noise_removed(make_report(counts=counts)) == 0.1
        assert noise_removed(smallest_report()) is None


class TestFormat:
    @pytest.mark.parametrize(
        ("shown", "expected"),
        [
            (text.number(1234567), "1 234 567"),
            (text.number(-0.004, 2), "0.00"),
            (text.significant(0.09312), "0.0931"),
            (text.share(0.0), "0 %"),
            (text.significant(9.999), "10.0"),
            (text.significant(0), "0"),
            (text.significant(3.2e-7, 2), "3.2\N{MULTIPLICATION SIGN}10\u207b\u2077"),
            (text.percent(0.00001), "< 0.1 %"),
            (text.percent(0.0), "0.0 %"),
            (text.large(99_950), "100 k"),
            (text.large(999_600), "1.00 M"),
            (text.duration(59.96), "1 min 00 s"),
            (text.duration(3599.6), "1 h 00 min"),
            (text.duration(50 * 3600), "2 d 2 h"),
            (text.size(38_000_001), "38.0 MB"),
            (text.centimetres(0.0412), "4.1 cm"),
            (text.millimetres(-0.00801), "\N{MINUS SIGN}8.0 mm"),
            (text.of_all(411, 1000), "41.1 % of all points"),
            (text.of_all(1, 0, "photons"), "\N{EN DASH} of all photons"),
            (text.as_ascii(f"5 m\u00b2 {text.significant(2e12)}"), "5 m\u00b2 2.00x10^12"),
            (text.expected_count(0.0079, "about"), "fewer than 1"),
            (text.expected_count(738.2, "about"), "about 740"),
            (text.plain(0.25), "0.25"),
            (text.surface_name("all"), "all surfaces"),
            (text.surface_name("slope_5_15"), "slope 5\N{EN DASH}15\N{DEGREE SIGN}"),
        ],
    )
    def test_numbers_read_well(self, shown: str, expected: str) -> None:
        assert shown.replace(NARROW, " ") == expected

    @pytest.mark.parametrize(
        "function",
        [
            text.number,
            text.significant,
            text.plain,
            text.percent,
            text.large,
            text.duration,
            text.size,
            text.centimetres,
            text.metres,
            text.millimetres,
        ],
    )
    def test_nothing_is_a_dash(self, function: Any) -> None:
        assert function(None) == text.DASH

    @given(st.floats(min_value=1e-12, max_value=1e15))
    def test_significant_keeps_three_figures(self, value: float) -> None:
        shown = text.significant(value).replace(NARROW, "").replace(text.MINUS, "-")
        back = float(text.as_ascii(shown).replace("x10^", "e"))
        assert back == pytest.approx(value, rel=5.001e-3)
