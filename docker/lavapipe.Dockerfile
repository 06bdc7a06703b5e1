# solari_vk on the processor, by Mesa's lavapipe. From the top of a checkout:
#   docker build -f docker/lavapipe.Dockerfile -t solari-vk .
#   docker run --rm -v "$PWD:/work" solari-vk render builtin:cornell_box -o box.png

# The wheel, with all shaders compiled by glslc.
FROM python:3.13-slim-trixie AS wheel
RUN apt-get update && apt-get install -y --no-install-recommends glslc && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY pyproject.toml hatch_build.py README.md LICENSE ./
COPY solari_vk solari_vk
COPY glsl glsl
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

# Debian 13 has Mesa 25.0, whose lavapipe traces rays.
FROM python:3.13-slim-trixie
RUN apt-get update \
    && apt-get install -y --no-install-recommends libvulkan1 mesa-vulkan-drivers \
    && rm -rf /var/lib/apt/lists/*
COPY --from=wheel /wheels /wheels
RUN pip install --no-cache-dir "$(echo /wheels/*.whl)[all]"
# The driver's compiled shaders: keep them by -v solari-vk-cache:/cache
ENV XDG_CACHE_HOME=/cache
WORKDIR /work
ENTRYPOINT ["solari-vk"]
CMD ["info"]
