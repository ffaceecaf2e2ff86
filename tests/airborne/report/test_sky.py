"""Haze and noise that does not fit its model, in the report's words."""

from types import SimpleNamespace

import numpy as np
import pytest
import rasterio
from affine import Affine

from spl_batch.airborne.lines.pair_table import PairDifference
from spl_batch.airborne.report.fit import places
from spl_batch.airborne.report.fit.clouds import haze, haze_warning
from spl_batch.airborne.report.fit.fog import fog_warning, thin_haze_warning
from spl_batch.airborne.report.fit.layers import misfit_warning
from spl_batch.airborne.report.fit.light import strong_light_warning
from spl_batch.airborne.report.fit.noise_fit import float_warning, noise_fit, uniform_warning
from spl_batch.airborne.report.fit.sky import drowned_warning, kept_warning
from spl_batch.airborne.settings import FilterSettings
from spl_batch.formats.rasters.parts import read_overview


def receipt(**facts):
    return SimpleNamespace(facts=facts)


def block(squares, low, high, returns=9000, expected=500.0, west=0):
    return {
        "squares": squares, "cubes": 4 * squares, "returns": returns, "expected": expected,
        "low": low * 1000, "high": high * 1000,
        "box": [west * 1000, 0, (west + 100) * 1000, 100_000],
    }  # fmt: skip


@pytest.fixture
def context(tmp_path):
    survey = SimpleNamespace(channel_dimension=None)
    return SimpleNamespace(output=tmp_path, workflow=SimpleNamespace(survey=survey))


def done(airs=(), layers=()):
    blocks = {str(k): receipt(air=air, layers=[]) for k, air in enumerate(airs)}
    for k, rows in enumerate(layers):
        core = [k * 300_000, 0, (k + 1) * 300_000, 300_000]
        blocks[f"l{k}"] = receipt(air=None, layers=rows, core=core)
    files = {"a": receipt(bounds=[10_000, 0, 0, 2_990_000, 100_000, 50_000])}
    return {"denoise": blocks, "index_file": files}


def test_haze_of_blocks_that_touch_is_one_sentence_with_height_area_and_factor(context):
    found = haze(done([block(100, 60, 90), block(300, 70, 110, 27_000, 1500.0, 100)]), context)
    assert found.area_km2 == pytest.approx(0.01)
    assert found.times_expected == pytest.approx(18)
    assert found.mean_per_m3 == pytest.approx(36_000 / (1600 * 125))
    assert (found.low_m, found.high_m) == (60.0, 110.0)
    assert found.extent_m == (0.0, 200.0, 0.0, 100.0)
    assert (found.others, found.others_area_km2, found.noise_class) == (0, None, None)
    (text,) = haze_warning(found)
    assert "18.0 times" in text
    assert "0.010 km2" in text
    assert "class 18" in text
    below = {"above_ground_m": -100.0, "top_above_ground_m": -62.5, "noise_class": 7}
    (text,) = haze_warning(found.model_copy(update=below))
    assert "between 62 and 100 m below ground" in text
    assert "class 18" not in text


def test_clouds_that_lie_apart_or_at_other_heights_are_not_averaged(context):
    near, far = block(500, 30, 50), block(400, 200, 230, west=9000)
    above = block(300, 120, 160)
    found = haze(done([near, far, above]), context)
    assert (found.low_m, found.high_m, found.others) == (30.0, 50.0, 2)
    assert found.extent_m == (0.0, 100.0, 0.0, 100.0)
    (text,) = haze_warning(found)
    assert "between heights of 30 and 50 m" in text
    assert "over 0.012 km2 within x 0 to 100 and y 0 to 100" in text
    assert text.endswith("There are 2 more such places, 0.017 km2 in all")
    (text,) = haze_warning(haze(done([near, far]), context))
    assert text.endswith("There is 1 more such place, of 0.010 km2")


@pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")
def test_a_cloud_between_the_walls_of_a_valley_is_above_its_floor(context):
    """Terrain is that below each place of the air: the box around all holds more wall."""
    heights = np.full((100, 100), 125.0, np.float32)
    diagonal = np.abs(np.subtract.outer(np.arange(100), np.arange(100))) <= 30
    heights[diagonal] = 40.0
    write_dtm(context.output / "dtm.tif", 0.0, heights)
    places = [[5 * k, 15 - 5 * k, 5 * k + 5, 20 - 5 * k, 16, 20, 25, 125, 5000, 250.0]
              for k in range(4)]  # fmt: skip
    air = block(100, 80, 105, 20_000, 1000.0) | {"places": places}
    found = haze(done([air]), context)
    assert (found.above_ground_m, found.top_above_ground_m, found.noise_class) == (40.0, 65.0, 18)
    assert found.returns == 20_000
    (text,) = haze_warning(found)
    assert "noise between 40 and 65 m above ground is 20.0 times" in text
    assert "class 18" in text
    places[0][4:6] = [2, 4]
    assert haze(done([air]), context).noise_class == 18
    for place in places:
        place[4:6] = [2, 4]
    (text,) = haze_warning(haze(done([air]), context))
    assert "between 15 and 30 m below ground" in text
    assert "class 7" in text


def write_dtm(path, west, height, cells=(100, 100)):
    profile = {"driver": "GTiff", "height": cells[0], "width": cells[1], "count": 1,
               "dtype": "float32", "nodata": -9999.0,
               "transform": Affine(1.0, 0.0, west, 0.0, -1.0, 100.0)}  # fmt: skip
    with rasterio.open(path, "w", **profile) as target:
        target.write(np.broadcast_to(np.float32(height), cells), 1)


@pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")
def test_the_ground_below_haze_is_that_of_the_piece_below_it_in_coarse_cells(context, monkeypatch):
    write_dtm(context.output / "dtm.tif", 5000.0, 500.0)
    write_dtm(context.output / "dtm_2.tif", 0.0, 20.0, (99, 3000))
    write_dtm(context.output / "dtm_quality_2.tif", 0.0, 0.02, (99, 3000))
    seen = []

    def reading(path, **given):
        seen.append(read_overview(path, **given))
        return seen[-1]

    monkeypatch.setattr(places, "read_overview", reading)
    wide = {**block(100, 60, 90), "box": [0, 0, 3_000_000, 100_000]}
    assert haze(done([wide, wide]), context).above_ground_m == pytest.approx(40.0)
    assert [max(part.values.shape) for part in seen] == [1000, 1000]


def test_a_few_squares_of_haze_or_no_more_noise_than_usual_are_not_told(context):
    assert haze(done([block(10, 60, 90)]), context) is None
    assert haze(done([block(100, 60, 90, returns=400)]), context) is None
    assert list(haze_warning(None)) == []


def test_noise_that_fits_its_model_is_not_told(context):
    rows = [[layer, 1000, 1010.0] for layer in range(40)]
    assert list(misfit_warning(done(layers=[rows]), context)) == []
    assert list(misfit_warning(done(), context)) == []


def test_noise_that_falls_along_the_gate_is_told_with_its_heights(context):
    above = [[layer, 1400, 1000.0] for layer in range(20)]
    below = [[layer, 990, 1000.0] for layer in range(-20, 0)]
    (text,) = misfit_warning(done(layers=[below + above[:8], above[8:]]), context)
    assert "1.40 times between 0 and 100 m" in text
    assert "-100" not in text
    assert "if this is linear-mode lidar" in text
    context.workflow.survey.channel_dimension = "user_data"
    (text,) = misfit_warning(done(layers=[below + above]), context)
    assert "linear" not in text


def test_noise_that_is_off_in_a_part_of_the_survey_alone_is_told_with_that_part(context):
    fits, thrice = ([[layer, times, 1000.0] for layer in range(40)] for times in (1000, 3000))
    parts = [fits] * 9
    (text,) = misfit_warning(done(layers=[thrice, *parts]), context)
    assert "expects in 1 of 10 blocks; the worst lies within x 10 to 300 and y 0 to 100" in text
    assert "and there it is 3.00 times between 0 and 200 m in height. Where there is more" in text
    half = [[layer, 480, 1000.0] for layer in range(40)]
    twice = [[layer, 2000, 1000.0] for layer in range(40)]
    (text,) = misfit_warning(done(layers=[twice, half]), context)
    assert "in 2 of 2 blocks; the worst lies within x 10 to 300" in text
    assert "2.00 times between" in text
    ground = [[layer, 2300 if layer < 8 else 800, 1000.0] for layer in range(40)]
    assert list(misfit_warning(done(layers=[ground, *parts]), context)) == []
    few = [[layer, 12, 4.0] for layer in range(40)]
    assert list(misfit_warning(done(layers=[few, fits]), context)) == []
    (text,) = misfit_warning(done(layers=[twice, twice, thrice]), context)
    assert "2.33 times between 0 and 200 m in height, within x 10 to 2990" in text
    assert "It is off in 3 of 3 blocks; the worst lies within x 600 to 900" in text


def test_a_difference_by_chance_or_in_few_returns_is_not_told(context):
    rows = [[layer, 1000, 1000.0] for layer in range(40)] + [[60, 9, 4.0], [61, 300, 100.0]]
    assert list(misfit_warning(done(layers=[rows]), context)) == []


def test_fog_is_told_where_most_places_are_filled_with_the_height_that_it_reaches():
    cells = {
        "a": receipt(filled=[50, 40, 36, 30, 5, 0, 0, 0, 0]),
        "b": receipt(filled=[50] + [40] * 2 + [10] * 6),
    }
    (text,) = fog_warning({"surface": cells})
    assert "up to 2.8 m above the ground evenly in 80 % of 0.010 km2, in places up to 8.8 m" in text
    cells["b"].facts["filled"] = [50] + [40] * 2 + [5, 0, 0, 0, 0, 0]
    cells["a"].facts["filled"] = [50, 40, 36, 0, 0, 0, 0, 0, 0]
    (text,) = fog_warning({"surface": cells})
    assert "of 0.010 km2: ground fog" in text
    bare = {"a": receipt(filled=[100, 20, 0, 0, 0, 0, 0, 0, 0]), "b": receipt()}
    assert list(fog_warning({"surface": bare})) == []
    assert list(fog_warning({"surface": {"a": receipt(filled=[10] * 9)}})) == []


def test_what_flightlines_that_lie_apart_fill_is_no_fog():
    filled = {"a": receipt(filled=[100, 90, 0, 0, 0, 0, 0, 0, 0])}
    mist = {"a": receipt(filled=[100, 9, 0, 0, 0, 0, 0, 0, 0], mist=[[12.0, 0.0, 0.0]])}
    for up_m, told in ((0.2, 1), (1.2, 0)):
        numbers = dict.fromkeys(PairDifference._fields, 0.0) | {"up_m": up_m, "noise_m": 0.05}
        numbers |= {"first": "00001_7", "second": "00002_9"}
        pairs = {"all": receipt(pairs=[list(numbers.values())])}
        both, other = [[1, 5, 5, []], [2, 6, 6, []]], [[1, 5, 5, []], [3, 6, 6, []]]
        for cells in (filled, mist):
            cells["a"].facts.pop("swaths", None)
            assert len(list(fog_warning({"surface": cells, "strip_pairs": pairs}))) == told
            for swaths, fits in ((both, told), (other, 1)):
                cells["a"].facts["swaths"] = swaths
                assert len(list(fog_warning({"surface": cells, "strip_pairs": pairs}))) == fits


def test_flightlines_that_lie_apart_do_not_hide_fog_elsewhere():
    numbers = dict.fromkeys(PairDifference._fields, 0.0) | {"up_m": 1.2, "noise_m": 0.05}
    numbers |= {"first": "00001_7", "second": "00002_9"}
    pairs = {"all": receipt(pairs=[list(numbers.values())])}
    swaths = {"swaths": [[1, 5, 5, []], [2, 6, 6, []]]}
    cells = {
        "far": receipt(filled=[100, 90, 0, 0, 0, 0, 0, 0, 0], **swaths),
        "fog": receipt(filled=[100, 95, 0, 0, 0, 0, 0, 0, 0], swaths=[[3, 8, 8, []]]),
    }
    (text,) = fog_warning({"surface": cells, "strip_pairs": pairs})
    assert "evenly in 95 % of 0.010 km2" in text
    cells["fog"] = receipt(filled=[100, 90, 90, 90, 0, 0, 0, 0, 0], **swaths)
    assert "up to 3.8 m" in next(fog_warning({"surface": cells, "strip_pairs": pairs}))


def test_mist_in_patches_is_told_where_most_ground_is_clear():
    clear = [100, 20, 20, 0, 0, 0, 0, 0, 0]
    cell = receipt(filled=clear, mist=[[12.0, 45_000.0, 55_000.0], [7.0, 0.0, 0.0]])
    (text,) = fog_warning({"surface": {"a": cell}})
    assert "up to 2.8 m and more above the ground evenly in 2 patches, 1 900 m2 in all" in text
    assert "the largest of 1 200 m2 at 45 E, 55 N" in text
    cell.facts["filled"] = [100, 90, 90, 0, 0, 0, 0, 0, 0]
    (text,) = fog_warning({"surface": {"a": cell}})
    assert "ground fog" in text


def test_thin_haze_is_told_with_its_place_and_not_beside_fog():
    layers = {"thin_haze": [[12.0, 20.0, 29.0, 45_000.0, 55_000.0, 0.0]]}
    low = {"thin_haze": [[30.0, 0.8, 9.0, 245_000.0, 55_000.0, 0.9]]}
    cells = {"a": receipt(**layers), "b": receipt(**low)}
    (text,) = thin_haze_warning({"surface": cells})
    assert "2 thin layers above the ground, 4 200 m2 in all, the largest of 3 000 m2" in text
    assert "at 245 E, 55 N, 1 to 9 m above it" in text
    cells["b"].facts |= {"filled": [100, 20, 20, 0, 0, 0, 0, 0, 0], "mist": [[30.0, 0.0, 0.0]]}
    assert "mist" in next(fog_warning({"surface": cells}))
    assert list(thin_haze_warning({"surface": cells})) == [text]
    cells["b"].facts["filled"] = [100, 90, 90, 0, 0, 0, 0, 0, 0]
    assert len(list(fog_warning({"surface": cells}))) == 1
    (text,) = thin_haze_warning({"surface": cells})
    assert "1 thin layer above the ground, 1 200 m2 in all" in text
    assert not list(thin_haze_warning({"surface": {"a": receipt(thin_haze=[])}}))


def test_dense_noise_that_leaves_no_surface_is_told_with_place_and_area():
    cells = {
        "a": receipt(core=[0, 0, 200_000, 200_000], dense=[1600, 300, 1600.0], below=[0, 0]),
        "b": receipt(core=[200_000, 0, 400_000, 200_000], dense=[400, 0, 1000.0], below=[0, 0]),
        "c": receipt(core=[400_000, 0, 600_000, 200_000]),
    }
    (text,) = drowned_warning({"ground": cells})
    assert "1.3 returns per m3 over 0.050 km2" in text
    assert "7 500 m2" in text
    assert "x 0 to 200 and y 0 to 200" in text
    cells["c"].facts["dense"] = [400, 100, 900.0]
    (text,) = drowned_warning({"ground": cells})
    assert "in 2 places, the largest within x 0 to 200 and y 0 to 200, no surface" in text
    few = {"a": receipt(core=[0, 0, 200_000, 200_000], dense=[1600, 19, 400.0])}
    (text,) = drowned_warning({"ground": few})
    assert text.startswith("noise is dense, 0.25 returns per m3 over 0.040 km2: wires")
    for dense in ([1600, 19, 290.0], [15, 0, 9.0]):
        less = {"a": receipt(core=[0, 0, 200_000, 200_000], dense=dense)}
        assert list(drowned_warning({"ground": less})) == []


@pytest.mark.parametrize(("kept", "told"), [(400, 0), (600, 1)])
def test_noise_that_is_kept_where_nothing_stands_is_told(kept, told):
    cells = {"a": receipt(below=[kept, 60_000]), "b": receipt(below=[0, 40_000]), "c": receipt()}
    texts = list(kept_warning({"ground": cells}, FilterSettings()))
    assert len(texts) == told
    assert all("0.60 % of 100 600" in text for text in texts)
    assert list(kept_warning({"ground": cells}, FilterSettings(method="aes"))) == []


def ground_cell(west, p_values, afloat):
    core = [west * 1000, 0, (west + 200) * 1000, 200_000]
    return receipt(core=core, p_values=p_values, afloat=afloat)


def test_p_values_that_are_not_uniform_are_told_with_place_and_consequence():
    fits, dense = [50, 50, 150, 250, 500, 4000], [150, 100, 300, 350, 600, 4000]
    cells = {"a": ground_cell(0, fits, [0, 900, 0]), "b": ground_cell(200, dense, [0, 900, 0])}
    (text,) = uniform_warning({"ground": cells})
    assert "2.00 times as many of 5 500 returns as the model" in text
    assert "up to 0.05, in 1 of 2 ground cells, within x 200 to 400 and y 0 to 200: " in text
    points = {"f": receipt(bounds=[20_000, 30_000, 0, 350_000, 90_000, 9])}
    (text,) = uniform_warning({"ground": cells, "index_file": points})
    assert "within x 200 to 350 and y 30 to 90: " in text
    assert "denser than expected" in text
    assert noise_fit({"ground": cells}).p_value_times == pytest.approx(1.67, abs=0.01)
    cells["d"] = ground_cell(800, [2 * count for count in dense], [0, 900, 0])
    (text,) = uniform_warning({"ground": cells})
    assert "in 2 of 3 ground cells, in 2 places, the largest within x 800 to 1000 and" in text
    thin = {"a": ground_cell(0, [20, 20, 60, 100, 100, 4700], [0, 900, 0])}
    assert "weak signals are lost" in next(uniform_warning({"ground": thin}))
    for some in ({"a": cells["a"]}, {"a": receipt(core=[0, 0, 0, 0])}, {}):
        assert list(uniform_warning({"ground": some})) == []


def test_signal_that_floats_over_an_area_is_told_with_its_share_and_place():
    settings = FilterSettings()
    cells = {
        "a": ground_cell(0, [0] * 6, [400, 10_000, 30, 50_000, 95_000, 0, 45_000]),
        "b": ground_cell(200, [0] * 6, [90, 10_000, 60, 200_000, 395_000, 0, 195_000]),
        "c": receipt(core=[0, 0, 0, 0]),
    }
    (text,) = float_warning({"ground": cells}, settings)
    assert "4.0 % of the signal within x 50 to 100 and y 0 to 50, 400 returns over 750 m2" in text
    assert noise_fit({"ground": cells}).floating_share == pytest.approx(0.0245)
    assert list(float_warning({"ground": {"b": cells["b"]}}, settings)) == []
    far = cells["a"].facts | {"core": [900_000, 0, 1_100_000, 200_000]}
    far["afloat"] = [300, 10_000, 20, 950_000, 995_000, 0, 45_000]
    (text,) = float_warning({"ground": cells | {"d": receipt(**far)}}, settings)
    assert "of the signal in 2 places, the largest within x 50 to 100 and y 0 to 50, 700" in text
    assert list(float_warning({"ground": cells}, FilterSettings(alpha=0.01))) == []
    assert list(float_warning({}, settings)) == []
    assert noise_fit({"ground": {"c": cells["c"]}}) is None


def test_light_is_told_where_it_is_strong_and_not_where_noise_fills_the_beamlets():
    def said(seen, noise_per_m, beamlets=100):
        facts = {"seen_fraction": seen, "noise_per_m": noise_per_m, "gate_m": 250.0}
        facts["beamlets"] = beamlets
        return list(strong_light_warning({"fit_line": {"00001_5": receipt(**facts)}}))

    (text,) = said(0.998, 0.001)
    assert text.startswith("flightline 00001_5: 99.8 % of the beamlets have a return, by a signal")
    assert "some 6.0 photo-electrons" in text
    assert said(1.0, 0.001)
    assert not said(0.65, 0.002)
    assert not said(0.96, 0.01)
    assert not said(None, None)
    assert not said(1.0, 0.001, beamlets=1), "a shot whose beamlets are not told apart"
