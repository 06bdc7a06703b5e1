# solari_vk on an NVIDIA card. The host needs the driver and NVIDIA's container toolkit. From the top of a checkout:
#   docker build -f docker/nvidia.Dockerfile -t solari-vk-nvidia .
#   docker run --rm --gpus all -v "$PWD:/work" solari-vk-nvidia render builtin:cornell_box -o box.png

# The wheel, with all shaders compiled by glslc.
FROM python:3.13-slim-trixie AS wheel
RUN apt-get update && apt-get install -y --no-install-recommends glslc && rm -rf /var/lib/apt/lists/*
WORKDIR /source
COPY pyproject.toml hatch_build.py README.md LICENSE ./
COPY solari_vk solari_vk
COPY glsl glsl
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

# The toolkit brings the driver into the container; the loader, and the X11 libraries that NVIDIA's Vulkan driver links
# to, come from Debian. No X server is needed.
FROM python:3.13-slim-trixie
RUN apt-get update \
    && apt-get install -y --no-install-recommends libvulkan1 libx11-6 libxext6 libegl1 \
    && rm -rf /var/lib/apt/lists/*
# By default the toolkit brings CUDA alone. "graphics" is Vulkan, "utility" is nvidia-smi.
ENV NVIDIA_VISIBLE_DEVICES=all
ENV NVIDIA_DRIVER_CAPABILITIES=graphics,utility
COPY --from=wheel /wheels /wheels
RUN pip install --no-cache-dir "$(echo /wheels/*.whl)[all]"
ENV XDG_CACHE_HOME=/cache
WORKDIR /work
ENTRYPOINT ["solari-vk"]
CMD ["info"]
