"""COPC twins of delivered clouds, and the catalogues of everything that was delivered."""

from collections.abc import Iterator
from typing import Any

from spl_batch.airborne.accuracy.evidence import LEVELS
from spl_batch.airborne.plan.flightlines import swath_totals
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.plan.task_memory import refusal
from spl_batch.engine.tasks.task import Task


def copc_name(delivered: str) -> str:
    """Name below the output of the COPC twin of a delivered cloud."""
    return f"copc/{delivered.removesuffix('.laz')}.copc.laz"


def deliver_copc(survey: Survey) -> Iterator[Task]:
    """Delivered clouds, each to be written once more as an octree."""
    if not survey.workflow.outputs.copc:
        return
    for key, receipt in sorted(survey.of("deliver_file").items()):
        name = receipt.facts["name"]
        args = {"source": f"laz/{name}", "target": copc_name(name)}
        refused = refusal("deliver_copc", receipt.points, survey.memory_bytes)
        yield Task("deliver_copc", key, args, (("deliver_file", key),), receipt.points, refused)


def catalogue(survey: Survey) -> Iterator[Task]:
    """One task, once there is anything to list."""
    delivered = survey.of("deliver_file")
    if not survey.workflow.outputs.catalogue or not delivered:
        return
    twins = survey.of("deliver_copc")
    made_of = ("mosaic", "deliver_geoid")
    rasters = [(kind, name, r) for kind in made_of for name, r in sorted(survey.of(kind).items())]
    clouds = {key: _cloud(survey, key, key in twins) for key in sorted(delivered)}
    checkpoints = survey.of("checkpoints")
    args = {
        "clouds": list(clouds.values()),
        "rasters": [n for *_, r in rasters for n in r.outputs if "store/" not in n],
        "flightlines": list(_flightlines(survey, clouds)),
        "checkpoints": [one for r in checkpoints.values() for one in r.facts["checkpoints"]],
        "cells": sorted(survey.of("surface")),
    }
    needs = (
        *(("deliver_file", key) for key in clouds),
        *(("deliver_copc", key) for key in sorted(twins)),
        *((kind, name) for kind, name, _ in rasters),
        *(("checkpoints", name) for name in sorted(checkpoints)),
        *(("surface", name) for name in sorted(survey.of("surface"))),
    )
    yield Task("deliver_catalogue", "all", args, needs)


def _cloud(survey: Survey, key: str, as_copc: bool) -> dict[str, Any]:  # noqa: FBT001 - one caller
    name = survey.of("deliver_file")[key].facts["name"]
    facts = survey.of("index_file")[key].facts
    spans = [span for mine in facts["spans"].values() for span in mine]
    known = facts["standard"] == "adjusted" and spans
    return {
        "href": copc_name(name) if as_copc else f"laz/{name}",
        "span_s": [min(s[0] for s in spans), max(s[1] for s in spans)] if known else None,
    }


def _flightlines(survey: Survey, clouds: dict[str, dict[str, Any]]) -> Iterator[dict[str, Any]]:
    level = LEVELS[survey.workflow.requirements.quality_level].spacing
    swaths = swath_totals(survey.of("surface").values(), survey.flown, level)
    for line in survey.flown:
        swath = swaths.get(line.name)
        files = [clouds[key]["href"] for key in line.sources if key in clouds]
        if files:
            yield {
                "id": line.name,
                "psid": line.psid,
                "number": line.number,
                "points": line.points,
                "first_s": line.first_s,
                "last_s": line.last_s,
                "area_m2": None if swath is None else swath.area_m2,
                "per_m2": None if swath is None else swath.pulses / swath.area_m2,
                "files": files,
            }
