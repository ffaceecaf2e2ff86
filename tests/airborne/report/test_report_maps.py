"""Maps of delivered rasters: the report reads each that it has a picture of."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from spl_batch.airborne.products.product_table import PRODUCTS
from spl_batch.airborne.report import summarise
from spl_batch.airborne.report.pictures import PICTURES
from spl_batch.formats.rasters.parts import RasterPart


def test_each_raster_with_a_picture_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers = {f"{product.name}.tif": k for k, product in enumerate(PRODUCTS)}

    def overview(path: Path, _: Any = None) -> RasterPart:
        return RasterPart(np.full((2, 2), numbers[path.name], np.float32), 0.0, 2.0, 1.0)

    monkeypatch.setattr(summarise, "_overview", overview)
    context: Any = SimpleNamespace(output=tmp_path, store=SimpleNamespace(local=tmp_path))
    found = summarise._parts({}, context, None)
    pictured = {*PICTURES} & {p.name for p in PRODUCTS}
    assert len(pictured) > 4
    for name in pictured:
        assert found[name].values[0, 0] == numbers[f"{name}.tif"]
