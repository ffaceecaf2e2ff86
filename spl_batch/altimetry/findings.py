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
                "no hdf5": "is no HDF5 file, which ATL08 is: nothing is compared with it",
                "atl03": "is of ATL03 and has no gtxx/signal_photons, as ATL08 has: nothing is "
                "compared with it",
                "no atl08": "has no gtxx/signal_photons, as ATL08 has: nothing is compared with it",
                "no atl03": "ATL08 is of ATL03's photons alone, and track.photons has none: "
                "nothing is compared with it",
                "granule": "no file of reference.labels has photons of this beam's segments and "
                "times",
                "terrain": "no file of reference.labels has a terrain height along this beam's "
                "ground",
                "points": "reference.points {name} has heights between {from_km:.7g} and "
                "{to_km:.7g} km along the track, the ground lies between {first_km:.7g} and "
                "{last_km:.7g} km",
                "unplaced ground": "reference.dtm {name} needs latitude and longitude, which the "
                "photons lack",
                "dtm": "reference.dtm {name} has no height at any ground of this beam: it reaches "
                "from {dtm[0]:.4f} to {dtm[2]:.4f} E and {dtm[1]:.4f} to {dtm[3]:.4f} N, the "
                "ground from {ground[0]:.4f} to {ground[2]:.4f} E and {ground[1]:.4f} to "
                "{ground[3]:.4f} N",
            },
            remedy="name files of the same track that have them",
            noun="beam",
        ),
        "P02": Code(
            "Labels of a beam are uncertain",
            {
                "all": "all {kept:photons} are signal; no noise is seen",
                "none": "no photon of {noise} is signal: nothing but noise is seen",
                "clumps": "the {kept:photons} called signal cannot be distinguished from noise, "
                "which comes in clumps ({noise:photons} of noise are expected among them)",
                "floor": "the {floor:photons} called floor below water are no more than the noise "
                "that is expected among the signal, {noise:photons}",
            },
            "signal, ground and canopy are not to be relied on",
            noun="beam",
        ),
    }
)
"""Codes of altimetry."""
