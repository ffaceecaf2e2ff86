"""The sections of the workflow file, each default written here and nowhere else.

Each key has its unit in its name or in its description.
"""

from spl_batch.airborne.settings.classes import ClassSettings, VegetationSettings
from spl_batch.airborne.settings.filters import (
    AesSettings,
    CylinderSettings,
    DccSettings,
    FilterSettings,
    MultilevelSettings,
    PixelSettings,
    VoxelSettings,
    WireSettings,
)
from spl_batch.airborne.settings.noise import AfterpulseSettings, NoiseSettings
from spl_batch.airborne.settings.requirements import RequirementSettings
from spl_batch.airborne.settings.surfaces import (
    GroundSettings,
    ProductSettings,
    PtdSettings,
    SmrfSettings,
)
from spl_batch.airborne.settings.survey import (
    AcquisitionSettings,
    OutputSettings,
    ReferenceSettings,
    SurveySettings,
    TilingSettings,
)

__all__ = [
    "AcquisitionSettings",
    "AesSettings",
    "AfterpulseSettings",
    "ClassSettings",
    "CylinderSettings",
    "DccSettings",
    "FilterSettings",
    "GroundSettings",
    "MultilevelSettings",
    "NoiseSettings",
    "OutputSettings",
    "PixelSettings",
    "ProductSettings",
    "PtdSettings",
    "ReferenceSettings",
    "RequirementSettings",
    "SmrfSettings",
    "SurveySettings",
    "TilingSettings",
    "VegetationSettings",
    "VoxelSettings",
    "WireSettings",
]
