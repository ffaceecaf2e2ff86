"""What failed is marked where it is, on each map; tables are called as their headings."""

import io

import numpy as np
import pytest
from PIL import Image
from spl_batch.engine.report.layers import layers

from spl_batch.engine.report import style
from spl_batch.engine.report.maps import Raster, draw_ramp, map_place
from spl_batch.engine.report.page import named_tables
from spl_batch.engine.report.parts import Failure
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.verbs.failures import extent_m


def failure(extent: tuple[float, float, float, float] | None) -> Failure:
    return Failure(stage="denoise", place="tile 1_2", reason="memory", extent_m=extent)


@pytest.mark.pictures
@pytest.mark.parametrize(
    ("shape", "cells"),
    [((40, 60), (12, 20, 5, 25)), ((10, 90), (2, 6, 40, 70)), ((1900, 1000), (400, 800, 100, 500))],
)
def test_a_mark_lies_on_what_it_marks(
    shape: tuple[int, int], cells: tuple[int, int, int, int]
) -> None:
    top, bottom, left, right = cells
    values = np.zeros(shape)
    values[top:bottom, left:right] = 1.0
    raster = Raster(values, (100.0, 100.0 + 2 * shape[1], 500.0, 500.0 + 2 * shape[0]))
    drawn = draw_ramp(raster, "t", "u", ramp=style.SKY, limits=(0.0, 1.0))
    png, width, height = style.to_png(drawn)
    north = 500.0 + 2 * shape[0]
    place = (100.0 + 2 * left, 100.0 + 2 * right, north - 2 * bottom, north - 2 * top)
    picture = Picture("t", "c", "t", png, width, height, map_place(raster))
    (layer,) = layers(["map", "none"], {"map": picture}, [failure(place), failure(None)])
    ((x, y, wide, high),) = (mark.box for mark in layer.marks)
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    dark = abs(pixels - [0x57, 0x1C, 0x3F]).sum(axis=2) < 9
    box = map_place(raster).box
    dark[:, round((box[0] + box[2]) * width) :] = False  # the colour bar
    dark[round((box[1] + box[3]) * height) :] = False
    rows, columns = np.nonzero(dark)
    assert rows.min() == pytest.approx(y * height, abs=2.5)
    assert rows.max() == pytest.approx((y + high) * height, abs=2.5)
    assert columns.min() == pytest.approx(x * width, abs=2.5)
    assert columns.max() == pytest.approx((x + wide) * width, abs=2.5)


def test_what_lies_beside_a_map_or_has_no_place_is_not_marked() -> None:
    raster = Raster(np.ones((4, 4)), (0.0, 4.0, 0.0, 4.0))
    picture = Picture("t", "c", "t", b"png", 10, 10, map_place(raster))
    beside = failure((4.0, 8.0, 0.0, 4.0))
    assert layers(["a"], {"a": picture}, [beside, failure(None)])[0].marks == ()
    assert layers(["a"], {"a": Picture("t", "c")}, [failure((0.0, 1.0, 0.0, 1.0))])[0].marks == ()


def test_a_unit_s_name_tells_its_place() -> None:
    assert extent_m("2_-3", 50.0) == (100.0, 150.0, -150.0, -100.0)
    assert extent_m("-4_12_2_3", 50.0) == (-200.0, -100.0, 600.0, 750.0)


TABLE = '<div class="scroll" tabindex="0"><table class="x"></table></div>'


def test_a_table_is_called_as_its_heading_and_a_second_one_is_counted() -> None:
    page = f'{TABLE}<h2 id="a">One <b>&amp; all</b></h2>{TABLE}<p>{TABLE}<h3>"Two"</h3>{TABLE}'
    made = named_tables(page)
    names = ["Table", "One &amp; all", "One &amp; all, table 2", "&quot;Two&quot;"]
    for name in names:
        assert (
            f'role="region" aria-label="{name}, scrolls"><table aria-label="{name}" class' in made
        )
    assert made.count("aria-label") == 2 * len(names)
    assert named_tables("<p>no table</p>") == "<p>no table</p>"
