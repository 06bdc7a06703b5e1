# Shared by tools/demo, tools/test and tools/docs, which set $root and source this file. `set_up demo` or `set_up test` installs
# what the job needs and sets $python to an interpreter that has the package. As root on Debian and its relatives it
# installs missing packages with apt; elsewhere one message says what to install.

log=$root/out/setup.log
# glslc, because the libshaderc1 of Debian 12 can't be loaded: it lacks symbols. A test links them from glslang-dev.
archive_packages='python3 python3-venv libvulkan1 libshaderc1 glslc'
archive_packages_test='vulkan-validationlayers spirv-tools xvfb xauth xdotool libllvm19 libatomic1 glslang-dev binutils'
# The first Mesa whose software device traces rays.
mesa_with_rays=24.1

say() { printf 'setup: %s\n' "$*"; }

fail() {
    printf 'setup: %s\n' "$*" >&2
    exit 1
}

# Runs a command with its output in the log; a failure shows the end of it.
logged() {
    mkdir -p "$root/out"
    printf '\n== %s\n' "$*" >>"$log"
    "$@" >>"$log" 2>&1 && return
    tail -n 12 "$log" >&2
    fail "failed: $* (all its output is in $log)"
}

set_up() {
    job=$1
    python=$root/.venv/bin/python
    steps=
    step 'system packages' install_system_packages
    begin_driver
    step 'Python packages' make_environment
    step "driver${driver_job:+, begun beside them}" install_driver
}

# Runs a command, and notes in $steps how long it took if that was a second or more: step NAME COMMAND ...
step() {
    step_name=$1
    shift
    step_began=$(date +%s)
    "$@"
    step_seconds=$(($(date +%s) - step_began))
    [ "$step_seconds" -lt 1 ] || steps="${steps:+$steps, }$step_name $step_seconds s"
}

# ---- system packages -----------------------------------------------------------------------------------

find_python() {
    for system_python in ${PYTHON:-} python3 python3.14 python3.13 python3.12 python3.11; do
        "$system_python" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && return
    done
    return 1
}

missing_now() {
    if find_python; then
        "$system_python" "$root/tools/missing.py" "$job"
    else
        echo 'Python 3.11 or later with venv'
    fi
}

install_system_packages() {
    missing=$(missing_now)
    [ -n "$missing" ] || return 0
    packages=$archive_packages
    [ "$job" = demo ] || packages="$packages $archive_packages_test"
    if can_use_apt; then
        say "installing $packages"
        logged apt-get update
        # shellcheck disable=SC2086 # a list of words
        apt_install $packages
        missing=$(missing_now)
        [ -n "$missing" ] || return 0
    fi
    # shellcheck disable=SC2086
    fail "missing: $(echo "$missing" | paste -s -d , - | sed 's/,/, /g'). $(how_to_install $packages)"
}

can_use_apt() { [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; }

apt_install() {
    DEBIAN_FRONTEND=noninteractive
    export DEBIAN_FRONTEND
    logged apt-get install -y --no-install-recommends -o Dpkg::Use-Pty=0 "$@"
}

# What to type for the packages of this system that stand for the given ones of Debian.
how_to_install() {
    echo 'Install it and run this again:'
    if command -v apt-get >/dev/null; then
        echo "    sudo apt-get install $*"
    elif command -v dnf >/dev/null; then
        echo '    sudo dnf install python3 vulkan-loader libshaderc glslc mesa-vulkan-drivers'
        [ "$job" = demo ] || echo '    sudo dnf install vulkan-validation-layers spirv-tools xorg-x11-server-Xvfb xdotool llvm19-libs libatomic'
    elif command -v pacman >/dev/null; then
        echo '    sudo pacman -S python vulkan-icd-loader shaderc vulkan-swrast'
        [ "$job" = demo ] || echo '    sudo pacman -S vulkan-validation-layers spirv-tools xorg-server-xvfb xdotool llvm19-libs'
    elif [ "$(uname)" = Darwin ]; then
        echo '    brew install python vulkan-loader shaderc'
        echo 'MoltenVK, the Vulkan driver of macOS, has not been tried.'
    else
        echo "    the packages of your system that are called $* on Debian"
    fi
}

# ---- virtual environment -------------------------------------------------------------------------------

make_environment() {
    extras="[$job]"
    if [ "$job" = demo ]; then
        # Open Image Denoise has packages for some machines only; elsewhere the demo shows the realtime renderer's picture.
        extras=$([ "$(uname -m)" != x86_64 ] && echo '[formats,terminal]' || echo '[formats,oidn,terminal]')
    fi
    stamp=$root/.venv/set_up_for_$job
    wanted=$(cd "$root" && cat pyproject.toml | cksum)
    if "$python" -c '' 2>/dev/null; then
        [ "$(cat "$stamp" 2>/dev/null)" != "$wanted" ] || return 0
    else
        find_python || fail "missing: Python 3.11 or later with venv. $(how_to_install python3 python3-venv)"
        say "creating a virtual environment in $root/.venv"
        logged "$system_python" -m venv --clear "$root/.venv"
    fi
    say "installing the package${extras:+ and its extras $extras}"
    logged "$python" -m pip install --disable-pip-version-check --editable "$root$extras"
    printf '%s\n' "$wanted" >"$stamp"
}

# ---- driver --------------------------------------------------------------------------------------------

# Whether a device can be used: has_device CONDITION
has_device() {
    "$python" -c "
import sys
from solari_vk.gpu.device.device import list_devices
sys.exit(not any(not device.missing and ($1) for device in list_devices()))" 2>/dev/null
}

# Without ray queries a software device takes several times as long, and the tests need them.
has_good_device() { has_device "device.kind != 'cpu' or not device.missing_rays['query']"; }

# Where there is no driver at all, one is installed while pip works.
begin_driver() {
    driver_job=
    can_use_apt && find_python && ! has_driver || return 0
    install_mesa &
    driver_job=$!
    trap 'wait "$driver_job" || true' EXIT # so that apt isn't left at work
}

has_driver() {
    [ -z "${VK_DRIVER_FILES:-}${VK_ICD_FILENAMES:-}" ] || return 0
    for manifest in /usr/share/vulkan/icd.d/*.json /usr/local/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json; do
        [ ! -e "$manifest" ] || return 0
    done
    return 1
}

install_driver() {
    if [ -n "$driver_job" ]; then
        trap - EXIT
        wait "$driver_job" # its failure has said why
    fi
    has_good_device && return
    if can_use_apt && [ -z "$driver_job" ]; then
        find_python
        install_mesa
        has_good_device && return
    fi
    [ "$job" != demo ] || ! has_device True || return 0
    "$python" -m solari_vk info >&2 || true
    fail "no Vulkan device that can be used. $(how_to_install_driver)"
}

install_mesa() {
    say "installing Mesa's software device"
    if ! dpkg --compare-versions "$(candidate)" ge "$mesa_with_rays"; then
        release=$(. /etc/os-release && echo "${VERSION_CODENAME:-}")-backports
        # A failure ends this inner shell alone.
        ! (add_backports "$release" && apt_install -t "$release" mesa-vulkan-drivers) || return 0
        say "going on with Mesa $(candidate), which has no ray queries: pictures take several times as long"
    fi
    apt_install mesa-vulkan-drivers
}

# The version of Mesa that apt would install.
candidate() { apt-cache policy mesa-vulkan-drivers | sed -n 's/^ *Candidate: //p' | sed 's/(none)/0/;s/^$/0/'; }

add_backports() {
    apt-cache policy mesa-vulkan-drivers | grep -q "$1/" && return
    added=$("$system_python" "$root/tools/backports.py" "$1") || fail "Mesa $mesa_with_rays or later is needed, and $1 can't be added"
    say "added $1 to apt: $added"
    logged apt-get update
}

how_to_install_driver() {
    echo 'Install a driver with Vulkan 1.3: that of your GPU, or Mesa for its software device, which has ray queries from Mesa 24.1 on.'
    if [ "$(uname)" = Darwin ]; then
        echo 'MoltenVK, the Vulkan driver of macOS, has not been tried.'
    elif command -v apt-get >/dev/null; then
        echo '    sudo apt-get install mesa-vulkan-drivers'
        echo 'Debian 12 has it in its backports. These commands add them, from where this machine gets its packages:'
        echo "    sudo $root/.venv/bin/python $root/tools/backports.py bookworm-backports && sudo apt-get update"
        echo '    sudo apt-get install -t bookworm-backports mesa-vulkan-drivers'
    else
        how_to_install mesa-vulkan-drivers
    fi
}
