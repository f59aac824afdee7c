#!/usr/bin/env bash
# Builds everything that a release consists of, and installs each part into an empty environment:
#
#   deploy/release.sh [FOLDER]    default: dist/VERSION
#
# Source archive; wheels for x86-64 and aarch64, for Python 3.11 and for 3.12 and later; Debian packages for this
# computer, and for arm64 where Debian's cross compiler is; the list of components; SHA256SUMS. Needs python3.11, and
# python3.12 or later with their headers, what deploy/debian/build.sh needs, and for the Debian packages' trial root and
# mmdebstrap; for arm64 elsewhere also arch-test and qemu-user-static. What is missing is left out, and the last lines
# say so; what fails ends it with 1.
set -uo pipefail
cd "$(dirname "$0")/.."

version=$(deploy/version.sh)
output=$(realpath -m "${1:-dist/$version}")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
export PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore
# Its C++ library is compiled once for both Pythons, if the compiler is at the same place.
export ZIG_GLOBAL_CACHE_DIR="${ZIG_GLOBAL_CACHE_DIR:-$work/zig}" ZIG_FOLDER="${ZIG_FOLDER:-$work/zig-program}"
mkdir -p "$output" "$work/log"
rows=() failed=0

# what, command...: done, or with the end of what it said why not.
step() {
    local what=$1 began=$SECONDS
    shift
    if "$@" >"$work/log/last" 2>&1; then
        rows+=("good    $what ($((SECONDS - began)) s)")
    else
        rows+=("FAILED  $what: $(tail -n 1 "$work/log/last")") failed=1
        tail -n 20 "$work/log/last" >&2
    fi
    echo "${rows[-1]}"
}
without() { rows+=("absent  $1: $2"); echo "${rows[-1]}"; }

sdist() {
    python3 -m venv "$work/build" &&
        "$work/build/bin/pip" install --quiet --no-compile --require-hashes -r requirements/build.lock &&
        git archive --prefix=source/ HEAD | tar -x -C "$work" && deploy/version.sh write "$work/source" &&
        (cd "$work/source" && "$work/build/bin/python" -c \
            'import sys; from scikit_build_core.build import build_sdist; print(build_sdist(sys.argv[1]))' "$output")
}

# python, archive or wheel...: into a new environment with nothing but what is locked, what builds an archive too
installs() {
    local python=$1 here=$work/env-$1
    shift
    rm -rf "$here"
    "$python" -m venv "$here" &&
        "$here/bin/pip" install --quiet --no-compile --require-hashes -r requirements/run.lock \
            -r requirements/build.lock &&
        "$here/bin/pip" install --quiet --no-compile --no-index --no-build-isolation --no-deps "$@" &&
        "$here/bin/talc-gateway" --version | grep -F "$version" &&
        (cd "$work" && "$here/bin/talc-gateway" check "$OLDPWD/deploy/debian/gateway.toml" &&
            "$here/bin/python" -c 'import talc.learner, talc._kernel, simulators.devices')
}

debian_installs() {  # its architecture, packages
    local architecture=$1
    shift
    mmdebstrap --architectures="$architecture" --variant=minbase --include=python3,libstdc++6,passwd --format=null \
        --customize-hook='mkdir "$1/packages"' --customize-hook="copy-in $* /packages" \
        --customize-hook='chroot "$1" sh -c "dpkg --install /packages/*.deb"' \
        --customize-hook='chroot "$1" talc-gateway check /etc/talc-gateway/gateway.toml' \
        --customize-hook='chroot "$1" /opt/talc-gateway/bin/python -c "import gateway.reporting.page"' \
        "$(sed -n 's/^VERSION_CODENAME=//p' /etc/os-release)" /dev/null
}

step "source archive" sdist
for python in python3.11 python3.12; do
    if "$python" --version >/dev/null 2>&1; then
        step "wheels, x86-64 and aarch64, by $python" env PYTHON="$python" deploy/wheels.sh "$output"
    else
        without "wheels by $python" "no such interpreter"
    fi
done
for python in python3.11 python3.12 python3.13; do
    tag=cp312-abi3
    [ "$python" != python3.11 ] || tag=cp311-cp311
    if "$python" --version >/dev/null 2>&1; then
        step "$tag wheel into an empty $python" installs "$python" \
            "$output"/talc_gateway-*-"$tag"-*"$(uname -m)".whl "$output"/talc_gateway_simulators-*.whl
    else
        without "$tag wheel into an empty $python" "no such interpreter"
    fi
done
step "source archive into an empty python3" installs python3 \
    "$output"/talc_gateway-*.tar.gz "$output"/talc_gateway_simulators-*.whl
step "Debian packages" deploy/debian/build.sh "$output"
if command -v aarch64-linux-gnu-g++ >/dev/null; then
    # An environment that can print the commands' helps: that of the package cannot run here.
    step "Debian packages for arm64" env ARCH=arm64 PYTHON="$work/env-python3/bin/python" deploy/debian/build.sh "$output"
else
    without "Debian packages for arm64" "no g++-aarch64-linux-gnu"
fi
without "wheels for $([ "$(uname -m)" = aarch64 ] && echo x86-64 || echo aarch64) into an empty Python" "another kind of computer"
bill() { dpkg-deb --fsys-tarfile "$output"/talc-gateway_*_"$(dpkg --print-architecture)".deb |
    tar -xO ./usr/share/doc/talc-gateway/sbom.cdx.json >"$output/talc-gateway-$version.cdx.json"; }
step "list of components" bill

for architecture in amd64 arm64; do
    packages=("$output"/talc-gateway*_"$architecture".deb) what="Debian packages for $architecture into an empty Debian"
    if [ ! -e "${packages[0]}" ]; then
        without "$what" "not built"
    elif [ "$(id -u)" != 0 ] || ! command -v mmdebstrap >/dev/null; then
        without "$what" "needs root and mmdebstrap"
    elif [ "$architecture" != "$(dpkg --print-architecture)" ] && ! arch-test "$architecture" >/dev/null 2>&1; then
        without "$what" "needs arch-test and qemu-user-static"
    else
        step "$what" debian_installs "$architecture" "${packages[@]}"
    fi
done
(cd "$output" && rm -f SHA256SUMS && sha256sum -- * >SHA256SUMS)
printf '\n%s\n' "$output"
(cd "$output" && ls -lh | awk 'NR > 1 { print $5 "\t" $9 }')
printf '%s\n' "${rows[@]}"
exit $failed
