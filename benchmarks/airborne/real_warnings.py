"""Whether runs on real clouds warn of anything that is not so.

Run ``python -m benchmarks.airborne.real_warnings FOLDER``.

FOLDER has real clouds of single-photon lidar in ``spl/`` (beamlets in ``user_data``) and of
linear-mode lidar in ``linear/``. Each is a survey of its own, run with the settings of its kind;
its warnings are printed to be read. A cloud whose CRS is refused is run again in :data:`CRS`. What
is counted are those that judge the fit: noise, air, lags, ranges, flightlines that lie apart.
"""

import argparse
import json
import re
import tempfile
from pathlib import Path
from typing import Final

from benchmarks.airborne.ground.whole_runs import WORKFLOWS
from spl_batch.engine.verbs.running import run
from spl_batch.errors import WorkflowError

CRS: Final = "EPSG:32612"
"""UTM zone of the cloud of the samples whose own CRS is wrong."""

OF_FIT: Final = re.compile(
    r"haze|cloud:|fog|mist|cross|bloom|one and the same range|afterpulse|law|noise is dense|"
    r"appear twice|what its model expects|filter\.alpha|p-value|floats|on one beam|"
    r"swing|ranges walk|so strong a light"
)
"""Words of warnings that the model of noise, instrument or flightlines does not fit."""


def warnings(path: Path, kind: str, folder: Path) -> list[str]:
    """What a run on a cloud warns of, or why it is refused."""
    workflow = folder / "workflow.yaml"
    workflow.write_text(WORKFLOWS[kind].format(path))
    said: list[str] = []
    for overrides in ([], [f"survey.crs={CRS}"]):
        try:
            run(workflow, workers=0, overrides=overrides)
        except WorkflowError as refused:
            said.append(f"refused: {refused}")
            continue
        report = json.loads((folder / "out" / "report.json").read_text())
        return [*said, *report["warnings"]]
    return said


def main() -> None:
    """Run all clouds and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    for kind, name in (("spl100", "spl"), ("linear", "linear")):
        for path in sorted((folder / name).glob("*.la[sz]")):
            with tempfile.TemporaryDirectory() as temporary:
                said = warnings(path.resolve(), kind, Path(temporary))
            misfits = sum(bool(OF_FIT.search(text)) for text in said)
            print(f"{path.name}: {len(said)} warnings, {misfits} of them of the fit", flush=True)
            for text in said:
                print(f"    {text}")


if __name__ == "__main__":
    main()
