# Aucamp for a ground computer, without a GPU. Which extras are in it: docker compose build --build-arg EXTRAS=enhance,view
ARG PYTHON=3.11

FROM python:${PYTHON}-slim AS build
ARG EXTRAS=""
# Another place to look for packages: PyTorch's own has it for processors alone, two gigabytes smaller.
ARG PIP_EXTRA_INDEX_URL=""
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
WORKDIR /src
COPY LICENSE README.md constraints.txt pyproject.toml ./
COPY agent agent
COPY aucamp aucamp
COPY hw hw
COPY replay replay
COPY router_config router_config
RUN python -m venv /opt/aucamp
RUN /opt/aucamp/bin/pip install --constraint constraints.txt ".${EXTRAS:+[$EXTRAS]}"

FROM python:${PYTHON}-slim
COPY --from=build /opt/aucamp /opt/aucamp
# Whoever runs it, by number, may write there: compiled functions are kept from one start to the next, a twin has a file.
RUN mkdir --mode=1777 /var/cache/aucamp /twin
ENV PATH=/opt/aucamp/bin:$PATH HOME=/tmp MPLCONFIGDIR=/tmp/matplotlib NUMBA_CACHE_DIR=/var/cache/aucamp PYTHONUNBUFFERED=1
USER 1000:1000
WORKDIR /recordings
ENTRYPOINT ["aucamp"]
