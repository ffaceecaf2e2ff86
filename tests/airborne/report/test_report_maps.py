"""Maps of delivered rasters: the report reads each that it has a picture of."""

from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from spl_batch.airborne.products.product_table import PRODUCTS
from spl_batch.airborne.report import summarise
from spl_batch.airborne.report.pictures import PictureInputs
from spl_batch.formats.rasters.parts import Part


def test_each_raster_with_a_picture_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers = {f"{product.name}.tif": k for k, product in enumerate(PRODUCTS)}

    def overview(path: Path, _: Any = None) -> Part:
        return Part(np.full((2, 2), numbers[path.name], np.float32), 0.0, 2.0, 1.0)

    monkeypatch.setattr(summarise, "_overview", overview)
    monkeypatch.setattr(summarise, "difference_map", lambda *_: None)
    monkeypatch.setattr(summarise, "cut_profile", lambda *_: None)
    context: Any = SimpleNamespace(output=tmp_path, store=SimpleNamespace(local=tmp_path))
    inputs = summarise._pictures({}, context, None)
    pictured = {field.name for field in fields(PictureInputs)} & {p.name for p in PRODUCTS}
    assert len(pictured) > 4
    for name in pictured:
        assert getattr(inputs, name).values[0, 0] == numbers[f"{name}.tif"]
