"""Steps of ``kind: altimetry``, in the order in which they are done."""

from typing import Final

from spl_batch.engine.tasks.step import Step, Steps, table

_TASKS: Final = "spl_batch.altimetry.tasks"

STEPS: Final[Steps] = table(
    Step(
        name="index_file",
        stage="index",
        run=f"{_TASKS}.index:index_file",
        tasks="spl_batch.altimetry.plan:index_file",
        unit="file",
    ),
    Step(
        name="take_in",
        stage="index",
        run=f"{_TASKS}.index:take_in",
        tasks="spl_batch.altimetry.plan:take_in",
        settings=("rate.cell_m", "signal.window_m", "work"),
        unit="beam",
    ),
    Step(
        name="label",
        stage="signal",
        run=f"{_TASKS}.labels:label_segment",
        tasks="spl_batch.altimetry.plan:label",
        settings=("rate", "signal", "profile.photons_factor", "reference.baseline"),
        unit="segment",
        bytes_per_point=500,
        remedy="lower work.segment_photons or signal.window_m",
    ),
    Step(
        name="profile",
        stage="profile",
        run=f"{_TASKS}.heights:profile_beam",
        tasks="spl_batch.altimetry.plan:profile",
        settings=("profile", "reference.baseline"),
        unit="beam",
    ),
    Step(
        name="compare",
        stage="profile",
        run=f"{_TASKS}.heights:compare",
        tasks="spl_batch.altimetry.plan:compare",
        settings=("reference",),
        unit="beam",
    ),
    Step(
        name="deliver_beam",
        stage="deliver",
        run=f"{_TASKS}.delivery:deliver_beam",
        tasks="spl_batch.altimetry.plan:deliver_beam",
        after=("profile",),
        settings=("outputs.refraction", "track.off_nadir_deg"),
        unit="beam",
        delivers=True,
    ),
    Step(
        name="deliver_file",
        stage="deliver",
        run=f"{_TASKS}.delivery:deliver_file",
        tasks="spl_batch.altimetry.plan:deliver_file",
        after=("profile",),
        settings=("outputs.hdf5",),
        delivers=True,
    ),
)
"""What is done, in the order in which it is done."""
