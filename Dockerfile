# haustra on a CPU: docker build -t haustra .
#   docker run --rm haustra reconstruct --demo -o /tmp/demo_run
#   docker run --rm --network=none --user "$(id -u):$(id -g)" -v FILMS:/input:ro -v OUT:/output haustra      (CLiMB)
# The steps from here on are in scripts/image_steps.sh, which scripts/check_image.sh runs without Docker too.
FROM python:3.11.13-slim-bookworm AS build
COPY . /src
RUN sh /src/scripts/image_steps.sh wheel /src /wheels

FROM python:3.11.13-slim-bookworm
LABEL org.opencontainers.image.title="haustra" org.opencontainers.image.licenses="Apache-2.0"
COPY --from=build /wheels /wheels
COPY constraints.txt scripts/image_steps.sh scripts/system_libraries.sh /setup/
RUN sh /setup/system_libraries.sh && rm -rf /var/lib/apt/lists/*
RUN sh /setup/image_steps.sh install /opt/haustra /wheels /setup/constraints.txt && rm -rf /wheels
# Whoever it runs as may write its caches, and nothing else but what is mounted.
ENV PATH=/opt/haustra/bin:$PATH HOME=/tmp MPLCONFIGDIR=/tmp/matplotlib NUMBA_CACHE_DIR=/tmp/numba PYTHONUNBUFFERED=1
RUN useradd --uid 1000 haustra && mkdir -p /input /output && chown haustra /output
USER haustra
WORKDIR /output
ENTRYPOINT ["sh", "/setup/image_steps.sh", "run"]
