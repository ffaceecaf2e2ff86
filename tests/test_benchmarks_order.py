"""Orders that the sources' tables turn on, on twins small enough for tests."""

from pathlib import Path

import pytest

from benchmarks import corridors, methods
from benchmarks.corridors import Counts
from benchmarks.twins import easton

FILTERS = ("published", "aes_alone", "dcc", "ours")


@pytest.fixture(scope="module")
def corridor(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Counts]:
    """The regions of both lines of a small Easton, by filter."""
    survey = methods.make_survey(easton(1, (40.0, 36.0)), Path(tmp_path_factory.mktemp("easton")))
    points, known = methods.load_truth(survey), methods.known_methods()
    regions = [corridors.region(spans, points) for _, spans in corridors.lines(survey)]
    found = {}
    for name in FILTERS:
        kept = methods.judge(survey, known[name]) == 0
        first, second = (corridors.count(points, kept, region) for region in regions)
        found[name] = first + second
    return found


@pytest.mark.slow
def test_wires_are_found_in_the_order_of_the_source(corridor: dict[str, Counts]) -> None:
    # [W18] Tables 1 and 2: 89.1, 25.9, 13.4 and 59.0, 29.3, 11.1 %.
    assert corridor["published"].wire > 300
    detection = [corridor[name].detection for name in ("published", "aes_alone", "dcc")]
    assert detection[0] > detection[1] + 20 > detection[2] + 40
    assert corridor["ours"].detection >= detection[0]


@pytest.mark.slow
def test_corridors_keep_less_noise_than_by_the_published_test(corridor: dict[str, Counts]) -> None:
    ours, published = corridor["ours"], corridor["published"]
    assert ours.noise_kept < published.noise_kept
    assert ours.false_alarm < published.false_alarm
