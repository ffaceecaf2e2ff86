"""What each code of a photon track's findings means (:mod:`spl_batch.engine.findings`)."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from spl_batch.engine.findings import Code

CODES: Final[Mapping[str, Code]] = MappingProxyType(
    {
        "P01": Code(
            "Photons or references that do not serve",
            {
                "unplaced": "{count:photons} without height or place, delivered unlabelled",
                "labels": "{what}: nothing is compared with it",
            },
            remedy="name files of the same track that have them",
            noun="beam",
        ),
        "P02": Code(
            "Labels of a beam are uncertain",
            "{what}",
            noun="beam",
        ),
    }
)
"""Codes of altimetry."""
