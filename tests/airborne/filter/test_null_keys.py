"""Drawn tables belong to settings: one rule for both, and no setting is overlooked."""

from typing import Any

import numpy as np
import pytest

from spl_batch.airborne.filter.ellipsoid import null_distribution
from spl_batch.airborne.filter.ellipsoid.null_distribution import settings_key
from spl_batch.airborne.filter.wires import wire_null
from spl_batch.airborne.settings import FilterSettings, WireSettings
from spl_batch.engine.settings.base import Section

FILTER = FilterSettings()
FILTERS: dict[str, Any] = {
    "method": "aes",
    "test": "published",
    "alpha": 0.02,
    **{
        k: getattr(FILTER, k)
        for k in ("wires", "aes", "dcc", "pixels", "voxel", "multilevel", "cylinder")
    },
}
"""Another value of each setting that the null distribution is said not to depend on."""

TABLES = [
    pytest.param(FILTER, null_distribution.IRRELEVANT, id="null_table"),
    pytest.param(FILTER.wires, wire_null.IRRELEVANT, id="wire_null"),
]


@pytest.mark.parametrize(("section", "irrelevant"), TABLES)
def test_a_setting_is_part_of_the_key_unless_it_is_named(
    section: Section, irrelevant: frozenset[str]
) -> None:
    fields = set(type(section).model_fields)
    assert irrelevant < fields, "a setting that there is no more"
    assert set(settings_key(section, irrelevant)) == fields - irrelevant


def test_what_is_named_changes_nothing_that_is_drawn() -> None:
    density = np.array([0.05, 0.1, 0.2, 0.4, 0.8])
    given = null_distribution.draw_table(FILTER, 1500, density)
    assert set(FILTERS) == null_distribution.IRRELEVANT
    other = FILTER.model_copy(
        update={**FILTERS, "wires": WireSettings(enabled=False, half_length_m=7.0)}
    )
    found = null_distribution.draw_table(other, 1500, density)
    for name in ("score", "own", "link_m"):
        np.testing.assert_array_equal(getattr(found, name), getattr(given, name))
    lax = FILTER.wires.model_copy(update={"alpha": 0.05})
    share = wire_null.draw_shares(lax, 20_000, density[2:3])
    switched = lax.model_copy(update={"enabled": False, "classify": True})
    np.testing.assert_array_equal(wire_null.draw_shares(switched, 20_000, density[2:3]), share)
    assert share > 0
