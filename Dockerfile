# docker build -t boresight .
# docker run --rm -v "$PWD:/work" boresight run cubesat --trials 200
# docker run --rm -v "$PWD:/work" boresight solve photo.jpg --annotate solved.png
FROM python:3.12-slim AS build
WORKDIR /src
COPY pyproject.toml README.md LICENSE ./
COPY scenarios scenarios
COPY simulator simulator
COPY startracker startracker
RUN pip install --no-cache-dir build && python -m build --wheel --outdir /wheels

FROM python:3.12-slim
COPY --from=build /wheels /wheels
RUN pip install --no-cache-dir /wheels/*.whl && rm -r /wheels
# Kernels are compiled for the processor of the machine that builds the image; another processor compiles them again, once
# for each container. Any user may write there.
ENV NUMBA_CACHE_DIR=/var/cache/boresight XDG_CACHE_HOME=/var/cache/boresight MPLCONFIGDIR=/var/cache/boresight
RUN mkdir -m 1777 /var/cache/boresight \
 && boresight warm-up \
 && chmod -R a+rwX /var/cache/boresight
WORKDIR /work
USER 1000
ENTRYPOINT ["boresight"]
CMD []
