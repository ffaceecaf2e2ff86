"""Which tasks are done again when a setting changes."""

import pytest

from spl_batch.airborne.settings import NoiseSettings
from spl_batch.airborne.steps import STEPS


@pytest.mark.parametrize("kind", ["sights", "observe", "fit_line", "scatter"])
def test_the_time_domain_depends_on_all_of_the_noise_but_haze(kind):
    keys = {key.removeprefix("noise.") for key in STEPS[kind].settings if key.startswith("noise")}
    assert keys == set(NoiseSettings.model_fields) - {"haze"}


@pytest.mark.parametrize("kind", ["index_part", "sights", "observe", "fit_line", "scatter"])
def test_what_reads_channels_depends_on_where_they_are(kind):
    assert "survey.channel_dimension" in STEPS[kind].settings


def test_the_filter_depends_on_haze():
    assert "noise" in STEPS["denoise"].settings
