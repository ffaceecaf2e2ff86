from spl_batch.airborne.arrays.filtering import (
    expected_noise as expected_noise,
)
from spl_batch.airborne.arrays.filtering import (
    filter_points as filter_points,
)
from spl_batch.airborne.arrays.labels import (
    ExpectedNoise as ExpectedNoise,
)
from spl_batch.airborne.arrays.labels import (
    Labels as Labels,
)
from spl_batch.airborne.arrays.surfaces import (
    Rasters as Rasters,
)
from spl_batch.airborne.arrays.surfaces import (
    ground_points as ground_points,
)
from spl_batch.airborne.arrays.surfaces import (
    rasterize as rasterize,
)

__version__: str
