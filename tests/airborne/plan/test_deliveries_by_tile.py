"""A survey that is cut by tile gives what the same survey gives by flightline."""

from itertools import pairwise
from pathlib import Path

import numpy as np

from tests import surveys

NAMES = ("X", "Y", "Z", "gps_time", "channel", "return_number", "noise_class", "classification")


def decided(output: Path) -> np.ndarray:
    """Every return with what the run found, whatever file it is in."""
    clouds = surveys.delivered(output)
    whole = {k: np.concatenate([c[k] for c in clouds.values()]) for k in NAMES}
    return surveys.point_rows(whole, NAMES)


def test_flightlines_cut_by_tile_without_their_ids_are_put_together(
    small_output: Path, tmp_path: Path
) -> None:
    pause_s = 3.0
    survey = surveys.join(
        *(
            surveys.flightline(shots=120, psid=0, start_s=surveys.START_S + pause_s * k, seed=k + 1)
            for k in (0, 1)
        )
    )
    east = survey["x"] - surveys.ORIGIN_M[0]
    tiles = [(low < east) & (east <= high) for low, high in pairwise([-np.inf, 1, 2, 5, np.inf])]
    assert all(len(np.unique(survey["gps_time"][mine] // pause_s)) == 2 for mine in tiles)
    for k, mine in enumerate(tiles):
        surveys.write_cloud(tmp_path / "lines" / f"{k}.laz", surveys.take(survey, mine))
    result = surveys.run(surveys.write_workflow(tmp_path, survey={"gap_s": 1.0}))

    assert len(result.report.survey.flightlines) == 2
    assert np.array_equal(decided(result.output), decided(small_output))
    for name, raster in surveys.rasters(small_output).items():
        assert surveys.rasters(result.output)[name] == raster, name
    for k, mine in enumerate(tiles):
        time = surveys.delivered(result.output)[f"lines/{k}.laz"]["gps_time"]
        assert np.array_equal(time, survey["gps_time"][mine]), "each file keeps its own order"
