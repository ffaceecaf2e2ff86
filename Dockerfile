# An image with the command, which runs as a user without rights.
#
#   docker build -t spl-batch .
#   docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/data" -v spl-batch-cache:/cache \
#     spl-batch run workflow.yaml
#
# Compiled kernels are kept in /cache: without that volume each container compiles them again.

FROM python:3.12-slim AS build
WORKDIR /source
COPY pyproject.toml README.md LICENSE ./
COPY spl_batch spl_batch
RUN pip wheel --no-cache-dir --wheel-dir /wheels .

FROM python:3.12-slim
# GDAL in the wheels of rasterio and pyogrio takes this library from the system.
RUN apt-get update && apt-get install --yes --no-install-recommends libexpat1 \
    && rm -rf /var/lib/apt/lists/*
RUN --mount=type=bind,from=build,source=/wheels,target=/wheels \
    pip install --no-cache-dir --no-index --find-links /wheels spl-batch \
    && useradd --create-home spl && install --directory --mode 1777 /cache
ENV NUMBA_CACHE_DIR=/cache HOME=/tmp MPLCONFIGDIR=/tmp/matplotlib
USER spl
WORKDIR /data
ENTRYPOINT ["spl-batch"]
CMD ["--help"]
